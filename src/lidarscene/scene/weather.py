"""Weather: fog, rain and snow in the air as plain data. The formulas are in `physics.weather`.

A scene file gives visibility and rain rate; the simulation needs extinction, backscatter and particle sizes at the
laser's wavelength. A `Medium` holds these.

Symbols: alpha extinction, beta backscatter coefficient.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal

from ..maths.arrays import Lanes, Numbers
from ..maths.attributes import HintedAttributes
from ..maths.units import FileKey, Quantity, Slider
from ..physics.weather import fog, glory, precipitation
from ..physics.weather.precipitation import Sizes

FogKind = Literal["strong_advection", "moderate_advection", "radiation", "strong_spray", "moderate_spray", "chu_hogg"]
DEFAULT_FOG = "moderate_advection"
"""Kind of fog if only its visibility is given."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Medium:
    """Fog, rain or snow at one wavelength.

    Attributes:
        name: class of its points: "fog", "rain" or "snow"
        extinction_per_m: alpha, one way
        backscatter_per_m_sr: beta
        sizes: of its drops or flakes; None for fog, whose droplets are too many to be drawn one by one
        particle_m2_sr: backscatter of one particle of diameter_m=..., W/sr per W/m2 on it
        particle_gain: factor on it for a lens that sees angles within_rad=..., from_rad=...; None: one
    """

    name: str
    extinction_per_m: float
    backscatter_per_m_sr: float
    sizes: Sizes | None = None
    particle_m2_sr: Callable[..., Lanes] | None = None
    particle_gain: Callable[..., Numbers] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Weather(HintedAttributes):
    """Fog, rain and snow, the same everywhere. The default is clear air.

    Attributes:
        fog: name in `physics.weather.fog.TYPES`, with its published density; None: no fog, or the default kind if a
            visibility is given
        fog_visibility_m: meteorological visibility, to which the number of droplets is scaled; None is clear air, and
            the end of its slider
    """

    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {"visibility": "scene.air.weather.fog_visibility_m"}

    fog: Annotated[
        FogKind | None, FileKey(about='kind of fog; with `fog_visibility_km` alone it is `"moderate_advection"`')
    ] = None
    fog_visibility_m: Annotated[
        float | None,
        Quantity("km", ge=0.005, le=50, about="meteorological visibility in the fog; that of the kind if left out"),
        Slider("fog visibility", "km", 0.02, 50.0, log=True),
    ] = None
    rain_mm_h: Annotated[float, Quantity(ge=0, le=300, about="rain rate"), Slider("rain", "mm/h", 0.0, 100.0)] = 0.0
    snow_mm_h: Annotated[
        float, Quantity(ge=0, le=50, about="snow rate, of water"), Slider("snow", "mm/h", 0.0, 20.0)
    ] = 0.0
    snow: Annotated[Literal["dry", "wet"], FileKey(about="kind of flakes")] = "dry"

    def extinction_at_per_m(self, wavelength_m: float) -> float:
        """Total extinction coefficient at a laser wavelength."""
        return sum(medium.extinction_per_m for medium in self.media(wavelength_m))

    def media(self, wavelength_m: float) -> tuple[Medium, ...]:
        """The media present, at a laser wavelength."""
        media = (self._fog(wavelength_m), self._rain(wavelength_m), self._snow(wavelength_m))
        return tuple(medium for medium in media if medium is not None)

    def _fog(self, wavelength_m: float) -> Medium | None:
        if self.fog is None and self.fog_visibility_m is None:
            return None
        droplets = fog.TYPES[self.fog or DEFAULT_FOG]
        scale = fog.visibility_m(droplets) / self.fog_visibility_m if self.fog_visibility_m else 1.0
        extinction, backscatter = fog.scattering(droplets, wavelength_m)
        return Medium(name="fog", extinction_per_m=scale * extinction, backscatter_per_m_sr=scale * backscatter)

    def _rain(self, wavelength_m: float) -> Medium | None:
        if self.rain_mm_h <= 0.0:
            return None
        rate, wavelength = {"rate_mm_h": self.rain_mm_h}, {"wavelength_m": wavelength_m}
        return Medium(
            name="rain",
            extinction_per_m=precipitation.rain_extinction_per_m(**rate),
            backscatter_per_m_sr=precipitation.rain_backscatter_per_m_sr(**rate, **wavelength),
            sizes=precipitation.marshall_palmer(**rate),
            particle_m2_sr=functools.partial(precipitation.drop_backscatter_m2_sr, **wavelength),
            particle_gain=functools.partial(glory.gain, wavelength_m=wavelength_m),
        )

    def _snow(self, wavelength_m: float) -> Medium | None:
        if self.snow_mm_h <= 0.0:
            return None
        extinction = precipitation.snow_extinction_per_m(
            rate_mm_h=self.snow_mm_h, wavelength_m=wavelength_m, kind=self.snow
        )
        sizes = precipitation.gunn_marshall(rate_mm_h=self.snow_mm_h, kind=self.snow)
        # Sizes are distributed as by Gunn and Marshall; their number is scaled to the extinction by ITU-R.
        number = sizes.intercept_per_m4 * extinction / sizes.extinction_per_m
        return Medium(
            name="snow",
            extinction_per_m=extinction,
            backscatter_per_m_sr=extinction / precipitation.snow_lidar_ratio_sr(wavelength_m=wavelength_m),
            sizes=replace(sizes, intercept_per_m4=number),
            particle_m2_sr=functools.partial(precipitation.flake_backscatter_m2_sr, wavelength_m=wavelength_m),
        )
