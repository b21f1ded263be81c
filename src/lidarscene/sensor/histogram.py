"""Histogram of photons over many shots: as data, and as [histogram] of a sensor file."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from ..errors import InputError
from ..files.table_model import Number, Table
from ..maths.arrays import Lanes, xp
from ..maths.attributes import HintedAttributes
from ..maths.units import STATIC, FileKey, Quantity, si
from ..physics.constants import SPEED_OF_LIGHT_M_S
from ..physics.electronics.pulse_sums import SIGMAS_PER_FWHM
from ..physics.photon_counting.walk import Filtering, Walk, calibrate
from .electronics import MOST_STOPS, Keep, Tdc, check_stops, kept_stops

MOST_BINS = 64
"""Most bins that are drawn around an echo: each is some hundred instructions of the kernel."""

SHORTEST_DEAD_TIME = 1.0
"""Choice: shortest dead time of a SPAD, in FWHM of the pulse: a SPAD counts an echo only once."""

MOST_COLUMNS = 16
"""Most columns that share their noise: each two are a random number of the kernel."""

LEAST_REST = 0.18
"""Source: recording of an OS0-32 (docs/recorded.md): the rest about a parabola over nine columns, over that of strong
returns, is 1/6 for returns of 23 photons. It is no noise of a mean: the parabola takes out the waves along
many columns."""

_TEMPLATE_REACH = 3.0
"""Accuracy bought: reach of the template to either side, in sigmas of the pulse."""

_SEARCH_REACH = 1.25
"""Accuracy bought: reach of the search for the filter's peak, in sigmas: its place scatters by a third of that at an
SNR of 5."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Histogram(HintedAttributes):
    """Sum of time stamps over shots, and what reads it.

    Attributes:
        shots: added up for one point
        period_s: between the laser's pulses of one point: light that is longer under way folds back; None: no limit
        reach: bins that are drawn to either side of an echo
        search: bins to either side of an echo in which its peak is looked for
        calibrated: shift of strong echoes by pile-up; None: it is left in the ranges, or the counts are corrected for
            it
        bin_to_sigma: width of a bin over that of an echo
        sweep_rad: angle by which the head turns while the shots of a point are summed; 0: it does not, or is left out
        column_rad: angle by which it turns from a point of a channel to the next; 0: it does not
        column_weights: of the noise of a point's own column and of those before it, their squares adding up to 1, or to
            either side with `column_range_sigmas`; None: columns share no noise
    """

    shots: Lanes
    period_s: Lanes | None
    bin_s: Annotated[Lanes, Quantity("ns", ge=1e-3, le=1e4, about="width of a bin")]
    threshold_slope: Annotated[
        Lanes,
        Quantity(
            ge=0, le=1e4, about="photons for the square root of the background counts and the pedestal, in all shots"
        ),
    ]
    threshold_pedestal: Annotated[
        Lanes, Quantity(ge=0, le=1e6, about="counts a shot that the threshold adds to those of the background")
    ] = 0.0
    threshold_floor: Annotated[
        Lanes, Quantity(ge=0, le=1e7, about="photons above that, whatever the background and the shots")
    ] = 0.0
    threshold_spread: Annotated[
        Lanes | None,
        Quantity(
            ge=1e-3,
            le=1.5,
            about=(
                "standard deviation of the threshold's logarithm from point to point; sharp if left "
                "out. With a `lone_factor` for echoes alone"
            ),
        ),
    ] = None
    threshold_least: Annotated[
        Lanes, Quantity(ge=0.01, le=1, about="minimum threshold of a point that the spread allows, over the median one")
    ] = 0.5
    lone_factor: Annotated[
        Lanes | None,
        Quantity(
            ge=1,
            le=100,
            about="times the threshold, for noise: a peak that no neighbouring point shares; points are not compared "
            "if left out",
        ),
    ] = None
    estimator: Annotated[
        Literal["matched_filter", "centroid"],
        FileKey(
            about=(
                "time of a peak: of the filter, or the centroid of the counts around it; both in "
                "docs/photon_counting.md"
            )
        ),
    ] = "matched_filter"
    coates: Annotated[bool, FileKey(about="whether counts are corrected for pile-up before the filter")] = False
    walk: Annotated[
        Literal["corrected", "raw"],
        FileKey(about="whether a calibration corrects the shift of strong echoes by pile-up"),
    ] = "corrected"
    reach: int = field(metadata=STATIC)
    search: int = field(metadata=STATIC)
    bin_to_sigma: float = field(metadata=STATIC)
    calibrated: Walk | None = None
    sweep_rad: float = 0.0
    column_rad: float = 0.0
    column_weights: tuple[Lanes, ...] | None = None
    column_range_sigmas: Annotated[
        Lanes | None,
        Quantity(
            ge=0.01,
            le=1e4,
            about=(
                "difference of the ranges of two columns on one surface, in standard deviations of the range, at "
                "which the weight of the other has fallen to 0.61, on both sides; if left out, columns before the "
                "point's own have their weights at any"
            ),
        ),
    ] = None

    column_photons: Annotated[
        Lanes | None,
        Quantity(
            ge=1,
            le=1e6,
            about=(
                "photons n below which columns share more: the noise of the range over that of a point's own light is "
                "S / n for a return of S, 0.18 at least; with `column_weights`"
            ),
        ),
    ] = None

    @property
    def window(self) -> dict[int, Lanes]:
        """Weights of the columns whose noise a point has, by the number of columns back from its own."""
        back = dict(enumerate(self.column_weights or (1.0,)))
        return (
            back
            if self.column_range_sigmas is None
            else dict(sorted(({-m: w for m, w in back.items()} | back).items()))
        )

    def noise_left(self, signal: Lanes) -> Lanes:
        """Return the noise of the range of an echo of ``signal`` photons, over that of its own light (T176b).

        It is the size of the rest about a parabola over nine columns, as recordings show it.
        """
        if self.column_photons is None:
            return 1.0
        ops = xp(signal, self.column_photons)
        return ops.minimum(ops.maximum(signal / self.column_photons, LEAST_REST), 1.0)

    @property
    def neighbours(self) -> bool:
        """True if a point is compared with its neighbours.

        Then noise, and echoes too weak for the neighbours, meet `lone_factor` times the median threshold, sharp.
        """
        return self.lone_factor is not None

    def threshold(self, background_counts: Lanes) -> Lanes:
        """Median threshold [photons] over the background counts of all shots (T110)."""
        counts = background_counts + self.threshold_pedestal * self.shots
        return self.threshold_floor + self.threshold_slope * xp(counts).sqrt(counts)

    def threshold_of_point(self, threshold: Lanes, deviate: Lanes, lone: Lanes = 0.0) -> Lanes:
        """Threshold that the echoes of a point meet (T111), (T113).

        Args:
            threshold: median one
            deviate: standard normal number of the point
            lone: how far its neighbours lack the echo: 0 as on a surface, 1 alone
        """
        if self.lone_factor is not None:
            threshold = threshold * (1.0 + lone * (self.lone_factor - 1.0))
        if self.threshold_spread is None:
            return threshold
        ops = xp(threshold, deviate, self.threshold_spread, self.threshold_least)
        logarithm = ops.maximum(self.threshold_spread * deviate, ops.log(self.threshold_least))
        return threshold * ops.exp((1.0 - lone) * logarithm)

    def threshold_of_noise(self, threshold: Lanes, deviate: Lanes) -> Lanes:
        """Threshold that the noise of a point meets; arguments as of `threshold_of_point`."""
        return self.threshold_of_point(threshold, deviate, 1.0 if self.neighbours else 0.0)

    @property
    def residual_walk(self) -> str | None:
        """Line on echoes whose shift by pile-up is ambiguous; None: there are none."""
        if self.calibrated is None or self.calibrated.alike is None:
            return None
        residual_m = self.calibrated.residual * float(self.bin_s) / self.bin_to_sigma * 0.5 * SPEED_OF_LIGHT_M_S
        low, high = self.calibrated.alike
        lights = f"{low:.1f} to {high:.0f}"
        return (
            f"up to {residual_m:.2f} m of pile-up may be left of echoes of {lights} detections on a SPAD in each shot"
        )


class HistogramFile(
    Table[Histogram],
    only=(
        "bin_s",
        "threshold_slope",
        "threshold_pedestal",
        "threshold_floor",
        "threshold_spread",
        "threshold_least",
        "lone_factor",
        "estimator",
        "coates",
        "walk",
        "column_range_sigmas",
        "column_photons",
    ),
):
    """[histogram]: sums the time stamps of many shots and finds the peaks; stands in the place of [tdc]."""

    shots: Annotated[int, Field(ge=1, le=10_000_000)] | None = Field(
        default=None, description="added up for one point; as many as the pulse period allows if left out"
    )
    pulse_period_us: Annotated[float, Number("us", ge=0.01, le=1e6)] | None = Field(
        default=None,
        description="between the laser's pulses of one point, at multiplier 1; later light folds back onto the next",
    )
    multiplier: Annotated[float, Field(gt=0, le=16)] = Field(
        default=1.0, description="of the number of shots; above 1 the pulse period is shorter by it"
    )
    window_us: Annotated[float, Number("us", ge=1e-3, le=1e5)] | None = Field(
        default=None, description="of the histogram, after each pulse; the pulse period if left out"
    )
    ambient_window_us: Annotated[float, Number("us", ge=1e-3, le=1e6)] | None = Field(
        default=None, description="time of each shot in which the background is counted; the window if left out"
    )
    blanking_ns: Annotated[float, Number("ns", ge=0, le=1e6, finest=1e-3)] = Field(
        default=0.0, description="after each pulse, in which nothing is counted: the shortest range"
    )
    separation_ns: Annotated[float, Number("ns", ge=0, le=1e6, finest=1e-3)] = Field(
        default=0.0, description="minimum distance of two returns; of nearer returns the first counts"
    )
    lsb_ps: Annotated[float, Number("ps", ge=0, le=1e6, finest=1e-3)] = Field(
        default=0.0, description="step of the reported time"
    )
    stops: Annotated[int, Field(ge=1, le=MOST_STOPS)] = Field(default=1, description="returns for each point")
    keep: Keep = Field(
        default="strongest",
        description='which peaks, if there are more than stops; `"strongest_and_last"` and `"all"` as of `[tdc]`',
    )
    column_weights: tuple[Annotated[float, Field(ge=0, le=1)], ...] | None = Field(
        default=None,
        min_length=2,
        max_length=MOST_COLUMNS,
        description=(
            "weights of a point's column and of those before it in the noise of its range; its "
            "column alone if left out (docs/photon_counting.md)"
        ),
    )

    @model_validator(mode="after")
    def _stops_of_what_is_kept(self) -> HistogramFile:
        check_stops(self.keep, self.stops if "stops" in self.model_fields_set else None)
        return self

    @field_validator("column_weights")
    @classmethod
    def _first_weight(cls, weights: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if weights is not None and weights[0] <= 0.0:
            raise ValueError(f"the first, of the point's own column, must be > 0, got {weights[0]:g}")
        return weights

    @property
    def _unit_weights(self) -> tuple[float, ...] | None:
        if self.column_weights is None:
            return None
        norm = math.sqrt(sum(weight * weight for weight in self.column_weights))
        return tuple(weight / norm for weight in self.column_weights)

    def period_us(self, dwell_us: float) -> float | None:
        """Time between the laser's pulses of one point, with the multiplier; None: not given.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        if self.pulse_period_us is None:
            return None
        period = self.pulse_period_us / max(self.multiplier, 1.0)
        if self.shots is not None and self.shots * period > dwell_us * (1.0 + 1e-9):
            raise InputError(
                f"histogram.shots: must be <= {math.floor(dwell_us / period)}, the pulses of {period:g} us in the "
                f"{dwell_us:g} us of a point, got {self.shots}"
            )
        return period

    def shots_per_point(self, dwell_us: float) -> int:
        """Number of shots of a point of this dwell time.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        if self.shots is not None:
            return self.shots
        if self.pulse_period_us is None:
            raise InputError("histogram: one of shots and pulse_period_us was expected, got none")
        exact = dwell_us / self.pulse_period_us * (1.0 + 1e-9)
        shots = min(round(exact * self.multiplier), math.floor(exact * max(self.multiplier, 1.0)))
        if shots < 1:
            raise InputError(
                f"histogram.pulse_period_us: must be <= {dwell_us * self.multiplier:g}, the time of a point, "
                f"got {self.pulse_period_us:g}"
            )
        return shots

    def sweep_rad(self, *, turn_rate_rad_s: float, dwell_us: float) -> float:
        """Angle by which a head of this turn rate turns from the first to the last of the shots of a point."""
        period_us = self.period_us(dwell_us)
        # Shots without a period of their own are taken to fill the time of a point.
        summed_us = dwell_us if period_us is None else period_us * self.shots_per_point(dwell_us)
        return abs(turn_rate_rad_s) * 1e-6 * summed_us

    def build(
        self,
        *,
        dead_time_s: float,
        jitter_s: float,
        pulse_fwhm_ns: float,
        dwell_us: float,
        spads: float = 1.0,
        coincidence: int = 1,
        turn_rate_rad_s: float = 0.0,
    ) -> Histogram:
        """Convert to SI units for points of this dwell time and a head of this turn rate.

        Args:
            dead_time_s: inf: a SPAD fires once in a shot
            spads: of the detector
            coincidence: of the detector

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        period_us = self.period_us(dwell_us)
        sigma_ns = pulse_fwhm_ns / SIGMAS_PER_FWHM
        sigma_ns = math.sqrt(sigma_ns**2 + (1e9 * jitter_s) ** 2 + self.bin_ns**2 / 12.0)
        if self.bin_ns > 1.5 * sigma_ns:
            raise InputError(
                f"histogram.bin_ns: must be <= {1.5 * sigma_ns:.3g}, 1.5 times the width (sigma) of an echo, "
                f"got {self.bin_ns:g}"
            )
        search = math.ceil(_SEARCH_REACH * sigma_ns / self.bin_ns)
        reach = search + 1 + math.ceil(_TEMPLATE_REACH * sigma_ns / self.bin_ns)
        if 2 * reach + 2 > MOST_BINS:
            finest_ns = 2.0 * (_SEARCH_REACH + _TEMPLATE_REACH) * sigma_ns / (MOST_BINS - 8)
            raise InputError(
                f"histogram.bin_ns: must be >= {finest_ns:.2g} ({MOST_BINS} bins around an echo), got {self.bin_ns:g}"
            )
        if 1e9 * dead_time_s < SHORTEST_DEAD_TIME * pulse_fwhm_ns:
            raise InputError(
                f"detector.dead_time_ns: must be >= {SHORTEST_DEAD_TIME * pulse_fwhm_ns:g}, the width of the pulse, "
                f"got {1e9 * dead_time_s:g}"
            )
        calibrated = None
        if self.walk == "corrected" and not self.coates:
            filtering = Filtering(
                bin_sigmas=self.bin_ns / sigma_ns,
                dead_sigmas=1e9 * dead_time_s / sigma_ns,
                spads=spads,
                coincidence=coincidence,
                side=reach - search - 1,
                centroid=self.estimator == "centroid",
            )
            calibrated = calibrate(filtering)
        return self.in_si(
            shots=float(self.shots_per_point(dwell_us)),
            period_s=si(period_us, "us"),
            reach=reach,
            search=search,
            bin_to_sigma=self.bin_ns / sigma_ns,
            calibrated=calibrated,
            sweep_rad=self.sweep_rad(turn_rate_rad_s=turn_rate_rad_s, dwell_us=dwell_us),
            column_rad=abs(turn_rate_rad_s) * 1e-6 * dwell_us,
            column_weights=self._unit_weights,
        )

    def converter(self, dwell_us: float) -> Tdc:
        """Converter that stands for the peak finder: one comparison for each bin.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        period_us = self.period_us(dwell_us)
        window_us = self.window_us if self.window_us is not None else period_us
        if window_us is None:
            raise InputError("histogram: one of window_us and pulse_period_us was expected, got none")
        longest_us = dwell_us if period_us is None else period_us
        if window_us > longest_us * (1.0 + 1e-9):
            raise InputError(f"histogram.window_us: must be <= {longest_us:g}, the pulse period, got {window_us:g}")
        stops, keep = kept_stops(self.keep, self.stops)
        values: dict[str, Any] = {
            "window_s": si(window_us, "us"),
            "bandwidth_hz": 1.0 / si(float(self.bin_ns), "ns"),
            "least_significant_bit_s": si(self.lsb_ps, "ps"),
            "stops": stops,
            "keep": keep,
            "blanking_s": si(self.blanking_ns, "ns"),
            "dead_time_s": si(self.separation_ns, "ns"),
            "walk": "none",
            "ambient_window_s": si(self.ambient_window_us, "us"),
        }
        return Tdc(**values)
