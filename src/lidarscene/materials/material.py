"""Materials: how a surface reflects light, by wavelength. Descriptions only; `kernel.world.bsdfs` makes Mitsuba
BSDFs.

A scene is lit by lasers of different wavelengths, and reflectivity differs between them. So a material keeps
published spectra, and each simulation takes the numbers at its own wavelength.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ..errors import InputError
from ..files.arguments import require_type
from ..files.late_binding import call_bound, read_by_name
from ..maths.attributes import HintedAttributes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spectrum:
    """A quantity over wavelength, interpolated linearly between published values.

    Attributes:
        wavelength_m: (n,) rising
        value: (n,)
    """

    wavelength_m: tuple[float, ...]
    value: tuple[float, ...]

    def __post_init__(self) -> None:
        """Raise InputError unless each wavelength has a value."""
        wavelengths, values = len(self.wavelength_m), len(self.value)
        if not wavelengths or wavelengths != values:
            raise InputError(f"Spectrum: must have a value for each wavelength, got {values} for {wavelengths}")

    @classmethod
    def constant(cls, value: float) -> Spectrum:
        """The same value at every wavelength."""
        return cls(wavelength_m=(0.0, np.inf), value=(value, value))

    def covers(self, wavelength_m: float) -> bool:
        """True if the table includes this wavelength (to 1 nm)."""
        return self.wavelength_m[0] - 1e-9 <= wavelength_m <= self.wavelength_m[-1] + 1e-9

    def at(self, wavelength_m: float) -> float:
        """Value at a wavelength within the table."""
        if self.value[0] == self.value[-1] and not np.isfinite(self.wavelength_m[-1]):
            return self.value[0]
        return float(np.interp(wavelength_m, self.wavelength_m, self.value))


@read_by_name("load_material")
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Material(HintedAttributes):
    """A surface. ``Material("brick")`` is that of the catalogue, ``Material(reflectivity=0.2)`` a diffuse one.

    Attributes:
        name: in scenes; without one it says the reflectivity
        bsdf: "diffuse", "coated", "conductor", "mirror", "glass" or "retroreflector"
        reflectivity: diffuse hemispherical reflectivity at normal incidence; the specular one for conductors, mirrors
            and glass; a number holds for every wavelength
        parameters: further numbers of that kind, held to what material files hold theirs: facet_slope_deg (deviation
            of the facets' slope of a rough matt surface); coat_ior, coat_roughness; roughness; index_n and index_k,
            constant or a `Spectrum`; thickness_m; retro_coefficient_cd_per_lx_m2, retro_half_angle_deg; transmittance
            (diffuse hemispherical, of a thin surface, constant or a `Spectrum`); cover (fraction of the surface that
            is not gaps); free_path_m (of light behind a surface with gaps)
    """

    MADE_BY: ClassVar[str] = (
        'Material("brick") is of the catalogue, of lidarscene.materials(); Material(reflectivity=0.2) is diffuse'
    )
    CHANGED_BY: ClassVar[str] = 'dataclasses.replace(material, name="mine") is another material'
    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("color", "colour", "reflectance", "albedo"), "material.at(905e-9) has its numbers"),
        **dict.fromkeys(("roughness", "ior", "transmittance"), "material.parameters"),
    }

    name: str = ""
    bsdf: str = "diffuse"
    reflectivity: Spectrum
    parameters: Mapping[str, float | Spectrum] = field(default_factory=dict)
    description: str = ""

    if TYPE_CHECKING:  # the fields, or what `read_by_name` reads

        def __init__(self, file: str = ..., /, **values: Any) -> None: ...

    def __post_init__(self) -> None:
        """Take a number for every wavelength, refuse what no material file may have, and name what has no name."""
        given: Any = self.reflectivity
        for name, kind in (("name", str), ("bsdf", str), ("parameters", Mapping), ("description", str)):
            require_type(name, getattr(self, name), kind)
        if not isinstance(given, Spectrum):
            require_type("reflectivity", given, float)
            if not 0.0 <= given <= 1.0:
                raise InputError(f"Material: reflectivity: must be from 0 to 1, got {given}")
            object.__setattr__(self, "reflectivity", Spectrum.constant(float(given)))
        call_bound("check_material", self)
        if not self.name:
            first, last = map(float, (self.reflectivity.value[0], self.reflectivity.value[-1]))
            object.__setattr__(self, "name", f"reflectivity {first}" + ("" if first == last else f" to {last}"))

    def at(self, wavelength_m: float) -> dict[str, Any]:
        """Name, kind, wavelength_m, reflectivity and parameters at one laser wavelength.

        Raises:
            InputError: if a table does not include the wavelength
        """
        values: dict[str, Any] = {"name": self.name, "bsdf": self.bsdf, "wavelength_m": wavelength_m}
        for key, value in {"reflectivity": self.reflectivity, **self.parameters}.items():
            values[key] = self._at(key, value, wavelength_m) if isinstance(value, Spectrum) else value
        return values

    def _at(self, key: str, spectrum: Spectrum, wavelength_m: float) -> float:
        if not spectrum.covers(wavelength_m):
            low, high = spectrum.wavelength_m[0], spectrum.wavelength_m[-1]
            raise InputError(
                f"material '{self.name}': no {key} at {wavelength_m * 1e9:.0f} nm; "
                f"its table reaches from {low * 1e9:.0f} to {high * 1e9:.0f} nm"
            )
        return spectrum.at(wavelength_m)
