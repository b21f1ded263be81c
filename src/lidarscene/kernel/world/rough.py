"""The BSDF of rough matt surfaces, which Mitsuba lacks: `physics.optics.reflection` as a plug-in."""

from __future__ import annotations

import functools
import math
from typing import Any

from ...maths.arrays import Lanes, Mask
from ...physics.optics import reflection
from ..device.backend import mitsuba
from ..device.types import DeviceVector, Surface

ROUGH_PLUGIN = "lidarscene_rough_diffuse"


@functools.cache
def register_rough_diffuse() -> None:
    """Register the plug-in with Mitsuba, once: plug-ins from Python exist only in the variant that is active."""
    mi = mitsuba()
    mi.register_bsdf(ROUGH_PLUGIN, _rough_diffuse_class())


def _rough_diffuse_class() -> Any:
    """Return the class, which is made at the first call: its base class exists only once a variant is set."""
    import drjit as dr

    mi = mitsuba()

    class RoughDiffuse(mi.BSDF):  # type: ignore[misc,name-defined]
        """Equation (T7a), two-sided. ``reflectance`` is a texture, ``slope_deg`` the deviation of the facets' slope."""

        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            self.reflectance = props.get_texture("reflectance", 0.5)
            self.relief = mi.Float(reflection.relief(math.radians(props.get("slope_deg", 30.0))))
            # Opaque: a literal would be part of the kernel, and each roughness would have code of its own.
            dr.make_opaque(self.relief)
            flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
            self.m_components = [flags]
            self.m_flags = flags

        def eval(self, ctx: object, si: Surface, wo: DeviceVector, active: Mask = True) -> Any:
            cos_i, cos_o = dr.abs(si.wi.z), dr.abs(wo.z)
            per_sr = reflection.rough_diffuse_per_sr(
                reflectivity=self.reflectance.eval(si, active)[0],
                relief=self.relief,
                cos_in=cos_i,
                cos_out=cos_o,
                cos_between=dr.dot(si.wi, wo),
            )
            return mi.Spectrum(dr.select(active & (si.wi.z * wo.z > 0.0), per_sr * cos_o, 0.0))

        def sample(self, ctx: object, si: Surface, sample1: Lanes, sample2: object, active: Mask = True) -> Any:
            # Our tracer never samples it. Mitsuba's own integrators do, in tests: the cosine covers the hemisphere.
            wo = mi.warp.square_to_cosine_hemisphere(sample2)
            wo.z = dr.mulsign(wo.z, si.wi.z)
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo, bs.eta, bs.sampled_component = wo, 1.0, 0
            bs.sampled_type = mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
            bs.pdf = self.pdf(ctx, si, wo, active)
            value = self.eval(ctx, si, wo, active) / dr.maximum(bs.pdf, 1e-12)
            return bs, dr.select(active & (bs.pdf > 0.0), value, 0.0)

        def pdf(self, ctx: object, si: Surface, wo: DeviceVector, active: Mask = True) -> Any:
            return dr.select(active & (si.wi.z * wo.z > 0.0), dr.abs(wo.z) * dr.inv_pi, 0.0)

        def eval_pdf(self, ctx: object, si: Surface, wo: DeviceVector, active: Mask = True) -> Any:
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def eval_diffuse_reflectance(self, si: Surface, active: Mask = True) -> Any:
            return self.reflectance.eval(si, active)

        def traverse(self, callback: Any) -> None:
            callback.put("reflectance", self.reflectance, mi.ParamFlags.Differentiable)
            callback.put("relief", self.relief, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: object) -> None:
            dr.make_opaque(self.relief)

        def to_string(self) -> str:
            return f"RoughDiffuse[reflectance={self.reflectance}, relief={self.relief}]"

    return RoughDiffuse
