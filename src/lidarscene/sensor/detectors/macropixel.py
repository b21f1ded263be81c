"""Macro-pixel: SPADs under one background, and how their firings become counts in a histogram.

Each shot adds the times of their firings to one histogram. A filter that is matched to the pulse goes over the sum of
all shots, and its peaks above a threshold are returns (docs/photon_counting.md).

Symbols: N number of SPADs times shots, lambda rate of detected photons of one free SPAD, Lambda detections of an echo
that one SPAD would make in a shot without dead time.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import ClassVar

from ...maths.arrays import Lanes, xp
from ...physics.electronics.pulse_sums import SIGMAS_PER_FWHM
from ...physics.optics import pulse
from ...physics.photon_counting import dead_time, draws, matched_filter, pile_up
from ..histogram import Histogram
from .spad_array import SpadArray
from .working_point import Noise, Response, ThresholdLaw, WorkingPoint

_INVERSIONS = 40
"""Bisections of the response with coincidence: from 1e-9 to 1e4 detections, to 1e-8 of their logarithm."""


_LARGEST_SHARE = 0.995
"""Accuracy bought: share of fired SPADs above which their number no longer depends on the light: 5.3 detections of
each."""

SUPPORTED_SHARE = 0.4
"""Choice: least share of neighbours with a return for which the law of the threshold holds: it is fitted to points with
a return in 8 of the 20 columns beside them (`studies.fit.threshold`)."""

PLACES = tuple((1.2 * k, math.exp(-0.5 * (1.2 * k) ** 2)) for k in range(-2, 3))
"""Places of a standard normal distribution, evenly apart, and its density there up to a factor: the trapezoidal rule,
to 0.004 for thresholds that scatter by 1.5 times the filter's noise, and to 0.03 by 2.5 times."""

_FOR_EVER = 1e9
"""Choice: dead time in widths of an echo that no window is as long as."""

_EARLY = (0.0, 0.3, 0.6, 1.0, 1.5)
"""Accuracy bought: widths of an echo by which the filter's peak may come early where SPADs count together."""

_LEAST_BEND = 0.2
"""Accuracy bought: least curvature of the filter's peak, over that of a weak echo as high whose SPADs count alone."""

_LEAST_NOISE = 0.05
"""Accuracy bought: least variance of the filter at an echo, over that of the background alone."""

_LEAST_FREE = 1e-12
"""Choice: least share of SPADs without a first firing, which underflows late in the sun: no count is left of it."""

_LEFT_STEPS = 12
"""Accuracy bought: steps in the share of SPADs without a first firing, over which coincidences are summed: to 0.3 % of
pairs and threes."""

_LEAST_RATE_HZ = 1e-3
"""Accuracy bought: no SPAD is darker; without any noise, the ratios of signal and threshold to it would have no
value."""

_LEAST_COUNTS = 1e-30
"""Choice: fewest counts of a bin of a shot, for the same reason: coincidences of many SPADs in the dark are rarer than
single precision resolves."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _FilteredEcho:
    """Peak of the filter at an echo; each field (n,).

    Attributes:
        height: highest value above that of the background
        variance: variance that the echo adds there; negative where its SPADs, which cannot count the background any
            more, take more from it than the echo brings
        of_slope: the same as far as the filter's slope has it
        bend: second derivative over that of a weak echo of this height
    """

    height: Lanes
    variance: Lanes
    of_slope: Lanes
    bend: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class Macropixel(ABC):
    """SPADs under one background, and the histogram that they fill. Each field a number or (n,).

    Its subclasses are the ways in which firings become counts: `FreeSpads`, of which each one counts, `CoatesSpads`,
    whose counts are corrected for pile-up, and `CoincidentSpads`, which count only together.

    Attributes:
        counts_firings: whether the counts of a bin are its firings
        knows_free: whether the receiver knows how many SPADs are free
        shades: whether SPADs fired by nearer echoes are known to be missing before the bins are drawn
        fwhm_s: FWHM of the laser's pulse
        sigma_s: width of an echo in the histogram: of the pulse, the jitter and a bin
        per_watt: detections of one free SPAD in a second, for each watt on the pixel
        rate_hz: lambda of the background and the dark counts, and of their afterpulses
        primary_hz: the same without afterpulses
        free: share of the SPADs that are free, before the echo
        trials: N, or the shots alone if SPADs count only together
        armed_s: time from when the SPADs were armed to the echo
        crowded: factor of an echo's variance by SPADs that exclude each other's firings (T104)
    """

    counts_firings: ClassVar[bool] = False
    knows_free: ClassVar[bool] = False
    shades: ClassVar[bool] = False

    spad: SpadArray
    histogram: Histogram
    fwhm_s: Lanes
    sigma_s: Lanes
    per_watt: Lanes
    rate_hz: Lanes
    primary_hz: Lanes
    free: Lanes
    trials: Lanes
    armed_s: Lanes
    crowded: Lanes = 1.0

    @staticmethod
    def for_background(
        background_power_w: Lanes,
        spad: SpadArray,
        histogram: Histogram,
        *,
        photon_energy_j: Lanes,
        pulse_fwhm_s: Lanes,
        armed_s: Lanes = 0.0,
    ) -> Macropixel:
        """Build the macro-pixel under this background.

        Args:
            armed_s: time since the SPADs were armed, which matters with ``stamps = "first"``
        """
        sigma = pulse_fwhm_s / SIGMAS_PER_FWHM
        bin_s, jitter = histogram.bin_s, spad.jitter_s
        variance = sigma * sigma + jitter * jitter + bin_s * bin_s / 12.0
        per_watt = spad.efficiency / (photon_energy_j * spad.spads)
        rate = xp(background_power_w).maximum(background_power_w * per_watt + spad.dark_rate_hz, _LEAST_RATE_HZ)
        primary = rate
        if spad.afterpulse is not None and spad.afterpulse_s is not None:
            rate = primary * dead_time.afterpulse_factor(
                rate_hz=primary,
                dead_time_s=spad.dead_time_s,
                afterpulse=spad.afterpulse,
                afterpulse_s=spad.afterpulse_s,
            )
        if spad.fires_once:
            free = dead_time.free_share_of_first(rate_hz=rate, time_s=armed_s)
            free = xp(free).maximum(free, _LEAST_FREE)
        else:
            free = dead_time.free_share(rate_hz=rate, dead_time_s=spad.dead_time_s)
        # Counts of coincidences do not give the number of free SPADs, so Coates' correction does not apply to them.
        kind: type[Macropixel] = CoatesSpads if histogram.coates else FreeSpads
        if spad.coincidence > 1:
            kind = CoincidentSpads
        pixel = kind(
            spad=spad,
            histogram=histogram,
            fwhm_s=pulse_fwhm_s,
            sigma_s=xp(variance).sqrt(variance),
            per_watt=per_watt,
            rate_hz=rate,
            primary_hz=primary,
            free=free,
            armed_s=armed_s,
            trials=kind.trials_of(histogram, spad),
        )
        # Once for all echoes: what a loop or a branch computes it computes at each pass.
        return replace(pixel.precompute(), crowded=1.0 + 4.0 * pixel.excluded(matched_filter.SIGNAL_REACH))

    @staticmethod
    def trials_of(histogram: Histogram, spad: SpadArray) -> Lanes:
        """N of such a pixel."""
        return histogram.shots * spad.spads

    def precompute(self) -> Macropixel:
        """Return the pixel with what it computes once for all echoes."""
        return self

    @property
    def count_share(self) -> Lanes:
        """Mean background counts of one trial in one bin; at most one of each SPAD fits into a bin."""
        # SPADs that come alive within the bin count too: firings renew themselves at the rate a lambda throughout.
        share = self.count_probability(self.free * self.rate_hz * self.histogram.bin_s)
        return xp(share).maximum(share, _LEAST_COUNTS)

    @property
    def count_rate_hz(self) -> Lanes:
        """Background counts a second, over all trials, as the filter sees them."""
        return self.trials * self.count_share / self.histogram.bin_s

    @property
    def even_afterpulses_hz(self) -> Lanes:
        """Rate of the afterpulses of one free SPAD in even light."""
        return self.rate_hz - self.primary_hz

    @property
    def sun(self) -> Lanes:
        """Detections of the background by one free SPAD within the width of an echo, lambda sigma."""
        return self.rate_hz * self.sigma_s

    @property
    def blind_sigmas(self) -> Lanes:
        """Dead time in widths of an echo; SPADs that fire but once are blind for ever, here for very long."""
        return _FOR_EVER if self.spad.fires_once else self.spad.dead_time_s / self.sigma_s

    def excluded(self, reach: float) -> Lanes:
        """Renewal density of a SPAD less its mean rate over a Gaussian of so many widths of an echo (T104)."""
        reach_s = reach * self.sigma_s
        excluded = matched_filter.excluded(
            rate_hz=self.rate_hz, free=self.free, dead_time_s=self.blind_sigmas * self.sigma_s, reach_s=reach_s
        )
        if self.spad.afterpulse is None or self.spad.afterpulse_s is None:
            return excluded
        return excluded + matched_filter.repeated(
            rate_hz=self.rate_hz,
            dead_time_s=self.spad.dead_time_s,
            reach_s=reach_s,
            afterpulse=self.spad.afterpulse,
            afterpulse_s=self.spad.afterpulse_s,
        )

    def background_counts(self, time_s: Lanes) -> tuple[Lanes, Lanes]:
        """Background counts per second over ``time_s`` of each shot, and the factor that narrows their noise."""
        if self.spad.fires_once:
            share = dead_time.firing_share(detections=self.rate_hz * time_s)
            ops = xp(share)
            return self.trials * share / time_s, ops.sqrt(1.0 - share)
        return self.trials * self.count_share / self.histogram.bin_s, self.free

    def window_counts(self, time_s: Lanes) -> Lanes:
        """Background counts of a point in ``time_s`` of each shot, as the filter sees them: those of (T110)."""
        if self.spad.fires_once:
            return self.background_counts(time_s)[0] * time_s
        return self.count_rate_hz * time_s

    @property
    def detections_of_watt(self) -> Lanes:
        """Lambda of an echo with a peak power of 1 W."""
        return self.per_watt * pulse.pulse_energy_j(peak_power_w=1.0, fwhm_s=self.fwhm_s)

    def detections(self, peak_power_w: Lanes) -> Lanes:
        """Lambda of an echo with this peak power."""
        return self.per_watt * pulse.pulse_energy_j(peak_power_w=peak_power_w, fwhm_s=self.fwhm_s)

    def height_of_free(self, excess: Lanes) -> Lanes:
        """Value of the filter [photons] where this share more of the SPADs are free than in even light."""
        step = self.rate_hz * self.histogram.bin_s
        counted = self.count_probability(self.free * step * (1.0 + excess)) - self.count_share
        template = matched_filter.SCALE * matched_filter.TEMPLATE * math.sqrt(2.0 * math.pi)
        return self.trials * counted * (template * self.sigma_s / self.histogram.bin_s)

    @property
    def has_humps(self) -> bool:
        """True if SPADs that come back together, a dead time behind an echo, raise the counts."""
        return not self.spad.fires_once

    @property
    def free_trials(self) -> Lanes:
        """Trials that can count."""
        return self.trials * self.free

    @property
    def signal_variance(self) -> Lanes:
        """Variance that a photon of an echo adds to the value of the filter (T95)."""
        return matched_filter.SIGNAL_VARIANCE

    @property
    def most_counts(self) -> Lanes | None:
        """Counts of an echo that fires all SPADs; None: counts go on with the light."""
        return self.free_trials

    @property
    @abstractmethod
    def variance_share(self) -> Lanes:
        """Variance of the filtered background over that of Poisson counts (T95)."""

    @property
    def slope_share(self) -> Lanes:
        """Variance of the slope of the filtered background over that of Poisson counts (T104)."""
        return self.variance_share

    @abstractmethod
    def counts(self, detections: Lanes) -> Lanes:
        """Photons of an echo, as the filter sees them, from Lambda (T92)."""

    @abstractmethod
    def power_w(self, counts: Lanes) -> Lanes:
        """Peak power of an echo with so many photons."""

    @abstractmethod
    def peak(self, signal: Lanes) -> _FilteredEcho:
        """Peak of the filter at an echo of so many photons, from the renewal course of the SPADs (T101), (T104)."""

    def count_probability(self, share: Lanes) -> Lanes:
        """Probability of a count of one trial from that of a firing of one SPAD."""
        return share

    def photons_of_box(self, counts: Lanes) -> Lanes:
        """Photons of an echo from its counts within `pile_up.BOX` sigmas, above those of the background."""
        return counts / pile_up.BOX_SHARE

    def first_trials(self, free: Lanes) -> tuple[Lanes, Lanes]:
        """Trials that have not fired before the first drawn bin, and those known to be free again.

        Args:
            free: share of the SPADs that is free then
        """
        return self.trials, 0.0

    @abstractmethod
    def draw(self, *, pool: Lanes, probability: Lanes, known_free: Lanes, uniform: Lanes) -> tuple[Lanes, Lanes]:
        """Draw the firings of a bin and its counts, (n,) each (T105).

        Args:
            pool: trials that may fire
            probability: of each of them
            known_free: trials known to be free
            uniform: in (0, 1]
        """

    def place_deviation_s(self, signal: Lanes) -> Lanes:
        """Standard deviation of the time of the filter's peak at a lone echo of so many photons (T176)."""
        echo, sigma = self.peak(signal), self.sigma_s
        background = matched_filter.background_variance(rate_hz=self.count_rate_hz, sigma_s=sigma)
        variance = matched_filter.place_variance(
            signal=echo.height, background=self.slope_share * background, signal_variance=echo.of_slope, bend=echo.bend
        )
        return sigma * xp(variance).sqrt(variance)

    def signal_of_height(self, height: Lanes) -> Lanes:
        """Photons of an echo whose peak behind the filter is so high, (n,): one step from those of weak light."""
        ops = xp(height, self.free)
        signal = ops.maximum(height, 1e-6)
        return signal * signal / ops.maximum(self.peak(signal).height, 1e-6)


@dataclass(frozen=True, slots=True, kw_only=True)
class FreeSpads(Macropixel):
    """SPADs each of whose firings counts.

    Attributes:
        weak: highest value of the filter at a weak echo (T101)
    """

    counts_firings: ClassVar[bool] = True
    shades: ClassVar[bool] = True

    weak: pile_up.Top | None = None

    def precompute(self) -> FreeSpads:
        """Return the pixel with the filter's value at a weak echo."""
        return replace(self, weak=pile_up.weak_top(sun=self.sun, dead=self.blind_sigmas))

    @property
    def shade(self) -> Lanes:
        """Value of the filter at a weak echo over its photons: its shadow lacks some of the background (T101)."""
        assert self.weak is not None
        return self.weak.height

    @property
    def most_counts(self) -> Lanes:
        """Counts of all free SPADs."""
        return self.trials * (self.free * self.shade)

    @property
    def variance_share(self) -> Lanes:
        """Firings exclude each other for a dead time."""
        doubled = 2.0 * self.excluded(matched_filter.BACKGROUND_REACH)
        return xp(self.rate_hz).maximum(1.0 + doubled, self.free * self.free)

    @property
    def slope_share(self) -> Lanes:
        """Share of the slope, as `variance_share`."""
        return matched_filter.slope_excluded(
            rate_hz=self.rate_hz, dead_time_s=self.blind_sigmas * self.sigma_s, sigma_s=self.sigma_s
        )

    def counts(self, detections: Lanes) -> Lanes:
        """Each free SPAD counts an echo once (T92)."""
        return self.trials * self.free * self.shade * dead_time.firing_share(detections=detections)

    def power_w(self, counts: Lanes) -> Lanes:
        """Inverse of `counts`."""
        share = counts / (self.trials * self.free * self.shade)
        return dead_time.detections_of_share(share=share) / self.detections_of_watt

    def peak(self, signal: Lanes) -> _FilteredEcho:
        """Peak from the renewal course of the SPADs (T101), (T104)."""
        ops = xp(signal, self.free)
        assert self.weak is not None
        share = signal / (self.trials * self.free * self.weak.height)
        detections = dead_time.detections_of_share(share=share)
        top = pile_up.top(detections=detections, sun=self.sun, dead=self.blind_sigmas, weak=self.weak)
        # SPADs that the echo fires without sun: what the peak is counted in.
        fired = signal / self.weak.height
        height = ops.maximum(fired * top.height, signal)
        # The echo's photons stand in the place of counts of the background that their SPADs would have made.
        return _FilteredEcho(
            height=height,
            variance=top.variance * fired * self.crowded - height * height / self.trials,
            of_slope=top.of_slope * fired,
            bend=top.bend,
        )

    def draw(self, *, pool: Lanes, probability: Lanes, known_free: Lanes, uniform: Lanes) -> tuple[Lanes, Lanes]:
        """Binomial counts."""
        firings = draws.binomial_count(trials=pool, probability=probability, uniform=uniform)
        return firings, firings

    def photons_of_box(self, counts: Lanes) -> Lanes:
        """Photons with those of the background that the echo's shadow takes."""
        assert self.weak is not None
        return counts * (self.weak.height / pile_up.shade_of_box(sun=self.sun))


@dataclass(frozen=True, slots=True, kw_only=True)
class CoatesSpads(Macropixel):
    """SPADs whose counts are corrected for pile-up by Coates' correction, which knows how many SPADs are free."""

    knows_free: ClassVar[bool] = True

    @property
    def has_humps(self) -> bool:
        """The correction takes them off."""
        return False

    @property
    def count_rate_hz(self) -> Lanes:
        """Rate as of SPADs without dead time."""
        return self.trials * self.rate_hz

    def window_counts(self, time_s: Lanes) -> Lanes:
        """Counts as of SPADs without dead time."""
        return self.count_rate_hz * time_s

    @property
    def signal_variance(self) -> Lanes:
        """The correction makes more of the noise where few SPADs are free."""
        return matched_filter.SIGNAL_VARIANCE / self.free

    @property
    def most_counts(self) -> None:
        """The correction goes on with the light."""
        return None

    @property
    def variance_share(self) -> Lanes:
        """Bins do not depend on each other, since the correction knows how many SPADs are free."""
        return 1.0 / self.free

    def counts(self, detections: Lanes) -> Lanes:
        """Counts in proportion to the light."""
        return self.trials * detections

    def power_w(self, counts: Lanes) -> Lanes:
        """Inverse of `counts`."""
        return counts / (self.trials * self.detections_of_watt)

    def peak(self, signal: Lanes) -> _FilteredEcho:
        """Peak as high as the photons say."""
        variance = matched_filter.SIGNAL_VARIANCE / self.free * signal
        return _FilteredEcho(height=signal, variance=variance, of_slope=variance, bend=1.0)

    def first_trials(self, free: Lanes) -> tuple[Lanes, Lanes]:
        """The counts before the bins say how many SPADs are free."""
        return 0.0, self.trials * free

    def draw(self, *, pool: Lanes, probability: Lanes, known_free: Lanes, uniform: Lanes) -> tuple[Lanes, Lanes]:
        """Binomial firings, and the detections that the correction makes of them."""
        firings = draws.binomial_count(trials=pool, probability=probability, uniform=uniform)
        free = xp(firings).maximum(known_free, 1e-6 * self.trials)
        return firings, self.trials * dead_time.detections_of_share(share=firings / free)


@dataclass(frozen=True, slots=True, kw_only=True)
class CoincidentSpads(Macropixel):
    """SPADs that count only together: one count for a bin in which so many of them fire."""

    @staticmethod
    def trials_of(histogram: Histogram, spad: SpadArray) -> Lanes:
        """The shots alone."""
        return histogram.shots

    @property
    def free_trials(self) -> Lanes:
        """All shots."""
        return self.trials

    @property
    def variance_share(self) -> Lanes:
        """Firings in other bins exclude each other, and coincidences go with them by their slope."""
        doubled = 2.0 * self.excluded(matched_filter.BACKGROUND_REACH)
        share, counted = self.free * self.rate_hz * self.histogram.bin_s, self.count_share
        variance = 1.0 - counted + self._coupling(share, counted) * (doubled + share)
        return xp(self.rate_hz).maximum(variance, _LEAST_NOISE)

    def background_counts(self, time_s: Lanes) -> tuple[Lanes, Lanes]:
        """Coincidences a second; of SPADs that fire once they become fewer faster than these do."""
        counts_hz, narrowing = Macropixel.background_counts(self, time_s)
        if not self.spad.fires_once:
            return counts_hz, narrowing
        step, fired = self.rate_hz * self.histogram.bin_s, dead_time.firing_share(detections=self.rate_hz * time_s)
        coincidences: Lanes = 0.0
        for k in range(_LEFT_STEPS):
            share = step * (1.0 - fired * ((k + 0.5) / _LEFT_STEPS))
            coincidences = coincidences + self.count_probability(share) / share
        return counts_hz * coincidences * (1.0 / _LEFT_STEPS), narrowing

    def count_probability(self, share: Lanes) -> Lanes:
        """Probability of a coincidence."""
        return dead_time.coincidence_share(least=self.spad.coincidence, spads=self.spad.spads, share=share)

    def _coupling(self, share: Lanes, counted: Lanes) -> Lanes:
        """Variance of coincidences by that of the firings, over the Poisson one, (n,).

        Args:
            share: probability that one SPAD fires in a bin
            counted: that of a coincidence
        """
        slope = dead_time.coincidence_slope(least=self.spad.coincidence, spads=self.spad.spads, share=share)
        return slope * slope * self.spad.spads * share / xp(counted).maximum(counted, 1e-30)

    def _course_of_bins(self, detections: Lanes) -> Iterable[tuple[int, Lanes, Lanes]]:
        """Bins around an echo of Lambda in the middle of one: number, share of SPADs that fire, counts of a trial."""
        bin_s, background, free = self.histogram.bin_s, self.rate_hz * self.histogram.bin_s, self.free
        step = bin_s / self.sigma_s
        ops = xp(detections, step)
        density = step / math.sqrt(2.0 * math.pi)
        bins, all_firings = range(-self.histogram.reach, self.histogram.reach + 1), list[Lanes]()
        for k in bins:
            light = detections * density * ops.exp(-0.5 * (k * step) * (k * step)) + background
            # As many SPADs come free as the sun has fired a dead time before.
            released = self.free * background
            of_free, of_released = dead_time.firing_parts(detections=light)
            firings = free * of_free + released * of_released
            free = free + released - firings
            all_firings.append(firings)
        return zip(bins, all_firings, ops.each(self.count_probability, all_firings), strict=True)

    def counts(self, detections: Lanes) -> Lanes:
        """Counts of an echo of Lambda, bin by bin (T93)."""
        ops, dark = xp(detections, self.sigma_s), self.count_share
        total: Lanes = 0.0
        for _, _, share in self._course_of_bins(detections):
            total = total + share - dark
        return self.trials * ops.maximum(total, 0.0)

    def peak(self, signal: Lanes) -> _FilteredEcho:
        """Peak from the counts of each bin (T93)."""
        detections = self.power_w(signal) * self.detections_of_watt
        ops, dark = xp(detections, self.sigma_s), self.count_share
        step = self.histogram.bin_s / self.sigma_s
        coupled: Lanes = 0.0
        # Height and curvature of the filter, and the variance that the echo adds to its value and to its slope.
        tops: list[tuple[Lanes, ...]] = [(0.0, 0.0, 0.0, 0.0)] * len(_EARLY)
        for k, firings, share in self._course_of_bins(detections):
            spread = share * (1.0 - share) - dark * (1.0 - dark)
            if k == 0:
                # Firings in other bins exclude each other, as of SPADs that count alone.
                coupled = self._coupling(firings, share)
            for number, early in enumerate(_EARLY):
                offset = (k * step + early) * (1.0 / matched_filter.TEMPLATE)
                square = offset * offset
                weight = matched_filter.SCALE * ops.exp(-0.5 * square)
                height, variance = weight * (share - dark), weight * weight * spread
                terms = (height, (1.0 - square) * height, variance, square * variance)
                tops[number] = tuple(old + term for old, term in zip(tops[number], terms, strict=True))
        top = tops[0]
        for other in tops[1:]:
            higher = other[0] > top[0]
            top = tuple(ops.where(higher, new, old) for new, old in zip(other, top, strict=True))
        peak_height, bend, of_value, of_slope = top
        # In units of the pulse: the template is wider.
        ratio = matched_filter.OUTPUT_WIDTH / matched_filter.TEMPLATE
        return _FilteredEcho(
            height=self.trials * ops.maximum(peak_height, 0.0),
            variance=self.trials * of_value * (1.0 + 4.0 * coupled * self.excluded(matched_filter.SIGNAL_REACH)),
            of_slope=self.trials * ops.maximum(of_slope, 0.0) * (ratio * ratio / matched_filter.SIGNAL_SLOPE),
            bend=ops.maximum(ratio * ratio * bend / ops.maximum(peak_height, 1e-30), _LEAST_BEND),
        )

    def power_w(self, counts: Lanes) -> Lanes:
        """Inverse of `counts`, which has no closed form: bisection on the logarithm of the detections."""
        unit = self.detections_of_watt
        ops = xp(counts, unit, self.free)
        zero: Lanes = ops.full(counts + self.free, 0.0)

        def halve(state: tuple[Lanes, Lanes, Lanes]) -> tuple[Lanes, Lanes, Lanes]:
            low, high, remaining_steps = state
            middle = 0.5 * (low + high)
            above = self.counts(ops.exp(middle)) > counts
            return ops.where(above, low, middle), ops.where(above, middle, high), remaining_steps - 1.0

        low, high, _ = ops.loop(
            (zero - 20.0, zero + 9.0, zero + float(_INVERSIONS)), lambda state: state[2] > 0.5, halve
        )
        return ops.exp(0.5 * (low + high)) / unit

    def first_trials(self, free: Lanes) -> tuple[Lanes, Lanes]:
        """Trials of one SPAD of each shot, whose mean stands for all."""
        return 1.0, 0.0

    def draw(self, *, pool: Lanes, probability: Lanes, known_free: Lanes, uniform: Lanes) -> tuple[Lanes, Lanes]:
        """Binomial coincidences, and the mean firings with so many."""
        # How many SPADs have fired is not known from the pixel's counts: their mean with so many stands for them.
        ops, spad = xp(pool, probability), self.spad
        mean = pool * probability
        together = self.count_probability(mean)
        coincidences = draws.binomial_count(trials=self.trials, probability=together, uniform=uniform)
        fired = dead_time.firings_in_coincidences(least=spad.coincidence, spads=spad.spads, share=mean)
        excess = (coincidences / self.trials - together) / ops.maximum(together * (1.0 - together), 1e-12)
        return ops.maximum(mean + excess * (fired / spad.spads - mean * together), 0.0), coincidences


def working_point(pixel: Macropixel, *, ambient_s: Lanes) -> WorkingPoint:
    """Working point of the filtered histogram; signals are photons, (T95) to (T98a), (T110) to (T113).

    Args:
        ambient_s: time in each shot in which the background is counted
    """
    histogram = pixel.histogram
    rate, sigma = pixel.count_rate_hz, pixel.sigma_s
    variance_share = pixel.variance_share
    poisson_variance = matched_filter.background_variance(rate_hz=rate, sigma_s=sigma)
    variance = variance_share * poisson_variance
    ops = xp(variance)
    signal_variance, most_counts = pixel.signal_variance, pixel.most_counts
    slope_variance = pixel.slope_share * poisson_variance
    kappa_2 = 0.0 if most_counts is None else -signal_variance / most_counts
    background_unit = matched_filter.background_skewness(variance_share=variance_share)
    signal_unit = signal_variance * (matched_filter.SIGNAL_SKEWNESS / matched_filter.SIGNAL_VARIANCE)

    def probability(threshold: Lanes, signal: Lanes, echo: _FilteredEcho) -> Lanes:
        noise = ops.maximum(variance + echo.variance, _LEAST_NOISE * variance)
        gained = matched_filter.gain_of_place(
            signal=echo.height, background=slope_variance, signal_variance=echo.of_slope, bend=echo.bend
        )
        lost = matched_filter.loss_between_bins(signal=echo.height, bin_sigmas=histogram.bin_s / sigma, bend=echo.bend)
        counted = signal_variance * signal
        poisson = ops.maximum(poisson_variance + counted, 1e-30)
        unit = (poisson_variance * background_unit + counted * signal_unit) / poisson
        return matched_filter.detection_probability(
            threshold=threshold, signal=echo.height, variance=noise, unit=unit, gained=gained - lost
        )

    def lone_share(threshold: Lanes, signal: Lanes, echo: _FilteredEcho) -> Lanes:
        if not histogram.neighbours:
            return 0.0
        # Neighbours on one wide surface have the same light, and half of them a threshold below the median.
        return ops.maximum(1.0 - probability(threshold, signal, echo) * (1.0 / SUPPORTED_SHARE), 0.0)

    def echo_probability(threshold: Lanes, signal: Lanes) -> Lanes:
        echo = pixel.peak(signal)
        lone = lone_share(threshold, signal, echo)
        if histogram.threshold_spread is None:
            return probability(histogram.threshold_of_point(threshold, 0.0, lone), signal, echo)
        total: Lanes = 0.0
        for place, weight in PLACES:
            total = total + weight * probability(histogram.threshold_of_point(threshold, place, lone), signal, echo)
        # Without a count there is no peak, however low the threshold is drawn.
        most = 1.0 - ops.exp(-signal - rate * histogram.bin_s * (2.0 * histogram.reach + 1.0))
        return ops.minimum(total * (1.0 / sum(weight for _, weight in PLACES)), most)

    def false_peak(threshold: Lanes) -> Lanes:
        return matched_filter.false_peak_share(
            threshold=threshold,
            rate_hz=rate,
            sigma_s=sigma,
            bin_s=histogram.bin_s,
            variance_share=variance_share,
            bin_to_sigma=histogram.bin_to_sigma,
        )

    return WorkingPoint(
        noise=Noise(
            deviation=ops.sqrt(variance),
            kappa_1=signal_variance,
            kappa_2=kappa_2,
            tail=false_peak,
            echo_tail=echo_probability,
        ),
        response=Response(
            signal=lambda power_w: pixel.counts(pixel.detections(power_w)),
            power_w=pixel.power_w,
            largest=None if most_counts is None else most_counts * _LARGEST_SHARE,
        ),
        law=ThresholdLaw(
            level=histogram.threshold(pixel.window_counts(ambient_s)),
            lone=lambda threshold, signal: lone_share(threshold, signal, pixel.peak(signal)),
        ),
    )
