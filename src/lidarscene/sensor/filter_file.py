"""The receiver's filter in a sensor file: a shape or a table of transmittance in, the sun's in-band irradiance out."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from ..errors import InputError
from ..files import pvlib
from ..files.toml import FileModel
from ..physics.optics.solar_spectrum import (
    Curve,
    box_filter,
    irradiance_at_100_klux_w_m2,
    super_gaussian_filter,
)

Wavelength = Annotated[float, Field(ge=300, le=2500)]
COLUMNS = ("wavelength_nm", "transmittance")


class FilterFile(FileModel):
    """[optics.filter]: what the receiver lets through, by shape or from a CSV file, and of which sunlight."""

    centre_nm: Wavelength | None = None
    width_nm: Annotated[float, Field(ge=0.01, le=1000)] | None = Field(
        default=None, description="full width at half of the peak, which is 1"
    )
    shape: Literal["box", "gaussian", "super_gaussian"] = "box"
    order: Annotated[float, Field(ge=2, le=100)] = Field(
        default=6.0, description="of a super_gaussian; 2 is a Gaussian, large is a box"
    )
    csv: Annotated[str, Field(min_length=1)] | None = Field(
        default=None, description="file with the columns wavelength_nm and transmittance, zero outside"
    )
    spectrum: Literal["global", "direct", "extraterrestrial"] = Field(
        default="global", description="column of ASTM G173, scaled to 100 klux"
    )

    @model_validator(mode="after")
    def _one_way(self) -> FilterFile:
        given = self.model_fields_set
        if self.csv is not None:
            extra = sorted(given & {"centre_nm", "width_nm", "shape", "order"})
            if extra:
                raise ValueError(f"csv says all of the filter, {' and '.join(extra)} came too")
        elif self.centre_nm is None or self.width_nm is None:
            raise ValueError("centre_nm and width_nm, or csv, were expected")
        elif "order" in given and self.shape != "super_gaussian":
            raise ValueError(f'order is for shape = "super_gaussian", shape "{self.shape}" came')
        return self

    def transmittance(self, folder: Path) -> Curve:
        """As a curve. Raises InputError."""
        if self.csv is not None:
            return read_transmittance(folder / self.csv)
        assert self.centre_nm is not None
        assert self.width_nm is not None
        centre_m, width_m = 1e-9 * self.centre_nm, 1e-9 * self.width_nm
        if self.shape == "box":
            return box_filter(centre_m=centre_m, width_m=width_m)
        order = 2.0 if self.shape == "gaussian" else self.order
        return super_gaussian_filter(centre_m=centre_m, width_m=width_m, order=order)

    def sun_irradiance_w_m2(self, folder: Path) -> float:
        """Of the sun, behind the filter, at 100 klux. Raises InputError, or LidarSceneError without pvlib."""
        curve = self.transmittance(folder)
        return irradiance_at_100_klux_w_m2(pvlib.reference_spectrum(self.spectrum), curve)


def read_transmittance(path: Path) -> Curve:
    """A filter from a CSV file with the columns wavelength_nm (rising) and transmittance (0 to 1).

    The first line may name them; lines that begin with # are skipped. Raises InputError.
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
                f"{where}, line {number}: a longer wavelength than {rows[-2][0]:g} nm was expected"
            )
    if len(rows) < 2:
        raise InputError(f"{where}: two lines of {','.join(COLUMNS)} or more were expected")
    wavelength_nm, transmittance = np.array(rows).T
    return Curve(wavelength_m=1e-9 * wavelength_nm, value=transmittance)


def _lines(path: Path, where: str) -> list[str]:
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError:
        raise InputError(f"{where}: no such file") from None
    except UnicodeDecodeError:
        raise InputError(f"{where}: not UTF-8 text") from None
    except OSError as error:
        raise InputError(f"{where}: cannot be read: {error.strerror or error}") from None


def _row(cells: list[str], where: str) -> tuple[float, float]:
    try:
        wavelength_nm, transmittance = (float(cell) for cell in cells)
    except ValueError:
        raise InputError(f"{where}: {','.join(COLUMNS)} was expected, {','.join(cells)} came") from None
    if not (0.0 < wavelength_nm < 1e6 and 0.0 <= transmittance <= 1.0):
        raise InputError(
            f"{where}: a wavelength above 0 nm and a transmittance of 0 to 1 were expected, {','.join(cells)} came"
        )
    return wavelength_nm, transmittance
