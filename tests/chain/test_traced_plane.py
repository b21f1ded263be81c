"""docs/validation.md, checks 1 and 5: the paper's plane through the ray tracer."""

import math

import numpy as np
import pytest
from helpers import chain
from helpers.run_seed import chosen

from lidarscene.kernel.world.mitsuba_world import build_world
from lidarscene.scene.scene import Sun
from lidarscene.studies.ranging import plane
from lidarscene.studies.ranging.plane import Target

pytestmark = pytest.mark.usefixtures("mi")

RANGES_M = np.geomspace(1.0, 500.0, 9)
THETAS_DEG = (0.0, 20.0, 45.0, 70.0, 85.0)
MIDDLE = 4  # of the 3 x 3 beams: exactly on the axis
CHECK_1 = 1e-5  # docs/validation.md, check 1; float32 leaves 1e-6

SENSORS = {
    "apd": chain.sensor("table1-apd", *chain.NARROW),
    "sipm": chain.sensor("table1-sipm", *chain.NARROW),
    "sipm_steady_state": chain.sensor("table1-sipm", *chain.NARROW, "detector.statistics='steady_state'"),
}


def sun_at(theta_deg, off_normal_deg=60.0):
    """A sun this far off the normal of a plane that faces the sensor at theta (its normal in the xy plane)."""
    return Sun(azimuth_rad=math.pi + math.radians(theta_deg), elevation_rad=math.radians(off_normal_deg))


@pytest.mark.parametrize("theta_deg", chosen(2, [*THETAS_DEG]))
def test_powers_and_snr_through_the_tracer(theta_deg):
    """Check 1: P_r, P_rs and SNR equal (5), (8), (19) and (27), 1 m to 500 m, 0 to 85 degrees; for each sensor."""
    target = Target(cos_incidence=math.cos(math.radians(theta_deg)), cos_sun=0.5)
    for range_m in RANGES_M:
        scene = chain.scene(chain.facing(range_m=range_m, theta_deg=theta_deg), sun=sun_at(theta_deg))
        world = build_world(scene, wavelength_m=905e-9, centre_m=np.zeros(3))
        for sensor in SENSORS.values():
            lanes = chain.run_stages(scene, sensor, world=world)
            expected = plane.echoes_of_plane(sensor, target, range_m)
            assert lanes.hits.has_surface[MIDDLE]
            assert lanes.hits.lit[MIDDLE]
            assert lanes.light.peak_power_w[MIDDLE] == pytest.approx(expected.peak_power_w[0], rel=CHECK_1)
            background = lanes.light.background_power_w[MIDDLE]
            assert background == pytest.approx(expected.background_power_w[0], rel=CHECK_1)
            snr = plane.snr(sensor, target, range_m)[0]
            assert lanes.detection.snr[MIDDLE] == pytest.approx(snr, rel=CHECK_1)


def peak_power(*, range_m=50.0, overrides=()):
    sensor = chain.sensor("table1-apd", *chain.NARROW, *overrides)
    return chain.run_stages(chain.scene(chain.facing(range_m=range_m)), sensor).light.peak_power_w[MIDDLE]


def test_energy_scales():
    """Check 5: exactly 1/4, 1/4, 1/2. Powers of two are exact in binary: one rounding (6e-8) is all that is left."""
    whole = peak_power()
    assert peak_power(overrides=["optics.aperture_radius_mm=12.5"]) / whole == pytest.approx(0.25, rel=2e-7)
    assert peak_power(range_m=100.0) / whole == pytest.approx(0.25, rel=2e-7)
    assert peak_power(overrides=["laser.peak_power_w=22.5"]) / whole == pytest.approx(0.5, rel=2e-7)


def test_shadow_and_sky():
    """A screen between plane and sun leaves the sky's rho E / pi; a beam into nothing sees E / pi."""
    sensor = chain.sensor("table1-apd", *chain.raster(120, 0.02, 60, 0.01))
    # The sun is behind the sensor and 60 degrees up; a screen over the plane's foot shades it.
    shade = chain.box(at=(48.0, 0.0, 2.0 * math.sqrt(3.0)), size_m=(1.0, 3.0, 1.0))
    lanes = chain.run_stages(chain.scene(chain.facing(range_m=50.0), shade, sky=0.2), sensor)
    middle, aside = 4, 3
    assert lanes.hits.has_surface[middle]
    assert not lanes.hits.lit[middle]
    assert not lanes.hits.has_surface[aside]
    optics = sensor.optics
    gathered = optics.aperture_m2 * math.pi * (1e-4 / 0.03) ** 2 * 0.7986
    sky = 0.2 * 29.4 / math.pi
    assert lanes.light.background_power_w[middle] == pytest.approx(0.1 * sky * gathered * 0.98, rel=1e-5)
    assert lanes.light.background_power_w[aside] == pytest.approx(sky * gathered * 0.98, rel=1e-5)


def test_sun_behind_the_surface_is_shadow():
    behind = Sun(azimuth_rad=0.0, elevation_rad=0.0)
    lanes = chain.run_stages(chain.scene(chain.facing(range_m=50.0), sun=behind), SENSORS["apd"])
    assert not lanes.hits.lit[MIDDLE]
    assert lanes.light.background_power_w[MIDDLE] == 0.0
    assert lanes.hits.cos_sun[MIDDLE] == pytest.approx(-1.0, abs=1e-6)
