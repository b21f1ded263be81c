"""Continue a beam beyond a surface: through panes and gaps, and off mirrors.

At a pane light goes two ways. A path tracer would draw one of them at random; here the caller follows both, so that
the optics have no Monte Carlo noise and each echo has a definite path (docs/theory_glass.md 1). Mitsuba's BSDFs are
still sampled, since that gives direction and share of each lobe, but the random number that selects the lobe is set
here.

Symbols: T, R transmittance and reflectance of a pane; throughput is the product of them along a path.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, TypeVar

from ...maths.arrays import Array, Lanes, Mask, is_drjit, xp
from ...maths.motion_table import Placement
from ...physics.optics import dielectrics
from ...physics.optics.polarisation import LobeShares, Stokes, pane_shares
from ..device.backend import mitsuba
from ..device.types import Ray
from .gaps import gap_share
from .meeting import Meeting, Moment
from .polarised import PolarisedBeam

START_OFFSET_M = 3e-4
"""Accuracy bought: height above a surface at which the next ray starts. Mitsuba's own offset grows to 22 mm at 250 m
(measured) and would jump over a 5 mm pane; float32 positions at 250 m are good to 0.03 mm."""

_LEAST_COSINE = 0.05
"""Accuracy bought: smallest cosine of incidence that the offset is divided by. A ray that grazes the surface has to go
farther to gain the same height: 6 mm at this cosine, and no more than that."""


LEAST_DRAW = 1e-9
"""Accuracy bought: random number that stands for smaller ones: no depth beyond 21 free paths."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BeamPath:
    """The path of a beam from the sensor to the start of its latest ray; one element for each ray.

    Attributes:
        ray: the latest ray, in the traced frame
        length_m: length of the path so far
        throughput: share of the light that has come this far, one way
        interactions: number of panes, mirrors and gaps so far
        mirrored: whether any of them was a reflection
        receding_m_s: rate at which the motion of sensor and mirrors lengthens the path
        glint_per_sr: f_r cos(theta) of a specular return (`glints`) at which the path ends; 0 if there is none
        polarised: polarisation of the light; then ``throughput`` is that of unpolarised light. None: left out
    """

    ray: Any
    length_m: Lanes = 0.0
    throughput: Lanes = 1.0
    interactions: Lanes = 0
    mirrored: Mask = False
    receding_m_s: Lanes = 0.0
    glint_per_sr: Lanes = 0.0
    polarised: PolarisedBeam | None = None


Followed = TypeVar("Followed", BeamPath, Meeting, Placement, PolarisedBeam, Stokes)


def select_fields(mask: Mask, if_true: Followed, if_false: Followed) -> Followed:
    """Select field by field between two objects of one type: ``if_true`` where the mask holds."""
    import drjit as dr

    def select(a: object, b: object) -> Any:
        if isinstance(a, tuple) and isinstance(b, tuple):
            return tuple(select(x, y) for x, y in zip(a, b, strict=True))
        if isinstance(a, Placement) and isinstance(b, Placement):
            return select_fields(mask, a, b)
        if isinstance(a, PolarisedBeam) and isinstance(b, PolarisedBeam):
            return select_fields(mask, a, b)
        if isinstance(a, Stokes) and isinstance(b, Stokes):
            return select_fields(mask, a, b)
        # The same object needs no select: Python numbers that nothing has changed stay Python numbers.
        return a if a is b else dr.select(mask, a, b)

    fields = [field.name for field in dataclasses.fields(if_true)]
    return dataclasses.replace(
        if_true, **{name: select(getattr(if_true, name), getattr(if_false, name)) for name in fields}
    )


def kind_of(moment: Moment, meeting: Meeting) -> Any:
    """Return `Speculars.kind` of what was met, UInt32; 0 where the beam ends."""
    import drjit as dr

    mi = mitsuba()
    speculars = moment.speculars
    # On the device a pointer to a shape is its number in Mitsuba's registry: an index for tables of ours.
    number = dr.reinterpret_array(mi.UInt32, meeting.surface.shape)
    return dr.gather(mi.UInt32, speculars.kind, number, meeting.valid)


def stopped(moment: Moment, path: BeamPath, pane: Meeting, behind_m: Lanes) -> tuple[Any, Meeting]:
    """Return whether paths end at a surface that lets others through, and where: a porous one, where there is no gap.

    Behind a surface with a free path l the same number u, of which the rays with u < 1 - c pass, gives the depth
    -l ln(u): that of Beer and Lambert's law, up to the depth at which the share 1 - c is left, or to the next surface.

    Args:
        behind_m: from the ray's start to the opaque surface behind
    """
    import drjit as dr

    if not moment.speculars.gaps:
        return pane.valid & False, pane
    porous = moment.speculars.is_porous(kind_of(moment, pane))
    draw = moment.draws.uniform(path.interactions)
    ends = porous & (draw >= gap_share(moment.world, pane.surface, porous))
    if moment.speculars.free_path_m is None:
        return ends, pane
    number = dr.reinterpret_array(mitsuba().UInt32, pane.surface.shape)
    free_path_m = dr.gather(mitsuba().Float, moment.speculars.free_path_m, number, porous)
    depth_m = -free_path_m * dr.log(dr.maximum(draw, LEAST_DRAW))
    deep, step_m = ends & (free_path_m > 0.0), _step_m(pane.surface.wi.z)
    inside = mitsuba().Ray3f(path.ray(pane.t + step_m), path.ray.d)
    passes = deep & ((pane.t + depth_m >= behind_m) | moment.glazed(inside, deep, dr.maximum(depth_m - step_m, 0.0)))
    return ends & ~passes, dataclasses.replace(pane, t=pane.t + depth_m)


def continued(moment: Moment, path: BeamPath, meeting: Meeting, active: Mask, *, reflected: bool) -> BeamPath:
    """Return the path beyond the panes, mirrors and gaps that were met: through panes, or ``reflected`` by them.

    Where ``active`` does not hold it is the path up to them.
    """

    def beyond() -> BeamPath:
        return _beyond(moment, path, meeting, active, reflected=reflected)

    # A path begins with plain numbers, and most rays meet the first pane. Few meet another: their packets alone go on.
    if not is_drjit(path.interactions):
        return select_fields(active, beyond(), path)
    return xp(path.interactions).where_any(active, beyond, path)


def _step_m(cosine: Array) -> Any:
    """Way to the start of the next ray: `START_OFFSET_M` is across the surface, so that along the ray it is longer."""
    import drjit as dr

    return START_OFFSET_M / dr.maximum(dr.abs(cosine), _LEAST_COSINE)


def _beyond(moment: Moment, path: BeamPath, meeting: Meeting, active: Mask, *, reflected: bool) -> BeamPath:
    """Return `continued` for rays of which all go on."""
    import drjit as dr

    mi = mitsuba()
    kind = kind_of(moment, meeting)
    direction, share = _lobe(moment, meeting, kind, active, reflected=reflected)
    # The ray starts on the far side of a pane, or on the near side of a mirror: along its own new direction.
    step = _step_m(direction.z)
    # The interaction's "world" is the frame of the body that was met; from there to the traced frame.
    out = dr.normalize(meeting.direction_outside(meeting.surface.to_world(direction)))
    # A mirror that moves by v changes the path's length by v . (d_in - d_out) per second. At a pane both directions
    # are the same, and its motion changes nothing.
    hit_point = path.ray.o + meeting.t * path.ray.d
    drift = meeting.receding(hit_point, path.ray.d - out)
    receding = path.receding_m_s if drift is None else path.receding_m_s + drift
    throughput, polarised = path.throughput * share, path.polarised
    if polarised is not None:
        normal = meeting.direction_outside(meeting.surface.sh_frame.n)
        shares = _lobe_shares(moment, meeting, kind, active, share, reflected=reflected)
        polarised = polarised.beyond(path.ray.d, normal, shares)
        throughput = polarised.unpolarised.intensity
    return dataclasses.replace(
        path,
        ray=mi.Ray3f(hit_point + step * out, out),
        length_m=path.length_m + meeting.t + step,
        throughput=throughput,
        interactions=path.interactions + mi.UInt32(1),
        mirrored=mi.Bool(True) if reflected else path.mirrored | moment.speculars.is_mirror(kind),
        receding_m_s=receding,
        polarised=polarised,
    )


def _lobe_shares(
    moment: Moment, meeting: Meeting, kind: Array, active: Mask, share: Lanes, *, reflected: bool
) -> LobeShares:
    """Return the shares of both polarisations that go into a lobe; ``share`` is that of `_lobe`, of unpolarised light.

    Panes follow Fresnel's equations. Gaps pass, and mirrors reflect, both polarisations alike.
    """
    import drjit as dr

    speculars, cosine = moment.speculars, dr.abs(meeting.surface.wi.z)
    # A mirror reverses one of two directions across the beam, of which s, p and the light are right-handed again.
    across, along, mixed = share, share, dr.select(speculars.is_mirror(kind), -share, share)
    for number, (index, glass) in enumerate(zip(speculars.index, speculars.glass, strict=True)):
        if index is None:  # Mitsuba's `null` passes all light
            continue
        of_bsdf = active & (kind == number + 1)
        internal: Lanes = 1.0
        if glass is not None:
            internal = dielectrics.internal_transmittance(depth=glass[1], cos_incidence=cosine, index=index)
        pane = pane_shares(cos_incidence=cosine, index=index, internal=internal, reflected=reflected)
        across = dr.select(of_bsdf, pane.across, across)
        along = dr.select(of_bsdf, pane.along, along)
        mixed = dr.select(of_bsdf, pane.mixed, mixed)
    return LobeShares(across=across, along=along, mixed=mixed)


def _lobe(moment: Moment, meeting: Meeting, kind: Array, active: Mask, *, reflected: bool) -> tuple[Any, Any]:
    """Return (n,) direction in the surface's own frame, and (n,) share of the light that goes there."""
    import drjit as dr

    mi = mitsuba()
    speculars = moment.speculars
    context = mi.BSDFContext()
    direction, share = mi.Vector3f(0.0, 0.0, 1.0), mi.Float(0.0)
    # Through a gap: straight on, with all of the light (the ray was drawn, `stopped`).
    if speculars.gaps and not reflected:
        porous = speculars.is_porous(kind)
        direction, share = dr.select(porous, -meeting.surface.wi, direction), dr.select(porous, 1.0, share)
    # One BSDF after the other, each for its own lanes: what does not end a beam has few.
    for number, bsdf in enumerate(speculars.bsdfs[: speculars.panes] if reflected else speculars.bsdfs):
        of_bsdf = active & (kind == number + 1)
        # The first random number selects the lobe: 0 is always the pane's reflection, 1 always its transmission. A
        # mirror has one lobe. Weight times pdf is the share that goes into the lobe, whatever its probability was.
        lobe = mi.Float(0.0 if reflected else 1.0)
        sample, weight = bsdf.sample(context, meeting.surface, lobe, mi.Point2f(0.5), of_bsdf)
        direction = dr.select(of_bsdf, sample.wo, direction)
        share = dr.select(of_bsdf, weight[0] * sample.pdf, share)
        if number < speculars.panes and (glass := speculars.glass[number]) is not None:
            absorbing = _absorbing_share(*glass, cosine=dr.abs(meeting.surface.wi.z), reflected=reflected)
            share = dr.select(of_bsdf, absorbing, share)
    if reflected:  # `null` transmits everything, even with the random number that selects a reflection
        share = dr.select(direction.z * meeting.surface.wi.z > 0.0, share, 0.0)
    return direction, share


def _absorbing_share(index: Lanes, depth: Lanes, *, cosine: Lanes, reflected: bool) -> Lanes:
    """Return T or R of a pane that absorbs. Mitsuba's `thindielectric` is lossless.

    Args:
        index: refractive index
        depth: optical depth at normal incidence
        cosine: of the angle of incidence: at an angle the path inside the glass is longer
    """
    surface = dielectrics.fresnel_reflectance(cos_incidence=cosine, index=index)
    internal = dielectrics.internal_transmittance(depth=depth, cos_incidence=cosine, index=index)
    law = dielectrics.pane_reflectance if reflected else dielectrics.pane_transmittance
    return law(surface=surface, internal=internal)


def sunlight_share(moment: Moment, ray: Ray, active: Mask, *, interactions: int) -> Any:
    """Return the share of the sun's light along these shadow rays: 1 in the open, less through panes, 0 in shadow.

    Args:
        interactions: largest number of panes and porous surfaces on a ray; behind more of them there is shadow.
            Sunlight that mirrors send is left out.
    """
    import drjit as dr

    mi = mitsuba()
    # Opaque surfaces are tested once, for the whole ray. Then the ray is followed from pane to pane. Gaps dim sunlight
    # by their share, without chance: unlike a ray of the beam, sunlight is an average over the surface.
    path, open_ = BeamPath(ray=ray, throughput=mi.Float(1.0)), active & ~moment.blocked(ray, active)
    glazed = open_
    for _ in range(interactions):
        pane = moment.pane(path.ray, dr.inf, glazed)
        glazed = pane.valid
        path = continued(moment, path, pane, glazed, reflected=False)
        if moment.speculars.gaps:
            porous = moment.speculars.is_porous(kind_of(moment, pane))
            dimmed = path.throughput * gap_share(moment.world, pane.surface, porous)
            path = dataclasses.replace(path, throughput=dr.select(porous, dimmed, path.throughput))
    return dr.select(open_ & ~moment.glazed(path.ray, glazed), path.throughput, 0.0)
