"""Exposure: trains of those pulses of a scanning sensor that enter an eye that does not move.

A scanning beam crosses a pupil only briefly; how many pulses enter, and how close together, sets the limits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...light.beams import firing_time_s
from ...maths.arrays import Numbers, frozen
from ...maths.pose import direction_from_angles
from ...sensor.sensor_model import Sensor

_PLACES = 128  # positions tried for the eye
_STEPS = 400  # most group sizes that are checked within one period


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PulseTrain:
    """Pulses of one energy that repeat every period.

    Attributes:
        time_s: (n,) float64, non-decreasing, from 0; n >= 1
        period_s: time after which they repeat, later than the last of them
    """

    time_s: Numbers
    period_s: float

    def __post_init__(self) -> None:
        """Check and freeze.

        Raises:
            ValueError: if a value is not allowed
        """
        times = frozen(self.time_s, np.float64, (None,))
        object.__setattr__(self, "time_s", times)
        if len(times) == 0 or times[0] != 0.0 or not (np.diff(times) >= 0.0).all() or times[-1] >= self.period_s:
            raise ValueError("times must go up from 0 to less than the period")

    @property
    def per_period(self) -> int:
        """Pulses in a period."""
        return len(self.time_s)

    @property
    def mean_rate_hz(self) -> float:
        """Pulses per second in the long run."""
        return self.per_period / self.period_s

    def shortest_span_s(self, pulses: int) -> float:
        """Shortest time from the first to the last of this many consecutive pulses."""
        periods, pulses_left = divmod(pulses - 1, self.per_period)
        twice = np.concatenate([self.time_s, self.time_s + self.period_s])
        return float(periods * self.period_s + (twice[pulses_left : pulses_left + self.per_period] - self.time_s).min())

    def most_within(self, duration_s: float) -> int:
        """Most pulses that start within a window of this duration, open at its end (minus 1e-9, for rounding)."""
        periods, rest_s = divmod(duration_s * (1.0 - 1e-9), self.period_s)
        twice = np.concatenate([self.time_s, self.time_s + self.period_s])
        starts = np.arange(self.per_period)
        ends = np.searchsorted(twice, self.time_s + rest_s, side="left")
        return int(periods) * self.per_period + int((ends - starts).max(initial=0))

    def groups_per_period(self, closer_than_s: float) -> int:
        """Groups per period, if pulses that start within this time of a group's first belong to it."""
        if self.period_s < closer_than_s:
            raise ValueError("the groups of a train are longer than its period")
        count, start = 0, 0
        while start < self.per_period:
            start = int(np.searchsorted(self.time_s, self.time_s[start] + closer_than_s, side="left"))
            count += 1
        return count

    def group_sizes(self, longest_s: float) -> list[int]:
        """Numbers of consecutive pulses to check, from 1 to all that start within this time."""
        most = max(self.most_within(longest_s), 1)
        steps = np.unique(np.geomspace(1, most, _STEPS).round().astype(int))
        inside = np.unique(np.linspace(1, min(most, self.per_period), _STEPS).round().astype(int))
        return [int(size) for size in np.union1d(steps, inside)]


def stationary_train(sensor: Sensor) -> PulseTrain:
    """Train of all pulses: the beam stands still."""
    rate_hz = float(sensor.laser.repetition_rate_hz) * len(_shots_s(sensor))
    return PulseTrain(time_s=np.zeros(1), period_s=1.0 / rate_hz)


def counted_train(sensor: Sensor, *, pulses_in_aperture: int) -> PulseTrain:
    """Train of this many consecutive pulses, once in each frame.

    Raises:
        ValueError: if a value is not allowed
    """
    if not 1 <= pulses_in_aperture <= sensor.scanner.pulses:
        raise ValueError(
            f"pulses_in_aperture must be 1 to {sensor.scanner.pulses} pulses of a frame, got {pulses_in_aperture}"
        )
    times = _with_shots(sensor, firing_time_s(sensor, np.arange(pulses_in_aperture, dtype=np.uint32)))
    return PulseTrain(time_s=times, period_s=_frame_s(sensor))


def scanned_train(sensor: Sensor, *, aperture_m: float, distance_m: float, beam_diameter_m: float = 0.0) -> PulseTrain:
    """Train of the pulses whose 1/e^2 beam touches a round aperture at this distance.

    All beams start at the sensor's origin. The aperture takes 129 positions, straight ahead and spread over the
    frame's pulses; the one with most pulses counts.
    """
    pulse = np.arange(sensor.scanner.pulses, dtype=np.uint32)
    azimuth, elevation = (np.asarray(angle, dtype=np.float64) for angle in sensor.scanner.angles(pulse))
    x, y, z = direction_from_angles(azimuth_rad=azimuth, elevation_rad=elevation)
    direction = np.stack([x, y, z])
    # A beam at an angle off the aperture's centre touches it up to the sum of both radii at this distance.
    reach = math.cos(math.atan(0.5 * (aperture_m + beam_diameter_m) / distance_m))
    places = np.unique(np.linspace(0, len(pulse) - 1, _PLACES).astype(int))
    best = np.zeros(0, dtype=np.intp)
    for centre in (np.array([1.0, 0.0, 0.0]), *direction[:, places].T):
        inside = np.flatnonzero(centre @ direction >= reach)
        best = inside if len(inside) > len(best) else best
    times = _with_shots(sensor, firing_time_s(sensor, pulse[best]))
    return PulseTrain(time_s=times - times[0], period_s=_frame_s(sensor))


def _shots_s(sensor: Sensor) -> Numbers:
    """(shots,) times in s of the laser's shots of one point, after the first; a single 0 without a histogram."""
    if sensor.histogram is None:
        return np.zeros(1)
    count, period = int(float(sensor.histogram.shots)), sensor.histogram.period_s
    if period is None:
        period = 1.0 / (float(sensor.laser.repetition_rate_hz) * count)
    return np.arange(count) * float(period)


def _with_shots(sensor: Sensor, times_s: Numbers) -> Numbers:
    """Rising times of all shots of the points that are fired at these times."""
    return np.sort((times_s[:, None] + _shots_s(sensor)).ravel())


def _frame_s(sensor: Sensor) -> float:
    """Time in s from the first pulse of a frame to that of the next."""
    return float(firing_time_s(sensor, np.array([sensor.scanner.pulses], dtype=np.uint32))[0])
