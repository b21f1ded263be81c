"""[optics] of a sensor file: the receiver, and how the laser's spot lies in its field of view.

A receiver is described by what a data sheet has: a filter as its transmittance or as a number, an overlap as the
place of the transmitter. The simulation wants watts and a share by range.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from ..errors import InputError
from ..files import pvlib
from ..files.inputs import LARGEST_TEXT, require_file
from ..files.table_model import Number, Table
from ..files.toml import FileModel
from ..maths.units import si
from ..physics.optics.solar_spectrum import (
    SpectralCurve,
    box_filter,
    gaussian_filter,
    irradiance_at_100_klux_w_m2,
    passed_share,
)
from .overlap import Alignment
from .sensor_model import Halo, Optics, StrayLight

Wavelength = Annotated[float, Number("nm", ge=300, le=2500)]
COLUMNS = ("wavelength_nm", "transmittance")


class FilterFile(FileModel):
    """[optics.filter]: what the receiver lets through, by shape or from a CSV file."""

    centre_nm: Wavelength | None = Field(default=None, description="middle of the band")
    width_nm: Annotated[float, Number("nm", ge=0.01, le=1000)] | None = Field(
        default=None, description="full width at half of the peak, which is 1"
    )
    shape: Literal["box", "gaussian"] = Field(default="box", description="of the transmittance")
    csv: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description=(
            "file with the columns `wavelength_nm` (rising) and `transmittance` (0 to 1): straight lines, zero outside"
        ),
    )

    @model_validator(mode="after")
    def _one_way(self) -> FilterFile:
        if self.csv is not None:
            extra = sorted(self.model_fields_set & {"centre_nm", "width_nm", "shape"})
            if extra:
                raise ValueError(f"csv says all of the filter and must stand alone, got {' and '.join(extra)} too")
        elif self.centre_nm is None or self.width_nm is None:
            raise ValueError("must have centre_nm and width_nm, or csv")
        return self

    def transmittance(self, folder: Path) -> SpectralCurve:
        """Transmittance over wavelength.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        if self.csv is not None:
            return read_transmittance(folder / self.csv)
        assert self.centre_nm is not None
        assert self.width_nm is not None
        centre_m, width_m = si(self.centre_nm, "nm"), si(self.width_nm, "nm")
        shaped = box_filter if self.shape == "box" else gaussian_filter
        return shaped(centre_m=centre_m, width_m=width_m)

    def sun_irradiance_w_m2(self, folder: Path) -> float:
        """Solar irradiance behind the filter at 100 klux.

        Raises:
            InputError: if a file, a key or a value cannot be understood
            LidarSceneError: without pvlib
        """
        curve = self.transmittance(folder)
        return irradiance_at_100_klux_w_m2(pvlib.reference_spectrum("global"), curve)

    def echo_share(self, folder: Path, wavelength_m: float, *, drift_m: float) -> float | None:
        """Share of the echo that passes, over that without the drift; None: nothing is shifted.

        Raises:
            InputError: if nothing passes
        """
        if not drift_m:
            return None
        curve = self.transmittance(folder)
        for passed_m in (wavelength_m, wavelength_m + drift_m):
            if not curve.at(passed_m) > 0.0:
                raise InputError(f"optics.filter: must pass the laser's light, got none at {1e9 * passed_m:.6g} nm")
        return passed_share(curve, wavelength_m=wavelength_m, drift_m=drift_m)


def read_transmittance(path: Path) -> SpectralCurve:
    """Read a filter from a CSV file with the columns wavelength_nm (rising) and transmittance (0 to 1).

    The first line may name them; lines that begin with # are skipped.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    where = f"optics.filter.csv: {path}"
    rows: list[tuple[float, float]] = []
    for number, row in enumerate(csv.reader(_lines(path, where)), start=1):
        cells = [cell.strip() for cell in row]
        if not any(cells) or cells[0].startswith("#") or (not rows and tuple(cells) == COLUMNS):
            continue
        rows.append(_row(cells, f"{where}, line {number}"))
        if len(rows) > 1 and not rows[-1][0] > rows[-2][0]:
            raise InputError(
                f"{where}, line {number}: the wavelength must be > {rows[-2][0]:g} nm, got {rows[-1][0]:g}"
            )
    if len(rows) < 2:
        raise InputError(f"{where}: must have two lines of {','.join(COLUMNS)} or more, got {len(rows)}")
    wavelength_nm, transmittance = np.array(rows).T
    return SpectralCurve(wavelength_m=1e-9 * wavelength_nm, value=transmittance)


def _lines(path: Path, where: str) -> list[str]:
    try:
        require_file(path, "a CSV file", largest=LARGEST_TEXT)
    except InputError as error:
        raise InputError(f"{where.removesuffix(str(path))}{error}") from None
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise InputError(f"{where}: not UTF-8 text") from None
    except OSError as error:
        raise InputError(f"{where}: cannot be read: {error.strerror or error}") from None


def _row(cells: list[str], where: str) -> tuple[float, float]:
    try:
        wavelength_nm, transmittance = (float(cell) for cell in cells)
    except ValueError:
        raise InputError(f"{where}: must be {','.join(COLUMNS)}, got {','.join(cells)}") from None
    if not (0.0 < wavelength_nm < 1e6 and 0.0 <= transmittance <= 1.0):
        raise InputError(
            f"{where}: must be a wavelength above 0 nm and a transmittance of 0 to 1, got {','.join(cells)}"
        )
    return wavelength_nm, transmittance


Distance = Annotated[float, Number(gt=0, le=1e6)]
Irradiance = Annotated[float, Number(ge=0, le=1e9)]
Millimetres = Annotated[float, Number("mm", ge=-1e4, le=1e4, finest=0.1)]


class OverlapFile(FileModel):
    """[optics.overlap]: where the transmitter stands beside the receiver, and at what range this is in focus."""

    transmitter_offset_mm: tuple[Millimetres, Millimetres] = Field(
        default=(0.0, 0.0),
        description=(
            "to the left and up from the receiver's axis, where the beam leaves; for a round spot"
            " only the distance counts"
        ),
    )
    parallax_free_at_m: Distance | None = Field(
        default=None, description="range at which the two axes meet; side by side if left out"
    )
    focus_at_m: Distance | None = Field(default=None, description="range that is in focus; infinity if left out")
    scattered_share: Annotated[float, Field(ge=0, le=0.5)] = Field(
        default=0.0,
        description="of the light, which window and lenses scatter onto the detector wherever the spot lies",
    )

    def build(self) -> Alignment:
        """Convert to SI units."""
        return Alignment(
            offset_m=si(math.hypot(*self.transmitter_offset_mm), "mm"),
            crossing_m=self.parallax_free_at_m or math.inf,
            focus_m=self.focus_at_m or math.inf,
            scattered=self.scattered_share,
        )


class HaloFile(Table[Halo]):
    """[optics.halo]: light that window and lens scatter around the beam, out and back together."""


class StrayLightFile(Table[StrayLight]):
    """[optics.stray]: light that lenses and detectors pass on between channels that fire at the same instant."""


class OpticsFile(Table[Optics]):
    """[optics]: the receiver."""

    sun_irradiance_w_m2: Irradiance | None = Field(
        default=None, description="E_sun in band, at normal incidence and 100 klux; exactly one of this and `filter`"
    )
    filter: FilterFile | None = Field(
        default=None, description="the receiver's filter, from which E_sun is computed; needs pvlib"
    )
    overlap: OverlapFile | None = Field(
        default=None,
        description=("of the laser's spot and the field of view; all of the spot is seen, and sharp, if left out"),
    )
    halo: HaloFile | None = Field(
        default=None, description="around the beam, with four rays a pulse or more; none if left out"
    )
    stray: StrayLightFile | None = Field(
        default=None, description="light between channels that fire at the same instant; none if left out"
    )

    @model_validator(mode="after")
    def _one_sun(self) -> OpticsFile:
        if (self.sun_irradiance_w_m2 is None) == (self.filter is None):
            raise ValueError("one of sun_irradiance_w_m2 and filter must be given, got both or none")
        return self

    @model_validator(mode="after")
    def _focus_beyond_the_lens(self) -> OpticsFile:
        focus = None if self.overlap is None else self.overlap.focus_at_m
        if focus is not None and focus * 1e3 < 10.0 * self.focal_length_mm:
            raise ValueError(
                f"overlap.focus_at_m: must be >= {0.01 * self.focal_length_mm:g} (ten focal lengths), got {focus:g}"
            )
        return self

    def build(self, folder: Path, wavelength_m: float, *, drift_m: float) -> Optics:
        """Convert to SI units, but for the overlap, which needs the detector; filter files lie in ``folder``.

        Args:
            wavelength_m: of the laser, at which the file's efficiencies hold
            drift_m: from there to the light that the laser emits
        """
        sun, share = self.sun_irradiance_w_m2, None
        if self.filter is not None:
            sun = self.filter.sun_irradiance_w_m2(folder)
            share = self.filter.echo_share(folder, wavelength_m, drift_m=drift_m)
        halo = None if self.halo is None else self.halo.in_si()
        stray = None if self.stray is None else self.stray.in_si()
        return self.in_si(sun_irradiance_w_m2=sun, halo=halo, stray=stray, filter_share=share)
