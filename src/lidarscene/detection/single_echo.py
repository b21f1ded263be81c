"""Single echo: finder for pulses with one echo each, in closed form.

The peak of a single Gaussian echo, its crossing time and its measured amplitude need no search. This module holds that
case; `multi_echo` handles several sub-echoes, and agrees with this one pulse by pulse where there is one
(docs/theory.md 7 to 9).

Symbols: P_d probability of a detection, s signal at the peak, t time of flight.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..light.echoes import Echoes
from ..maths.arrays import Array, xp
from ..maths.random import Seed
from ..physics.optics import pulse as pulse_shape
from ..physics.optics import radiometry
from ..sensor.sensor_model import Sensor
from . import comparator
from . import stops as stop_list
from .outcomes import Status
from .pulses import timing
from .shots import Shots
from .stops import EMPTY, Found, Stop


@dataclass(frozen=True, slots=True, kw_only=True)
class SingleEcho(Shots):
    """Comparator and TDC for n pulses with one echo each."""

    echoes: Echoes

    @classmethod
    def of(cls, echoes: Echoes, sensor: Sensor, *, seed: Seed, pulse: Array) -> SingleEcho:
        """Prepare the search; arguments as of `receiver.detect`."""
        point = sensor.working_point(echoes.background_power_w)
        return cls(
            sensor=sensor,
            point=point,
            threshold=sensor.threshold(point),
            seed=seed,
            pulse=pulse,
            fluctuation=echoes.fluctuation,
            echoes=echoes,
        )

    def search(self) -> Found:
        """Detect and measure the echo of each pulse; theory (T24) to (T26)."""
        echoes, sensor = self.echoes, self.sensor
        ops, fwhm = xp(echoes.range_m), sensor.received_fwhm_s
        trip = comparator.trip(self, echoes.peak_power_w)
        tripped = echoes.has_surface & trip.tripped
        power = ops.where(tripped, echoes.peak_power_w, 1.0)
        arrival = radiometry.time_of_flight_s(range_m=echoes.range_m)
        # With counted cells P_d is not Gaussian, so an echo may trip although its peak is below the level: at the peak
        # then.
        share = ops.where(tripped & (trip.level < trip.signal), self.point.response.power_w(trip.level) / power, 1.0)
        early = pulse_shape.leading_edge_time_s(level=share, fwhm_s=fwhm)
        crossing = arrival + early + comparator.count_lag_s(self, trip, share=share, peak_power_w=power)
        measured = timing.amplitude(self, trip, lag_s=early)
        width_s = None
        if sensor.tdc.both_edges:
            width_s = comparator.width_s(self, trip, peak_power_w=power, early_s=early)
        reported_s = timing.lone_pulse_time_s(
            self, trip, arrival_s=arrival, crossing_s=crossing, measured=measured, power_w=power, width_s=width_s
        )
        in_window = tripped & comparator.accepts_crossing(sensor, crossing) & comparator.is_range(reported_s)
        stop = Stop(
            key=ops.where(in_window, stop_list.sort_key(sensor.tdc, crossing, measured), EMPTY),
            crossing_s=crossing,
            reported_s=reported_s,
            amplitude=measured,
            width_s=width_s,
            status=ops.full(crossing, int(Status.ECHO)),
        )
        return Found(
            stops=(stop, *stop_list.empty_stops(sensor.tdc, stop)[1:]),
            tripped=tripped,
            in_window=in_window,
            snr=ops.where(echoes.has_surface, self.point.snr(trip.expected), 0.0),
            detection_probability=ops.where(echoes.has_surface, trip.probability, 0.0),
        )
