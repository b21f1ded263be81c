"""Electronics behind the detector as data: amplifier, converter, samplers, and the scale of intensity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from ..maths.arrays import Lanes
from ..maths.units import FileKey, Quantity
from ..physics.amplifier.low_pass import LOW_PASSES, LowPass

MOST_STOPS = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Tdc:
    """Comparator and time-to-digital converter.

    window_s                  listening time after each pulse
    threshold_to_noise        U / sigma_0 (TNR), or None with a fixed level
    threshold_level           fixed U in signal units, or None
    least_significant_bit_s   step of the reported time; 0: none
    jitter_s                  standard deviation of the converter's own jitter
    stops                     crossings reported per shot, in order of time
    keep                      crossings that are kept: "first", "last", "strongest" or "strongest_and_last"
    both_edges                whether the end of a pulse is timed too: its width is known
    walk                      "raw" leaves the walk error in; "corrected" subtracts the walk inferred from the measured
                              amplitude, or from the width of a saturated pulse; "none" subtracts the exact walk
    false_alarms              "published": (9) and (10), independent comparisons at the bandwidth's rate; "crossings":
                              how often the noise rises through the threshold (docs/theory.md, section 9)
    """

    window_s: Annotated[Lanes, Quantity("us", ge=1e-3, le=1e5)]
    bandwidth_hz: Annotated[Lanes, Quantity("mhz", ge=1e-3, le=1e5)]
    threshold_to_noise: Annotated[Lanes | None, Quantity(ge=0.01, le=1e4)] = None
    threshold_level: Annotated[Lanes | None, Quantity(ge=1e-15, le=1e9, about="amperes (APD) or cells (SiPM)")] = None
    least_significant_bit_s: Annotated[Lanes, Quantity("ps", name="lsb_ps", ge=0, le=1e6, finest=1e-3)] = 0.0
    jitter_s: Annotated[Lanes, Quantity("ps", ge=0, le=1e6, finest=1e-3)] = 0.0
    stops: Annotated[int, Quantity(ge=1, le=MOST_STOPS)] = 1
    keep: str = "first"
    order: Annotated[
        Literal["time", "strength"], FileKey(about="of the returns: that of their crossings, or the strongest first")
    ] = "time"
    timing: Annotated[
        Literal["leading_edge", "constant_fraction", "peak", "matched_filter"],
        FileKey(about="what is timed of a pulse; a matched filter also lowers the threshold, with the noise"),
    ] = "leading_edge"
    fraction: Annotated[Lanes, Quantity(gt=0, lt=1, about="of its peak, at which constant_fraction times a pulse")] = (
        0.5
    )
    blanking_s: Annotated[
        Lanes,
        Quantity(
            "ns",
            ge=0,
            le=1e6,
            finest=1e-3,
            about="after the pulse leaves, in which crossings go unnoticed: the shortest range",
        ),
    ] = 0.0
    dead_time_s: Annotated[
        Lanes, Quantity("ns", ge=0, le=1e6, finest=1e-3, about="from an echo's crossing to the next that can be taken")
    ] = 0.0
    both_edges: bool = False
    walk: Annotated[Literal["none", "raw", "corrected"], FileKey()] = "corrected"
    false_alarms: Annotated[Literal["published", "crossings"], FileKey(about="how often noise trips")] = "published"
    ambient_window_s: Annotated[
        Lanes | None,
        Quantity("us", ge=1e-3, le=1e6, about="time in which the background is counted; the window if left out"),
    ] = None

    @property
    def listening_s(self) -> Lanes:
        """Time in which crossings are taken."""
        return self.window_s - self.blanking_s

    @property
    def ambient_s(self) -> Lanes:
        """Time in which the background is counted."""
        return self.window_s if self.ambient_window_s is None else self.ambient_window_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Receiver:
    """Frequency response of the amplifier, `physics.amplifier`. Its bandwidth is that of the noise, `Tdc.bandwidth_hz`.

    response  of its low pass: "none" filters the noise and not the pulse, as the paper does
    """

    response: Annotated[Literal["none", "gaussian", "single_pole"], FileKey(about="the low pass of the amplifier")] = (
        "none"
    )
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
class Intensity:
    """The scale on which the maker reports intensity, `physics.electronics.intensity`.

    kind  "range_corrected": watts at ``reference_m``; "reflectivity": 0 to 255
    """

    kind: Annotated[Literal["range_corrected", "reflectivity"], FileKey()]
    reference_m: Annotated[Lanes, Quantity(gt=0, le=1e6, about="that range")] = 10.0
    white_value: Annotated[Lanes, Quantity(gt=0, lt=255, about="of a white Lambertian surface across the beam")] = 100.0
    exponent: Annotated[
        Lanes | None,
        Quantity(gt=0, le=4, about="of the reflectivity on the scale below that, 0.5: its root; linear if left out"),
    ] = None
    retro: Annotated[
        Literal["linear", "logarithmic"], FileKey(about="the scale above white: the same law, or a logarithmic one")
    ] = "logarithmic"
    retro_reflectivity: Annotated[Lanes, Quantity(gt=1, le=1e9, about="that reads 255 on a logarithmic scale")] = 1000.0
    coarse_above: Annotated[
        Lanes | None,
        Quantity(ge=0, le=255, about="value above which there are only steps of coarse_step; none if left out"),
    ] = None
    coarse_step: Annotated[Lanes | None, Quantity(gt=1, le=128, about="from one value to the next above that")] = None

    @property
    def unit(self) -> str:
        """Unit of the reported intensity."""
        return "W" if self.kind == "range_corrected" else "1"


@dataclass(frozen=True, slots=True, kw_only=True)
class MultiLevel:
    """Comparators at several levels behind the first: amplitude and walk from the width of the pulse.

    levels  in thresholds, rising, from 1 on
    """

    levels: tuple[Lanes, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Adc:
    """Converter that the comparator starts: samples around each crossing.

    rate_hz     samples per second, on a clock that starts with the pulse
    step        least significant bit, in signal units
    full_scale  largest sample, with an offset that keeps noise off the lower end
    samples     read for each crossing, from one pulse width before it to three behind
    room        for how many samples kernels are made: more than there are
    estimator   "matched_filter" or "centroid"
    """

    rate_hz: Annotated[Lanes, Quantity("mhz", ge=0.1, le=1e6)]
    step: Lanes
    full_scale: Annotated[Lanes, Quantity(ge=1e-12, le=1e9, about="largest sample, amperes (APD) or cells (SiPM)")]
    samples: int
    room: int
    estimator: Annotated[Literal["matched_filter", "centroid"], FileKey()] = "matched_filter"
