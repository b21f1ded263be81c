"""Rays over the footprint, several echoes and the air's light through the whole chain, against closed forms."""

import dataclasses
import math

import numpy as np
import pytest
from helpers import chain, trains
from helpers.run_seed import chosen
from helpers.table_1 import K_PD, P_RS, M, sigma_18

from lidarscene.detection.outcomes import Status
from lidarscene.light.beams import Beams
from lidarscene.light.echoes import Ambient, gather_background, hump_of, receive
from lidarscene.light.field_background import background_power_w, field_of_view
from lidarscene.light.hits import Hits
from lidarscene.maths.arrays import LookupTable
from lidarscene.physics.optics.sunlight import SUN_RADIUS_RAD
from lidarscene.physics.weather import soft_target
from lidarscene.rendering.simulator import Simulator
from lidarscene.scene.scene import Air, Interferer
from lidarscene.scene.weather import Weather

pytestmark = pytest.mark.usefixtures("mi")

BEAM = ["laser.divergence_mrad=3", "laser.exit_diameter_mm=10"]
COARSE = ["scanner.azimuth_step_deg=0.5", "scanner.elevation_step_deg=0.5"]
CENTRE = 4
"""The beam of `chain.NARROW` that is on the axis."""


def two_boards(apart_m):
    """A board that takes the left half of a beam along x at 50 m, and one as wide as all of it behind."""
    near = chain.facing(range_m=50.0, size_m=2.0)
    near = dataclasses.replace(
        near, name="near", pose=dataclasses.replace(near.pose, position_m=np.array([50.0, 1.0, 0.0]))
    )
    far = dataclasses.replace(chain.facing(range_m=50.0 + apart_m, size_m=8.0), name="far")
    return chain.scene(near, far)


def centre_points(cloud):
    return cloud.select(cloud.time_s == np.unique(cloud.time_s)[CENTRE])


@pytest.mark.parametrize("rays", chosen(3, [1, 2, 3, 7, 19, 64]))
@pytest.mark.parametrize("profile", ["gaussian", "top_hat"])
def test_a_plane_wider_than_the_spot_gives_the_lidar_equation(rays, profile):
    """(5) at any number of rays, over (18) with the sun of (8), all typed out. Tolerance 1e-4 of the issue: the
    farthest ray of a beam with 1.5 mrad of half angle has 2e-6 more range and tilt; single precision of the sum of 64
    terms is 1e-6. The rays' powers together: 1e-5.
    """
    sensor = chain.sensor("table1-apd", *chain.NARROW, *BEAM, f"laser.beam_profile='{profile}'")
    simulator = Simulator(chain.scene(chain.facing(range_m=80.0, size_m=20.0)), sensor, rays=rays)
    cloud = centre_points(simulator.render(seed=1))
    power = 0.98**2 * 0.7206 * 0.1 * 45.0 * np.pi * 0.025**2 / (np.pi * 80.0**2)
    assert cloud.snr[0] == pytest.approx(K_PD * M * power / sigma_18(P_RS), rel=1e-4)
    assert cloud.true_range_m[0] == pytest.approx(80.0, abs=1e-4)
    (part,) = simulator.light(seed=1).parts
    assert part.peak_power_w.reshape(-1, rays)[CENTRE].sum() == pytest.approx(power, rel=1e-5)


def test_one_ray_and_many_at_one_place_draw_the_same_noise():
    """All rays of a beam of no width are the axis: the waveform's road must give the closed form's points.

    Tolerance: 2e-4 m; the crossing is searched in single precision of places, 0.03 ps, at 400 ns.
    """
    sensor = chain.sensor("table1-apd", *COARSE, "tdc.stops=2")
    scene = chain.scene(chain.facing(range_m=60.0, size_m=40.0), chain.box(at=(20.0, 3.0, 0.0)))
    one_ray, four_rays = (Simulator(scene, sensor, rays=rays).render(seed=3) for rays in (1, 4))
    # An edge within rounding of the threshold may fall to the other side: fewer than one in a thousand.
    assert abs(len(one_ray) - len(four_rays)) <= 1 + len(one_ray) // 1000
    one_ray, four_rays = (cloud.select(cloud.status == Status.ECHO) for cloud in (one_ray, four_rays))
    _, alone_index, many_index = np.intersect1d(one_ray.time_s, four_rays.time_s, return_indices=True)
    np.testing.assert_array_equal(one_ray.body[alone_index], four_rays.body[many_index])
    assert np.quantile(np.abs(one_ray.range_m[alone_index] - four_rays.range_m[many_index]), 0.998) < 3e-4
    assert np.quantile(np.abs(one_ray.snr[alone_index] / four_rays.snr[many_index] - 1.0), 0.998) < 1e-4


@pytest.mark.parametrize("apart_m", chosen(1, [4.0, 12.0]))
def test_two_half_spots_are_two_returns_of_half_the_power(apart_m):
    """Each half of a symmetric pattern has half of the rays. Of the far one the range takes its square off.

    Tolerance: one ray of 200 at the edge, 1 %, and the tail of the other pulse: 4 m are 10 sigma of a 6 ns pulse.
    """
    sensor = chain.sensor("table1-apd", *chain.NARROW, *BEAM, "tdc.stops=2", "tdc.threshold_to_noise=8")
    cloud = centre_points(Simulator(two_boards(apart_m), sensor, rays=200).render(seed=2))
    whole = centre_points(Simulator(chain.scene(chain.facing(range_m=50.0, size_m=20.0)), sensor).render(seed=2))
    assert [cloud.body_names[body] for body in cloud.body] == ["near", "far"]
    assert cloud.return_number.tolist() == [1, 2]
    np.testing.assert_allclose(cloud.true_range_m, [50.0, 50.0 + apart_m], atol=1e-3)
    shares = cloud.snr / whole.snr[0]
    np.testing.assert_allclose(shares, [0.5, 0.5 * (50.0 / (50.0 + apart_m)) ** 2], atol=0.01)


def test_boards_within_the_pulse_are_one_return_between_them():
    """0.3 m apart is 0.8 sigma of the pulse: one peak, near the mean of the two by their power."""
    sensor = chain.sensor("table1-apd", *chain.NARROW, *BEAM, "tdc.stops=2", "tdc.threshold_to_noise=8")
    cloud = centre_points(Simulator(two_boards(0.3), sensor, rays=200).render(seed=2))
    assert len(cloud) == 1
    assert cloud.true_range_m[0] == pytest.approx(50.15, abs=0.005)


def test_fog_is_the_first_return_and_the_wall_the_last():
    """The bump of fog of 100 m trips Table 1's comparator in every pulse; the wall at 30 m is behind it.

    Reference for the wall: clear air's SNR times exp(-2 alpha R), and the fog's light before the wall, which over a
    pulse's length L = c FWHM / 2 is 1.0645 L beta against rho / pi, about half of it before the wall.
    """
    dense = Air(transmittance=0.98, weather=Weather(fog_visibility_m=100.0))
    plane = chain.facing(range_m=30.0, size_m=30.0)  # in the dark: fog would take light off the background too
    first = chain.sensor("table1-apd", *chain.NARROW, *BEAM)
    cloud = Simulator(chain.scene(plane, air=dense, klux=0.0), first).render(seed=1)
    assert (cloud.status == Status.WEATHER).all()
    assert {cloud.class_names[class_index] for class_index in cloud.class_id} == {"fog"}
    assert (cloud.body == -1).all()
    assert cloud.range_m.max() < 10.0
    # At a lower threshold the comparator would still be high from the fog when the wall's echo comes.
    last = chain.sensor("table1-apd", *chain.NARROW, *BEAM, "tdc.keep='last'", "tdc.threshold_to_noise=300")
    behind = centre_points(Simulator(chain.scene(plane, air=dense, klux=0.0), last).render(seed=1))
    clear = centre_points(Simulator(chain.scene(plane, klux=0.0), last).render(seed=1))
    assert behind.status[0] == Status.ECHO
    alpha = dense.extinction_at_per_m(905e-9)
    (fog,) = dense.weather.media(905e-9)
    fwhm_s = last.laser.pulse_fwhm_s
    before = soft_target.share_before_surface(range_m=30.0, surface_m=30.0, extinction_per_m=alpha, fwhm_s=fwhm_s)
    fog_share = 1.0645 * soft_target.pulse_length_m(fwhm_s=fwhm_s) * fog.backscatter_per_m_sr * before / (0.1 / np.pi)
    assert 0.01 < fog_share < 0.1
    # The peak of the sum is not where the wall is, and the air's course is a table: a part in a hundred.
    assert behind.snr[0] == pytest.approx(clear.snr[0] * np.exp(-2.0 * alpha * 30.0) * (1.0 + fog_share), rel=0.01)


def test_keep_and_dead_time_act_with_one_ray():
    """A false alarm before the echo: "first" with one stop reports it, "strongest" the echo."""
    noisy = ["tdc.threshold_to_noise=3"]
    scene = chain.scene(chain.facing(range_m=20.0, size_m=30.0))
    shares = {}
    for keep in ("first", "strongest"):
        sensor = chain.sensor("table1-apd", *COARSE, *noisy, f"tdc.keep='{keep}'")
        cloud = Simulator(scene, sensor).render(seed=2)
        on_wall = np.isfinite(cloud.true_range_m)
        shares[keep] = np.mean(cloud.status[on_wall] == Status.ECHO)
    assert shares["strongest"] > 0.999 > shares["first"]


BY_HAND = trains.sensor("table1-apd", "optics.efficiency_laser=0.5", "optics.efficiency_sun=0.4")
SUN = (0.6, 0.0, 0.8)
FIELD_RAD = float(BY_HAND.detector.radius_m / BY_HAND.optics.focal_length_m)
BEAMS = Beams(
    pulse=np.arange(2, dtype=np.uint32),
    origin_m=(0.0, 0.0, 0.0),
    direction=(np.ones(2), np.zeros(2), np.zeros(2)),
    aperture_m2=1e-3,
    background_aperture_m2=2e-3,
)
HITS = Hits(
    has_surface=np.array([True, False]),
    range_m=np.array([20.0, 1.0]),
    cos_incidence=np.array([0.9, 0.0]),
    backscatter_per_sr=np.array([0.05, 0.0]),
    sun_scatter_per_sr=np.array([0.2, 0.0]),
    reflectivity=np.array([0.3, 0.0]),
    transmittance=np.array([0.1, 0.0]),
    cos_sun=np.array([0.5, 0.0]),
    lit=np.array([True, False]),
    face=np.array([3, -1]),
    throughput=np.array([0.7, 0.8]),
    direction=tuple(np.full(2, component) for component in SUN),
)
AMBIENT = Ambient(
    sun_irradiance_w_m2=29.0,
    sky_irradiance_w_m2=5.0,
    transmittance=0.9,
    extinction_per_m=0.01,
    sun_direction=SUN,
    lamps_w_m2=2.0,
    interferers=(Interferer(rate_hz=1e4, irradiance_w_m2=1e-3, spread_db=6.0),),
)
AIR = 0.9 * math.exp(-0.2)
FIELD_SR = math.pi * FIELD_RAD**2
LIT = 29.0 * 0.2 + (0.3 + 0.1) * (5.0 + 2.0) / math.pi
"""Radiance of the surface: sun, and sky with lamps on both of its sides."""
DISC = 29.0 / (math.pi * SUN_RADIUS_RAD**2)


def test_echo_and_background_of_a_ray():
    """The pane dims the echo twice and the background once; a ray that ends at no surface sees the sky, through the air
    but for its length, and here the sun's disc fills the field of view.
    """
    light = receive(BEAMS, HITS, BY_HAND, AMBIENT)
    echo = 45.0 * 0.05 * 1e-3 / 20.0**2 * AIR**2 * 0.5 * 0.7**2
    np.testing.assert_allclose(light.peak_power_w, [echo, 0.0], rtol=1e-12)
    assert FIELD_RAD < SUN_RADIUS_RAD
    surface = LIT * 2e-3 * FIELD_SR * AIR * 0.4 * 0.7
    above = (5.0 / math.pi * 0.9 + DISC) * 2e-3 * FIELD_SR * 0.4 * 0.8
    np.testing.assert_allclose(light.background_power_w, [surface, above], rtol=1e-6)
    cloudy = receive(BEAMS, HITS, BY_HAND, dataclasses.replace(AMBIENT, sun_direction=None))
    sky = 5.0 / math.pi * 0.9 * 2e-3 * FIELD_SR * 0.4 * 0.8
    np.testing.assert_allclose(cloudy.background_power_w, [surface, sky], rtol=1e-12)
    (interferer,) = light.interference
    assert (interferer.rate_hz, interferer.spread_db) == (1e4, 6.0)
    assert interferer.peak_power_w == pytest.approx(1e-3 * 1e-3 * 0.5)
    assert light.white_w_m2 == 1.0
    scaled = trains.sensor("table1-apd", "optics.efficiency_laser=0.5", "intensity.kind='reflectivity'")
    assert receive(BEAMS, HITS, scaled, AMBIENT).white_w_m2 == pytest.approx(45.0 * 1e-3 * 0.5 / math.pi)


def test_background_of_a_field_of_view():
    """The mean over its rays, each as if all of the field saw what it sees; the disc is not dimmed once more."""
    background_w = background_power_w(BEAMS, [HITS], BY_HAND, AMBIENT, count=2)
    surface = LIT * 2e-3 * FIELD_SR * AIR * 0.4 * 0.7
    above = (5.0 / math.pi * 0.9 + DISC) * 2e-3 * FIELD_SR * 0.4 * 0.8
    np.testing.assert_allclose(background_w, [0.5 * (surface + above)], rtol=1e-6)
    rays = field_of_view(BY_HAND, 64)
    assert rays.slope == pytest.approx((FIELD_RAD, FIELD_RAD))
    # An even disc of radius 1 has the variance 1 / 4 on each axis, and nothing beyond its edge.
    assert np.hypot(*rays.points.values.T).max() < 1.05
    np.testing.assert_allclose(rays.points.values.T @ rays.points.values / 64, 0.25 * np.eye(2), atol=1e-12)


def test_the_background_of_all_paths_is_the_first_ones():
    ways = [receive(BEAMS, HITS, BY_HAND, AMBIENT) for _ in range(3)]
    first, *further = gather_background(ways)
    np.testing.assert_allclose(first.background_power_w, 3.0 * ways[0].background_power_w)
    assert [gathered is way for gathered, way in zip(further, ways[1:], strict=True)] == [True, True]


@pytest.mark.parametrize("near_m", [0.0, -2.0])
def test_the_hump_of_a_gaussian_course(near_m):
    """It is concave within one deviation of its middle, to a step of the grid on either side."""
    grid = np.linspace(near_m, 50.0, 2601)
    shape = LookupTable(np.exp(-0.5 * ((grid - 20.0) / 3.0) ** 2))
    step = grid[1] - grid[0]
    assert hump_of(shape, 50.0, near_m) == pytest.approx((17.0, 23.0), abs=1.5 * step)
    # Half of the bend that is left out at either end is 1e-7 of the peak.
    straight = LookupTable(np.linspace(0.0, 1.0, 101))
    assert hump_of(straight, 50.0, near_m) == (near_m, near_m)


def test_a_drop_is_rain_however_much_fog_is_between() -> None:
    """Haze of 20 km gives more even light than the drops that are not drawn, and trips nothing itself: every point is
    of a drop, and says so.
    """
    sensor = chain.sensor("table1-apd", *COARSE, *BEAM, "tdc.threshold_to_noise=60", "tdc.stops=3")

    def rain_points(rain_mm_h):
        air = Air(transmittance=1.0, weather=Weather(rain_mm_h=rain_mm_h, fog_visibility_m=20e3))
        scene = chain.scene(chain.facing(range_m=40.0, size_m=100.0), air=air, klux=0.0)
        simulator = Simulator(scene, sensor)
        assert simulator._stages.air.strongest == "fog"
        cloud = simulator.render(seed=5)
        return cloud.select(cloud.status == Status.WEATHER)

    assert len(rain_points(0.0)) == 0
    drops = rain_points(2.0)
    assert len(drops) > 1000
    # Haze and small drops together may trip once in a while; a first drop that was taken for haze would be most points.
    of_rain = np.array([drops.class_names[class_index] == "rain" for class_index in drops.class_id])
    assert of_rain.mean() > 0.99
