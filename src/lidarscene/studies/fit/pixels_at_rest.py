"""Pixels that a sensor at rest saw again and again, on surfaces whose lean is known.

A pixel is compared with itself: what differs from frame to frame is the sensor's, whatever the surface reflects.
"""

from __future__ import annotations

import math
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
from ..twin.ground import ground_plane, leaning_as_ground
from ..twin.matched_pulses import strength_of
from ..twin.planes import align_columns, fit_planes
from ..twin.reading_noise import lean_of
from ..twin.tuning import LEAST_COS, MOST_BEAM_M, WHOLE_FRAME
from .recorded_pulses import BLOCK_COLUMNS, fitted_blocks
from .tuning import (
    ADAPTIONS,
    LAW,
    LAW_SIGMAS,
    LAWS,
    LEAST_OF_RING,
    LEAST_STEPS,
    OFF_SQUARE,
    READING_SIGMA,
    RING_STEP,
    ROUNDING,
    WIDER,
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelsAtRest:
    """n pixels on smooth surfaces that returned in the first and fullest frame, over all frames at rest.

    Their mean ranges are within `MOST_BEAM_M` of the surface.

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
    planes, direction = fit_planes(grid), grid.sweep.direction
    normal = leaning_as_ground(ground_plane(first.xyz_m[first.has_return]), planes.normal, direction)
    cos = -np.einsum("...i,...i", normal, direction)
    usable = grid.sweep.has_return & planes.smooth(0.5) & planes.has_plane & (cos > LEAST_COS)
    usable &= np.logical_and.reduce([frame.recorded.ravel()[order] for frame in frames])
    all_m = np.stack([frame.range_m.ravel()[order] for frame in frames])
    # Paint or a kerb in the beam moves a return along it, and loses some, as no board does.
    usable[usable] = np.abs(np.nanmean(all_m[:, usable], axis=0) - planes.range_m[usable]) < MOST_BEAM_M
    if not usable.any():
        return None
    chosen, range_m = order[usable], all_m[:, usable]
    strengths = [strength_of(frame) if sensor.histogram is None else frame.signal for frame in frames]
    strength = (
        None
        if any(values is None for values in strengths)
        else np.where(
            np.isfinite(range_m), np.stack([np.asarray(values, float).ravel()[chosen] for values in strengths]), np.nan
        )
    )
    each = np.stack([gauge.apparent(frame, frame.range_m).ravel()[chosen] for frame in frames])
    apparent, error = np.nanmean(np.where(np.isfinite(range_m), each, np.nan), axis=0), np.zeros(len(chosen))
    if strength is not None and sensor.histogram is None and len(gauge.per_count) == 1:
        step, read = step_of(strength), np.nanmean(strength, axis=0)
        smooth, error = unrounded(read / step, cos[usable])
        # What reads 0 in some frames counts as more there, so its law is no factor on its mean.
        apparent = np.where(smooth == read / step, apparent, smooth * step * gauge.per_count)
    column = np.broadcast_to(np.arange(order.shape[1]), order.shape)[usable]
    return PixelsAtRest(
        range_m=range_m,
        strength=strength,
        apparent=apparent,
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
    r"""Strengths of few whole steps without their rounding, and the relative error that is left.

    Far ground reads 1 all over. But it reads 2 from 1.5 on, and a law of the cosine of the incidence must go that way,

    .. math:: \ln I = a_0 + a_1 \ln\cos\beta + a_2 \ln^2\cos\beta \tag{T185a}

    Of all such laws that are as likely as not to give the readings of each ring, by importance sampling, mean and
    deviation are told. Where that is not what was read, as on another material, the number that was read stays, with
    its own rounding. Symbols: I strength in steps, beta incidence.
    """
    from scipy.special import ndtr

    few = strength < LEAST_STEPS
    smooth, error = strength.copy(), ROUNDING / np.maximum(strength, 1.0)
    read, logs = strength[few], np.log(cos_incidence[few])
    ring = np.unique(np.rint(logs / RING_STEP), return_inverse=True)[1]
    rings = [np.flatnonzero(ring == number) for number in range(ring.max(initial=-1) + 1)]
    rings = [members for members in rings if len(members) >= LEAST_OF_RING]
    if not rings:
        return smooth, error
    near = [members[np.abs(read[members] - np.median(read[members])) < 1.0] for members in rings]
    of_ring, means = (np.array([values[members].mean() for members in near]) for values in (logs, read))

    def terms(values: Numbers) -> Numbers:
        return np.stack([np.ones_like(values), values, values**2, np.zeros_like(values)])

    def squares(numbers: Numbers, inverse: Numbers, centre: Numbers) -> Numbers:
        return np.asarray(np.einsum("ni,ij,nj->n", numbers - centre, inverse, numbers - centre))

    expected, known = np.array(LAW), np.diag(np.array(LAW_SIGMAS) ** -2.0)
    steps, design, weight = np.arange(0.5, LEAST_STEPS + 1.0), terms(of_ring), (np.maximum(means, 0.5) / ROUNDING) ** 2
    inverse = (design * weight) @ design.T + known
    mean = np.linalg.solve(inverse, design @ (weight * np.log(np.maximum(means, 0.5))) + known @ expected)
    covariance, random = np.linalg.inv(inverse), np.random.default_rng(0)
    for _ in range(ADAPTIONS):
        numbers = random.multivariate_normal(mean, WIDER * covariance, LAWS)
        law = np.exp(np.minimum(numbers @ design, math.log(2.0 * LEAST_STEPS)))
        blur = law * np.exp(numbers[:, 3:])
        off = (ndtr((law[..., None] - steps) / blur[..., None]).sum(axis=2) - means) / READING_SIGMA
        likely = np.minimum(off**2, OFF_SQUARE).sum(axis=1) + squares(numbers, known, expected)
        logs_of = 0.5 * (squares(numbers, np.linalg.inv(WIDER * covariance), mean) - likely)
        chance = np.exp(logs_of - logs_of.max())
        mean, covariance = np.average(numbers, axis=0, weights=chance), np.cov(numbers.T, aweights=chance)
        covariance += 1e-6 * np.eye(len(mean))
    law, design = np.exp(mean @ terms(logs)), terms(logs)
    sigma = np.sqrt(np.einsum("in,ij,jn->n", design, covariance, design))
    holds = np.abs(law - read) < 0.5 + READING_SIGMA
    smooth[few] = np.where(holds, law, read)
    error[few] = np.where(holds, np.minimum(sigma, ROUNDING / np.maximum(law, 0.5)), error[few])
    return smooth, error
