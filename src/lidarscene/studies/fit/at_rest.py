r"""Numbers of a sensor from pixels that it saw again and again at rest: noise of ranges and strengths, and losses.

Strengths scatter from frame to frame with the energy of the pulses, by rounding and by the noise of an echo of I at R,

.. math:: \sigma_{\ln I}^2 = r^2 + \frac{q}{I^2} + \frac{p R^2}{I} \tag{T184}

and ranges on surfaces that hardly lean with the clock and with the noise on an edge,

.. math:: \sigma_R^2 = a^2 + \left(\frac{b R^2}{I}\right)^2 \tag{T185}

These need no sensor file. For its keys, ranges scatter and returns are lost as the sensor's own stages say of a board
as strong, at the pixel's range and lean. Pixels of like strength and lean make a bin; bins of the recording and of the
simulation are compared. An Ouster's ranges scatter by c over the root of its photons, times what columns share on a
surface of that lean, (T176a).

Symbols: r relative deviation of the energy, I strength, R range; a, b, p and q are fitted.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import Any

import numpy as np

from ...errors import InputError
from ...light.echoes import Echoes
from ...maths.arrays import Numbers, map_arrays
from ...sensor.electronics import Tdc
from ...sensor.sensor_model import Sensor
from ..held import LIMITS, Held
from ..ranging.plane import Target, detection_margin, detection_probability, echoes_of_plane
from ..twin.judge import CLIPPED_DEVIATION, spread
from ..twin.reading_noise import noise_by_step
from ..twin.repeats import changes_m, held_share, kept_by_bin
from ..twin.tuning import ASSUMED_KLUX, CLIP_SIGMAS, OCTAVES_M, SAME_SURFACE_M
from .binned_fit import Prior, Statistics, solve
from .board_law import BoardLaw, BoardNoise
from .estimates import Estimate, Solution, exponential
from .near_field import LEAST_BINS
from .pixels_at_rest import PixelsAtRest, step_of
from .published_fit import POWER
from .scatter import is_strong
from .sensor_text import Changes, at_rest_changes, get_key, parse_sensor, put_changes
from .tuning import (
    BEAM_STEP,
    CLIPS,
    DITHER,
    EXCESS_SIGMAS,
    HEIGHT_PARTS,
    LEAST_BROADENING,
    LEAST_LEAN_M,
    LEAST_OF_BIN,
    LEAST_OF_STRENGTH,
    LEAST_SLOPE,
    LEAST_STEP_MM,
    LEAST_STEPS,
    LIGHT_BOUNDS,
    LIGHT_ERROR,
    LOG_STEP,
    MOST_KEPT,
    PIXELS_OF_BIN,
    REST_BOUNDS,
    STRENGTH_BOUNDS,
)

ENERGY, COLUMNS = "laser.energy_spread", "histogram.column_range_sigmas"
STRONG, DIVERGENCE, CHATTER = "tdc.strong_jitter_ps", "laser.divergence_mrad", "tdc.chatter_mhz"
CONVERTER = ("tdc.jitter_ps", STRONG, DIVERGENCE, CHATTER)
"""Keys that ranges and losses at rest say something of, of a sensor that times pulses."""

CLOCK = {"tdc.jitter_ps": ("jitter_s", 1e-12), STRONG: ("strong_jitter_s", 1e-12), CHATTER: ("chatter_hz", 1e6)}
"""Those of them that are fields of the clock -> field, and the key's unit in the field's."""

FLOOR, SLOPE = "range_floor_at_rest", "range_noise_at_rest"
"""Coefficients a and b of (T185), which are no keys of a file."""

LIGHT = "light_over_noise_at_rest"
"""Signal of a reflectivity over the noise, in that of the file: power, lens and the scale of the intensities are one
product, so it is no key of a file."""

STRENGTH = "strength_of_few_steps_at_rest"
"""Strength of surfaces that read few whole numbers over what is taken for it, of those that are known the least."""

UNITS = {ENERGY: "", COLUMNS: "", FLOOR: "mm", SLOPE: "mm/m2", LIGHT: "times"} | {
    key: key.rpartition("_")[2].replace("mhz", "MHz") for key in CONVERTER
}
"""Number that is told, or else the reason why not -> its unit."""


Law = tuple[Sequence[str], Solution | None, dict[str, str]]
"""Parameters, their solution if any, and why those that are missing are."""


def pixel_squares(changes: Numbers) -> Numbers:
    """(n,) mean square of each pixel's changes within `CLIP_SIGMAS` of the scatter of all; NaN without any."""
    known = changes[np.isfinite(changes)]
    if len(known) < LEAST_OF_BIN:
        return np.full(changes.shape[1], np.nan)
    inlier = np.abs(changes) <= CLIP_SIGMAS * spread(known)
    with np.errstate(invalid="ignore"):
        squares = np.sum(np.where(inlier, changes, 0.0) ** 2, axis=0) / inlier.sum(axis=0)
    return np.asarray(squares / CLIPPED_DEVIATION**2)


def bins_of_pixels(keys: Numbers, changes: Numbers) -> Iterator[tuple[Numbers, Numbers]]:
    """Indices of pixels of like whole (keys, n) numbers, and their `pixel_squares`, where enough of these are known."""
    index = np.unique(np.floor(keys), axis=1, return_inverse=True)[1].ravel()
    for number in range(index.max(initial=-1) + 1):
        chosen = np.flatnonzero(index == number)
        squares = pixel_squares(changes[:, chosen])
        if np.isfinite(squares).sum() >= LEAST_OF_BIN:
            yield chosen, squares


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Boards:
    """Bins of pixels of like strength and lean.

    Attributes:
        pixels: all of them
        members: indices of each bin's pixels
        drawn: those that stand for them in what is expected, at most `PIXELS_OF_BIN` of each bin
        first: of each bin, among ``drawn``
        lean_m: of ``drawn``
    """

    pixels: PixelsAtRest
    members: Sequence[Numbers]
    drawn: PixelsAtRest
    first: Numbers
    lean_m: Numbers

    @classmethod
    def of(cls, pixels: PixelsAtRest, sensor: Sensor, parts: int = 1) -> Boards:
        """Sort pixels by octaves of the lean and of the height in thresholds.

        Args:
            parts: largest number of parts into which a bin is cut by the height, where each has enough known pixels
        """
        height = np.maximum(detection_margin(sensor, pixels.board, pixels.mean_m), 0.25)
        keys = np.log2([np.maximum(pixels.lean_m, LEAST_LEAN_M), height])
        members: list[Numbers] = []
        for chosen, squares in bins_of_pixels(keys, changes_m(pixels.range_m)):
            order = np.argsort(height[chosen])
            returned = np.cumsum(np.isfinite(squares[order]))
            number = min(max(returned[-1] // (2 * LEAST_OF_BIN), 1), parts)
            ends = np.searchsorted(returned, returned[-1] * np.arange(1, number) / number)
            members += np.split(chosen[order], ends)
        # In order of what makes a range scatter, so that the few that stand for all are as different as these.
        rank, drawn = 2.0 * keys[0] - keys[1], [np.zeros(0, int)]
        for chosen in members:
            count = min(len(chosen), PIXELS_OF_BIN)
            places = ((np.arange(count) + 0.5) * len(chosen) / count).astype(int)
            drawn.append(chosen[np.argsort(rank[chosen])[places]])
        first = np.cumsum([len(chosen) for chosen in drawn])[:-1]
        drawn_pixels = pixels.select(np.concatenate(drawn))
        return cls(pixels=pixels, members=members, drawn=drawn_pixels, first=first, lean_m=drawn_pixels.lean_m)

    def recorded(self) -> Statistics:
        """Logarithm of the mean square of ranges, then the share kept after the first frame, of each bin."""
        range_m, block = self.pixels.range_m, self.pixels.block
        again = np.isfinite(range_m[1:]).mean(axis=0)
        squares = [pixel_squares(changes_m(range_m[:, chosen])) for chosen in self.members]
        kept = Statistics.of([again[chosen] for chosen in self.members], self.members, block)
        trials = np.array([float(len(chosen) * (len(range_m) - 1)) for chosen in self.members])
        scatter = Statistics.of(squares, self.members, block).logarithm()
        return Statistics.join([scatter, replace(kept, sigma=0.0 * kept.sigma, trials=trials)])

    def light(self, sensor: Sensor) -> Echoes:
        """Echoes of the pixels that stand for all."""
        return echoes_of_plane(sensor, self.drawn.board, self.drawn.mean_m)

    def expected(self, law: BoardLaw, noise: BoardNoise, tdc: Tdc) -> Numbers:
        """What `recorded` is to be of a sensor with this clock."""
        counts = np.diff([*self.first, len(self.lean_m)])
        squares = _clipped_squares(*law.squares_m2(noise, tdc), self.first, counts)
        return np.concatenate([np.log(squares), np.add.reduceat(law.kept(noise, tdc), self.first) / counts])


def _clipped_squares(squares_m2: Numbers, chances: Numbers, first: Numbers, counts: Numbers) -> Numbers:
    """Means over bins of the `pixel_squares` of `changes_m`: (3, n) normal ones with these mean squares and chances."""
    from scipy.special import erf

    sigma_m, most_m = np.sqrt(squares_m2), SAME_SURFACE_M / math.sqrt(2.0)
    end_m: Numbers | float = most_m
    for _ in range(CLIPS):
        end = end_m / sigma_m
        shares = erf(end / math.sqrt(2.0))
        squares = np.sum(chances * squares_m2 * (shares - math.sqrt(2.0 / math.pi) * end * np.exp(-0.5 * end**2)), 0)
        share = np.sum(chances * shares, axis=0)
        scatter_m = np.sqrt(np.add.reduceat(squares, first) / np.add.reduceat(share, first)) / CLIPPED_DEVIATION
        end_m = np.minimum(np.repeat(CLIP_SIGMAS * scatter_m, counts), most_m)
    return np.asarray(np.add.reduceat(squares / share, first) / counts / CLIPPED_DEVIATION**2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FitAtRest:
    """Numbers that frames at rest determine, and why others are not.

    Attributes:
        estimates: of keys of the sensor file, and of (T185)
        unknown: key, or coefficient -> why this recording does not determine it
        solutions: name -> parameters, and solution
    """

    estimates: tuple[Estimate, ...]
    unknown: Mapping[str, str]
    solutions: Mapping[str, tuple[Sequence[str], Solution]]

    @property
    def by_key(self) -> dict[str, Estimate]:
        """Estimates of keys of the file."""
        return {estimate.key: estimate for estimate in self.estimates if estimate.key in REST_BOUNDS}


def fit_at_rest(pixels: PixelsAtRest, text: str, where: str) -> FitAtRest:
    """Fit the numbers of a sensor file that pixels at rest say something of.

    Args:
        text: sensor file, for all numbers that stay
        where: its name in messages
    """
    fitted = pixels.select(pixels.fitted)
    sensor = parse_sensor(text, where)
    energy = _energy(fitted, sensor)
    known = {estimate.key: estimate.value for estimate in _estimates(energy) if estimate.is_known}
    laws = {"strengths at rest": energy}
    if sensor.histogram is None:
        laws["floor at rest"] = _floor_and_noise(fitted)
        laws["ranges at rest"] = _converter(fitted, put_changes(text, _changes(known)), where)
    else:
        laws["ranges at rest"] = _columns(fitted, text, where)
    return FitAtRest(
        estimates=tuple(estimate for law in laws.values() for estimate in _estimates(law)),
        unknown={key: reason for *_, reasons in laws.values() for key, reason in reasons.items()},
        solutions={name: (keys, solved) for name, (keys, solved, _) in laws.items() if solved is not None},
    )


def _estimates(law: Law) -> Iterator[Estimate]:
    """Estimates of the numbers of a law that are worth telling."""
    keys, solved, _ = law
    for index, key in enumerate(keys):
        if solved is not None and key in UNITS:
            yield solved.estimate(key, UNITS[key], exponential(index))


def _changes(values: Mapping[str, float]) -> Changes:
    return at_rest_changes({key: (value, "") for key, value in values.items()})


def _energy(pixels: PixelsAtRest, sensor: Sensor) -> Law:
    """Relative deviation of the energy of a pulse, (T184)."""
    if sensor.histogram is not None:
        shots = float(sensor.histogram.shots)
        return ((), None, {ENERGY: f"a point sums {shots:g} pulses, which averages the spread down by sqrt({shots:g})"})
    if pixels.strength is None:
        return (), None, {ENERGY: "no strengths are recorded"}
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.where(pixels.strength > 0.0, np.log(pixels.strength), np.nan)
    strength, range_m = np.maximum(np.nanmean(pixels.strength, axis=0), LEAST_OF_STRENGTH), pixels.mean_m
    keys = 2.0 * np.log2([strength, range_m])
    logs[:, strength < LEAST_STEPS * step_of(pixels.strength)] = np.nan
    members, recorded = _binned(pixels, keys, np.diff(logs, axis=0) / math.sqrt(2.0))
    terms = np.stack([np.ones_like(range_m), strength**-2.0, range_m**2 / strength])
    if recorded is not None:
        members, recorded = _no_more_than_weaker(terms, members, recorded)
    return _sum_of_terms((ENERGY, "q", "p"), np.array([2.0, 1.0, 1.0]), terms, members, recorded)


def _floor_and_noise(pixels: PixelsAtRest) -> Law:
    """Coefficients of (T185), in millimetres and square metres."""
    level = pixels.select(pixels.lean_m < 2.0 * LEAST_LEAN_M)
    if level.strength is None or not len(level.block):
        reason = "no strengths are recorded" if level.strength is None else "every surface leans"
        return (), None, dict.fromkeys((FLOOR, SLOPE), reason)
    weakness = level.mean_m**2 / np.maximum(np.nanmean(level.strength, axis=0), LEAST_OF_STRENGTH)
    # Of changes as large as the step to another surface the larger ones are cut off.
    most_mm = 1e3 * SAME_SURFACE_M / math.sqrt(2.0) / CLIP_SIGMAS
    members, recorded = _binned(level, 2.0 * np.log2(weakness)[None], 1e3 * changes_m(level.range_m), most_mm)
    return _sum_of_terms(
        (FLOOR, SLOPE), np.array([2.0, 2.0]), np.stack([np.ones_like(weakness), weakness**2]), members, recorded
    )


def _binned(
    pixels: PixelsAtRest, keys: Numbers, changes: Numbers, most: float = math.inf
) -> tuple[list[Numbers], Statistics | None]:
    """Pixels of like whole (keys, n) numbers, and the logarithms of the mean squares of their changes, below the most.

    Args:
        most: largest deviation of the changes of a bin
    """
    members, values = [], []
    for chosen, squares in bins_of_pixels(keys, changes):
        known = np.isfinite(squares)
        if 0.0 < squares[known].mean() < most**2:
            members.append(chosen[known])
            values.append(squares[known])
    if len(members) < LEAST_BINS:
        return members, None
    return members, Statistics.of(values, members, pixels.block).logarithm()


def _no_more_than_weaker(
    terms: Numbers, members: Sequence[Numbers], recorded: Statistics
) -> tuple[list[Numbers], Statistics | None]:
    """Bins whose strengths scatter no more than others do of which every term of (T184) is larger; None for too few.

    What does, such as strengths of pulses that saturate the receiver, has another cause. Strengths that scatter by less
    than half of a whole number may not scatter at all, and say nothing of others.
    """
    law = np.stack([terms[:, chosen].mean(axis=1) for chosen in members])
    is_noisy = np.exp(0.5 * recorded.value) > DITHER * np.sqrt(law[:, 1])
    excess = recorded.value[:, None] - recorded.value
    above = excess > EXCESS_SIGMAS * np.hypot(recorded.sigma[:, None], recorded.sigma)
    rest = ~np.any(above & is_noisy & np.all(law[:, None] <= law, axis=2), axis=1)
    if rest.sum() < LEAST_BINS:
        return [], None
    return list(itertools.compress(members, rest)), map_arrays(lambda values: values[..., rest], recorded)


def _sum_of_terms(
    names: tuple[str, ...], power: Numbers, terms: Numbers, members: Sequence[Numbers], recorded: Statistics | None
) -> Law:
    """Fit the coefficients c of a mean square sum_k c_k^power_k terms_k.

    Args:
        terms: (k, n) of each pixel
    """
    if recorded is None:
        reason = "too few surfaces of different strength and range"
        return (), None, {key: reason for key in names if key in UNITS}
    law = np.stack([terms[:, chosen].mean(axis=1) for chosen in members])
    level = float(np.exp(np.median(recorded.value)))
    start = np.log(level / len(names) / np.median(law, axis=0)) / power
    bounds = start + np.log([[1e-6], [1e3]]) / power
    solved = solve(recorded, lambda logs: np.asarray(np.log(law @ np.exp(power * logs))), start, bounds)
    return _determined(names, solved, bounds)


def _columns(pixels: PixelsAtRest, text: str, where: str) -> Law:
    """Reach in range of the columns that share shots: the noise over c / sqrt(SIGNAL) by the lean over it, (T176a)."""
    if pixels.strength is None:
        return (), None, {COLUMNS: "SIGNAL is not recorded"}
    start = float(get_key(text, COLUMNS) or 4.0)
    try:
        histogram = parse_sensor(text, where, {COLUMNS: (start, "")}).histogram
    except InputError as error:
        return (), None, {COLUMNS: str(error)}
    assert histogram is not None
    signal = np.nanmean(pixels.strength, axis=0)
    step_mm = 1e3 * np.abs(pixels.row_slope) * pixels.mean_m * float(histogram.column_rad) * np.sqrt(signal)
    strong = is_strong(signal, histogram)
    keys = 2.0 * np.log2(np.maximum(step_mm[strong], LEAST_STEP_MM))
    changes_mm = 1e3 * changes_m(pixels.range_m[:, strong]) * np.sqrt(signal[strong])
    members, recorded = _binned(pixels.select(strong), keys[None], changes_mm)
    if recorded is None:
        return (), None, {COLUMNS: "too few smooth surfaces of different lean"}
    steps = [np.sort(step_mm[strong][chosen]) for chosen in members]

    def law(place: Numbers) -> Numbers:
        reach_mm = np.exp(place.sum())
        squares = [np.mean(noise_by_step(histogram, of_bin / reach_mm) ** 2) for of_bin in steps]
        return np.asarray(2.0 * place[0] + np.log(squares))

    first = np.array([0.5 * float(np.min(recorded.value)), math.log(start)])
    bounds = np.array([first[0] + np.array([-3.0, 3.0]), np.log(REST_BOUNDS[COLUMNS])]).T
    return _determined(("scatter_c at rest", COLUMNS), solve(recorded, law, first, bounds), bounds)


def _converter(pixels: PixelsAtRest, text: str, where: str) -> Law:
    """Jitter, slopes and chatter by the sensor's own stages.

    Beam, chatter and light make up for each other, so all are fitted: what is told of one holds for any of the others.
    """
    sensor = parse_sensor(text, where)
    boards = Boards.of(pixels, sensor, HEIGHT_PARTS)
    if len(boards.members) < LEAST_BINS:
        return (), None, dict.fromkeys((*CONVERTER, LIGHT), "too few smooth surfaces of different strength and lean")
    recorded = boards.recorded()
    reasons: dict[str, str] = {}
    if sensor.tdc.strong_above is None:
        reasons[STRONG] = "the file has no tdc.strong_above, from which on pulses have a channel of their own"
    kept = recorded.kind == 1
    if np.min((recorded.value + 2.0 * recorded.spread(recorded.value))[kept]) > MOST_KEPT:
        reasons[CHATTER] = f"no surface loses more than {1.0 - MOST_KEPT:.0%} of its pulses"
    keys = [key for key in (*CONVERTER, LIGHT) if key == CHATTER or key not in reasons]
    if pixels.apparent_error.any():
        keys.append(STRENGTH)
    names, solved, more = _converter_law(boards, recorded, keys, text, where)
    reasons = more | reasons
    told = f": {LIGHT}" if LIGHT in names else ", and not here"
    reasons[POWER] = f"only its product with lens and scale of intensities is known, over the noise{told}"
    if STRONG in names and solved is not None:
        assert sensor.tdc.strong_above is not None
        light_times = math.exp(solved.value[names.index(LIGHT)]) if LIGHT in names else 1.0
        margin = light_times * detection_margin(sensor, boards.pixels.board, boards.pixels.mean_m)
        strongest = max(np.median(margin[members]) for members in boards.members)
        if strongest < sensor.tdc.strong_above:  # of weaker ones only what else scatters would be told
            reasons[STRONG] = f"no surface is strong: echoes reach {strongest:.3g} times the threshold"
    if DIVERGENCE in names and solved is not None:
        beam = {DIVERGENCE: math.exp(solved.value[names.index(DIVERGENCE)])}
        light = echoes_of_plane(parse_sensor(text, where, _changes(beam)), boards.pixels.board, boards.pixels.mean_m)
        longest = max(np.median(np.asarray(light.broadening)[members]) for members in boards.members)
        if longest < LEAST_BROADENING:  # near by, what scatters for another reason would widen the beam
            reasons[DIVERGENCE] = f"no surface leans enough: echoes are {longest:.2g} times as long as the pulse"
    if DIVERGENCE in reasons:
        reasons.setdefault(CHATTER, "it makes up for the width of the beam, which is not determined")
    return tuple(f"{key}, not told" if key in reasons else key for key in names), solved, reasons


def _converter_law(boards: Boards, recorded: Statistics, keys: Sequence[str], text: str, where: str) -> Law:
    """Fit these keys to the statistics of the boards; without the beam if the file refuses one that is tried."""
    pixels = boards.pixels
    middle_m, least_known = np.median(pixels.mean_m), np.max(pixels.apparent_error)
    share = boards.drawn.apparent_error / max(least_known, 1e-9)
    file = parse_sensor(text, where)
    law = BoardLaw.of(file, boards.light(file), LIGHT_BOUNDS[1])
    tried = REST_BOUNDS | {LIGHT: LIGHT_BOUNDS, STRENGTH: STRENGTH_BOUNDS}
    start = np.log([get_key(text, key) or math.sqrt(math.prod(tried[key])) for key in keys])
    bounds = np.log([tried[key] for key in keys]).T

    @cache
    def lit(node: int) -> Numbers:
        """(2, n) logarithms of power and length of the echoes of a beam, of one wider than its field as of the file's.

        The light that it loses is LIGHT's.
        """
        sensor = parse_sensor(text, where, _changes({DIVERGENCE: math.exp(BEAM_STEP * node)}))
        target = Target(illuminance_klux=ASSUMED_KLUX)
        heights = [detection_margin(each, target, middle_m).item() for each in (file, sensor)]
        light = boards.light(sensor)
        power_w = np.asarray(light.peak_power_w) * (heights[0] / heights[1])
        return np.asarray(np.log(np.stack([power_w, np.asarray(light.broadening)])))

    @lru_cache(maxsize=8)
    def noise(log_beam: float | None, log_light: float, log_strength: float) -> BoardNoise:
        light = boards.light(file)
        if log_beam is not None:
            node, rest = divmod(log_beam / BEAM_STEP, 1.0)
            power_w, length = np.exp((1.0 - rest) * lit(int(node)) + rest * lit(int(node) + 1))
            light = replace(light, peak_power_w=power_w, broadening=length)
        times = np.exp(log_light + log_strength * share)
        return law.noise(replace(light, peak_power_w=light.peak_power_w * times), boards.lean_m)

    def expected(logs: Numbers) -> Numbers:
        values = dict(zip(keys, logs.tolist(), strict=True))
        numbers: dict[str, Any] = {
            field: scale * math.exp(values[key]) for key, (field, scale) in CLOCK.items() if key in values
        }
        of_echoes = noise(values.get(DIVERGENCE), values[LIGHT], values.get(STRENGTH, 0.0))
        return boards.expected(law, of_echoes, replace(file.tdc, **numbers))

    try:
        prior = Prior(start, np.where(np.array(keys) == STRENGTH, least_known, np.inf))
        solved = solve(recorded, expected, np.clip(start, *bounds), bounds, prior, along=keys.index(LIGHT))
        solved = solved.wider(np.diag(np.where(np.array(keys) == LIGHT, LIGHT_ERROR**2, 0.0)))
    except InputError as failure:
        if DIVERGENCE not in keys:
            return (), None, dict.fromkeys(keys, str(failure))
        # Files refuse beams narrower than their diffraction, and longer echoes of slopes behind an AC coupling.
        rest = [key for key in keys if key != DIVERGENCE]
        names, found, reasons = _converter_law(boards, recorded, rest, text, where)
        return names, found, {DIVERGENCE: str(failure), **reasons}
    return _determined(tuple(keys), solved, bounds)


def _determined(keys: tuple[str, ...], solved: Solution, bounds: Numbers) -> Law:
    """Law without the parameters that ended at a bound or that no statistic depends on; these stay as they are."""
    at_bound = np.any(np.abs(solved.value - bounds) < LOG_STEP, axis=0)
    apart = 0.0 if solved.held_covariance is None else np.diag(solved.held_covariance)
    silent = np.diag(solved.slope) < LEAST_SLOPE * (1.0 + apart * np.diag(solved.slope))
    reasons = {
        key: "nothing that was recorded depends on it, or other numbers make up for it"
        if quiet
        else f"{'below' if value < middle else 'above'} {math.exp(value):.3g}, if there is any"
        for key, value, middle, quiet, ends in zip(
            keys, solved.value, bounds.mean(axis=0), silent, at_bound, strict=True
        )
        if (quiet or ends) and key in UNITS
    }
    rest = np.flatnonzero(~at_bound & ~silent)
    if not len(rest):
        return (), None, reasons
    square, in_common = np.ix_(rest, rest), solved.held_covariance
    solved = replace(
        solved,
        value=solved.value[rest],
        slope=solved.slope[square],
        scores=solved.scores[:, rest],
        held_covariance=None if in_common is None else in_common[square],
    )
    return tuple(keys[index] for index in rest), solved, reasons


def checks_at_rest(boards: Boards, sensor: Sensor) -> Iterator[Held]:
    """Hold a sensor, such as that of the written file, to pixels: their scatter by bin, the share kept by range."""
    rest = boards.pixels
    if not boards.members:
        return
    law = BoardLaw.of(sensor, boards.light(sensor))
    noise = law.noise(boards.light(sensor), boards.lean_m)
    recorded, simulated = boards.recorded().value, boards.expected(law, noise, sensor.tdc)
    for members, real, found in zip(boards.members, recorded, simulated, strict=False):
        lean_m, strength = np.median(rest.lean_m[members]), np.median(rest.apparent[members])
        real_mm, found_mm = (1e3 * math.exp(0.5 * value) for value in (real, found))
        yield Held(
            quantity="range, scatter at rest",
            condition=f"{np.median(rest.mean_m[members]):.3g} m, lean {lean_m:.4g} m, reflectivity {strength:.2g}",
            reference=real_mm,
            simulated=found_mm,
            value=found_mm / real_mm,
            limits=LIMITS["scatter ratio"],
            unit="mm",
        )
    kept = np.isfinite(rest.range_m[1:]).mean(axis=0)
    found_kept = detection_probability(sensor, rest.board, rest.mean_m)
    for octave in kept_by_bin(kept, found_kept, rest.mean_m, OCTAVES_M, least=LEAST_OF_BIN):
        yield held_share("share kept at rest", *octave)
