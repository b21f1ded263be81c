"""Report: what the electronics make of each pulse, and the one place that names the outcome of its echo."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ..maths.arrays import Array, Lanes, Mask, xp
from .outcomes import Outcome, Status


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement:
    """Measurement of a return, and the light that caused it; each field (n,), NumPy or Dr.Jit.

    The following belong to this return alone. They are None if pulses have one echo and `single_echo` detects it: the
    `Detection` has them then.

    Attributes:
        status: a `Status`; None as long as the finder searches for more
        amplitude: peak at the comparator, in amperes (APD) or cells (SiPM), or photons in a histogram
        width_s: time over the threshold; None: the sensor does not measure it
        snr: (n,) as in `Detection`; 0 for a false alarm
        detection_probability: (n,) as in `Detection`; 0 for a false alarm
        source: (n,) number of the sub-echo that caused the return, -1 for the even light of the air; for a false alarm,
            the pulse's strongest sub-echo
        true_range_m: (n,) mean range of the sub-echoes, weighted by their power at the peak; the range of the air if
            its light tripped the comparator
    """

    status: Lanes | None
    amplitude: Lanes
    width_s: Lanes | None = None
    snr: Lanes | None = None
    detection_probability: Lanes | None = None
    source: Lanes | None = None
    true_range_m: Lanes | None = None

    @property
    def of_own_echo(self) -> Mask:
        """True where a surface in the beam caused the return, (n,) bool."""
        return (self.status == int(Status.ECHO)) | (self.status == int(Status.ALIASED))


@dataclass(frozen=True, slots=True, kw_only=True)
class Returns(Measurement):
    """Returns that one stop of the converter reports for n pulses; NumPy or Dr.Jit.

    Attributes:
        reported: (n,) bool, whether this stop was used
        range_m: (n,) c t / 2 of the reported time
        intensity: (n,) on the maker's scale, `detection.reported_intensity.reported_intensity`
    """

    reported: Mask
    range_m: Lanes
    intensity: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class Detection:
    """Result of the electronics for n pulses; NumPy or Dr.Jit.

    Attributes:
        snr: (n,) peak signal over the noise without an echo, (19) or (27); of the highest peak; 0 without an echo
        detection_probability: (n,) P_d, that this echo trips the comparator; of the highest peak; 0 without an echo
        outcome: (n,) int32, an `Outcome`
        ambient: (n,) background counts, `detection.ambient.counts`
        stops: one `Returns` for each stop, first crossing first
        source: (n,) number of the strongest sub-echo of a surface; None: there is only one
    """

    snr: Lanes
    detection_probability: Lanes
    outcome: Array
    ambient: Lanes
    stops: tuple[Returns, ...]
    source: Lanes | None = None


def outcome_of(stops: Sequence[Returns], *, has_surface: Mask, tripped: Mask, in_window: Mask) -> Array:
    """Outcome of each pulse's echo, (n,) int32: the first stage at which it was lost.

    Args:
        has_surface: (n,) whether the pulse met a surface
        tripped: (n,) whether any light tripped the comparator
        in_window: (n,) whether the converter took any of it
    """
    ops = xp(stops[0].range_m)
    # Later lines overrule earlier ones.
    outcome = ops.where(_has_echo(stops), int(Outcome.KEPT), int(Outcome.HIDDEN))
    outcome = ops.where(in_window, outcome, int(Outcome.OUT_OF_WINDOW))
    outcome = ops.where(tripped, outcome, int(Outcome.BELOW_THRESHOLD))
    return ops.where(has_surface, outcome, int(Outcome.NO_SURFACE))


def without_returns(detection: Detection, withheld: Sequence[Mask]) -> Detection:
    """Leave out the withheld returns, a mask (n,) for each stop; pulses that lose their last echo are hidden."""
    stops = _without(detection.stops, withheld)
    lost = (detection.outcome == int(Outcome.KEPT)) & ~_has_echo(stops)
    outcome = xp(detection.outcome).where(lost, int(Outcome.HIDDEN), detection.outcome)
    return replace(detection, stops=stops, outcome=outcome)


def without_pulses(detection: Detection, left_out: Mask) -> Detection:
    """Leave out all returns of some pulses, (n,) bool, which then count as without a surface."""
    stops = _without(detection.stops, (left_out,) * len(detection.stops))
    outcome = xp(left_out).where(left_out, int(Outcome.NO_SURFACE), detection.outcome)
    return replace(detection, stops=stops, outcome=outcome)


def _without(stops: Sequence[Returns], withheld: Sequence[Mask]) -> tuple[Returns, ...]:
    return tuple(replace(stop, reported=stop.reported & ~mask) for stop, mask in zip(stops, withheld, strict=True))


def _has_echo(stops: Sequence[Returns]) -> Mask:
    """True where an echo of a surface is reported, (n,) bool."""
    has_echo: Mask = False
    for stop in stops:
        has_echo = has_echo | (stop.reported & stop.of_own_echo)
    return has_echo
