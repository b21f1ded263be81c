"""Translate materials to Mitsuba BSDFs and textures, and add the BSDFs that Mitsuba lacks.

Mitsuba has no retro-reflector and no rough matt surface: both are plug-ins of ours.

Reflection is Mitsuba's: its BSDFs are documented, tested and what users of Mitsuba scenes expect. They are made from
the numbers of one wavelength, the laser's, as dictionaries that `mi.load_dict` and XML scenes both understand.

Everything that does not transmit is two-sided. Mitsuba's one-sided `diffuse` is black from behind, and meshes from
elsewhere are rarely wound consistently: a car would lose all panels that are wound the other way.

Symbols: rho diffuse reflectivity, R_A coefficient of retro-reflection (cd/lx/m2 = 1/sr), alpha observation angle, beta
entrance angle, f_r BSDF (1/sr).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Hashable, Mapping
from typing import Any, Protocol

import numpy as np

from ...errors import InputError
from ...materials.colour import reflectivity_by_colour
from ...maths.arrays import Lanes, Mask, Numbers, xp
from ...physics.optics import dielectrics, reflection
from ...scene.meshes.reflectivity_patterns import Cutout, ReflectivityPattern
from ..device import transfer
from ..device.backend import mitsuba
from ..device.types import Bsdf, DeviceVector, Interaction

RETRO_PLUGIN = "lidarscene_retroreflector"
ROUGH_PLUGIN = "lidarscene_rough_diffuse"

_PERFECT_INDEX = 3e9
"""Accuracy bought: refractive index of a perfect mirror, which takes 7e-10 / cos(theta) of the light. Its fourth power
is a float32. Mitsuba's own mirror, of n = 0 and k = 1, takes sqrt(x^2) - |x| for 0: where a GPU's `sqrt.approx` is one
unit in the last place off, that is 5e-4 of the light."""


class _Parameters(Protocol):
    """What Mitsuba hands to a BSDF that lists its parameters."""

    def put(self, name: str, value: object, flags: object) -> None: ...


ATTRIBUTE = "vertex_reflectivity"
"""Name of the mesh attribute that holds the reflectivity of each vertex."""

_ENTRANCE_EXPONENT = 3.61
"""Source: ASTM D4956; R_A falls as cos(entrance angle)^3.61: the 150 against 250 cd/lx/m2 at 30 against 4 degrees that
it asks of white type III sheeting, log(150/250) / log(cos 30 / cos 4)."""
_STATED_ENTRANCE_COS = math.cos(math.radians(4.0))


def bsdf_dict(values: dict[str, Any], reflectance: dict[str, object] | None = None) -> dict[str, Any]:
    """Return a Mitsuba dictionary for `Material.at`: reflectivity and parameters at the laser's wavelength.

    Gaps become Mitsuba's `mask`. Diffuse transmittance is left to `rays.trace`: Mitsuba has no BSDF for it.

    Args:
        reflectance: Mitsuba texture in place of the reflectivity of a diffuse material
    """
    whole = _BUILDERS[values["bsdf"]](values)
    if reflectance is not None:
        whole.get("inner", whole)["reflectance"] = reflectance
    cover = values.get("cover", 1.0)
    return whole if cover == 1.0 else {"type": "mask", "opacity": float(cover), "nested": whole}


def make_bsdf(
    values: dict[str, Any], reflectance: dict[str, object] | None = None, cutout: Cutout | None = None
) -> Any:
    """Return Mitsuba's BSDF of a material with the gaps of a cutout, if any; other arguments as of `bsdf_dict`."""
    if cutout is not None:
        solid = bsdf_dict(values | {"cover": 1.0}, reflectance)
        return mitsuba().load_dict({"type": "mask", "opacity": _opacity(cutout, values), "nested": solid})
    if values["bsdf"] == "coated" and reflectance is None and values.get("cover", 1.0) == 1.0:
        return _load_coat(values)
    return mitsuba().load_dict(bsdf_dict(values, reflectance))


def diffuse_share(values: Mapping[str, Any]) -> float:
    """Return the share of the sky's light that a surface reflects diffusely; metal and glass mirror it instead."""
    return 0.0 if values["bsdf"] in ("conductor", "mirror", "glass") else float(values["reflectivity"])


def _two_sided(inner: object) -> dict[str, Any]:
    return {"type": "twosided", "inner": inner}


def _spectrum(value: float) -> dict[str, Any]:
    return {"type": "spectrum", "value": float(value)}


def _diffuse(values: dict[str, Any]) -> dict[str, Any]:
    if "facet_slope_deg" in values:
        return _rough_diffuse(values)
    return _two_sided({"type": "diffuse", "reflectance": _spectrum(values["reflectivity"])})


def _rough_diffuse(values: dict[str, Any]) -> dict[str, Any]:
    register_rough_diffuse()
    slope_deg = float(values["facet_slope_deg"])
    limit = _largest_reflectivity(values)
    if values["reflectivity"] > limit:
        raise InputError(
            f"material '{values.get('name', '')}': reflectivity must be <= {limit:.3g} with a facet_slope_deg of "
            f"{slope_deg:.3g}, got {values['reflectivity']:.3g}"
        )
    return {"type": ROUGH_PLUGIN, "reflectance": _spectrum(values["reflectivity"]), "slope_deg": slope_deg}


def _largest_reflectivity(values: Mapping[str, Any]) -> float:
    """Return the reflectivity at which a matt surface, with what it transmits, sends out all light that comes in."""
    of_opaque = reflection.largest_reflectivity(math.radians(values.get("facet_slope_deg", 0.0)))
    return of_opaque * (1.0 - float(values.get("transmittance", 0.0)))


def _coated(values: dict[str, Any]) -> dict[str, Any]:
    """A diffuse base under a rough dielectric coat; the reflectivity is the diffuse part, seen from outside."""
    white = mitsuba().load_dict(_roughplastic(values, _spectrum(1.0)))
    return _two_sided(_roughplastic(values, _spectrum(_base(values, white))))


def _load_coat(values: dict[str, Any]) -> Any:
    """Return Mitsuba's BSDF of `_coated`.

    To tabulate a coat takes Mitsuba 20 ms. So one is tabulated, over a white base, and then the base is darkened.
    """
    mi = mitsuba()
    reflectance = mi.load_dict(_spectrum(1.0))
    white = mi.load_dict(_roughplastic(values, reflectance))
    parameters = mi.traverse(reflectance)
    parameters["value"] = transfer.opaque(_base(values, white))
    parameters.update()
    return mi.load_dict(_two_sided(white))


def _base(values: dict[str, Any], white: Bsdf) -> float:
    """Return the reflectivity of the base of a coat; ``white`` is Mitsuba's BSDF over a white one."""
    ior, roughness = float(values["coat_ior"]), float(values["coat_roughness"])
    limit = diffuse_throughput(white)
    if values["reflectivity"] > limit:
        raise InputError(
            f"material '{values.get('name', '')}': reflectivity must be <= {limit:.3g} under a coat of "
            f"coat_ior {ior:.3g} and coat_roughness {roughness:.3g}, got {values['reflectivity']:.3g}"
        )
    # The material's reflectivity is measured through the coat, Mitsuba's parameter is the base's below it. The linear
    # model ("nonlinear": False) makes one proportional to the other, so one division converts.
    return float(values["reflectivity"] / limit)


def _roughplastic(values: Mapping[str, float], base: object) -> dict[str, object]:
    return {
        "type": "roughplastic",
        "distribution": "ggx",
        "int_ior": float(values["coat_ior"]),
        "alpha": float(values["coat_roughness"]),
        "nonlinear": False,
        "diffuse_reflectance": base,
    }


def diffuse_throughput(coat: Bsdf) -> float:
    """Return the share of light that passes the coat, is scattered by a white base and leaves again; normal incidence.

    Reflectivities are measured near normal incidence and over the hemisphere. So a base whose reflectivity is the
    material's over this share has the material's reflectivity (docs/theory.md 4).

    Args:
        coat: Mitsuba's BSDF, over a white base
    """
    # Mitsuba tabulates the transmittance of the rough coat and does not give it away. So its own BSDF, without the
    # mirror lobe, is integrated over the hemisphere: 64-point Gauss-Legendre in the cosine.
    mi = mitsuba()
    nodes, weights = np.polynomial.legendre.leggauss(64)
    cosines = 0.5 * (nodes + 1.0)
    surface = mi.SurfaceInteraction3f()
    surface.wi = mi.Vector3f(0.0, 0.0, 1.0)
    outgoing = mi.Vector3f(mi.Float(np.sqrt(1.0 - cosines**2)), 0.0, mi.Float(cosines))
    context = mi.BSDFContext()
    context.type_mask = mi.BSDFFlags.DiffuseReflection
    value = coat.eval(context, surface, outgoing, True)[0].numpy()
    return float(2.0 * math.pi * 0.5 * np.dot(weights, value))


def _conductor(values: dict[str, Any]) -> dict[str, Any]:
    return _metal(values, type="roughconductor", distribution="ggx", alpha=values["roughness"])


def _mirror(values: dict[str, Any]) -> dict[str, Any]:
    return _metal(values, type="conductor")


def _metal(values: dict[str, Any], **lobe: object) -> dict[str, Any]:
    if "index_n" in values:
        return _two_sided(lobe | {"eta": _spectrum(values["index_n"]), "k": _spectrum(values["index_k"])})
    # Without an index: a perfect mirror's lobe, scaled by the reflectivity.
    perfect = {"eta": _spectrum(_PERFECT_INDEX), "k": _spectrum(0.0)}
    return _two_sided(lobe | perfect | {"specular_reflectance": _spectrum(values["reflectivity"])})


def _glass(values: dict[str, Any]) -> dict[str, Any]:
    """A pane: both faces of a thin sheet at once. Lossless in Mitsuba; its absorption is in `Speculars.glass`."""
    return {"type": "thindielectric", "int_ior": values["index_n"], "ext_ior": 1.0}


def absorption(values: Mapping[str, Any]) -> tuple[float, float] | None:
    """Return index and optical depth at normal incidence of a pane that absorbs; None for everything else."""
    if values["bsdf"] != "glass" or not values["index_k"] or "thickness_m" not in values:
        return None
    depth = dielectrics.optical_depth(
        index_k=values["index_k"], thickness_m=values["thickness_m"], wavelength_m=values["wavelength_m"]
    )
    return values["index_n"], depth


def _retroreflector(values: dict[str, Any]) -> dict[str, Any]:
    register_retroreflector()
    return {
        "type": RETRO_PLUGIN,
        "reflectivity": values["reflectivity"],
        "coefficient": values["retro_coefficient_cd_per_lx_m2"],
        "half_angle_deg": values["retro_half_angle_deg"],
    }


_BUILDERS = {
    "diffuse": _diffuse,
    "coated": _coated,
    "conductor": _conductor,
    "mirror": _mirror,
    "glass": _glass,
    "retroreflector": _retroreflector,
}


@functools.cache
def _cosine_sampled() -> Any:
    """Return the base class of opaque, two-sided BSDFs that are sampled by the cosine, which covers the hemisphere.

    Our tracer never samples. Mitsuba's own integrators do, in tests.
    """
    import drjit as dr

    mi = mitsuba()

    class CosineSampled(mi.BSDF):  # type: ignore[misc,name-defined]
        def __init__(self, props: Any, further: Any = 0) -> None:
            mi.BSDF.__init__(self, props)
            sides = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
            self.m_flags = mi.BSDFFlags.DiffuseReflection | sides | further
            self.m_components = [self.m_flags]

        def sample(self, ctx: object, si: Interaction, sample1: Lanes, sample2: object, active: Mask = True) -> Any:
            wo = mi.warp.square_to_cosine_hemisphere(sample2)
            wo.z = dr.mulsign(wo.z, si.wi.z)
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo, bs.eta, bs.sampled_component = wo, 1.0, 0
            bs.sampled_type = mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
            bs.pdf = self.pdf(ctx, si, wo, active)
            value = self.eval(ctx, si, wo, active) / dr.maximum(bs.pdf, 1e-12)
            return bs, dr.select(active & (bs.pdf > 0.0), value, 0.0)

        def pdf(self, ctx: object, si: Interaction, wo: DeviceVector, active: Mask = True) -> Any:
            return dr.select(active & (si.wi.z * wo.z > 0.0), dr.abs(wo.z) * dr.inv_pi, 0.0)

        def eval_pdf(self, ctx: object, si: Interaction, wo: DeviceVector, active: Mask = True) -> Any:
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    return CosineSampled


def retro_peak_per_sr(*, coefficient_cd_per_lx_m2: float, half_angle_deg: float) -> float:
    """Return R_A at alpha = beta = 0, 1/sr, from the stated R_A at alpha = 0.2 and beta = 4 degrees.

    The lobe is Gaussian in alpha, and half as high at ``half_angle_deg``.
    """
    return coefficient_cd_per_lx_m2 * 2.0 ** ((0.2 / half_angle_deg) ** 2) / _STATED_ENTRANCE_COS**_ENTRANCE_EXPONENT


@functools.cache
def register_retroreflector() -> None:
    """Register the plug-in with Mitsuba, once: plug-ins from Python exist only in the variant that is active."""
    import drjit as dr

    mi = mitsuba()

    class Retroreflector(_cosine_sampled()):  # type: ignore[misc]
        """f_r = rho / pi + R_A(alpha, beta) / (cos beta_i cos beta_o), two-sided.

        A sheet of coefficient R_A under an illuminance E_perp sends R_A E_perp cd per m2 of sheet back, so its
        radiance is R_A E_perp / cos(beta_o) and its irradiance E_perp cos(beta_i) (CIE 54.2). alpha is the
        angle between the incoming and outgoing rays, beta the entrance angle.
        """

        def __init__(self, props: Mapping[str, float]) -> None:
            super().__init__(props, mi.BSDFFlags.GlossyReflection)
            self.reflectivity = mi.Float(props.get("reflectivity", 0.0))
            half_angle_deg = props.get("half_angle_deg", 0.4)
            self.peak = mi.Float(
                retro_peak_per_sr(
                    coefficient_cd_per_lx_m2=props.get("coefficient", 250.0), half_angle_deg=half_angle_deg
                )
            )
            self.half_angle = mi.Float(math.radians(half_angle_deg))
            # Opaque: literals would be part of the kernel, and each retro-reflector would have code of its own.
            dr.make_opaque(self.reflectivity, self.peak, self.half_angle)

        def eval(self, ctx: object, si: Interaction, wo: DeviceVector, active: Mask = True) -> Any:
            cos_i, cos_o = dr.abs(si.wi.z), dr.abs(wo.z)
            same_side = si.wi.z * wo.z > 0.0
            # For small angles |wi - wo| is the observation angle alpha; acos would lose it in rounding.
            observation = dr.norm(si.wi - wo)
            lobe = dr.exp(-math.log(2.0) * dr.square(observation / self.half_angle))
            # The geometric mean of both cosines stands for cos(beta): f_r has to be the same with wi and wo exchanged.
            entrance = dr.power(cos_i * cos_o, 0.5 * _ENTRANCE_EXPONENT)
            # Mitsuba's `eval` is f_r cos(beta_o), so that R_A / (cos beta_i cos beta_o) loses one of its cosines.
            retro = self.peak * lobe * entrance / xp(cos_i).maximum(cos_i, 1e-3)
            diffuse = self.reflectivity * cos_o * dr.inv_pi
            return mi.Spectrum(dr.select(active & same_side, diffuse + retro, 0.0))

        def eval_diffuse_reflectance(self, si: Interaction, active: Mask = True) -> Any:
            return mi.Spectrum(self.reflectivity)

        def traverse(self, callback: _Parameters) -> None:
            callback.put("reflectivity", self.reflectivity, mi.ParamFlags.Differentiable)
            callback.put("peak", self.peak, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: object) -> None:
            dr.make_opaque(self.reflectivity, self.peak)

        def to_string(self) -> str:
            return f"Retroreflector[reflectivity={self.reflectivity}, peak={self.peak}]"

    mi.register_bsdf(RETRO_PLUGIN, Retroreflector)


@functools.cache
def register_rough_diffuse() -> None:
    """Register the plug-in with Mitsuba, once: plug-ins from Python exist only in the variant that is active."""
    import drjit as dr

    mi = mitsuba()

    class RoughDiffuse(_cosine_sampled()):  # type: ignore[misc]
        """Equation (T7a), two-sided. ``reflectance`` is a texture, ``slope_deg`` the deviation of the facets' slope."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.reflectance = props.get_texture("reflectance", 0.5)
            self.relief = mi.Float(reflection.relief(math.radians(props.get("slope_deg", 30.0))))
            # Opaque: a literal would be part of the kernel, and each roughness would have code of its own.
            dr.make_opaque(self.relief)

        def eval(self, ctx: object, si: Interaction, wo: DeviceVector, active: Mask = True) -> Any:
            cos_i, cos_o = dr.abs(si.wi.z), dr.abs(wo.z)
            per_sr = reflection.rough_diffuse_per_sr(
                reflectivity=self.reflectance.eval(si, active)[0],
                relief=self.relief,
                cos_in=cos_i,
                cos_out=cos_o,
                cos_between=dr.dot(si.wi, wo),
            )
            return mi.Spectrum(dr.select(active & (si.wi.z * wo.z > 0.0), per_sr * cos_o, 0.0))

        def eval_diffuse_reflectance(self, si: Interaction, active: Mask = True) -> Any:
            return self.reflectance.eval(si, active)

        def traverse(self, callback: _Parameters) -> None:
            callback.put("reflectance", self.reflectance, mi.ParamFlags.Differentiable)
            callback.put("relief", self.relief, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: object) -> None:
            dr.make_opaque(self.relief)

        def to_string(self) -> str:
            return f"RoughDiffuse[reflectance={self.reflectance}, relief={self.relief}]"

    mi.register_bsdf(ROUGH_PLUGIN, RoughDiffuse)


# --- reflectivity that varies over a surface ----------------------------------------------------------


def texture_key(pattern: ReflectivityPattern | None) -> Hashable:
    """Return what parts of one material must share to be one Mitsuba mesh: pattern or none, and which image."""
    if pattern is None or pattern.uv is None:
        return pattern is not None
    return id(pattern.values), pattern.mean


def reflectivities(pattern: ReflectivityPattern, values: Mapping[str, Any]) -> Numbers:
    """Return the pattern's values as reflectivities of a material at the laser's wavelength, float32.

    At most what conserves energy on its surface.

    Args:
        values: the material by `Material.at`
    """
    varied: Numbers = pattern.values
    if pattern.kind == "colour":
        # A part that is black all over has no mean to be scaled by, and stays black.
        varied = reflectivity_by_colour(
            red=pattern.values,
            mean_red=max(pattern.mean, 1e-6),
            reflectivity=values["reflectivity"],
            wavelength_m=values["wavelength_m"],
        )
    return np.minimum(varied, _largest_reflectivity(values)).astype(np.float32)


def has_gaps(cutout: Cutout | None, values: Mapping[str, Any]) -> bool:
    """Return whether a material shows the gaps of a cutout: one that mirrors light has none (`speculars`)."""
    return cutout is not None and values["bsdf"] not in ("mirror", "glass")


def _opacity(cutout: Cutout, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the Mitsuba texture of a cutout: the material's cover where the image is solid, 0 in its gaps."""
    cover = cutout.solid.astype(np.float32)[..., None] * np.float32(values.get("cover", 1.0))
    # Each pixel is there or not: between two there is no half.
    nearest = {"raw": True, "wrap_mode": "repeat", "filter_type": "nearest"}
    return {"type": "bitmap", "bitmap": mitsuba().Bitmap(cover)} | nearest


def texture(pattern: ReflectivityPattern, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the Mitsuba texture of a pattern; a mesh brings the values of its vertices itself, by `ATTRIBUTE`.

    Raises:
        InputError: for a material that is not diffuse
    """
    if values["bsdf"] != "diffuse":
        raise InputError(
            f"material '{values['name']}': must be diffuse where reflectivity varies, got {values['bsdf']}"
        )
    if pattern.uv is None:
        return {"type": "mesh_attribute", "name": ATTRIBUTE}
    image = mitsuba().Bitmap(reflectivities(pattern, values)[..., None])
    return {"type": "bitmap", "bitmap": image, "raw": True, "wrap_mode": "repeat"}
