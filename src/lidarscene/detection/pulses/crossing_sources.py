"""Sources of crossings: the surface, drop or flake, or the even light of the air, that trips the comparator.

Symbols: P power over time, sigma_p unit of all places.
"""

from __future__ import annotations

from ...maths.arrays import Lanes, Mask
from ..rises import Rise
from ..shots import Received
from ..sources import brightest


def crossing_source(
    shots: Received, rise: Rise, *, surfaces: int, stray: bool, place: Lanes, in_valley: Mask, measured: Lanes
) -> tuple[Lanes, Lanes]:
    """Number (n,) of the sub-echo that causes a crossing, -1 for the air's even light, and its true range [m].

    The cause is the light that rises most steeply at the crossing, of the surfaces or of the air. The most light
    would be the wrong test: fog may trip the comparator on the way up to the peak of a surface far behind it, and a
    surface may trip it on top of fog that is brighter (docs/theory_light.md 5).

    Args:
        surfaces: number of sub-echoes that are of surfaces; they come before those of the air
        stray: whether the last sub-echo is stray light of other channels
        place: (n,) place of the crossing
        in_valley: (n,) bool, whether that is the valley before the rise
        measured: (n,) place that the sampler takes for the pulse's: even light has no other
    """
    ops, wave = shots.ops, shots.wave
    number, range_m = _surface_or_air(
        shots,
        rise,
        surfaces=surfaces,
        end=len(wave.centres) - stray,
        place=place,
        in_valley=in_valley,
        measured=measured,
    )
    if not stray:
        return number, range_m
    # Stray light is no surface of this pulse: the return is of it where it is more than half of the light.
    last = len(wave.centres) - 1
    other = brightest(wave, rise.peak, last, last + 1)
    is_stray = other.total > 0.5 * rise.top[0]
    return ops.where(is_stray, last, number), ops.where(is_stray, wave.range_m(wave.centres[last]), range_m)


def _surface_or_air(
    shots: Received, rise: Rise, *, surfaces: int, end: int, place: Lanes, in_valley: Mask, measured: Lanes
) -> tuple[Lanes, Lanes]:
    """`crossing_source` among the surfaces and the air, whose sub-echoes end before number ``end``."""
    ops, wave = shots.ops, shots.wave
    # The true range is the mean of the centres weighted by their light at the peak. There P' is zero, and P' is the
    # sum of light times distance: the weighted mean of all sub-echoes is then the place of the peak itself.
    surface = brightest(wave, rise.peak, 0, surfaces)
    if wave.volume is None:
        return surface.number, wave.range_m(surface.mean)
    # At the peak and in the valley no light rises. A crossing there is judged by the slopes at a place on the way
    # up: sigma_p before the peak, or half the way from the valley if that is later.
    between = ops.maximum(rise.peak - 1.0, 0.5 * (rise.valley + rise.peak))
    edge = ops.where(in_valley, between, ops.minimum(place, between))
    particle = brightest(wave, edge, surfaces, end)
    slope, surface_slope = wave.at(edge)[1], brightest(wave, edge, 0, surfaces).slope
    # The slope is that of all light. Above twice the surfaces' slope, the air's share is larger than theirs; above
    # that of surfaces plus twice the particles', the even light's share is larger than the particles'.
    by_air, by_even_light = slope > 2.0 * surface_slope, slope > surface_slope + 2.0 * particle.slope
    range_m = wave.range_m(ops.where(by_air, ops.where(by_even_light, measured, particle.mean), surface.mean))
    number = ops.where(by_air, ops.where(by_even_light, -1, particle.number), surface.number)
    # Air just in front of the lens can trip the comparator while the pulse still leaves: no range is below 0.
    return number, ops.maximum(range_m, 0.0)
