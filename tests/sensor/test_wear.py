"""Wear of a sensor: light, halo, drops, weak lasers and a knocked mounting, against closed forms."""

import math

import numpy as np
import pytest
from helpers import chain

from lidarscene import load_sensor
from lidarscene.outputs.light import AmbientImage
from lidarscene.rendering.simulator import Simulator
from lidarscene.scene.scene import Air
from lidarscene.scene.weather import Weather
from lidarscene.sensor.wear import Drops

pytestmark = pytest.mark.usefixtures("mi")

WALL = chain.facing(range_m=40.0, size_m=60.0)
DROPS = ["wear.drops_per_cm2=0.5", "wear.window_radius_mm=50"]


def points(name, *overrides, **options):
    return Simulator(chain.scene(WALL), chain.sensor(name, *overrides), **options).render(seed=1)


def test_film_and_grains_dim_the_echo_both_ways_and_the_sun_once():
    """0.8 x 0.9 one way. The scale of the maker does not know: a wall reads darker by the square of it. Single
    precision of a dozen products: 1e-5.
    """
    new, worn = (points("vlp-16", *wear) for wear in ([], ["wear.film_transmittance=0.8", "wear.covered_share=0.1"]))
    sensors = [
        load_sensor("vlp-16"),
        load_sensor("vlp-16", overrides=["wear.film_transmittance=0.8", "wear.covered_share=0.1"]),
    ]
    one_way = 0.8 * 0.9
    assert sensors[1].optics.efficiency_sun == pytest.approx(one_way * sensors[0].optics.efficiency_sun)
    assert sensors[1].calibrated_efficiency == pytest.approx(sensors[0].optics.efficiency_laser)
    assert sensors[1].optics.halo.share == pytest.approx(0.19)
    assert set(np.unique(new.wear)) == {0.0}
    np.testing.assert_allclose(worn.wear, 1.0 - one_way**2, rtol=1e-5)


def test_the_light_of_each_pulse_falls_by_its_label():
    """The power of each pulse behind drops and weak lasers, over that of a new sensor, is 1 less its label.

    Single precision places a beam to 1e-4 of a cell of the table, over which the share changes by up to 0.3.
    """
    wear = [*DROPS, "wear.laser_power=[[0, 0.3], [7, 0.0]]", "wear.film_transmittance=0.9"]
    sensor = chain.sensor("vlp-16", *wear)
    new, worn = (Simulator(chain.scene(WALL), lidar).light() for lidar in (chain.sensor("vlp-16"), sensor))
    pulse = np.arange(sensor.scanner.pulses, dtype=np.uint32)
    loss = sensor.wear.loss(sensor.scanner.direction(pulse), sensor.scanner.channel(pulse))
    lit = new.parts[0].peak_power_w > 0.0
    share = worn.parts[0].peak_power_w[lit] / new.parts[0].peak_power_w[lit]
    np.testing.assert_allclose(share, 1.0 - loss[lit], atol=1e-4)
    assert loss[sensor.scanner.channel(pulse) == 7] == pytest.approx(1.0)
    assert 0.01 < loss.std() < 0.5


def test_the_light_of_fog_falls_as_echoes_do():
    """No air light is brighter behind a worn window. Tolerance: as of the test above, at the edge of a drop."""
    sensor = chain.sensor("vlp-16", *DROPS, "wear.laser_power=[[0, 0.3], [7, 0.0]]", "wear.film_transmittance=0.9")
    scene = chain.scene(WALL, air=Air(weather=Weather(fog="radiation", fog_visibility_m=100.0)))
    new, worn = (Simulator(scene, lidar).light() for lidar in (chain.sensor("vlp-16"), sensor))
    pulse = np.arange(sensor.scanner.pulses, dtype=np.uint32)
    loss = sensor.wear.loss(sensor.scanner.direction(pulse), sensor.scanner.channel(pulse))
    np.testing.assert_allclose(worn.volume.scale / new.volume.scale, 1.0 - loss, atol=5e-4)


def test_background_falls_with_the_way_back_alone():
    """A dead laser leaves the sun's light as it is; drops take their share of it."""
    sensor = chain.sensor("vlp-16", *DROPS, "wear.laser_power=[[7, 0.0]]")
    new, worn = (Simulator(chain.scene(WALL), lidar).light() for lidar in (chain.sensor("vlp-16"), sensor))
    pulse = np.arange(sensor.scanner.pulses, dtype=np.uint32)
    _, inward = sensor.wear.shares(sensor.scanner.direction(pulse), sensor.scanner.channel(pulse))
    np.testing.assert_allclose(worn.background_power_w, new.background_power_w * inward, rtol=1e-4)


def test_drops_cover_their_share_of_the_window():
    """The mean clear share is 1 less the area of the drops on 1 cm2: 0.5 x pi 0.15^2 = 0.0353.

    Some 40 drops lie before the scanned band for each of eight seeds: 6 % in the mean, and four times that.
    """
    shares = []
    for seed in range(8):
        sensor = load_sensor("vlp-16", overrides=[*DROPS, "wear.drop_diameter_mm=3", f"wear.seed={seed}"])
        pulse = np.arange(0, sensor.scanner.pulses, 7, dtype=np.uint32)
        assert sensor.wear is not None
        shares.append(sensor.wear.shares(sensor.scanner.direction(pulse), sensor.scanner.channel(pulse))[1].mean())
    assert 1.0 - np.mean(shares) == pytest.approx(0.5 * math.pi * 0.15**2, rel=0.24)


def test_a_drop_before_the_lens_takes_what_it_covers():
    """One drop of 2 mm radius on the axis before a lens of 8 mm: (2 / 8)^2 of the echo, and all of a thin beam."""
    drops = Drops.tabulate(
        np.array([[1.0, 0.0, 0.0]]),
        axes_rad=(np.linspace(-0.5, 0.5, 401), np.linspace(-0.5, 0.5, 401)),
        window_m=0.05,
        drop_m=2e-3,
        lens_m=8e-3,
        exit_m=1e-3,
        offset_m=(0.0, 0.0),
    )
    outward, inward = drops.shares((np.ones(1), np.zeros(1), np.zeros(1)))
    assert outward == pytest.approx(0.0, abs=1e-6)
    assert inward == pytest.approx(1.0 - (2.0 / 8.0) ** 2, rel=1e-4)
    aside = drops.shares((np.full(1, math.cos(0.3)), np.full(1, math.sin(0.3)), np.zeros(1)))
    assert [float(share[0]) for share in aside] == [1.0, 1.0]


def test_a_knocked_sensor_reports_its_old_mounting():
    """A wall at 40 m across a sensor that stands 50 mrad to the left: what it calls straight ahead is at 40 / cos."""
    error = 0.05
    sensor = chain.sensor("table1-apd", *chain.NARROW, f"wear.mounting_error_mrad=[{1e3 * error}, 0, 0]")
    cloud = Simulator(chain.scene(WALL), sensor).render(seed=1)
    ahead = cloud.select((np.abs(cloud.azimuth_rad) < 1e-6) & (np.abs(cloud.elevation_rad) < 1e-6))
    assert ahead.true_range_m == pytest.approx(40.0 / math.cos(error), rel=1e-5)
    assert np.abs(ahead.xyz_m[:, 1:]).max() < 1e-5


def test_the_mask_of_every_pulse_is_in_the_ambient_file(tmp_path):
    """Also of pulses that lost their echo: the row of a dead laser is 1 throughout."""
    sensor = load_sensor("vlp-16", overrides=[*DROPS, "wear.laser_power=[[1, 0.0]]"])
    scene = chain.scene(WALL)
    mask, simulator = AmbientImage(), Simulator(scene, sensor)
    points = simulator.render(seed=1, ambient=mask)
    mask.save(tmp_path / "mask.npz", sensor)
    with np.load(tmp_path / "mask.npz") as file:
        dead = file["channel"] == 1
        assert (file["wear"][dead] == 1.0).all()
        assert file["wear"].shape == file["pulse"].shape
        rows = np.flatnonzero((file["wear_image"] == 1.0).mean(axis=1) > 0.9)
        assert len(rows) == 1
    assert not (points.channel[points.status == "echo"] == 1).any()  # its false alarms need no laser
