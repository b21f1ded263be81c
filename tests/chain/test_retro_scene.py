"""The shipped retro.toml: calibrated intensity of boards and retro-reflectors, width and range of saturated echoes."""

import math
from pathlib import Path

import numpy as np
import pytest
from helpers import chain

from lidarscene import Simulator, load_scene
from lidarscene.physics.reference import electronics as reference_electronics

pytestmark = pytest.mark.usefixtures("mi")

SCENE = Path(__file__).parents[2] / "scenes" / "retro.toml"
CLIPS_A, RECOVERY_S = 10e-3, 5e-9
CLIPPING = [f"detector.saturation_ua={1e6 * CLIPS_A}", f"detector.recovery_ns={1e9 * RECOVERY_S}"]
FINE = ["scanner.azimuth_step_deg=0.1", "scanner.elevation_step_deg=0.1"]
CALIBRATED = "intensity.kind='reflectivity'"


@pytest.fixture(scope="module")
def compiled():
    """The scene and its world."""
    scene = load_scene(SCENE)
    return scene, Simulator(scene, chain.sensor("table1-apd")).world


@pytest.fixture(scope="module")
def clouds(compiled):
    """Clouds by name: the scene with both edges timed, with rising edges only, and with a SiPM."""
    (scene, world), rendered = compiled, {}
    options = {
        "both": ("table1-apd", *CLIPPING),
        "rising": ("table1-apd", *CLIPPING, "tdc.edges='rising'"),
        "sipm": ("table1-sipm", "detector.statistics='time_domain'"),
    }
    for name, (sensor, *keys) in options.items():
        equipped = chain.sensor(sensor, *FINE, CALIBRATED, *keys)
        rendered[name] = Simulator(scene, equipped, world=world).render(seed=2)
    return rendered


def points_on_body(cloud, name):
    """Echoes of a body, looked at squarely."""
    on_body = (cloud.body == cloud.body_names.index(name)) & (cloud.status == 0)
    return cloud.select(on_body & (cloud.incidence_angle_rad < math.radians(6.0)))


@pytest.mark.parametrize("name", ["both", "sipm"])
@pytest.mark.parametrize("range_m", [10, 20, 40])
def test_boards_read_their_reflectivity(clouds, name, range_m):
    """Rationale: what is calibrated. Reference: 100 rho, in clear air. Tolerance: four standard errors of a SiPM's
    noise (15 %), or half a whole number; its 80 % of the cells and more are read from the width.
    """
    for percent in (10, 50, 80):
        board = points_on_body(clouds[name], f"board_{percent}_{range_m}m")
        assert len(board) > 100
        error = 4.0 * float(board.intensity.std()) / math.sqrt(len(board))
        assert board.intensity.mean() == pytest.approx(percent, abs=0.5 + error + 0.03 * percent)


@pytest.mark.parametrize(("name", "r_a", "half_deg"), [("plate", 70.0, 0.41), ("vest", 330.0, 0.39)])
@pytest.mark.parametrize("range_m", [10, 20])
@pytest.mark.parametrize("sensor", ["both", "sipm"])
def test_retro_reflectors_read_above_white(clouds, sensor, name, r_a, half_deg, range_m):
    """Reference: R_A carried from (0.2, 4) to (0, 0) degrees by (T9), typed out; rho_hat = 0.3 + pi R_A; 101 to 255
    in proportion to its logarithm, 255 at 1000. Tolerance: noise of the width, 2 of the 155 steps in the mean.
    """
    peak = r_a * 2.0 ** ((0.2 / half_deg) ** 2) / math.cos(math.radians(4.0)) ** 3.61
    expected = min(100.0 + 155.0 * math.log(0.3 + math.pi * peak) / math.log(1000.0), 255.0)
    body = f"{name}_{range_m}m" + (".0" if name == "vest" else "")
    points = points_on_body(clouds[sensor], body)
    assert len(points) > 10
    assert points.intensity.mean() == pytest.approx(expected, abs=2.0)
    # The amplitude alone could not: it ends at S, or at half a cell below all.
    if sensor == "both":
        dark = points_on_body(clouds["rising"], body)
        assert dark.intensity.max() < 0.9 * expected


def test_width_and_range_of_a_saturated_plate(clouds):
    """The number plate at 10 m: its pulses last as (T45) says, it is too near by (T44) if only its height is known,
    and where it is if its width is. Reference: powers typed out from (5) and (T8), with incidence and range of each
    point; widths and ranges in the mean, to 1 % and 15 mm for the noise of a curved edge.
    """
    both_edges, rising = (points_on_body(clouds[name], "plate_10m") for name in ("both", "rising"))
    sensor = chain.sensor("table1-apd", *CLIPPING)
    optics = sensor.optics
    peak = 70.0 * 2.0 ** ((0.2 / 0.41) ** 2) / math.cos(math.radians(4.0)) ** 3.61
    cos, range_m = np.cos(both_edges.incidence_angle_rad), both_edges.true_range_m.astype(float)
    # R_A / cos^2 of incidence, cos of the surface that is seen, cos^3.61 of the entrance angle.
    per_sr = (0.3 / math.pi + peak * cos**3.61 / cos**2) * cos
    power = 45.0 * per_sr * optics.efficiency_laser * math.pi * 0.025**2 / range_m**2
    # The sun of 50 klux on its white face, and a sky of 20 % of it, by (T6) and (T7).
    light = 0.3 / math.pi * 0.5 * 29.4 * (np.cos(both_edges.sun_angle_rad) + 0.2)
    background = light * optics.aperture_m2 * math.pi * (sensor.detector.radius_m / 0.03) ** 2 * 0.7986
    point = sensor.working_point(background.astype(float))
    shape = {"signal": point.response.signal(power), "saturation": CLIPS_A, "fwhm_s": 6e-9}
    level = sensor.threshold(point)
    expected_s = reference_electronics.width_at_level_s(level=level, recovery_s=RECOVERY_S, **shape)
    assert both_edges.pulse_width_s.mean() == pytest.approx(expected_s.mean(), rel=0.01)
    assert abs((both_edges.range_m - both_edges.true_range_m).mean()) < 0.015
    bias_m = reference_electronics.walk_bias_m(threshold=level, **shape).mean()
    assert bias_m < -0.3
    assert (rising.range_m - rising.true_range_m).mean() == pytest.approx(bias_m, abs=0.015)
    assert (rising.pulse_width_s == 0.0).all()
    assert clouds["both"].pulse_width_s.min() > 0.0


def test_bloom_around_a_sign(compiled):
    """Rationale: what a halo does. Points in the sky beside the sign at 20 m lie at the sign's range, and none come
    without the halo, or with too few rays for one. How far they reach: where the halo's light of the sign's
    nearest part falls below the threshold.
    """
    halo = ["optics.halo.share=1e-3", "optics.halo.divergence_mrad=20"]
    # Beams in a box of sky around the sign's face, 3 degrees up: the disc is 1.7 degrees wide.
    box = chain.raster(20, 4, 0.1)
    scene, world = compiled

    def points_around_sign(rays, *keys):
        sensor = chain.sensor("table1-apd", *box, "laser.divergence_mrad=1", "tdc.threshold_to_noise=8", *keys)
        cloud = Simulator(scene, sensor, world=world, rays=rays).render(seed=1, coordinates="sensor")
        azimuth, elevation = np.degrees(cloud.azimuth_rad), np.degrees(cloud.elevation_rad)
        above = (elevation > 1.5) & (np.abs(azimuth + 10.0) < 4.0)
        return cloud.select(above)

    lone, plain, few_rays, many_rays = (
        points_around_sign(1),
        points_around_sign(16),
        points_around_sign(3, *halo),
        points_around_sign(32, *halo),
    )
    sign = many_rays.body_names.index("sign_20m.0")
    assert (many_rays.body == sign).all()
    # 20 mrad full: the last of 16 rays is 12 mrad off the axis. At 20 m the disc has 0.3 m and some.
    off_m = np.hypot(
        20.0 * np.sin(many_rays.azimuth_rad - math.radians(-10.0)), 20.0 * np.tan(many_rays.elevation_rad) - 1.08
    )
    bloom = off_m > 0.35
    assert bloom.sum() > 0.3 * len(plain)
    assert off_m.max() < 0.32 + 20.0 * 0.015
    assert np.abs(many_rays.range_m - 20.0)[bloom].max() < 0.5
    assert len(few_rays) <= len(plain) * 1.05
    assert len(many_rays) > 1.3 * len(plain) > 1.2 * len(lone)
