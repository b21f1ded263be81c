"""Pixels that a sensor at rest saw again and again, on surfaces whose lean is known.

A pixel is compared with itself: what differs from frame to frame is the sensor's, whatever the surface reflects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...light.hits import relative_row_slope
from ...maths.arrays import Numbers, map_arrays
from ...recordings.sweep import Sweep
from ...sensor.sensor_model import Sensor
from ..ranging.plane import Target
from ..twin.apparent_reflectivity import ReflectivityGauge, board
from ..twin.frame_poses import is_at_rest
from ..twin.ground import ground_plane
from ..twin.matched_pulses import strength_of
from ..twin.planes import align_columns, fit_planes
from ..twin.reading_noise import lean_of
from ..twin.tuning import LEAST_COS, WHOLE_FRAME
from .recorded_pulses import BLOCK_COLUMNS, fitted_blocks
from .tuning import GROUND_COS, LEAST_OF_BIN, LEAST_STEPS, ROUNDING


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelsAtRest:
    """n pixels on smooth surfaces that returned in the first and fullest frame, over all frames at rest.

    Attributes:
        range_m: (frames, n) NaN where nothing came back
        strength: (frames, n) photons of a sensor that counts them, else intensity or reflectivity; None: not recorded
        apparent: (n,) apparent reflectivity by the mean strength
        apparent_error: (n,) relative error of it that like pixels share, since strengths are whole numbers
        cos_incidence: (n,) on the surface
        row_slope: (n,) dR / (R dphi) of the surface along the row
        block: (n,) block of columns
    """

    range_m: Numbers
    strength: Numbers | None
    apparent: Numbers
    apparent_error: Numbers
    cos_incidence: Numbers
    row_slope: Numbers
    block: Numbers

    @property
    def mean_m(self) -> Numbers:
        """(n,) mean range of the frames with a return."""
        return np.asarray(np.nanmean(self.range_m, axis=0))

    @property
    def lean_m(self) -> Numbers:
        """(n,) range times tangent of the incidence, to which the length of an echo goes."""
        return lean_of(self.mean_m, self.cos_incidence)

    @property
    def board(self) -> Target:
        """Boards that return as much as the pixels, and lean as they do."""
        return board(self.apparent, self.cos_incidence)

    @property
    def fitted(self) -> Numbers:
        """(n,) mask of the pixels that are fitted; the others judge the fit."""
        return fitted_blocks(self.block)

    def select(self, chosen: Numbers) -> PixelsAtRest:
        """Select pixels by a mask or by their indices."""
        return map_arrays(lambda values: values[..., chosen], self)


def pixels_at_rest(sweeps: Sequence[Sweep], sensor: Sensor) -> PixelsAtRest | None:
    """Gather the pixels of the first frame and of all that were recorded at the same place; None of a moving sensor.

    Args:
        sweeps: rows and columns; lists of points are on the sensor's grid (`on_grid`)
        sensor: sensor of the recording
    """
    placed = sorted(sweeps, key=lambda sweep: -int(sweep.recorded.sum()))
    first = placed[0]
    whole = WHOLE_FRAME * first.recorded.sum()
    frames = [first, *(frame for frame in placed[1:] if frame.recorded.sum() >= whole and is_at_rest(frame, first))]
    gauge = ReflectivityGauge.from_sweep(first, sensor)
    if len(frames) < 2 or gauge is None:
        return None
    # The number of a pixel goes where the pixel goes, so that the other frames can be put in the same order.
    grid = align_columns(replace(first, column=np.arange(first.range_m.size).reshape(first.shape)))
    order = grid.sweep.column
    assert order is not None
    planes, ground = fit_planes(grid), ground_plane(first.xyz_m[first.has_return])
    normal, direction = planes.normal, grid.sweep.direction
    if ground is not None:
        # Seen flat, a plane through a few rings leans by chance as much as the ground does: all of it leans as one.
        upward = np.array([-ground[1], -ground[2], 1.0]) / np.linalg.norm([*ground[1:], 1.0])
        normal = np.where((normal @ upward > GROUND_COS)[..., None], upward, normal)
    cos = -np.einsum("...i,...i", normal, direction)
    usable = grid.sweep.has_return & planes.smooth(0.5) & planes.has_plane & (cos > LEAST_COS)
    usable &= np.logical_and.reduce([frame.recorded.ravel()[order] for frame in frames])
    if not usable.any():
        return None
    chosen = order[usable]
    range_m = np.stack([frame.range_m.ravel()[chosen] for frame in frames])
    strengths = [strength_of(frame) if sensor.histogram is None else frame.signal for frame in frames]
    strength = (
        None
        if any(values is None for values in strengths)
        else np.where(
            np.isfinite(range_m), np.stack([np.asarray(values, float).ravel()[chosen] for values in strengths]), np.nan
        )
    )
    apparent = [gauge.apparent(frame, frame.range_m).ravel()[chosen] for frame in frames]
    smooth, error = np.ones(len(chosen)), np.zeros(len(chosen))
    if strength is not None and sensor.histogram is None:
        smooth, error = unrounded(np.nanmean(strength, axis=0) / step_of(strength), cos[usable])
    column = np.broadcast_to(np.arange(order.shape[1]), order.shape)[usable]
    return PixelsAtRest(
        range_m=range_m,
        strength=strength,
        apparent=np.nanmean(np.where(np.isfinite(range_m), apparent, np.nan), axis=0) * smooth,
        apparent_error=error,
        cos_incidence=cos[usable],
        row_slope=np.asarray(relative_row_slope(tuple(np.moveaxis(normal[usable], -1, 0)), tuple(direction[usable].T))),
        block=column // BLOCK_COLUMNS,
    )


def step_of(strength: Numbers) -> float:
    """Step of recorded strengths: the least difference of two of them; the strength itself if all are the same."""
    read = np.unique(strength[np.isfinite(strength)])
    return float(np.min(np.diff(read), initial=read.max(initial=0.0)))


def unrounded(strength: Numbers, cos_incidence: Numbers) -> tuple[Numbers, Numbers]:
    r"""Strengths of few whole steps without their rounding, over themselves, and the relative error that is left.

    Far ground reads 1 all over. A power of the cosine of the incidence is fitted to all that read few steps, over which
    roundings compensate each other: at the end of a line through m steps, spread evenly, least squares leave

    .. math:: \sigma_1 = \frac{1}{6 m}, \quad m = \sqrt{12}\, \sigma_I \tag{T185a}

    of a step, by parts: the weight 4 / m - 6 x / m^2 of what is read at x has 4 / m and -2 / m at its ends, and the
    integral of a rounding varies by 1 / sqrt(720). Where the law is not what was read, as on another material, the
    number that was read stays, with its own rounding. Symbols: I strength in steps, sigma_I its deviation.
    """
    from scipy.optimize import least_squares

    few = strength < LEAST_STEPS
    smooth, error = np.ones_like(strength), ROUNDING / np.maximum(strength, 1.0)
    if few.sum() < LEAST_OF_BIN:
        return smooth, error
    read, cos = strength[few], cos_incidence[few]
    factor, exponent = least_squares(lambda p: p[0] * cos ** p[1] - read, (1.0, 0.0), loss="huber", f_scale=0.5).x
    law = factor * cos**exponent
    holds = np.abs(law - read) < 0.5
    smooth[few] = np.where(holds, law / np.maximum(read, 0.5), 1.0)
    steps_off = np.minimum(ROUNDING, ROUNDING / 6.0 / np.maximum(np.std(read), 1e-9))
    error[few] = np.where(holds, steps_off / np.maximum(law, 0.5), error[few])
    return smooth, error
