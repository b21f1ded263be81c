"""Shots: the inputs that all steps of the electronics share.

Every step from the comparator to the reported point needs the same five values, so it takes them as one `Shots`.
Steps that work on a waveform take a `Received`, which adds the waveform.

Symbols: sigma_p standard deviation of the received pulse. A place on a waveform is in units of sigma_p.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..light.echoes import Fluctuation
from ..light.waveform import Waveform
from ..maths import random
from ..maths.arrays import Array, Lanes, Ops, xp
from ..maths.random import Seed, Stage
from ..physics.electronics.pulse_sums import SIGMAS_PER_FWHM
from ..physics.optics import radiometry
from ..sensor.detectors import WorkingPoint
from ..sensor.sensor_model import Sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Shots:
    """Inputs of the electronics for n pulses, known before their light comes back.

    Attributes:
        sensor: the sensor that fired the pulses
        point: working point of the detector under each pulse's background
        threshold: (n,) level U of the comparator, in the detector's unit of signal
        seed: 32-bit frame seed; every random number is keyed by (seed, stage, pulse)
        pulse: (n,) uint32 pulse numbers
        fluctuation: of the power that comes back; None: it has none
    """

    sensor: Sensor
    point: WorkingPoint
    threshold: Lanes
    seed: Seed
    pulse: Array
    fluctuation: Fluctuation | None = None

    def words(self, stage: Stage, draw: Lanes = 0) -> tuple[Array, Array]:
        """Two random 32-bit words for each pulse, (n,) each; ``draw`` separates the uses of one stage."""
        return random.words(seed=self.seed, stage=stage, pulse=self.pulse, draw=draw)


@dataclass(frozen=True, slots=True, kw_only=True)
class Received(Shots):
    """Inputs of the electronics for n pulses with their received waveforms."""

    wave: Waveform

    @property
    def ops(self) -> Ops:
        """Array functions of the arrays' kind, NumPy's or Dr.Jit's."""
        return xp(self.wave.origin_m)

    @property
    def sigma_s(self) -> Lanes:
        """sigma_p: standard deviation of the received pulse; (n,) of echoes that are broadened."""
        return self.wave.fwhm_s / SIGMAS_PER_FWHM

    def time_s(self, place: Lanes) -> Lanes:
        """Time of flight at a place on the waveform, (n,)."""
        return radiometry.time_of_flight_s(range_m=self.wave.range_m(place))

    @property
    def sample_threshold(self) -> Lanes:
        """Level U of the signal before a matched filter, (n,)."""
        raw = self.point.unfiltered
        return self.threshold if raw is None else self.sensor.threshold(raw)

    def noise_at(self, signal: Lanes) -> Lanes:
        """Standard deviation of a sample's noise at a signal level, (n,); (T12) or (T20)."""
        return (self.point.unfiltered or self.point).noise.at(signal)
