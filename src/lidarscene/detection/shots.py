"""Shots: some pulses on their way through the electronics.

Every step from the comparator to the reported point asks for the same five things, and takes them as one `Shots`.
The steps that follow a waveform take a `Received`, which has that too.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..light.waveform import Waveform
from ..maths import random
from ..maths.arrays import Array, Lanes, Ops, xp
from ..maths.random import Stage
from ..physics.electronics import tdc
from ..physics.electronics.pulse_sums import SIGMAS_PER_FWHM
from ..physics.optics import radiometry
from ..sensor.detectors import WorkingPoint
from ..sensor.model import Sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Shots:
    """Some pulses, and what the electronics know of each before its light comes back.

    sensor     that fired them
    point      the detector's working point under the background of each pulse
    threshold  (n,) of the comparator, in the detector's unit of signal
    seed       32-bit frame seed; every random number is keyed by (seed, stage, pulse)
    pulse      (n,) uint32 pulse numbers
    """

    sensor: Sensor
    point: WorkingPoint
    threshold: Lanes
    seed: Lanes
    pulse: Array

    def words(self, stage: Stage, draw: Lanes = 0) -> tuple[Array, Array]:
        """Two random words for each pulse; ``draw`` tells the uses of one stage apart."""
        return random.words(seed=self.seed, stage=stage, pulse=self.pulse, draw=draw)


@dataclass(frozen=True, slots=True, kw_only=True)
class Received(Shots):
    """Some pulses and the waveform that comes back of each."""

    wave: Waveform

    @property
    def ops(self) -> Ops:
        """Functions for these arrays."""
        return xp(self.wave.origin_m)

    @property
    def sigma_s(self) -> Lanes:
        """Standard deviation of the laser's pulse."""
        return self.sensor.laser.pulse_fwhm_s / SIGMAS_PER_FWHM

    def time_s(self, place: Lanes) -> Lanes:
        """Time of flight of a place of the waveform."""
        return radiometry.time_of_flight_s(range_m=self.wave.range_m(place))

    def noise_at(self, signal: Lanes) -> Lanes:
        """Standard deviation of the noise at a signal level."""
        point = self.point
        return tdc.noise_at_level(
            level=signal, noise=point.noise, kappa_1=point.kappa_1, kappa_2=point.kappa_2
        )
