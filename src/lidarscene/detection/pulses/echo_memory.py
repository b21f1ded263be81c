"""Detector memory: residues of a pulse's earlier echoes that change the working point of the next one.

Cells that fired are missing until their dead time is over, and until then the count stays up, so that a comparator
sees no second edge. A clipped amplifier holds charge, which drains with its recovery time. Either way the next echo
meets another working point: part of the response, on top of what is left (docs/theory_receivers.md 2).

Symbols: h what is left of earlier echoes, in signal units; sigma_p width of the laser pulse and unit of all places.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from ...maths.arrays import Lanes, xp
from ...physics.electronics import saturation, sipm_response
from ...sensor.detectors import CellMemory, WorkingPoint
from ..rises import Rise
from ..shots import Received

_FOOT = 3.0
"""Accuracy bought: distance from an echo's start to its peak, in sigma_p: a thousandth of its light has come by
then."""

_REMEMBERED = 2
"""Earlier echoes with entries of their own: the last, and all others together."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Earlier:
    """An earlier echo, or several; each field (n,).

    Attributes:
        place: place of its peak; for an amplifier: the place at which it leaves clipping
        amount: cells that it fired; of an amplifier: charge that it holds, as a level of the signal
    """

    place: Lanes
    amount: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class Residue:
    """Residue of earlier echoes at one rise; each field (n,).

    Attributes:
        floor: signal that is left where the rise begins
        held: signal that is left at its peak
        share: share of the response that is left at its peak; 1 without memory
    """

    floor: Lanes
    held: Lanes
    share: Lanes

    def working_point(self, point: WorkingPoint) -> WorkingPoint:
        """Working point of the detector at the rise."""
        ops = xp(self.held, self.share)

        def power_w(signal: Lanes) -> Lanes:
            return point.response.power_w(ops.maximum(signal - self.held, 1e-30) / self.share)

        response = replace(
            point.response,
            signal=lambda power_w: self.held + self.share * point.response.signal(power_w),
            power_w=power_w,
        )
        return replace(point, response=response, calibrated=point)


Memory = tuple[Earlier, ...]
"""Earlier echoes of each pulse, the last one first; empty if the detector has no memory."""


def empty_memory(shots: Received) -> Memory:
    """Memory before the first rise; empty if there is no second one."""
    if shots.wave.lone:
        return ()
    point, zero = shots.point, shots.ops.full(shots.wave.origin_m, 0.0)
    if point.memory is not None:
        return (Earlier(place=zero, amount=zero),) * _REMEMBERED
    if point.response.saturation is not None and point.response.recovery_s is not None:
        return (Earlier(place=zero, amount=zero),)
    return ()


def find_residue(shots: Received, rise: Rise, memory: Memory) -> Residue | None:
    """Residue of earlier echoes at a rise; None if the detector has no memory."""
    if not memory:
        return None
    ops, point = shots.ops, shots.point
    foot = ops.maximum(rise.valley, rise.peak - _FOOT)
    if point.memory is None:
        (clipped,) = memory
        return Residue(
            floor=_charge(shots, clipped, foot), held=_charge(shots, clipped, rise.peak), share=ops.full(rise.peak, 1.0)
        )
    cells = point.memory
    lag_s = sipm_response.peak_lag_s(pulse_fwhm_s=shots.sensor.laser.pulse_fwhm_s, dead_time_s=cells.dead_time_s)
    floor, held, missing = (
        sum(_busy_cells(shots, cells, echo, place) for echo in memory)
        for place in (foot, rise.peak + lag_s / shots.sigma_s, rise.peak)
    )
    # Never none at all: a working point is solved for the light.
    return Residue(floor=floor, held=held, share=ops.maximum(1.0 - missing / cells.free, 1e-6))


def update_memory(shots: Received, rise: Rise, signal: Lanes, residue: Residue | None, memory: Memory) -> Memory:
    """Memory after a rise.

    Args:
        signal: (n,) its peak, with what was left of earlier echoes
    """
    if residue is None:
        return memory
    ops, point = shots.ops, shots.point
    if point.memory is None:
        assert point.response.saturation is not None
        (previous,) = memory
        # The light falls back to the clipping level a pulse's flank behind its peak.
        overdrive = ops.maximum(signal / point.response.saturation, 1.0)
        clips = rise.exists & (overdrive > 1.0)
        release = rise.peak + ops.sqrt(2.0 * ops.log(overdrive))
        return (
            Earlier(place=ops.where(clips, release, previous.place), amount=ops.where(clips, signal, previous.amount)),
        )
    cells = point.memory
    fired = sipm_response.fired_by_pulse(
        peak=ops.maximum(signal - residue.held, 0.0),
        rate_hz=cells.rate_hz,
        pulse_fwhm_s=shots.sensor.laser.pulse_fwhm_s,
        dead_time_s=cells.dead_time_s,
        cells=cells.cells,
    )
    # All echoes before the last are one, at the mean of their places weighted by cells; after two dead times they no
    # longer count (T45b).
    last, older = memory
    forgotten = (rise.peak - older.place) * shots.sigma_s > 2.0 * cells.dead_time_s
    older_amount = ops.where(forgotten, 0.0, older.amount)
    total = last.amount + older_amount
    place = (last.place * last.amount + older.place * older_amount) / ops.where(total > 0.0, total, 1.0)
    new = Earlier(place=rise.peak, amount=fired), Earlier(place=place, amount=total)
    return tuple(
        Earlier(
            place=ops.where(rise.exists, updated.place, old.place),
            amount=ops.where(rise.exists, updated.amount, old.amount),
        )
        for updated, old in zip(new, memory, strict=True)
    )


def _busy_cells(shots: Received, cells: CellMemory, echo: Earlier, place: Lanes) -> Lanes:
    """Cells above the background's count that an earlier echo leaves at a place, (n,); theory (T45b)."""
    return echo.amount * sipm_response.residual_busy(
        age_s=(place - echo.place) * shots.sigma_s,
        rate_hz=cells.rate_hz,
        dead_time_s=cells.dead_time_s,
        sigma_s=shots.sigma_s,
    )


def _charge(shots: Received, clipped: Earlier, place: Lanes) -> Lanes:
    """Signal that a clipped amplifier still holds at a place, (n,); theory (T45c)."""
    assert shots.point.response.recovery_s is not None
    return saturation.remaining_charge(
        held=clipped.amount, since_s=(place - clipped.place) * shots.sigma_s, recovery_s=shots.point.response.recovery_s
    )
