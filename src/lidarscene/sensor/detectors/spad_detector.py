"""SPADs and their histogram as data, and their working point under a background.

A macro-pixel is an array of single-photon avalanche diodes. Each shot adds the times of their firings to one
histogram. A filter that is matched to the pulse goes over the sum of all shots, and its peaks above a threshold are
returns. So the signal is a number of photons: the value of the filter above that of the background
(docs/photon_counting.md).

Symbols: N number of SPADs times shots, lambda rate of detected photons of one free SPAD, Lambda detections of an echo
that one SPAD would make in a shot without dead time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal

from pydantic import model_validator

from ...files.table_model import Table
from ...maths.arrays import Lanes, xp
from ...maths.units import FileKey, Quantity, Slider
from ...physics.electronics.pulse_sums import SIGMAS_PER_FWHM
from ...physics.optics import pulse, radiometry
from ...physics.photon_counting import dead_time, matched_filter, pile_up
from ..histogram import Histogram
from .detector import Detector, Reception
from .working_point import Noise, Response, ThresholdLaw, WorkingPoint

_INVERSIONS = 40
"""Bisections of the response with coincidence: from 1e-9 to 1e4 detections, to 1e-8 of their logarithm."""


_LARGEST_SHARE = 0.995
"""Share of fired SPADs above which their number no longer depends on the light: 5.3 detections of each."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Spad(Detector):
    """Macro-pixel of single-photon avalanche diodes. SI units.

    stamps       "all": a SPAD fires again after its dead time; "first": once in a shot
    coincidence  1: each SPAD has its own time stamps; else the pixel has one for a bin in which that many SPADs fire
    afterpulse   afterpulses of each firing, whether their SPAD is free by then or not; None: no such thing
    """

    label: ClassVar[str] = "SPAD histogram"
    unit: ClassVar[str] = "photons"
    fills_histogram: ClassVar[bool] = True

    spads: Annotated[Lanes, Quantity(ge=1, le=1e6, whole=True, about="SPADs of one pixel")]
    radius_m: Annotated[
        Lanes, Quantity("mm", ge=1e-3, le=100, about="of a disc of the pixel's area: the field of view")
    ]
    pde: Annotated[Lanes, Quantity(gt=0, le=1, about="with the fill factor"), Slider("PDE", "", 0.01, 1.0)]
    dead_time_s: Annotated[Lanes, Quantity("ns", ge=0.01, le=1e5, about="after a firing")]
    dark_count_rate_hz: Annotated[Lanes, Quantity(ge=0, le=1e9, about="of each SPAD")]
    jitter_s: Annotated[
        Lanes, Quantity("ps", ge=0, le=1e6, finest=1e-3, about="standard deviation of a time stamp")
    ] = 0.0
    stamps: Annotated[
        Literal["all", "first"],
        FileKey(about='time stamps of a SPAD in a shot: "all" that its dead time allows, or the "first"'),
    ] = "all"
    coincidence: Annotated[
        int, Quantity(ge=1, le=16, about="SPADs that must fire in one bin to count; 1: each one counts")
    ] = 1
    afterpulse: Annotated[
        Lanes | None,
        Quantity(
            ge=0,
            le=0.5,
            about="with `afterpulse_ns`: share of firings after which the same SPAD fires again if it is free; none if "
            "left out",
        ),
    ] = None
    afterpulse_s: Annotated[
        Lanes | None, Quantity("ns", ge=0.01, le=1e5, about="with `afterpulse`: their mean delay, exponential")
    ] = None

    @property
    def saturates(self) -> bool:
        """True: a SPAD counts each echo only once, so strong ones lose their height."""
        return True

    @property
    def silicon(self) -> str:
        """Always."""
        return "a SiPM or SPAD is of silicon"

    def pixel(self, background_power_w: Lanes, reception: Reception, *, range_m: Lanes | None = None) -> Macropixel:
        """The SPADs and their histogram under this background; ``range_m`` as for `working_point`."""
        assert reception.histogram is not None
        armed_s: Lanes = 0.0
        if range_m is not None:
            armed_s = radiometry.time_of_flight_s(range_m=range_m) - reception.blanking_s
        return Macropixel.for_background(
            background_power_w,
            self,
            reception.histogram,
            photon_energy_j=reception.photon_energy_j,
            pulse_fwhm_s=reception.pulse_fwhm_s,
            armed_s=armed_s,
        )

    def working_point(
        self, background_power_w: Lanes, reception: Reception, *, range_m: Lanes | None = None
    ) -> WorkingPoint:
        """Signal and noise behind the filter over the histogram, in photons."""
        return working_point(self.pixel(background_power_w, reception, range_m=range_m), ambient_s=reception.ambient_s)

    def background_counts(self, background_power_w: Lanes, reception: Reception) -> tuple[Lanes, Lanes]:
        """Counts of all shots of a point, averaged over the ambient window."""
        return self.pixel(background_power_w, reception).background_counts(reception.ambient_s)


class SpadFile(Table[Spad]):
    """[detector] type = "spad"."""

    type: Literal["spad"]

    @model_validator(mode="after")
    def _enough_spads_for_a_coincidence(self) -> SpadFile:
        if self.coincidence > self.spads:
            raise ValueError(f"coincidence: must be <= {self.spads:g}, the spads of the pixel, got {self.coincidence}")
        return self

    @model_validator(mode="after")
    def _afterpulses_of_spads_that_fire_again(self) -> SpadFile:
        if (self.afterpulse is None) != (self.afterpulse_ns is None):
            raise ValueError("afterpulse, afterpulse_ns: must be given together, got one of them")
        if self.afterpulse is not None and self.stamps == "first":
            raise ValueError('afterpulse: must be left out with stamps = "first", whose SPADs fire once in a shot')
        return self


SUPPORTED_SHARE = 0.4
"""Least share of neighbours with a return for which the law of the threshold holds: it is fitted to points with a
return in 8 of the 20 columns beside them (`studies.fit.threshold`)."""

PLACES = tuple((1.2 * k, math.exp(-0.5 * (1.2 * k) ** 2)) for k in range(-2, 3))
"""Places of a standard normal distribution, evenly apart, and its density there up to a factor: the trapezoidal rule,
to 0.004 for thresholds that scatter by 1.5 times the filter's noise, and to 0.03 by 2.5 times."""

_FOR_EVER = 1e9
"""Dead time in widths of an echo that no window is as long as."""

_EARLY = (0.0, 0.3, 0.6, 1.0, 1.5)
"""Widths of an echo by which the filter's peak may come early where SPADs count together."""

_LEAST_BEND = 0.2
"""Least curvature of the filter's peak, over that of a weak echo as high whose SPADs count alone."""

_LEAST_NOISE = 0.05
"""Least variance of the filter at an echo, over that of the background alone."""

_LEAST_RATE_HZ = 1e-3
"""No SPAD is darker; without any noise, the ratios of signal and threshold to it would have no value."""

_LEAST_COUNTS = 1e-30
"""Nor has a bin of a shot fewer counts, for the same reason: coincidences of many SPADs in the dark are rarer than
single precision resolves."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _FilteredEcho:
    """Peak of the filter at an echo; each field (n,).

    height    highest value above that of the background
    variance  variance that the echo adds there; negative where its SPADs, which cannot count the background any more,
              take more from it than the echo brings
    of_slope  the same as far as the filter's slope has it
    bend      second derivative over that of a weak echo of this height
    """

    height: Lanes
    variance: Lanes
    of_slope: Lanes
    bend: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class Macropixel:
    """SPADs under one background, and the histogram that they fill. Each field a number or (n,).

    fwhm_s       FWHM of the laser's pulse
    sigma_s      width of an echo in the histogram: of the pulse, the jitter and a bin
    per_watt     detections of one free SPAD in a second, for each watt on the pixel
    rate_hz      lambda of the background and the dark counts, and of their afterpulses
    primary_hz   the same without afterpulses
    free         share of the SPADs that are free, before the echo
    trials       N, or the shots alone if SPADs count only together
    armed_s      time from when the SPADs were armed to the echo
    weak         highest value of the filter at a weak echo (T101); None where it is 1: counts are corrected for
                 pile-up, or SPADs count together
    crowded      factor of an echo's variance by SPADs that exclude each other's firings (T104)
    """

    spad: Spad
    histogram: Histogram
    fwhm_s: Lanes
    sigma_s: Lanes
    per_watt: Lanes
    rate_hz: Lanes
    primary_hz: Lanes
    free: Lanes
    trials: Lanes
    armed_s: Lanes
    weak: pile_up.Top | None = None
    crowded: Lanes = 1.0

    @classmethod
    def for_background(
        cls,
        background_power_w: Lanes,
        spad: Spad,
        histogram: Histogram,
        *,
        photon_energy_j: Lanes,
        pulse_fwhm_s: Lanes,
        armed_s: Lanes = 0.0,
    ) -> Macropixel:
        """Build the macro-pixel under this background.

        armed_s  time since the SPADs were armed, which matters with ``stamps = "first"``
        """
        sigma = pulse_fwhm_s / SIGMAS_PER_FWHM
        bin_s, jitter = histogram.bin_s, spad.jitter_s
        variance = sigma * sigma + jitter * jitter + bin_s * bin_s / 12.0
        per_watt = spad.pde / (photon_energy_j * spad.spads)
        rate = xp(background_power_w).maximum(background_power_w * per_watt + spad.dark_count_rate_hz, _LEAST_RATE_HZ)
        primary = rate
        if spad.afterpulse is not None and spad.afterpulse_s is not None:
            rate = primary * dead_time.afterpulse_factor(
                rate_hz=primary,
                dead_time_s=spad.dead_time_s,
                afterpulse=spad.afterpulse,
                afterpulse_s=spad.afterpulse_s,
            )
        if spad.stamps == "first":
            free = dead_time.free_share_of_first(rate_hz=rate, time_s=armed_s)
        else:
            free = dead_time.free_share(rate_hz=rate, dead_time_s=spad.dead_time_s)
        pixel = cls(
            spad=spad,
            histogram=histogram,
            fwhm_s=pulse_fwhm_s,
            sigma_s=xp(variance).sqrt(variance),
            per_watt=per_watt,
            rate_hz=rate,
            primary_hz=primary,
            free=free,
            armed_s=armed_s,
            trials=histogram.shots * (spad.spads if spad.coincidence == 1 else 1.0),
        )
        # Once for all echoes: what a loop or a branch computes it computes at each pass.
        weak = None
        if not pixel.corrected and spad.coincidence == 1:
            weak = pile_up.weak_top(sun=pixel.sun, dead=pixel.blind_sigmas)
        return replace(pixel, weak=weak, crowded=1.0 + 4.0 * pixel.excluded(matched_filter.SIGNAL_REACH))

    @property
    def corrected(self) -> bool:
        """True if Coates' correction applies: not to coincidences, which do not give the number of free SPADs."""
        return self.histogram.coates and self.spad.coincidence == 1

    @property
    def count_share(self) -> Lanes:
        """Mean background counts of one trial in one bin; at most one of each SPAD fits into a bin."""
        # SPADs that come alive within the bin count too: firings renew themselves at the rate a lambda throughout.
        share = self.coincidence_probability(self.free * self.rate_hz * self.histogram.bin_s)
        return xp(share).maximum(share, _LEAST_COUNTS)

    @property
    def count_rate_hz(self) -> Lanes:
        """Background counts a second, over all trials, as the filter sees them."""
        if self.corrected:
            return self.trials * self.rate_hz
        return self.trials * self.count_share / self.histogram.bin_s

    @property
    def sun(self) -> Lanes:
        """Detections of the background by one free SPAD within the width of an echo, lambda sigma."""
        return self.rate_hz * self.sigma_s

    @property
    def blind_sigmas(self) -> Lanes:
        """Dead time in widths of an echo; SPADs that fire but once are blind for ever, here for very long."""
        return _FOR_EVER if self.spad.stamps == "first" else self.spad.dead_time_s / self.sigma_s

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

    @property
    def variance_share(self) -> Lanes:
        """Variance of the filtered background over that of Poisson counts (T95)."""
        ops = xp(self.rate_hz)
        if self.corrected:
            # The correction knows how many SPADs are free, so its bins do not depend on each other.
            return 1.0 / self.free
        doubled = 2.0 * self.excluded(matched_filter.BACKGROUND_REACH)
        if self.spad.coincidence == 1:
            return ops.maximum(1.0 + doubled, self.free * self.free)
        # Firings in other bins exclude each other, and coincidences go with them by their slope.
        share, counted = self.free * self.rate_hz * self.histogram.bin_s, self.count_share
        return ops.maximum(1.0 - counted + self._coupling(share, counted) * (doubled + share), _LEAST_NOISE)

    def _coupling(self, share: Lanes, counted: Lanes) -> Lanes:
        """Variance of coincidences by that of the firings, over the Poisson one, (n,).

        share    probability that one SPAD fires in a bin
        counted  that of a coincidence
        """
        slope = dead_time.coincidence_slope(least=self.spad.coincidence, spads=self.spad.spads, share=share)
        return slope * slope * self.spad.spads * share / xp(counted).maximum(counted, 1e-30)

    @property
    def shade(self) -> Lanes:
        """Value of the filter at a weak echo over its photons: its shadow lacks some of the background (T101)."""
        return 1.0 if self.weak is None else self.weak.height

    def background_counts(self, time_s: Lanes) -> tuple[Lanes, Lanes]:
        """Background counts per second over ``time_s`` of each shot, and the factor that narrows their noise."""
        if self.spad.stamps == "first":
            share = dead_time.firing_share(detections=self.rate_hz * time_s)
            ops = xp(share)
            return self.trials * share / time_s, ops.sqrt(1.0 - share)
        return self.trials * self.count_share / self.histogram.bin_s, self.free

    def detections(self, peak_power_w: Lanes) -> Lanes:
        """Lambda of an echo with this peak power."""
        return self.per_watt * pulse.pulse_energy_j(peak_power_w=peak_power_w, fwhm_s=self.fwhm_s)

    def counts(self, detections: Lanes) -> Lanes:
        """Photons of an echo, as the filter sees them, from Lambda (T92)."""
        if self.corrected:
            return self.trials * detections
        if self.spad.coincidence == 1:
            return self.trials * self.free * self.shade * dead_time.firing_share(detections=detections)
        return self._coincidences(detections)

    def height_of_free(self, excess: Lanes) -> Lanes:
        """Value of the filter [photons] where this share more of the SPADs are free than in even light."""
        step = self.rate_hz * self.histogram.bin_s
        counted = self.coincidence_probability(self.free * step * (1.0 + excess)) - self.count_share
        template = matched_filter.SCALE * matched_filter.TEMPLATE * math.sqrt(2.0 * math.pi)
        return self.trials * counted * (template * self.sigma_s / self.histogram.bin_s)

    @property
    def slope_share(self) -> Lanes:
        """Variance of the slope of the filtered background over that of Poisson counts (T104)."""
        if self.corrected or self.spad.coincidence > 1:
            return self.variance_share
        return matched_filter.slope_excluded(
            rate_hz=self.rate_hz, dead_time_s=self.blind_sigmas * self.sigma_s, sigma_s=self.sigma_s
        )

    def peak(self, signal: Lanes) -> _FilteredEcho:
        """Peak of the filter at an echo of so many photons, from the renewal course of the SPADs (T101), (T104)."""
        if self.corrected:
            variance = matched_filter.SIGNAL_VARIANCE / self.free * signal
            return _FilteredEcho(height=signal, variance=variance, of_slope=variance, bend=1.0)
        ops = xp(signal, self.free)
        if self.spad.coincidence > 1:
            unit_w = self.per_watt * pulse.pulse_energy_j(peak_power_w=1.0, fwhm_s=self.fwhm_s)
            return self._peak_of_coincidences(self.power_w(signal) * unit_w)
        assert self.weak is not None
        share = signal / (self.trials * self.free * self.weak.height)
        detections = dead_time.detections_of_share(share=share)
        top = pile_up.top(detections=detections, sun=self.sun, dead=self.blind_sigmas, weak=self.weak)
        narrowing = ops.maximum(top.height / self.weak.height, 1.0)
        height = signal * narrowing
        # The echo's photons stand in the place of counts of the background that their SPADs would have made.
        of_value, of_slope = matched_filter.signal_variance_of(narrowing=narrowing)
        return _FilteredEcho(
            height=height,
            variance=of_value * signal * self.crowded - height * height / self.trials,
            of_slope=of_slope * signal,
            bend=top.bend,
        )

    def place_deviation_s(self, signal: Lanes) -> Lanes:
        """Standard deviation of the time of the filter's peak at a lone echo of so many photons (T176)."""
        echo, sigma = self.peak(signal), self.sigma_s
        background = matched_filter.background_variance(rate_hz=self.count_rate_hz, sigma_s=sigma)
        variance = matched_filter.place_variance(
            signal=echo.height, background=self.slope_share * background, signal_variance=echo.of_slope, bend=echo.bend
        )
        return sigma * xp(variance).sqrt(variance)

    def _course_of_bins(self, detections: Lanes) -> Iterator[tuple[int, Lanes, Lanes]]:
        """Bins around an echo of Lambda in the middle of one: number, share of SPADs that fire, counts of a trial."""
        bin_s, background, free = self.histogram.bin_s, self.rate_hz * self.histogram.bin_s, self.free
        step = bin_s / self.sigma_s
        ops = xp(detections, step)
        density = step / math.sqrt(2.0 * math.pi)
        for k in range(-self.histogram.reach, self.histogram.reach + 1):
            light = detections * density * ops.exp(-0.5 * (k * step) * (k * step)) + background
            # As many SPADs come free as the sun has fired a dead time before.
            released = self.free * background
            of_free, of_released = dead_time.firing_parts(detections=light)
            firings = free * of_free + released * of_released
            free = free + released - firings
            yield k, firings, self.coincidence_probability(firings)

    def _coincidences(self, detections: Lanes) -> Lanes:
        """Counts of an echo of Lambda whose SPADs count only together (T93)."""
        ops, dark = xp(detections, self.sigma_s), self.count_share
        total: Lanes = 0.0
        for _, _, share in self._course_of_bins(detections):
            total = total + share - dark
        return self.trials * ops.maximum(total, 0.0)

    def _peak_of_coincidences(self, detections: Lanes) -> _FilteredEcho:
        """Peak of an echo of Lambda whose SPADs count only together, bin by bin (T93)."""
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

    def signal_of_height(self, height: Lanes) -> Lanes:
        """Photons of an echo whose peak behind the filter is so high, (n,): one step from those of weak light."""
        ops = xp(height, self.free)
        signal = ops.maximum(height, 1e-6)
        return signal * signal / ops.maximum(self.peak(signal).height, 1e-6)

    def power_w(self, counts: Lanes) -> Lanes:
        """Peak power of an echo with so many photons."""
        unit = self.per_watt * pulse.pulse_energy_j(peak_power_w=1.0, fwhm_s=self.fwhm_s)
        if self.corrected:
            return counts / (self.trials * unit)
        if self.spad.coincidence == 1:
            share = counts / (self.trials * self.free * self.shade)
            return dead_time.detections_of_share(share=share) / unit
        # With coincidence the counts have no inverse in closed form: bisection on the logarithm of the detections.
        ops = xp(counts, unit, self.free)
        zero = 0.0 * (counts + self.free)

        def halve(state: tuple[Lanes, Lanes, Lanes]) -> tuple[Lanes, Lanes, Lanes]:
            low, high, remaining_steps = state
            middle = 0.5 * (low + high)
            above = self.counts(ops.exp(middle)) > counts
            return ops.where(above, low, middle), ops.where(above, middle, high), remaining_steps - 1.0

        low, high, _ = ops.loop(
            (zero - 20.0, zero + 9.0, zero + float(_INVERSIONS)), lambda state: state[2] > 0.5, halve
        )
        return ops.exp(0.5 * (low + high)) / unit

    def coincidence_probability(self, share: Lanes) -> Lanes:
        """Probability of a count of one trial from that of a firing of one SPAD."""
        if self.spad.coincidence == 1:
            return share
        return dead_time.coincidence_share(least=self.spad.coincidence, spads=self.spad.spads, share=share)


def working_point(pixel: Macropixel, *, ambient_s: Lanes) -> WorkingPoint:
    """Working point of the filtered histogram; signals are photons, (T95) to (T98a), (T110) to (T113).

    ambient_s  time in each shot in which the background is counted
    """
    histogram = pixel.histogram
    rate, sigma = pixel.count_rate_hz, pixel.sigma_s
    variance_share = pixel.variance_share
    poisson_variance = matched_filter.background_variance(rate_hz=rate, sigma_s=sigma)
    variance = variance_share * poisson_variance
    ops = xp(variance)
    signal_variance = matched_filter.SIGNAL_VARIANCE / (pixel.free if pixel.corrected else 1.0)
    slope_variance = pixel.slope_share * poisson_variance
    most_counts = pixel.trials * (pixel.free * pixel.shade if pixel.spad.coincidence == 1 else 1.0)
    kappa_2 = 0.0 if pixel.corrected else -signal_variance / most_counts
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
            largest=None if pixel.corrected else most_counts * _LARGEST_SHARE,
        ),
        law=ThresholdLaw(
            level=histogram.threshold(rate * ambient_s),
            lone=lambda threshold, signal: lone_share(threshold, signal, pixel.peak(signal)),
        ),
    )
