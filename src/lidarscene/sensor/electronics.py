"""Electronics behind the detector as data: amplifier, converter, samplers, and the scale of intensity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Literal

from ..maths.arrays import Lanes
from ..maths.attributes import HintedAttributes
from ..maths.units import COUNT, STATIC, FileKey, Quantity
from ..physics.amplifier.low_pass import LOW_PASSES, LowPass

MOST_STOPS = 16


Keep = Literal["first", "last", "strongest", "strongest_and_last", "all"]
"""Returns that a sensor file keeps, if there are more."""

_STOPS_OF = {"all": MOST_STOPS, "strongest_and_last": 2}
"""Returns of the orders that have a number of their own."""


def check_stops(keep: Keep, stops: int | None) -> None:
    """Check that a number of stops goes with what is kept; None: the file gives none.

    Raises:
        ValueError: if a value is not allowed
    """
    if stops is not None and keep == "all":
        raise ValueError(f'stops: not together with keep = "all", which has {MOST_STOPS}')
    if stops not in (None, 2) and keep == "strongest_and_last":
        raise ValueError(f'stops: must be 2 with keep = "strongest_and_last", got {stops}')


def kept_stops(keep: Keep, stops: int) -> tuple[int, str]:
    """Number of stops and `Tdc.keep` of what a sensor file keeps."""
    return _STOPS_OF.get(keep, stops), "first" if keep == "all" else keep


SENSOR_CHANGED_BY = 'sensor.replace("laser.peak_power_w=50") is another sensor'


@dataclass(frozen=True, slots=True, kw_only=True)
class Tdc(HintedAttributes):
    """Comparator and time-to-digital converter.

    Attributes:
        window_s: time from when the middle of a pulse leaves, in which crossings are taken
        threshold_to_noise: U / sigma_0 (TNR), or None with a fixed level
        threshold_level: fixed U in signal units, or None
        least_significant_bit_s: step of the reported time; 0: none
        jitter_s: standard deviation of the converter's own jitter
        stops: crossings reported per shot, in order of time
        keep: crossings that are kept: "first", "last", "strongest" or "strongest_and_last"
        both_edges: whether the end of a pulse is timed too: its width is known
        walk: "raw" leaves the walk error in; "corrected" subtracts the walk inferred from the measured amplitude, or
            from the width of a saturated pulse; "none" subtracts the exact walk
        false_alarms: "published": (9) and (10), independent comparisons at the bandwidth's rate; "crossings": how often
            the noise rises through the threshold (docs/theory.md, section 9)
    """

    CHANGED_BY: ClassVar[str] = SENSOR_CHANGED_BY
    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("resolution", "lsb"), "sensor.tdc.least_significant_bit_s"),
        **dict.fromkeys(("range_gate", "max_range", "range", "gate"), "sensor.tdc.window_s, sensor.max_range()"),
    }

    window_s: Annotated[
        Lanes,
        Quantity(
            "us",
            ge=1e-3,
            le=1e5,
            about=(
                "from when a pulse's middle leaves; an echo counts that crosses the threshold by then, even if its "
                "middle comes later: 4 us is 600 m for a weak one, and up to a pulse's width more for a strong one"
            ),
        ),
    ]
    bandwidth_hz: Annotated[
        Lanes, Quantity("mhz", ge=1e-3, le=1e5, about="B_w: of the noise, and comparisons per second")
    ]
    threshold_to_noise: Annotated[
        Lanes | None, Quantity(ge=0.01, le=1e4, about="TNR: threshold over the noise without echo")
    ] = None
    threshold_level: Annotated[
        Lanes | None, Quantity(ge=1e-15, le=1e9, about="fixed threshold, amperes (APD) or cells (SiPM)")
    ] = None
    least_significant_bit_s: Annotated[
        Lanes, Quantity("ps", name="lsb_ps", ge=0, le=1e6, finest=1e-3, about="step of the reported time; 0: none")
    ] = 0.0
    jitter_s: Annotated[
        Lanes, Quantity("ps", ge=0, le=1e6, finest=1e-3, about="standard deviation of the converter's jitter")
    ] = 0.0
    strong_above: Annotated[
        Lanes | None,
        Quantity(
            gt=1,
            le=1e9,
            about="height in thresholds above which a second channel of lower gain times a pulse; none if left out",
        ),
    ] = None
    strong_jitter_s: Annotated[
        Lanes | None, Quantity("ps", ge=0, le=1e6, finest=1e-3, about="jitter of that channel, with `strong_above`")
    ] = None
    strong_spread: Annotated[
        Lanes | None,
        Quantity(
            ge=0, le=1, about="deviation of the logarithm of that height from pulse to pulse, with `strong_above`"
        ),
    ] = None
    stops: Annotated[int, Quantity(ge=1, le=MOST_STOPS, about="crossings reported per shot")] = field(
        default=1, metadata=STATIC
    )
    keep: str = "first"
    timing: Annotated[
        Literal["leading_edge", "constant_fraction", "peak", "matched_filter"],
        FileKey(
            about=(
                "timed feature of a pulse: where it crosses the threshold, a fraction of its peak, "
                "its peak, or its peak behind a matched filter, which also finds weaker ones; not "
                "with `[sampler]` (docs/theory_receivers.md 6)"
            )
        ),
    ] = "leading_edge"
    fraction: Annotated[Lanes, Quantity(gt=0, lt=1, about='with `timing = "constant_fraction"`: of the peak')] = 0.5
    blanking_s: Annotated[
        Lanes,
        Quantity(
            "ns",
            ge=0,
            le=1e6,
            finest=1e-3,
            about="after the pulse leaves, no crossing counts: the shortest range, 6.67 ns for each metre",
        ),
    ] = 0.0
    dead_time_s: Annotated[
        Lanes,
        Quantity(
            "ns",
            ge=0,
            le=1e6,
            finest=1e-3,
            about="after a crossing by an echo, no other counts; of peaks nearer than that the highest",
        ),
    ] = 0.0
    both_edges: bool = False
    walk: Annotated[
        Literal["none", "raw", "corrected"], FileKey(about='`"raw"`, `"none"` or `"corrected"`; see docs/theory.md 8')
    ] = "corrected"
    chatter_hz: Annotated[
        Lanes | None,
        Quantity(
            "mhz",
            gt=0,
            le=1e5,
            about=(
                "rms frequency of the noise at the comparator: a slow edge crosses the threshold several times, and "
                "such a pulse gives no point; each counts if left out (docs/theory_receivers.md 6)"
            ),
        ),
    ] = None
    false_alarms: Annotated[
        Literal["published", "crossings"],
        FileKey(
            about=(
                'how often noise trips: `"published"`, the paper\'s (9) and (10), or `"crossings"` of '
                "band-limited noise; see docs/theory.md 9"
            )
        ),
    ] = "published"
    ambient_window_s: Lanes | None = None

    @property
    def listening_s(self) -> Lanes:
        """Time in which crossings are taken."""
        return self.window_s - self.blanking_s

    @property
    def ambient_s(self) -> Lanes:
        """Time in which the background is counted."""
        return self.window_s if self.ambient_window_s is None else self.ambient_window_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Receiver(HintedAttributes):
    """Frequency response of the amplifier, `physics.amplifier`. Its bandwidth is that of the noise, `Tdc.bandwidth_hz`.

    Attributes:
        response: of its low pass: "none" filters the noise and not the pulse, as the paper does
    """

    response: Annotated[
        Literal["none", "gaussian", "single_pole"],
        FileKey(about='low pass for pulse and noise; `"none"` filters the noise only, as the paper does'),
    ] = "none"
    ac_coupling_hz: Annotated[
        Lanes | None,
        Quantity("khz", ge=1e-3, le=5e4, about="-3 dB of an AC-coupled amplifier's high pass; DC-coupled if left out"),
    ] = None

    @property
    def low_pass(self) -> LowPass | None:
        """Low pass of this response, or None."""
        return LOW_PASSES.get(self.response)

    @property
    def filters(self) -> bool:
        """True if the amplifier changes the pulse."""
        return self.low_pass is not None or self.ac_coupling_hz is not None

    @property
    def noise_ratio(self) -> float:
        """Bandwidth of the noise over the cutoff (-3 dB) of the low pass; 1 without one."""
        return 1.0 if self.low_pass is None else self.low_pass.noise_ratio


@dataclass(frozen=True, slots=True, kw_only=True)
class Intensity(HintedAttributes):
    """The scale on which the maker reports intensity, `physics.electronics.intensity`.

    Attributes:
        kind: "range_corrected": watts at ``reference_m``; "reflectivity": 0 to 255
    """

    kind: Annotated[Literal["range_corrected", "reflectivity"], FileKey()]
    reference_m: Annotated[Lanes, Quantity(gt=0, le=1e6, about="the reference range")] = 10.0
    white_value: Annotated[Lanes, Quantity(gt=0, lt=255, about="of a white Lambertian surface across the beam")] = 100.0
    exponent: Annotated[
        Lanes | None,
        Quantity(gt=0, le=4, about="of the reflectivity on that scale, such as 0.5 for its root; linear if left out"),
    ] = None
    retro: Annotated[
        Literal["linear", "logarithmic"],
        FileKey(about='the scale above white: `"linear"` continues, `"logarithmic"` reaches 255 at the next'),
    ] = "logarithmic"
    retro_reflectivity: Annotated[
        Lanes, Quantity(gt=1, le=1e9, about="reflectivity that reads 255: of a retro-reflector, pi R_A")
    ] = 1000.0
    coarse_above: Annotated[
        Lanes | None,
        Quantity(ge=0, le=255, about="value above which there are only steps of coarse_step; none if left out"),
    ] = None
    coarse_step: Annotated[Lanes | None, Quantity(gt=1, le=128, about="from one value to the next above that")] = None
    measures: Annotated[
        Literal["peak", "energy"],
        FileKey(about="of an echo that `laser.slope_broadening` lengthens: its peak, or all of its energy"),
    ] = "peak"

    @property
    def unit(self) -> str:
        """Unit of the reported intensity."""
        return "W" if self.kind == "range_corrected" else "1"


@dataclass(frozen=True, slots=True, kw_only=True)
class MultiLevel(HintedAttributes):
    """Comparators at several levels behind the first: amplitude and walk from the width of the pulse.

    Attributes:
        levels: in thresholds, rising, from 1 on
    """

    levels: tuple[Lanes, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Adc(HintedAttributes):
    """Converter that the comparator starts: samples around each crossing.

    Attributes:
        rate_hz: samples per second, on a clock that starts with the pulse
        step: least significant bit, in signal units
        full_scale: largest sample, with an offset that keeps noise off the lower end
        samples: read for each crossing, from one pulse width before it to three behind
        room: for how many samples kernels are made: more than there are
        estimator: "matched_filter" or "centroid"
    """

    rate_hz: Annotated[
        Lanes, Quantity("mhz", ge=0.1, le=1e6, about="samples per second; from one in a pulse width to 1024 in four")
    ]
    step: Lanes
    full_scale: Annotated[Lanes, Quantity(ge=1e-12, le=1e9, about="maximum sample, amperes (APD) or cells (SiPM)")]
    samples: int = field(metadata=COUNT)
    room: int = field(metadata=STATIC)
    estimator: Annotated[Literal["matched_filter", "centroid"], FileKey(about="of time and amplitude")] = (
        "matched_filter"
    )
