"""Weather in scene files: what each key does to the extinction, and to a board behind it."""

from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from helpers import chain, drops
from helpers.scene_text import scene_of

from lidarscene import Simulator
from lidarscene.physics.weather import fog, precipitation
from lidarscene.scene.scene import Air
from lidarscene.scene.weather import FogKind, Weather

BODY = '[[bodies]]\nname = "wall"\nprimitive = "plane"\nsize_m = [4, 4]\nposition_m = [9, 0, 0]\nmaterial = "brick"\n'
LASERS_M = (905e-9, 1550e-9)


def air_of(folder: Path, text: str) -> Air:
    return scene_of(folder, text + BODY).air


def test_kinds_of_fog_are_those_that_are_known() -> None:
    assert get_args(FogKind) == tuple(fog.TYPES)


def test_clear_without() -> None:
    assert Weather().media(905e-9) == ()
    assert Weather().extinction_at_per_m(905e-9) == 0.0


def test_file(tmp_path: Path) -> None:
    air = air_of(
        tmp_path, '[weather]\nfog = "radiation"\nfog_visibility_km = 0.1\nrain_mm_h = 10\nsnow_mm_h = 2\nsnow = "wet"\n'
    )
    assert air.weather == Weather(fog="radiation", fog_visibility_m=100.0, rain_mm_h=10.0, snow_mm_h=2.0, snow="wet")


@pytest.mark.parametrize("wavelength_m", LASERS_M)
def test_all_add_up_with_the_air(tmp_path: Path, wavelength_m: float) -> None:
    air = air_of(
        tmp_path, '[air]\nextinction_per_m = 1e-3\n[weather]\nfog = "chu_hogg"\nrain_mm_h = 5\nsnow_mm_h = 1\n'
    )
    expected = 1e-3 + fog.scattering(fog.TYPES["chu_hogg"], wavelength_m)[0]
    expected += precipitation.rain_extinction_per_m(rate_mm_h=5.0)
    expected += precipitation.snow_extinction_per_m(rate_mm_h=1.0, wavelength_m=wavelength_m, kind="dry")
    assert air.extinction_at_per_m(wavelength_m) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("kind", [None, "radiation"])
def test_visibility_scales_the_number_of_droplets(kind: str | None) -> None:
    """The extinction at 550 nm is 3.912 / V whatever the kind; the lidar ratio stays."""
    fog = Weather(fog=kind or "moderate_advection").media(905e-9)[0]
    (scaled,) = Weather(fog=kind, fog_visibility_m=50.0).media(905e-9)
    assert Weather(fog=kind, fog_visibility_m=50.0).extinction_at_per_m(550e-9) == pytest.approx(3.912 / 50)
    ratio = fog.extinction_per_m / fog.backscatter_per_m_sr
    assert scaled.extinction_per_m / scaled.backscatter_per_m_sr == pytest.approx(ratio)
    assert (scaled.name, scaled.sizes) == ("fog", None)


@pytest.mark.parametrize("wavelength_m", LASERS_M)
@pytest.mark.parametrize(
    "weather", [Weather(rain_mm_h=20.0), Weather(snow_mm_h=2.0), Weather(snow_mm_h=5.0, snow="wet")]
)
def test_particles_make_up_their_medium(weather: Weather, wavelength_m: float) -> None:
    """The sizes carry the extinction, and their echoes the backscatter, that the medium states.

    The sums are of 1e5 even steps.
    """
    (medium,) = weather.media(wavelength_m)
    assert medium.sizes is not None
    assert medium.particle_m2_sr is not None
    assert medium.sizes.extinction_per_m == pytest.approx(medium.extinction_per_m, rel=1e-12)
    d = np.linspace(0.0, 40.0 / medium.sizes.slope_per_m, 100_001)
    number = medium.sizes.intercept_per_m4 * np.exp(-medium.sizes.slope_per_m * d)
    beta = np.trapezoid(number * medium.particle_m2_sr(diameter_m=d), d)
    assert beta == pytest.approx(medium.backscatter_per_m_sr, rel=1e-6)


def test_a_board_in_rain_loses_both_ways(mi, monkeypatch: pytest.MonkeyPatch) -> None:
    """Measured through the whole chain, point by point: without sun an APD's SNR is proportional to the echo's power.

    The last crossing is the board's. 1e-3: the rain's own light within a pulse's length, some 3e-4 of the board's for
    the faces of its drops.
    """
    drops.as_bright_as_their_faces(monkeypatch)
    sensor = chain.sensor(
        "table1-apd",
        "scanner.azimuth_fov_deg=10 scanner.elevation_fov_deg=10 tdc.keep='last'",
        "tdc.threshold_to_noise=300",
    )
    alpha = precipitation.rain_extinction_per_m(rate_mm_h=30.0)
    clear, wet = (
        Simulator(chain.scene(chain.facing(range_m=60.0), klux=0.0, air=Air(weather=weather)), sensor).render(seed=1)
        for weather in (Weather(), Weather(rain_mm_h=30.0))
    )
    clear, wet = (cloud.select(cloud.status == 0) for cloud in (clear, wet))
    _, clear_index, wet_index = np.intersect1d(clear.time_s, wet.time_s, return_indices=True)
    assert len(clear_index) > 500
    expected = np.exp(-2 * alpha * clear.true_range_m[clear_index])
    np.testing.assert_allclose(wet.snr[wet_index] / clear.snr[clear_index], expected, rtol=1e-3)


@pytest.mark.parametrize("weather", [Weather(rain_mm_h=0.1), Weather(snow_mm_h=0.1)], ids=["rain", "snow"])
def test_drizzle_is_rain(weather: Weather) -> None:
    (medium,) = weather.media(905e-9)
    assert medium.extinction_per_m > 0.0
