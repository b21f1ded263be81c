"""Weather as the simulation sees it: fog, rain and snow in the air. Plain data; what they do is in `physics`."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace

from ..maths.arrays import Lanes
from ..physics.weather import fog, precipitation
from ..physics.weather.precipitation import Sizes

DEFAULT_FOG = "moderate_advection"
"""Kind of a fog of which only the visibility is known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Medium:
    """Fog, rain or snow at one wavelength.

    name                    class of the points that it causes: "fog", "rain" or "snow"
    extinction_per_m        alpha, one way
    backscatter_per_m_sr    beta
    sizes                   of its drops or flakes; None for fog, whose droplets are too many to be told apart
    particle_m2_sr          what one of diameter_m=... sends straight back, W/sr for each W/m2 on it
    """

    name: str
    extinction_per_m: float
    backscatter_per_m_sr: float
    sizes: Sizes | None = None
    particle_m2_sr: Callable[..., Lanes] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Weather:
    """What falls or floats, the same everywhere; clear without.

    fog               name in `physics.weather.fog.TYPES`, with the density published for it; None for none, or for the
                      default kind where a visibility is given
    fog_visibility_m  meteorological visibility, to which the number of droplets is scaled
    rain_mm_h         rain rate
    snow_mm_h         snow rate, of water
    snow              "dry" or "wet"
    """

    fog: str | None = None
    fog_visibility_m: float | None = None
    rain_mm_h: float = 0.0
    snow_mm_h: float = 0.0
    snow: str = "dry"

    def extinction_at_per_m(self, wavelength_m: float) -> float:
        """Extinction coefficient at a laser wavelength, of all together."""
        return sum(medium.extinction_per_m for medium in self.media(wavelength_m))

    def media(self, wavelength_m: float) -> tuple[Medium, ...]:
        """What there is, at a laser wavelength."""
        found = (self._fog(wavelength_m), self._rain(wavelength_m), self._snow(wavelength_m))
        return tuple(medium for medium in found if medium is not None)

    def _fog(self, wavelength_m: float) -> Medium | None:
        if self.fog is None and self.fog_visibility_m is None:
            return None
        droplets = fog.TYPES[self.fog or DEFAULT_FOG]
        scale = fog.visibility_m(droplets) / self.fog_visibility_m if self.fog_visibility_m else 1.0
        extinction, backscatter = fog.scattering(droplets, wavelength_m)
        return Medium(
            name="fog", extinction_per_m=scale * extinction, backscatter_per_m_sr=scale * backscatter
        )

    def _rain(self, wavelength_m: float) -> Medium | None:
        if self.rain_mm_h <= 0.0:
            return None
        rate, at = {"rate_mm_h": self.rain_mm_h}, {"wavelength_m": wavelength_m}
        return Medium(
            name="rain",
            extinction_per_m=precipitation.rain_extinction_per_m(**rate),
            backscatter_per_m_sr=precipitation.rain_backscatter_per_m_sr(**rate, **at),
            sizes=precipitation.marshall_palmer(**rate),
            particle_m2_sr=functools.partial(precipitation.drop_backscatter_m2_sr, **at),
        )

    def _snow(self, wavelength_m: float) -> Medium | None:
        if self.snow_mm_h <= 0.0:
            return None
        extinction = precipitation.snow_extinction_per_m(
            rate_mm_h=self.snow_mm_h, wavelength_m=wavelength_m, kind=self.snow
        )
        sizes = precipitation.gunn_marshall(rate_mm_h=self.snow_mm_h, kind=self.snow)
        # The widths of the flakes are Gunn and Marshall's, their number is what the extinction asks for.
        number = sizes.intercept_per_m4 * extinction / sizes.extinction_per_m
        return Medium(
            name="snow",
            extinction_per_m=extinction,
            backscatter_per_m_sr=extinction / precipitation.snow_lidar_ratio_sr(wavelength_m=wavelength_m),
            sizes=replace(sizes, intercept_per_m4=number),
            particle_m2_sr=functools.partial(
                precipitation.flake_backscatter_m2_sr, wavelength_m=wavelength_m
            ),
        )
