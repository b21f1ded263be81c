"""Background beyond (8): the sun's disc, lamps, and the sky in the shade."""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import chain
from helpers.run_seed import chosen

from lidarscene.physics.optics import sunlight
from lidarscene.scene.scene import Air, Sun

ESUN, APERTURE_M2, ETA = 29.4, math.pi * 0.025**2, 0.7986
FIELD_RAD = 1e-4 / 0.03


def test_sun_disc_by_counting():
    """Reference: points of the field of view that lie on the disc. Tolerance: of a grid of 1500."""
    grid = FIELD_RAD * ((np.arange(1500) + 0.5) / 750 - 1)
    x, y = np.meshgrid(grid, grid)
    in_field = np.hypot(x, y) <= FIELD_RAD
    disc = math.radians(959.63 / 3600.0)
    for angle in (0.0, 1e-3, 2e-3, 5e-3, 7e-3, 9e-3):
        counted = np.count_nonzero(in_field & (np.hypot(x - angle, y) <= disc)) * (grid[1] - grid[0]) ** 2
        power = sunlight.sun_disc_power_w(
            sun_irradiance_w_m2=ESUN,
            sun_angle_rad=np.array([angle]),
            field_rad=FIELD_RAD,
            aperture_m2=APERTURE_M2,
            efficiency=ETA,
        )
        expected = ESUN / (math.pi * disc**2) * counted * APERTURE_M2 * ETA
        assert power[0] == pytest.approx(expected, rel=2e-3, abs=2e-6)


def test_the_whole_disc_is_its_irradiance():
    """A field of view wider than the sun collects E_sun A eta, whatever the sun's size."""
    power = sunlight.sun_disc_power_w(
        sun_irradiance_w_m2=ESUN, sun_angle_rad=np.array([1e-3]), field_rad=6e-3, aperture_m2=2.0, efficiency=0.5
    )
    assert power[0] == pytest.approx(ESUN, rel=1e-12)


def looking_at_the_sun(name, *overrides, bodies=(), off_deg=0.0, sky=0.1):
    """A narrow raster around x, the sun so far to its left."""
    sun = Sun(azimuth_rad=math.radians(off_deg), elevation_rad=0.0, illuminance_klux=100.0)
    behind = chain.ball(at=(-50.0, 0.0, 0.0))
    described = chain.scene(*(bodies or (behind,)), sun=sun, sky=sky, air=Air(transmittance=1.0))
    return chain.run_stages(described, chain.sensor(name, *chain.NARROW, *overrides))


@pytest.mark.parametrize("off_deg", [0.0, 0.2, 0.35, 0.5])
def test_beams_into_the_sun(mi, off_deg):
    """Sky and disc add up for the beam on the axis; 0.5 degrees off there is the sky alone."""
    power = looking_at_the_sun("table1-apd", off_deg=off_deg).light.background_power_w[4]
    disc = sunlight.sun_disc_power_w(
        sun_irradiance_w_m2=ESUN,
        sun_angle_rad=np.array([math.radians(off_deg)]),
        field_rad=FIELD_RAD,
        aperture_m2=APERTURE_M2,
        efficiency=ETA,
    )[0]
    sky = 0.1 * ESUN / math.pi * APERTURE_M2 * math.pi * FIELD_RAD**2 * ETA
    assert (disc > 0.0) == (off_deg < 0.45)
    assert power == pytest.approx(disc + sky, rel=2e-5)


@pytest.mark.parametrize(
    ("name", "options"),
    chosen(
        3,
        [
            ("table1-apd", []),
            ("table1-apd", ["detector.tail='mcintyre'"]),
            ("table1-sipm", []),
            ("table1-sipm", ["detector.counting='binomial'"]),
            ("table1-sipm", ["detector.statistics='published'"]),
            ("table1-sipm", ["detector.statistics='time_domain'"]),
        ],
    ),
)
def test_blinded_channels_stay_finite(mi, name, options):
    """A million times the usual background: no NaN in any lane, and an SNR of nothing."""
    detection = looking_at_the_sun(name, *options, off_deg=0.0).detection
    for values in (
        detection.snr,
        detection.detection_probability,
        detection.stops[0].range_m,
        detection.stops[0].amplitude,
    ):
        assert np.isfinite(values).all()
    assert (detection.snr == 0.0).all()


def test_lamps_light_surfaces_and_not_the_sky(mi):
    dark = chain.scene(chain.facing(range_m=30.0), klux=0.0, air=Air(transmittance=1.0))
    lamps = replace(dark, lamps_w_m2=2.0)
    sensor = chain.sensor("table1-apd", *chain.NARROW)
    lit = chain.run_stages(lamps, sensor).light.background_power_w
    expected = 0.1 * 2.0 / math.pi * APERTURE_M2 * math.pi * FIELD_RAD**2 * ETA
    np.testing.assert_allclose(lit, expected, rtol=1e-5)
    assert (chain.run_stages(dark, sensor).light.background_power_w == 0.0).all()
    ball_behind = replace(chain.scene(chain.ball(at=(-50.0, 0.0, 0.0)), klux=0.0), lamps_w_m2=2.0)
    assert (chain.run_stages(ball_behind, sensor).light.background_power_w == 0.0).all()
