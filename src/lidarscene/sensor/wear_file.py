"""[wear] of a sensor file: what the road did to a lidar that was built well (docs/sensor_files.md)."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from ..errors import InputError
from ..files.table_model import Number
from ..files.toml import FileModel
from ..maths.arrays import LookupTable
from ..maths.pose import rotation_matrix
from ..maths.units import si
from ..physics.optics import window
from ..scan import Scanner
from .sensor_model import Halo, Laser, Optics
from .wear import Drops, Wear, directions

_MOST_DROPS = 20_000
_MOST_CELLS = 4_000_000
_SAMPLED_PULSES = 20_000
"""Pulses from which the scanner's field of view is taken."""


class WearFile(FileModel):
    """[wear]: dirt, drops and scratches on the window, weak lasers, a mounting that is off."""

    film_transmittance: Annotated[float, Number(ge=1e-3, le=1)] = Field(
        default=1.0, description="one-way transmittance of an absorbing film on the window"
    )
    covered_share: Annotated[float, Number(ge=0, le=0.9)] = Field(
        default=0.0, description="fraction of the window under opaque grains or scratches"
    )
    grain_um: Annotated[float, Number("um", ge=5, le=1000)] = Field(
        default=50.0,
        description=(
            "diameter of a grain, or width of a scratch; what they diffract is a halo, with four rays a pulse or more"
        ),
    )
    drops_per_cm2: Annotated[float, Number(ge=0, le=1000)] = Field(
        default=0.0, description="drops on the window at random places; the light that meets one is lost"
    )
    drop_diameter_mm: Annotated[float, Number("mm", ge=0.1, le=50)] = Field(default=3.0, description="of each drop")
    window_radius_mm: Annotated[float, Number("mm", ge=1, le=2000)] | None = Field(
        default=None, description="of the window's sphere about the sensor's origin; required with drops"
    )
    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = Field(default=0, description="of the drops' places")
    laser_power: tuple[tuple[Annotated[int, Field(ge=0, le=2**20)], Annotated[float, Number(ge=0, le=1)]], ...] = Field(
        default=(), description="channels and the relative power of their lasers, 0 for a dead laser; 1 if not listed"
    )
    mounting_error_mrad: tuple[
        Annotated[float, Number("mrad", ge=-500, le=500)],
        Annotated[float, Number("mrad", ge=-500, le=500)],
        Annotated[float, Number("mrad", ge=-500, le=500)],
    ] = Field(default=(0.0, 0.0, 0.0), description="yaw, pitch and roll of the real mounting against the reported one")

    @model_validator(mode="after")
    def _window_with_drops(self) -> Self:
        if self.drops_per_cm2 > 0.0 and self.window_radius_mm is None:
            raise ValueError("window_radius_mm: must be given with drops_per_cm2, got none")
        return self

    def worn_optics(self, optics: Optics, wavelength_m: float) -> Optics:
        """Optics behind film and grains: less light, and a halo of what the grains diffract (T157, T158)."""
        one_way = self._one_way
        worn = replace(
            optics,
            efficiency_laser=optics.efficiency_laser * one_way * one_way,
            efficiency_sun=optics.efficiency_sun * one_way,
        )
        if not self.covered_share:
            return worn
        share = window.diffracted_share(covered=self.covered_share)
        angle_rad = window.diffraction_angle_rad(wavelength_m=wavelength_m, grain_m=si(self.grain_um, "um"))
        if optics.halo is None:
            return replace(worn, halo=Halo(share=share, divergence_rad=angle_rad))
        # Light is in the clear core only if neither halo has it. The common halo keeps the mean square of the angles.
        clean = optics.halo.share
        scattered = 1.0 - (1.0 - clean) * (1.0 - share)
        square = (clean * optics.halo.divergence_rad**2 + share * angle_rad**2) / (clean + share)
        return replace(worn, halo=Halo(share=scattered, divergence_rad=math.sqrt(square)))

    def build(self, *, optics: Optics, laser: Laser, scanner: Scanner, offset_m: tuple[float, float]) -> Wear:
        """Convert to SI units; raises InputError.

        Args:
            offset_m: to the left and up from the receiver's axis, where the laser's beam leaves
        """
        rotation = None
        if any(self.mounting_error_mrad):
            yaw, pitch, roll = (si(error, "mrad") for error in self.mounting_error_mrad)
            turned = rotation_matrix(yaw_rad=yaw, pitch_rad=pitch, roll_rad=roll)
            rotation = tuple(float(number) for number in turned.ravel())
        return Wear(
            calibrated_share=self._one_way**2,
            drops=None if not self.drops_per_cm2 else self._drops(optics, laser, scanner, offset_m),
            laser_power=self._laser_power(scanner) if self.laser_power else None,
            rotation=rotation,
        )

    @property
    def _one_way(self) -> float:
        """Share of the light that passes film and grains, whatever its direction then."""
        return self.film_transmittance * (1.0 - self.covered_share)

    def _laser_power(self, scanner: Scanner) -> LookupTable:
        """Relative power by channel."""
        channels = int(np.max(scanner.channel(np.arange(scanner.pulses, dtype=np.uint32)))) + 1
        power = np.ones(max(channels, 2))  # a table has two entries or more
        for channel, share in self.laser_power:
            if channel >= channels:
                raise InputError(f"wear.laser_power: channels must be < {channels}, got {channel}")
            power[channel] = share
        return LookupTable(power)

    def _drops(self, optics: Optics, laser: Laser, scanner: Scanner, offset_m: tuple[float, float]) -> Drops:
        """Tabulate the clear shares of both beams over the scanner's field of view."""
        assert self.window_radius_mm is not None
        window_m, drop_m = si(self.window_radius_mm, "mm"), 0.5 * si(self.drop_diameter_mm, "mm")
        exit_m, lens_m = 0.5 * (laser.exit_diameter_m or 0.0), float(optics.aperture_radius_m)
        step = max(1, scanner.pulses // _SAMPLED_PULSES)
        angles = [np.asarray(axis) for axis in scanner.angles(np.arange(0, scanner.pulses, step, dtype=np.uint32))]
        # Beyond the outermost beams, drops that still touch them.
        margin = (max(exit_m, lens_m) + drop_m + math.hypot(*offset_m)) / window_m
        low = [float(axis.min()) - margin for axis in angles]
        high = [float(axis.max()) + margin for axis in angles]
        low[0], high[0] = max(low[0], -math.pi), min(high[0], math.pi)
        low[1], high[1] = max(low[1], -0.5 * math.pi), min(high[1], 0.5 * math.pi)
        area_cm2 = 1e4 * window_m**2 * (high[0] - low[0]) * (math.sin(high[1]) - math.sin(low[1]))
        count = round(self.drops_per_cm2 * area_cm2)
        if count > _MOST_DROPS:
            raise InputError(
                f"wear.drops_per_cm2: must be <= {_MOST_DROPS / area_cm2:.3g} ({_MOST_DROPS} drops on the window), "
                f"got {self.drops_per_cm2:g}"
            )
        rng = np.random.default_rng(self.seed)
        elevation = np.arcsin(rng.uniform(math.sin(low[1]), math.sin(high[1]), count))
        # Steps of a quarter of the least distance over which a beam meets a drop.
        step_rad = 0.25 * (drop_m + min(exit_m, lens_m)) / window_m
        cells = [math.ceil((end - start) / step_rad) + 2 for start, end in zip(low, high, strict=True)]
        if cells[0] * cells[1] > _MOST_CELLS:
            raise InputError(
                f"wear.window_radius_mm: must be less with drops of {self.drop_diameter_mm:g} mm (their table has "
                f"{cells[0] * cells[1]:.2g} cells, at most {_MOST_CELLS:.0e}), got {self.window_radius_mm:g}"
            )
        return Drops.tabulate(
            directions(rng.uniform(low[0], high[0], count), elevation),
            axes_rad=(np.linspace(low[0], high[0], cells[0]), np.linspace(low[1], high[1], cells[1])),
            window_m=window_m,
            drop_m=drop_m,
            lens_m=lens_m,
            exit_m=exit_m,
            offset_m=offset_m,
        )
