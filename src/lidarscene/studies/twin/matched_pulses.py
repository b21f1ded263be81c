"""Recorded frame and its simulation in the twin, pulse by pulse."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from ...cloud.point_cloud import PointCloud
from ...errors import InputError
from ...maths.arrays import Numbers, map_arrays
from ...maths.pose import Pose
from ...recordings.sweep import Sweep
from ...rendering.render_options import FrameOptions
from ...rendering.simulator import Simulator
from ...scan.spinning import Spinning
from ...scan.turns import Turns
from ...scene.scene import Scene
from ...sensor.sensor_model import Sensor
from .apparent_reflectivity import withheld_mask
from .planes import angles_from, has_grid, shifted, wrapped
from .surfels import KINDS, SMOOTH
from .tuning import DIFFERENCE_STEP_RAD, LARGEST_ANGLE_RAD

RAYS = 16
"""Rays per pulse if the sensor reports second returns, since a single ray meets one surface."""

NO_SURFACE = -1
"""Value of `MatchedPulses.kind` without a surface."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MatchedPulses:
    """Recorded pulses of a frame and their simulation, (n,) each; NaN where there is no return.

    * `simulated_*`: the same of the simulation

    Attributes:
        angle_rad: angle between recorded and simulated direction
        pulse: number of the pulse in the simulated frame
        ring: row of the recording
        column: column of the recording
        range_m: range of the first return. It counts from the beam's exit in the simulated sensor, makers count from
            elsewhere
        aimed_range_m: recorded range in the simulated direction (`_ranges_towards`)
        signal: photons of the first return; None if not recorded (an intensity does not count)
        strength: photons, intensity or reflectivity, whichever is recorded, of both sides; None if none is
        xyz_m: (n, 3) point of the first return, in the sensor's axes
        change_m: `_second_difference` of the ranges along the ring, on smooth surfaces
        gap_m: distance between the two returns
        withheld: True if the sensor found an echo and reported no range (`withheld_mask`)
        true_range_m: range of the twin's surface
        reflectivity: reflectivity of the twin's surface
        kind: index of the twin's surface in `KINDS`, or `NO_SURFACE`; those of another scene are smooth
    """

    angle_rad: Numbers
    pulse: Numbers
    ring: Numbers
    column: Numbers
    range_m: Numbers
    aimed_range_m: Numbers
    signal: Numbers | None
    strength: Numbers | None
    xyz_m: Numbers
    change_m: Numbers
    gap_m: Numbers
    withheld: Numbers
    simulated_range_m: Numbers
    simulated_signal: Numbers
    simulated_strength: Numbers | None
    simulated_xyz_m: Numbers
    simulated_change_m: Numbers
    simulated_gap_m: Numbers
    true_range_m: Numbers
    reflectivity: Numbers
    kind: Numbers

    @property
    def has_return(self) -> Numbers:
        """Mask of the pulses with a recorded return."""
        return np.isfinite(self.range_m)

    @property
    def has_simulated_return(self) -> Numbers:
        """Mask of the pulses with a simulated return."""
        return np.isfinite(self.simulated_range_m)

    def select(self, mask: Numbers) -> MatchedPulses:
        """Keep only the pulses of a mask."""
        return map_arrays(lambda values: values[mask], self)


def simulate_pulses(
    scene: Scene, sensor: Sensor, sweep: Sweep, *, pose: Pose | None = None, options: FrameOptions | None = None
) -> tuple[MatchedPulses, PointCloud]:
    """Render the twin and match its pulses to the recorded ones; returns them and the cloud.

    Args:
        pose: pose of the sensor; None: the scene's own
        options: seed and chunk of the rendering

    Raises:
        InputError: where the sensor does not fire the recording's pulses
    """
    sensor = in_step(sensor, sweep)
    numbers, angle_rad = match_pulses(sensor, sweep)
    simulator = Simulator(scene, sensor, pose=pose, rays=RAYS if sensor.tdc.stops > 1 else 1)
    chunks: list[tuple[Numbers, Mapping[str, Numbers]]] = []
    cloud = simulator.render(options, points=lambda pulse, columns: chunks.append((pulse, columns)))
    n = sensor.scanner.pulses
    of_points = np.concatenate([np.zeros(0, np.int64), *(pulse.astype(np.int64) for pulse, _ in chunks)])
    # Clouds have the returns of a pulse in order of time, recordings of the strongest ones these first: by the photons
    # that were counted. Of other receivers a cloud has no amplitude, but its mean.
    counted = cloud.snr if sensor.histogram is None else cloud.signal
    first, second = _by_pulse(of_points, n, counted if sensor.tdc.keep.startswith("strongest") else None)
    range_m, other_m = (_at_points(cloud.range_m, point_index) for point_index in (first, second))
    true_range_m, reflectivity, kind = np.full(n, np.nan), np.full(n, np.nan), np.full(n, NO_SURFACE)
    kinds = np.array([KINDS.index(name) if name in KINDS else SMOOTH for name in simulator.class_names])
    for _, columns in chunks:
        if columns:
            pulse = columns["pulse"].astype(np.int64)
            true_range_m[pulse], reflectivity[pulse] = columns["true_range_m"], columns["reflectivity"]
            kind[pulse] = np.where(columns["class_id"] >= 0, kinds[columns["class_id"]], NO_SURFACE)
    recorded_m = ranges_from_exit(sensor, sweep, numbers)
    simulated_m = range_m[numbers]
    smooth = (kind[numbers] == SMOOTH) & np.isfinite(recorded_m) & np.isfinite(simulated_m)
    step = max(
        1, round(float(DIFFERENCE_STEP_RAD / np.median(np.linalg.norm(np.diff(sweep.direction, axis=1), axis=-1))))
    )
    gap_m = np.full(sweep.shape, np.nan) if sweep.second is None else np.abs(sweep.second.range_m - sweep.range_m)
    rows, columns_of_pixels = np.indices(sweep.shape)
    strength = strength_of(sweep)
    simulated_strength = cloud.intensity if sweep.signal is None else cloud.signal
    matched = MatchedPulses(
        angle_rad=angle_rad,
        withheld=withheld_mask(sweep),
        pulse=numbers,
        ring=rows,
        column=columns_of_pixels,
        range_m=recorded_m,
        aimed_range_m=_ranges_towards(fired_directions(sensor)[numbers], sweep.direction, recorded_m),
        gap_m=gap_m,
        signal=None if sweep.signal is None else sweep.signal.astype(np.float64),
        strength=strength,
        xyz_m=sweep.xyz_m,
        change_m=_second_difference(np.where(smooth, recorded_m, np.nan), step),
        simulated_range_m=simulated_m,
        simulated_signal=_at_points(cloud.signal, first)[numbers],
        simulated_strength=None if strength is None else _at_points(simulated_strength, first)[numbers],
        simulated_xyz_m=_at_points(cloud.in_sensor_frame().xyz_m, first)[numbers],
        simulated_change_m=_second_difference(np.where(smooth, simulated_m, np.nan), step),
        simulated_gap_m=np.abs(other_m - range_m)[numbers],
        true_range_m=true_range_m[numbers],
        reflectivity=reflectivity[numbers],
        kind=kind[numbers],
    )
    return matched.select(sweep.recorded), cloud


def strength_of(sweep: Sweep) -> Numbers | None:
    """Photons of each return, else its intensity, else its reflectivity; None where none is recorded."""
    for values in (sweep.signal, sweep.intensity, sweep.reflectivity):
        if values is not None:
            return values.astype(np.float64)
    return None


def ranges_from_exit(sensor: Sensor, sweep: Sweep, numbers: Numbers) -> Numbers:
    """Recorded ranges, counted from the exit of the simulated beam."""
    exit_m = _exits_m(sensor, numbers)
    if exit_m is None and sweep.origin_m is None:
        return sweep.range_m
    return np.asarray(np.einsum("...i,...i", sweep.xyz_m - (0.0 if exit_m is None else exit_m), sweep.direction))


def _exits_m(sensor: Sensor, numbers: Numbers) -> Numbers | None:
    """Exit of each of these pulses [m]; None if all start at the origin."""
    start = sensor.scanner.offset_m(np.arange(sensor.scanner.pulses, dtype=np.uint32))
    return None if start is None else np.stack([np.asarray(x, np.float64) for x in start], axis=-1)[numbers]


def _ranges_towards(fired: Numbers, direction: Numbers, range_m: Numbers) -> Numbers:
    """Nearest that was recorded about each fired direction: by a pixel, its neighbour on that side, and its plane.

    From row to row inverse ranges are interpolated, which on a plane go in proportion with the direction (`planes`).
    Where one surface ends between two pixels of a row is not recorded.
    """
    order = np.argsort(-np.median(direction[..., 2], axis=1), kind="stable")
    (azimuth, elevation), (aimed_azimuth, aimed_elevation) = angles_from(direction[order]), angles_from(fired[order])
    inverse = 1.0 / range_m[order]
    nearest = inverse.copy()
    for side in (-1, 1):
        share = wrapped(aimed_azimuth - azimuth) / wrapped(shifted(azimuth, 0, side) - azimuth)
        nearest = np.where(share > 0.0, np.fmax(nearest, shifted(inverse, 0, side)), nearest)
    for side in (-1, 1):
        share = (aimed_elevation - elevation) / (shifted(elevation, side, 0) - elevation)
        nearer = share * (shifted(inverse, side, 0) - inverse)
        nearest += np.where((share > 0.0) & (share < 1.0) & (nearer > 0.0), nearer, 0.0)
    aimed_range_m = np.zeros_like(range_m)
    aimed_range_m[order] = 1.0 / nearest
    return aimed_range_m


def _second_difference(range_m: Numbers, step: int) -> Numbers:
    """(r_before - 2 r + r_after) / sqrt(6): it has the deviation of independent errors, and is 0 on plane walls."""
    return np.asarray((np.roll(range_m, step, 1) - 2.0 * range_m + np.roll(range_m, -step, 1)) / np.sqrt(6.0))


def fired_directions(sensor: Sensor) -> Numbers:
    """(pulses, 3) directions of a frame's pulses."""
    pulse = np.arange(sensor.scanner.pulses, dtype=np.uint32)
    return np.stack([np.asarray(x, np.float64) for x in sensor.scanner.direction(pulse)], axis=-1)


def in_step(sensor: Sensor, sweep: Sweep) -> Sensor:
    """The sensor with its head where it was in this frame, if no encoder has turns begin alike.

    The step from column to column is that of the recorded turn, since motors are not exact. The head's angle within a
    step is the mean of what recorded beams are ahead of the nearest simulated ones.
    """
    scanner = sensor.scanner
    if not isinstance(scanner, Spinning) or scanner.phase(scanner.pulses) == scanner.phase(0) or not has_grid(sweep):
        return sensor
    azimuth, _ = angles_from(sweep.direction)
    turn = np.unwrap(azimuth, axis=1)
    half = sweep.shape[1] // 2
    step_rad = abs(float(np.median(turn[:, half:] - turn[:, :-half]))) / half
    own_rad = float(wrapped(np.diff(np.asarray(scanner.head.angle_rad(np.arange(2)))))[0])
    step_rad /= max(1, round(step_rad / abs(own_rad)))  # every second column may be left out
    scanner = replace(scanner, head=Turns.from_fraction(Fraction(math.copysign(step_rad / math.tau, own_rad))))
    fired, _ = angles_from(fired_directions(replace(sensor, scanner=scanner)))
    ahead = np.exp(2j * np.pi / step_rad * (azimuth - fired[match_pulses(replace(sensor, scanner=scanner), sweep)[0]]))
    by_rad = step_rad / math.tau * float(np.angle(np.mean(ahead[sweep.has_return])))
    return replace(sensor, scanner=replace(scanner, head=scanner.head.turned(by_rad)))


def match_pulses(sensor: Sensor, sweep: Sweep) -> tuple[Numbers, Numbers]:
    """Pulse number of each pixel of a sweep, and the angle between recorded and simulated direction [rad].

    Rows go by elevation; in each row the pulse of the nearest azimuth is taken. Where beams draw no rows it is the
    nearest of all. Drivers that tell no exits count points from these or from the origin: the nearer beams are taken.

    Raises:
        InputError: for a list of points, another number of channels, or a median angle above `LARGEST_ANGLE_RAD`
    """
    if not has_grid(sweep):
        raise InputError("the recording must have rows and columns, got a list of points")
    fired = fired_directions(sensor)
    channel = np.asarray(sensor.scanner.channel(np.arange(len(fired), dtype=np.uint32)))
    channels = np.unique(channel)
    if len(channels) != sweep.shape[0] and not isinstance(sensor.scanner, Spinning):
        from scipy.spatial import KDTree

        chord, numbers = KDTree(fired).query(sweep.direction)
        return np.asarray(numbers), _near_enough(2.0 * np.arcsin(0.5 * chord), sweep)
    if len(channels) != sweep.shape[0]:
        raise InputError(f"the sensor must have {sweep.shape[0]} channels, as the recording has, got {len(channels)}")
    height = [float(np.median(fired[channel == number, 2])) for number in channels]
    rows = np.argsort(-np.median(sweep.direction[..., 2], axis=1), kind="stable")
    numbers = np.zeros(sweep.shape, np.int64)
    for row, row_channel in zip(rows, channels[np.argsort(-np.array(height), kind="stable")], strict=True):
        row_pulses = np.flatnonzero(channel == row_channel)
        azimuth, _ = angles_from(fired[row_pulses])
        order = np.argsort(azimuth)
        target_azimuth, _ = angles_from(sweep.direction[row])
        # Intervals of nearest azimuth: their bounds are half way between neighbours, all around the turn.
        closed_azimuth = np.r_[azimuth[order], azimuth[order][0] + 2.0 * np.pi]
        midpoints = 0.5 * (closed_azimuth[1:] + closed_azimuth[:-1])  # the last one lies beyond the turn
        target_azimuth = midpoints[-1] - (midpoints[-1] - target_azimuth) % (2.0 * np.pi)
        nearest = np.searchsorted(midpoints, target_azimuth) % len(row_pulses)
        numbers[row] = row_pulses[order][nearest]
    beams, exit_m = [sweep.direction], _exits_m(sensor, numbers)
    if exit_m is not None and sweep.origin_m is None:
        beams.append(np.where(sweep.has_return[..., None], sweep.xyz_m - exit_m, sweep.direction))
    sines = [np.linalg.norm(np.cross(fired[numbers], b), axis=-1) / np.linalg.norm(b, axis=-1) for b in beams]
    sine = min(sines, key=lambda values: float(np.median(values[sweep.recorded])))
    return numbers, _near_enough(np.arcsin(sine.clip(0.0, 1.0)), sweep)


def _near_enough(angle_rad: Numbers, sweep: Sweep) -> Numbers:
    """The angles between recorded and simulated directions.

    Raises:
        InputError: for a median above `LARGEST_ANGLE_RAD`
    """
    median = float(np.median(angle_rad[sweep.recorded]))
    if median > LARGEST_ANGLE_RAD:
        raise InputError(
            f"the sensor must fire where the recording's did, got {np.degrees(median):.3g} degrees between them in the "
            "median"
        )
    return angle_rad


def _by_pulse(pulse: Numbers, n: int, strength: Numbers | None = None) -> tuple[Numbers, Numbers]:
    """Indices of the first and the second point of each of n pulses, -1 without one.

    Args:
        strength: of each point, the strongest is the first; None: the order is that of the points
    """
    order = np.argsort(pulse, kind="stable") if strength is None else np.lexsort((-strength, pulse))
    pulse = pulse[order]
    first, second = np.full(n, -1), np.full(n, -1)
    starts = np.r_[True, pulse[1:] != pulse[:-1]] if len(pulse) else np.zeros(0, bool)
    first[pulse[starts]] = order[starts]
    follows = np.r_[False, starts[:-1]] & ~starts if len(pulse) else starts
    second[pulse[follows]] = order[follows]
    return first, second


def _at_points(values: Numbers, point_index: Numbers) -> Numbers:
    """Values at these indices; NaN at -1."""
    gathered = np.full((len(point_index), *np.shape(values)[1:]), np.nan)
    gathered[point_index >= 0] = np.asarray(values, np.float64)[point_index[point_index >= 0]]
    return gathered
