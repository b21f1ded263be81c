"""Onward: a beam on its way through panes and gaps and off mirrors, from one surface to the next.

Both branches at a pane are followed by rule and not by chance, so there is no noise in the optics: Mitsuba's BSDFs
are sampled, but which lobe they choose is decided here.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from ...maths.arrays import Lanes, Mask, xp
from ...physics.optics import dielectrics
from ..device.backend import mitsuba
from .gaps import gap_share
from .meeting import Meeting, Moment

START_OFFSET_M = 3e-4
"""How far off a surface the next ray starts. Mitsuba's own offset grows to 22 mm at 250 m and would jump through a 5
mm pane; float32 positions at 250 m are good to 0.03 mm (MITSUBA.md 5.7)."""

_LEAST_COSINE = 0.05
"""Along a ray that grazes the surface the same height takes longer, up to 6 mm at this cosine."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Way:
    """A beam from the sensor to where its latest ray starts.

    ray           the latest ray, in the traced frame
    length_m      of the way so far
    throughput    share of the light that has come this far
    interactions  with panes, mirrors and gaps
    mirrored      whether any of them was a reflection
    receding_m_s  by how much the motion of sensor and mirrors makes the way longer, per second
    glint_per_sr  where it ends at a pane or mirror that throws it back: f_r cos(theta) that would be as bright
    """

    ray: Any
    length_m: Lanes = 0.0
    throughput: Lanes = 1.0
    interactions: Lanes = 0
    mirrored: Mask = False
    receding_m_s: Lanes = 0.0
    glint_per_sr: Lanes = 0.0


def chosen(mask: Any, here: Any, elsewhere: Any) -> Any:
    """``here`` where the mask holds, field by field, of a `Way` or a `Meeting`."""
    import drjit as dr

    def one(a: Any, b: Any) -> Any:
        if isinstance(a, tuple):
            return tuple(one(x, y) for x, y in zip(a, b, strict=True))
        return a if a is b else dr.select(mask, a, b)

    fields = [field.name for field in dataclasses.fields(here)]
    return dataclasses.replace(
        here, **{name: one(getattr(here, name), getattr(elsewhere, name)) for name in fields}
    )


def kind_of(moment: Moment, met: Meeting) -> Any:
    """0 where the beam ends, else `Speculars.kind`, UInt32."""
    import drjit as dr

    mi = mitsuba()
    speculars = moment.speculars
    number = dr.reinterpret_array(mi.UInt32, met.surface.shape)
    return dr.gather(mi.UInt32, speculars.kind, number, met.found)


def stopped(moment: Moment, way: Way, pane: Meeting) -> Any:
    """Whether ways end at what lets others through: at porous surfaces, where they find no gap."""
    if not moment.speculars.gaps:
        return pane.found & False
    porous = moment.speculars.is_porous(kind_of(moment, pane))
    return porous & (moment.draws.uniform(way.interactions) >= gap_share(pane.surface, porous))


def gone_on(moment: Moment, way: Way, met: Meeting, active: Any, *, reflected: bool) -> Way:
    """The way beyond the panes and mirrors that were met: through panes, or ``reflected`` by them."""
    import drjit as dr

    mi = mitsuba()
    kind = kind_of(moment, met)
    direction, share = _lobe(moment, met, kind, active, reflected=reflected)
    step = START_OFFSET_M / xp(share).maximum(dr.abs(direction.z), _LEAST_COSINE)
    out = met.surface.to_world(direction)
    for (_, place), here in zip(moment.moving, met.here, strict=True):
        out = dr.select(here, mi.Vector3f(*place.vector(tuple(out))), out)
    out = dr.normalize(out)
    at = way.ray.o + met.t * way.ray.d
    receding = way.receding_m_s
    for (_, place), here in zip(moment.moving, met.here, strict=True):
        drift = mi.Vector3f(*place.velocity_at(tuple(at)))
        receding = dr.select(here, receding + dr.dot(drift, way.ray.d - out), receding)
    return Way(
        ray=mi.Ray3f(at + step * out, out),
        length_m=way.length_m + met.t + step,
        throughput=way.throughput * share,
        interactions=way.interactions + mi.UInt32(1),
        mirrored=mi.Bool(True) if reflected else way.mirrored | moment.speculars.is_mirror(kind),
        receding_m_s=receding,
    )


def _lobe(moment: Moment, met: Meeting, kind: Any, active: Any, *, reflected: bool) -> tuple[Any, Any]:
    """Direction in the surface's own frame, and share of the light that goes there."""
    import drjit as dr

    mi = mitsuba()
    speculars = moment.speculars
    context = mi.BSDFContext()
    direction, share = mi.Vector3f(0.0, 0.0, 1.0), mi.Float(0.0)
    if speculars.gaps and not reflected:
        porous = speculars.is_porous(kind)
        direction, share = dr.select(porous, -met.surface.wi, direction), dr.select(porous, 1.0, share)
    for number, bsdf in enumerate(speculars.bsdfs[: speculars.panes] if reflected else speculars.bsdfs):
        here = active & (kind == number + 1)
        # The first random number chooses the lobe; 0 is the pane's reflection and 1 its transmission.
        lobe = mi.Float(0.0 if reflected else 1.0)
        sample, weight = bsdf.sample(context, met.surface, lobe, mi.Point2f(0.5), here)
        direction = dr.select(here, sample.wo, direction)
        share = dr.select(here, weight[0] * sample.pdf, share)
        if number < speculars.panes and (glass := speculars.glass[number]) is not None:
            absorbing = _of_pane(*glass, cosine=dr.abs(met.surface.wi.z), reflected=reflected)
            share = dr.select(here, absorbing, share)
    if reflected:  # `null` lets everything through, whatever is asked
        share = dr.select(direction.z * met.surface.wi.z > 0.0, share, 0.0)
    return direction, share


def _of_pane(index: Lanes, depth: Lanes, *, cosine: Lanes, reflected: bool) -> Lanes:
    """T or R of a pane that absorbs: Mitsuba's is lossless, and light's way inside is longer at an angle."""
    surface = dielectrics.fresnel_reflectance(cos_incidence=cosine, index=index)
    internal = dielectrics.internal_transmittance(depth=depth, cos_incidence=cosine, index=index)
    law = dielectrics.pane_reflectance if reflected else dielectrics.pane_transmittance
    return law(surface=surface, internal=internal)


def sunlight_share(moment: Moment, ray: Any, active: Any, *, interactions: int) -> Any:
    """Share of the sun's light that comes along these rays: 1 in the open, less through panes and gaps, 0 in shadow.

    At most so many panes and porous surfaces; light that mirrors send is left out.
    """
    import drjit as dr

    mi = mitsuba()
    way, open_ = Way(ray=ray, throughput=mi.Float(1.0)), active & ~moment.blocked(ray, active)
    glazed = open_
    for _ in range(interactions):
        pane = moment.pane(way.ray, dr.inf, glazed)
        glazed = pane.found
        way = chosen(glazed, gone_on(moment, way, pane, glazed, reflected=False), way)
        if moment.speculars.gaps:
            porous = moment.speculars.is_porous(kind_of(moment, pane))
            dimmed = way.throughput * gap_share(pane.surface, porous)
            way = dataclasses.replace(way, throughput=dr.select(porous, dimmed, way.throughput))
    return dr.select(open_ & ~moment.glazed(way.ray, glazed), way.throughput, 0.0)
