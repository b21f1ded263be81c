"""Receiver: from the light of a pulse to what the sensor reports, whatever its electronics.

A *finder* searches the light for echoes and measures them. There are three, one for each way in which a receiver
looks at light: `SingleEcho`, a lone echo in closed form; `Rises`, the rises of a waveform; `Peaks`, the peaks of a
histogram. All that a converter does with what is found stands here once: which returns it keeps (`stops`), false alarms
(`alarms`), what it withholds (`withholding`), and the report with the outcome of each pulse (`report`).
"""

from __future__ import annotations

from dataclasses import fields

from ..light.echoes import Echoes, EchoTrain, SubEchoes
from ..light.stray_light import ChannelLight, Crosstalk
from ..maths.arrays import Array
from ..maths.random import Seed
from ..physics.optics import radiometry
from ..sensor.sensor_model import Sensor
from . import ambient
from .alarms import add_alarms
from .multi_echo import Rises
from .photon_counting.column_noise import share_noise
from .photon_counting.peaks import Peaks
from .report import Detection, Measurement, Returns, outcome_of
from .reported_intensity import reported_intensity
from .single_echo import SingleEcho
from .stops import Stop, reported_stops
from .withholding import withhold_beside_glare

Finder = SingleEcho | Rises | Peaks


def is_plain(sensor: Sensor) -> bool:
    """True if the closed form for one echo per pulse (`single_echo`) holds for the sensor's receiver."""
    needs_waveform = (
        sensor.sampler is not None
        or sensor.histogram is not None
        or sensor.receiver.ac_coupling_hz is not None
        or sensor.laser.slope_broadening
    )
    return not needs_waveform and sensor.tdc.keep == "first"


def _choose_finder(light: Echoes | EchoTrain, sensor: Sensor, *, seed: Seed, pulse: Array) -> Finder:
    """Choose how the sensor looks for echoes in this light; arguments as of `detect`."""
    if isinstance(light, Echoes):
        return SingleEcho.of(light, sensor, seed=seed, pulse=pulse)
    if sensor.histogram is None:
        return Rises.of(light, sensor, seed=seed, pulse=pulse)
    return Peaks.of(light, sensor, seed=seed, pulse=pulse)


def detect(
    light: Echoes | EchoTrain,
    sensor: Sensor,
    *,
    seed: Seed,
    pulse: Array,
    channels: ChannelLight | None = None,
    crosstalk: Crosstalk | None = None,
) -> Detection:
    """Detect pulses: one `Returns` for each stop of the converter (docs/theory.md 7 to 9, docs/theory_light.md 5).

    Args:
        light: of each pulse: one echo in clear air, or a train of sub-echoes
        seed: 32-bit frame seed; every random number is keyed by (seed, stage, pulse)
        pulse: (n,) uint32 pulse numbers; with ``channels``, of whole scan lines in order of time
        channels: light of the pulses, computed before, in which other channels of their volley may glare; None: none
            does
        crosstalk: with ``channels``: which channels see each other's light
    """
    if isinstance(light, Echoes) and not is_plain(sensor):
        light = _train_of(light)
    finder = _choose_finder(light, sensor, seed=seed, pulse=pulse)
    # Echoes first: only they obey the dead time. Then false alarms compete with them for the stops.
    found = finder.search()
    kept = reported_stops(sensor.tdc, add_alarms(finder, found, light.interference))
    stops = tuple(_returns(finder, light, stop) for stop in kept)
    detection = Detection(
        snr=found.snr,
        detection_probability=found.detection_probability,
        outcome=outcome_of(stops, has_surface=light.has_surface, tripped=found.tripped, in_window=found.in_window),
        ambient=ambient.counts(light.background_power_w, sensor, seed=seed, pulse=pulse),
        stops=stops,
        source=found.source,
    )
    if isinstance(finder, Peaks):
        detection = share_noise(detection, finder)
    if channels is None or crosstalk is None:
        return detection
    return withhold_beside_glare(detection, channels, crosstalk, sensor, pulse=pulse)


def _returns(finder: Finder, light: Echoes | EchoTrain, stop: Stop) -> Returns:
    """Report what a stop holds: its time as a range, its amplitude on the maker's scale, and all that was measured."""
    range_m = radiometry.range_from_time_of_flight_m(time_of_flight_s=stop.reported_s)
    return Returns(
        reported=stop.occupied,
        range_m=range_m,
        intensity=reported_intensity(finder, light, amplitude=stop.amplitude, width_s=stop.width_s, range_m=range_m),
        **{field.name: getattr(stop, field.name) for field in fields(Measurement)},
    )


def _train_of(echoes: Echoes) -> EchoTrain:
    """Pulses with one echo each in clear air as a train."""
    part = SubEchoes(range_m=echoes.range_m, peak_power_w=echoes.peak_power_w, count=1)
    return EchoTrain(
        parts=(part,),
        surfaces=1,
        has_surface=echoes.has_surface,
        background_power_w=echoes.background_power_w,
        interference=echoes.interference,
        white_w_m2=echoes.white_w_m2,
        fluctuation=echoes.fluctuation,
        broadening=echoes.broadening,
        row_slope=echoes.row_slope,
    )
