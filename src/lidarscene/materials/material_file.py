"""Material files of the catalogue, and the inline materials of scene files, to `Material`.

People write tables of published values, by wavelength, and each kind of surface has keys of its own. Missing and
superfluous keys of a kind are refused here, before anything is traced.
"""

from __future__ import annotations

import itertools
import math
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from ..catalog import names, path_of
from ..errors import InputError, did_you_mean
from ..files.table_model import Number
from ..files.toml import FileModel, read_toml, validate
from ..maths.units import Quantity, si
from .material import Material, Spectrum

UnitInterval = Annotated[float, Field(ge=0, le=1)]
Wavelength = Annotated[float, Number("nm", ge=10, le=1e6)]

# What each kind of surface needs beyond its reflectivity, and what it may have besides.
_NEEDED: dict[str, tuple[str, ...]] = {
    "diffuse": (),
    "coated": ("coat_ior", "coat_roughness"),
    "conductor": ("roughness",),
    "mirror": (),
    "glass": ("index",),
    "retroreflector": ("retro_coefficient_cd_per_lx_m2", "retro_half_angle_deg"),
}
_OPTIONAL: dict[str, tuple[str, ...]] = {
    "diffuse": ("facet_slope_deg", "transmittance", "cover", "free_path_m"),
    "coated": ("cover",),
    "conductor": ("index", "cover"),
    "mirror": ("index",),
    "glass": ("thickness_mm",),
    "retroreflector": ("cover",),
}
_PLAIN = (
    "facet_slope_deg",
    "coat_ior",
    "coat_roughness",
    "roughness",
    "cover",
    "free_path_m",
    "retro_coefficient_cd_per_lx_m2",
    "retro_half_angle_deg",
)
"""Numbers that go into a `Material` as they are."""
_PARAMETERS = {"transmittance": "transmittance", "index_n": "index", "index_k": "index", "thickness_m": "thickness_mm"}
"""Other parameters of a `Material`, and their keys in files."""
_WAVELENGTHS_NM = (10.0, 1e6)
"""Choice: wavelengths of the rows of a constant index: the bounds of `Wavelength`."""
_KINDS_KEYS = sorted({key for keys in (*_NEEDED.values(), *_OPTIONAL.values()) for key in keys})


class ReflectivityRow(FileModel):
    """One published reflectivity or transmittance."""

    wavelength_nm: Wavelength
    value: UnitInterval
    source: str = Field(default="", description='publication, data set or "estimate", and why')


class IndexRow(FileModel):
    """One published complex refractive index n + i k."""

    wavelength_nm: Wavelength
    n: Annotated[float, Number(gt=0, le=1000)] = Field(description="real part")
    k: Annotated[float, Number(ge=0, le=1000)] = Field(default=0.0, description="imaginary part")
    source: str = Field(default="", description="source")


def _is_table(value: object) -> str:
    return "table" if isinstance(value, tuple) else "number"


Reflectivity = Annotated[
    Annotated[UnitInterval, Tag("number")] | Annotated[tuple[ReflectivityRow, ...], Tag("table")],
    Discriminator(_is_table),
]


class MaterialFile(FileModel):
    """A surface: its kind, its diffuse reflectivity by wavelength (or one for all), and what its kind needs."""

    name: str = Field(
        default="", description="for people: a material goes by its file's name or its key in the scene file"
    )
    description: str = Field(default="", description="one line for `lidarscene catalog materials`")
    note: str = Field(default="", description="doubts, spread, related values")
    bsdf: Literal["diffuse", "coated", "conductor", "mirror", "glass", "retroreflector"] = "diffuse"
    reflectivity: Reflectivity = Field(
        description="a number for every wavelength, or rows as below; its meaning depends on `bsdf`: above"
    )
    transmittance: Reflectivity | None = Field(
        default=None,
        description=(
            "diffuse: what comes out on the other side of a thin surface, evenly; a number or "
            "rows as of `reflectivity`, together at most 1: docs/theory_glass.md 2"
        ),
    )
    facet_slope_deg: Annotated[float, Field(gt=0, le=60)] | None = Field(
        default=None,
        description="diffuse: standard deviation of the slope of its facets, Lambertian without: docs/theory.md 4",
    )
    facet_slope_source: str = Field(default="", description="source")
    cover: Annotated[float, Field(gt=0, le=1)] | None = Field(
        default=None,
        description="all but mirror and glass: fraction of the surface that is not gaps; without it there are no gaps",
    )
    cover_source: str = Field(default="", description="source")
    free_path_m: Annotated[float, Number("m", ge=1e-3, le=100)] | None = Field(
        default=None,
        description=(
            "diffuse with a cover below 1: mean way of light behind the surface to a leaf or blade; without it all are "
            "on the surface: docs/theory_glass.md 2"
        ),
    )
    free_path_source: str = Field(default="", description="source")
    coat_ior: Annotated[float, Field(gt=1, lt=4)] | None = Field(
        default=None, description="coated: refractive index of the coat"
    )
    coat_roughness: Annotated[float, Field(gt=0, le=1)] | None = Field(
        default=None, description="coated: GGX roughness of the coat"
    )
    coat_source: str = Field(default="", description="source")
    roughness: Annotated[float, Field(gt=0, le=1)] | None = Field(default=None, description="conductor: GGX roughness")
    roughness_source: str = Field(default="", description="source")
    index: tuple[IndexRow, ...] | None = Field(
        default=None, description="conductor, mirror, glass: complex refractive index, rows as below"
    )
    thickness_mm: Annotated[float, Number("mm", ge=0.01, le=1e4)] | None = Field(
        default=None,
        description="glass: of the pane; with k of `index` it says what the pane absorbs, nothing if left out",
    )
    thickness_source: str = Field(default="", description="source")
    retro_coefficient_cd_per_lx_m2: Annotated[float, Number(ge=1e-3, le=1e7)] | None = Field(
        default=None, description="retroreflector: R_A at 0.2 degrees of observation and 4 degrees of entrance"
    )
    retro_source: str = Field(default="", description="source")
    retro_half_angle_deg: Annotated[float, Field(ge=0.05, le=5)] | None = Field(
        default=None, description="retroreflector: observation angle at which R_A has fallen to half of its peak"
    )
    retro_half_angle_source: str = Field(default="", description="source")

    @model_validator(mode="after")
    def _complete(self) -> MaterialFile:
        missing = [key for key in _NEEDED[self.bsdf] if getattr(self, key) is None]
        if missing:
            raise ValueError(f"a {self.bsdf} material needs {' and '.join(missing)}")
        allowed = {*_NEEDED[self.bsdf], *_OPTIONAL[self.bsdf]}
        idle = [key for key in _KINDS_KEYS if key not in allowed and getattr(self, key) is not None]
        if idle:
            raise ValueError(f"a {self.bsdf} material has no {' and no '.join(idle)}")
        for key in ("reflectivity", "transmittance", "index"):
            rows = getattr(self, key)
            if isinstance(rows, tuple):
                wavelengths = [row.wavelength_nm for row in rows]
                if not rows or any(a >= b for a, b in itertools.pairwise(wavelengths)):
                    raise ValueError(f"{key}: must be rows of rising wavelength_nm, got {wavelengths}")
        if self.free_path_m is not None and (self.cover is None or self.cover == 1.0):
            raise ValueError(f"free_path_m: needs cover below 1, got {self.cover}")
        self._check_energy()
        return self

    def _check_energy(self) -> None:
        if self.transmittance is None:
            return
        reflected, transmitted = _spectrum(self.reflectivity), _spectrum(self.transmittance)
        tables = (rows for rows in (self.reflectivity, self.transmittance) if isinstance(rows, tuple))
        for wavelength_nm in sorted(row.wavelength_nm for table in tables for row in table) or [0.0]:
            wavelength_m = si(wavelength_nm, "nm")
            total = reflected.at(wavelength_m) + transmitted.at(wavelength_m)
            if total > 1.0:
                where = f" at {wavelength_nm:.0f} nm" if wavelength_nm else ""
                raise ValueError(f"reflectivity and transmittance: must be <= 1 together, got {total:.4g}{where}")

    def build(self, name: str) -> Material:
        """Build the material under this name: the numbers of its kind in one mapping, tables as spectra."""
        numbers: dict[str, float | Spectrum | None] = {key: getattr(self, key) for key in _PLAIN}
        numbers["thickness_m"] = si(self.thickness_mm, "mm")
        if self.transmittance is not None:
            numbers["transmittance"] = _spectrum(self.transmittance)
        if self.index:
            wavelengths = si(tuple(row.wavelength_nm for row in self.index), "nm")
            for part in ("n", "k"):
                values = tuple(getattr(row, part) for row in self.index)
                numbers[f"index_{part}"] = Spectrum(wavelength_m=wavelengths, value=values)
        parameters = {key: value for key, value in numbers.items() if value is not None}
        return Material(
            name=name,
            bsdf=self.bsdf,
            reflectivity=_spectrum(self.reflectivity),
            parameters=parameters,
            description=self.description,
        )


def _spectrum(reflectivity: float | tuple[ReflectivityRow, ...]) -> Spectrum:
    if not isinstance(reflectivity, tuple):
        return Spectrum.constant(reflectivity)
    return Spectrum(
        wavelength_m=si(tuple(row.wavelength_nm for row in reflectivity), "nm"),
        value=tuple(row.value for row in reflectivity),
    )


def check_material(material: Material) -> None:
    """Raise InputError for a material that no file may describe."""
    known = (*_PLAIN, *_PARAMETERS)
    for key in material.parameters:
        if key not in known:
            meant = did_you_mean(key, known)
            raise InputError(
                f"Material: parameters: unknown '{key}'; {meant}{' ' if meant else ''}known here: {', '.join(known)}"
            )
    if ("index_n" in material.parameters) != ("index_k" in material.parameters):
        raise InputError("Material: parameters: must have both of index_n and index_k, or none")
    kinds = [kind for kind in _NEEDED if "index" in (*_NEEDED[kind], *_OPTIONAL[kind])]
    where = "Material (its index: parameters index_n and index_k)" if material.bsdf in kinds else "Material"
    validate(MaterialFile, material_table(material), where)


def material_table(material: Material) -> dict[str, Any]:
    """Table of a scene file that gives this material.

    Raises:
        InputError: if a file cannot have its index
    """
    numbers = dict(material.parameters)
    table = {"bsdf": material.bsdf, "reflectivity": _rows(material.reflectivity), "description": material.description}
    if "transmittance" in numbers:
        table["transmittance"] = _rows(numbers.pop("transmittance"))
    if "thickness_m" in numbers:
        table["thickness_mm"] = Quantity("mm").in_file(numbers.pop("thickness_m"))
    if "index_n" in numbers:
        rows = {part: _rows(numbers.pop(f"index_{part}")) for part in "nk"}
        tables = [[row["wavelength_nm"] for row in part] for part in rows.values() if isinstance(part, list)]
        if tables[1:] and tables[0] != tables[1]:
            raise InputError("Material: parameters: index_n and index_k: must have the same wavelengths")
        table["index"] = [
            {"wavelength_nm": nm}
            | {key: part[number]["value"] if isinstance(part, list) else part for key, part in rows.items()}
            for number, nm in enumerate(tables[0] if tables else _WAVELENGTHS_NM)
        ]
    return table | numbers


def _rows(spectrum: Any) -> Any:
    """Value of a file that gives this spectrum: a number, or rows."""
    if not isinstance(spectrum, Spectrum):
        return spectrum
    if not math.isfinite(spectrum.wavelength_m[-1]):
        return spectrum.value[0]
    wavelengths_nm = [Quantity("nm").in_file(wavelength_m) for wavelength_m in spectrum.wavelength_m]
    return [{"wavelength_nm": nm, "value": value} for nm, value in zip(wavelengths_nm, spectrum.value, strict=True)]


def read_material(path: Path) -> Material:
    """Read a material from a TOML file.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    return validate(MaterialFile, read_toml(path), str(path)).build(path.stem)


def materials() -> list[str]:
    """Names of the catalogue's materials, which `Material` and `Scene.add` take."""
    return names("materials")


@cache
def catalogue_material(name: str) -> Material:
    """Load a material of the catalogue by name.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    return read_material(path_of("materials", name))
