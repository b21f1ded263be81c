"""A frame of a spinning sensor pulse by pulse: clouds, piece by piece, in; arrays of firings by lasers out.

A cloud holds only the pulses that came back. Its times and channels give their firing and laser; all other pulses are
lost ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...maths.arrays import Numbers
from ...scan.spinning import Spinning
from ...sensor.imu import ImuSamples
from ...sensor.sensor_model import Sensor
from ..cloud_columns import Cloud

RETURNS = 2
"""Returns of a pulse that packets have room for."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Firings:
    """One frame: a row for each firing of the bank, in order of time, a column for each laser, as the sensor file lists
    them. The first three have one number for each return, the strongest first; 0 where nothing came back.

    Attributes:
        range_m: (firings, lasers, 2) float64, from the beam's exit
        intensity: (firings, lasers, 2) float32, as the sensor reports it
        signal: (firings, lasers, 2) float32, photons
        ambient: (firings, lasers) float32, background counts, of lost pulses too if the sensor's maker sends them
        number: of the first firing, counted from the first frame's
        time_s: (firings,) float64, when the first laser of each fires, since 1970
        imu: samples of the sensor's IMU until the next frame, with times since 1970; None without one
    """

    range_m: Numbers
    intensity: Numbers
    signal: Numbers
    ambient: Numbers
    number: int
    time_s: Numbers
    imu: ImuSamples | None = None

    def __len__(self) -> int:
        return len(self.time_s)


class FiringsBuilder:
    """Builder of the `Firings` of a frame from its clouds, piece by piece.

    Args:
        sensor: a spinning one, which `select_encoder` accepts
        number: number of the frame
        epoch_ns: from 1970 to the scene's second 0
        imu: samples of the sensor's IMU until the next frame, by the scene's clock
    """

    def __init__(self, sensor: Sensor, number: int, *, epoch_ns: int = 0, imu: ImuSamples | None = None) -> None:
        assert isinstance(sensor.scanner, Spinning)
        self._imu = imu
        self._epoch_s = epoch_ns / 1e9
        self._scanner = scanner = sensor.scanner
        self._number = number
        lasers = np.asarray(scanner.lasers_by_place.values, np.int64)
        self._lasers = lasers
        self._firing_s = np.zeros(scanner.lasers)
        self._firing_s[lasers] = scanner.firing_s - scanner.firing_s[0]  # a frame begins with its first pulse
        shape = scanner.cycles, scanner.lasers
        self._range_m = np.zeros((*shape, RETURNS))
        self._strength, self._intensity, self._signal = (np.zeros((*shape, RETURNS), np.float32) for _ in range(3))
        self._ambient = np.zeros(shape, np.float32)
        self._start_s = 0.0

    def add(self, cloud: Cloud) -> None:
        """Add the points of a cloud of this frame; of more than two returns of a pulse the two strongest stay."""
        self._start_s = self._epoch_s + cloud.frame_start_s
        laser = cloud.column("channel").astype(np.int64)
        cycle_s = self._scanner.cycle_s
        firing = np.rint((cloud.column("time") - self._firing_s[laser]) / cycle_s).astype(np.int64)
        signal, snr = cloud.column("signal"), cloud.column("snr")
        strength = np.where(signal > 0.0, signal, snr)
        return_values = (cloud.column("range"), cloud.column("intensity"), signal)
        number = cloud.column("return_number")
        for return_number in np.unique(number):
            self._insert(number == return_number, firing, laser, strength, return_values)

    def _insert(
        self, rows: Numbers, firing: Numbers, laser: Numbers, strength: Numbers, values: Sequence[Numbers]
    ) -> None:
        """Insert one return of each of these pulses: before a stored one that is weaker, which becomes the second."""
        firing, laser = firing[rows], laser[rows]
        arrays: list[Numbers] = [self._strength, self._range_m, self._intensity, self._signal]
        new_returns = [column[rows] for column in (strength, *values)]
        takes_place = (self._range_m[firing, laser] == 0.0) | (new_returns[0][:, None] > self._strength[firing, laser])
        first = takes_place[:, 0]
        second = ~first & takes_place[:, 1]
        for array, new_values in zip(arrays, new_returns, strict=True):
            array[firing[first], laser[first], 1] = array[firing[first], laser[first], 0]
            array[firing[first], laser[first], 0] = new_values[first]
            array[firing[second], laser[second], 1] = new_values[second]

    def ambient(self, pulse: Numbers, counts: Numbers) -> None:
        """Add the background of every pulse: an observer of `rendering.render_options.Observers`."""
        within = pulse.astype(np.int64) - self._number * self._scanner.pulses
        self._ambient[within // self._scanner.lasers, self._lasers[within % self._scanner.lasers]] = counts

    def firings(self) -> Firings:
        """Firings of the frame, once all its clouds were added."""
        cycles = self._scanner.cycles
        return Firings(
            range_m=self._range_m,
            intensity=self._intensity,
            signal=self._signal,
            ambient=self._ambient,
            number=self._number * cycles,
            time_s=self._start_s + self._scanner.cycle_s * np.arange(cycles),
            imu=None if self._imu is None else replace(self._imu, time_s=self._epoch_s + self._imu.time_s),
        )
