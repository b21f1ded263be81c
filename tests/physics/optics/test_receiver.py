"""Spot and field of view: closed forms against other libraries, and against rays sent through the lens."""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import chain
from scipy.stats import ncx2

from lidarscene.errors import InputError
from lidarscene.physics.optics import receiver
from lidarscene.physics.reference import optics as reference_optics
from lidarscene.sensor.overlap import Alignment, Overlap, OverlapGeometry, Spot
from lidarscene.studies.ranging import plane
from lidarscene.studies.ranging.plane import Target

RAYS = 150_000
SIGMAS = 4.5  # of a share counted among RAYS: 7e-6 false alarms, times some 60 comparisons
COAXIAL = "optics.overlap.transmitter_offset_mm=[0, 0]"

# spot, off axis, field, blur: sharp and not, spot inside, across and beside the field, blur = field
CASES = (
    (1.0, 0.0, 2.0, 0.0),
    (1.0, 0.5, 1.0, 0.3),
    (2.0, 1.0, 1.0, 1.0),
    (0.5, 3.0, 1.0, 2.5),
    (0.1, 2.0, 1.0, 1.5),
    (0.05, 0.9, 1.0, 0.0),
    (1.0, 0.2, 1.0, 4.0),
    (0.3, 0.0, 1.0, 0.98),
)


def disc(rng, radius, count):
    r, angle = radius * np.sqrt(rng.random(count)), 2.0 * math.pi * rng.random(count)
    return r * np.cos(angle), r * np.sin(angle)


def spot(rng, profile, radius, count):
    if profile == "top_hat":
        return disc(rng, radius, count)
    return rng.normal(0.0, radius / 2.0, count), rng.normal(0.0, radius / 2.0, count)


def test_gaussian_in_circle_is_rice():
    """Reference: SciPy's non-central chi-square. Tolerance: the integral along the circle is good to rounding."""
    rng = np.random.default_rng(1)
    w, r, d = rng.uniform(0.3, 3.0, 200), rng.uniform(0.1, 3.0, 200), rng.uniform(0.0, 4.0, 200)
    share = receiver.gaussian_in_circle(spot_radius=w, circle_radius=r, distance=d)
    np.testing.assert_allclose(share, ncx2.cdf((2 * r / w) ** 2, 2, (2 * d / w) ** 2), atol=1e-12)
    axial = receiver.gaussian_in_circle(spot_radius=w, circle_radius=r, distance=np.zeros(200))
    np.testing.assert_allclose(axial, 1.0 - np.exp(-2.0 * (r / w) ** 2), atol=1e-12)


def test_narrow_spots_count_as_a_twentieth():
    """The limit that the function states: inside 1, outside 0, and one half on the edge."""
    share = receiver.gaussian_in_circle(
        spot_radius=np.zeros(3), circle_radius=np.ones(3), distance=np.array([0.85, 1.0, 1.15])
    )
    np.testing.assert_allclose(share, [1.0, 0.5, 0.0], atol=0.01)  # the blurred edge is curved


@pytest.mark.parametrize("radii", [(1.0, 1.0), (1.0, 0.3), (0.4, 2.0)])
def test_circles_overlap(radii):
    """Reference: area counted on a grid. Tolerance: the grid's, of 500 pixels along an edge."""
    grid = (np.arange(500) + 0.5) / 500 * 6 - 3
    x, y = np.meshgrid(grid, grid)
    for distance in (0.0, 0.5, 0.7, 1.0, 1.6, 1.99, 2.5):
        counted = np.count_nonzero((np.hypot(x, y) <= radii[0]) & (np.hypot(x - distance, y) <= radii[1]))
        area = receiver.circles_overlap(first_radius=radii[0], second_radius=radii[1], distance=np.array([distance]))
        assert area[0] == pytest.approx(counted * (6 / 500) ** 2, abs=5e-3)


@pytest.mark.parametrize("profile", ["gaussian", "top_hat"])
@pytest.mark.parametrize("case", CASES)
def test_spot_share(profile, case):
    """Reference: rays from the spot, each moved by its place in the lens. Adds 5e-4 for the 32 circles."""
    w, d, field, blur = case
    rng = np.random.default_rng(7)
    sx, sy = spot(rng, profile, w, RAYS)
    bx, by = disc(rng, blur, RAYS)
    counted = np.mean(np.hypot(d + sx + bx, sy + by) <= field)
    share = receiver.spot_share(
        profile=profile, spot_rad=np.array([w]), off_axis_rad=d, field_rad=field, blur_rad=blur
    )[0]
    assert abs(share - counted) < SIGMAS * math.sqrt(max(counted * (1 - counted), 1 / RAYS) / RAYS) + 5e-4


@pytest.mark.parametrize("off_axis", [0.0, 0.6, 1.4, 3.0])
def test_point_share(off_axis):
    """Reference: rays over the lens. The share of a whole spot is the mean of those of its points."""
    x, y = disc(np.random.default_rng(5), 0.8, RAYS)
    counted = np.mean(np.hypot(off_axis + x, y) <= 1.0)
    share = reference_optics.point_share(off_axis_rad=np.array([off_axis]), field_rad=1.0, blur_rad=0.8)[0]
    assert share == pytest.approx(counted, abs=SIGMAS * 0.5 / math.sqrt(RAYS))
    sx, sy = spot(np.random.default_rng(6), "gaussian", 0.7, RAYS)
    points = reference_optics.point_share(off_axis_rad=np.hypot(off_axis + sx, sy), field_rad=1.0, blur_rad=0.8)
    whole = receiver.spot_share(
        profile="gaussian", spot_rad=np.array([0.7]), off_axis_rad=off_axis, field_rad=1.0, blur_rad=0.8
    )[0]
    assert whole == pytest.approx(points.mean(), abs=SIGMAS * 0.5 / math.sqrt(RAYS))


@pytest.mark.parametrize("range_m", [0.8, 3.0, 10.0, 60.0])
def test_rays_through_a_thin_lens(range_m):
    """Reference: the lens itself in metres: spot on a wall, ray to a point of the lens, Snell's thin lens
    (slope less u / f), detector in the image plane of the focus. Tolerance: counting, and f against the image
    distance, which is 0.05 % longer in the reference.
    """
    f, r_pd, r_a, w0, half, offset, crossing, focus = 0.03, 1e-4, 0.012, 1e-3, 2e-3, 0.02, 30.0, 60.0
    rng = np.random.default_rng(11)
    w = math.hypot(w0, half * range_m)
    x, y = spot(rng, "gaussian", w, RAYS)
    x += offset * (1.0 - range_m / crossing)
    u, v = disc(rng, r_a, RAYS)
    image = 1.0 / (1.0 / f - 1.0 / focus)
    on_detector = [a + image * ((a - b) / range_m - a / f) for a, b in ((u, x), (v, y))]
    counted = np.mean(np.hypot(*on_detector) <= r_pd)
    overlap = Overlap.from_geometry(
        OverlapGeometry(
            spot=Spot(profile="gaussian", half_divergence_rad=half, exit_radius_m=w0),
            aperture_radius_m=r_a,
            field_rad=r_pd / f,
            alignment=Alignment(offset_m=offset, crossing_m=crossing, focus_m=focus),
        )
    )
    share = float(overlap.share(np.array([range_m]))[0])
    assert share == pytest.approx(counted, abs=SIGMAS * 0.5 / math.sqrt(RAYS), rel=2e-3)


def test_table_against_the_formula():
    """Tolerance: as `sensor.overlap._PLACES` states, wider where the axes cross and the share has a peak."""
    optics = {"half_divergence_rad": 1.5e-3, "exit_radius_m": 2e-3}
    ranges = np.geomspace(0.05, 1000.0, 301)
    for offset, crossing in ((0.0, math.inf), (0.02, math.inf), (0.02, 10.0)):
        overlap = Overlap.from_geometry(
            OverlapGeometry(
                spot=Spot(profile="gaussian", **optics),
                aperture_radius_m=0.015,
                field_rad=1.7e-3,
                alignment=Alignment(offset_m=offset, crossing_m=crossing),
            )
        )
        exact = receiver.spot_share(
            profile="gaussian",
            spot_rad=receiver.spot_radius_rad(range_m=ranges, **optics),
            off_axis_rad=receiver.parallax_rad(offset_m=offset, crossing_m=crossing, range_m=ranges),
            field_rad=1.7e-3,
            blur_rad=receiver.blur_radius_rad(aperture_radius_m=0.015, focus_m=math.inf, range_m=ranges),
        )
        np.testing.assert_allclose(overlap.share(ranges), exact, atol=1e-5)


def test_near_and_far():
    """Far away the sharp closed form; near by the detector takes phi^2 R^2 / r_A^2 of what is spread over it."""
    sensor = chain.sensor("livox-mid-40", COAXIAL)
    share = sensor.optics.overlap.share(np.array([1e6, 0.5]))
    field = 0.1 / 60.0
    assert share[0] == pytest.approx(1.0 - math.exp(-2.0 * (field / 2.2975e-3) ** 2), abs=1e-4)
    assert share[1] == pytest.approx((field * 0.5 / 0.015) ** 2, rel=1e-3)


def test_scattered_light():
    """Rationale: where the spot is outside of the field there is the scattered share alone, else it takes part of 1."""
    beam = Spot(profile="top_hat", half_divergence_rad=1.5e-3, exit_radius_m=0.0)
    lens = OverlapGeometry(spot=beam, aperture_radius_m=0.015, field_rad=1.7e-3)
    clean, hazy = (
        Overlap.from_geometry(replace(lens, alignment=Alignment(offset_m=0.06, scattered=share)))
        for share in (0.0, 0.02)
    )
    range_m = np.array([5.0, 20.0, 1e5])
    np.testing.assert_allclose(hazy.share(range_m), 0.02 + 0.98 * clean.share(range_m), rtol=1e-12)
    np.testing.assert_allclose(hazy.share(range_m)[[0, 2]], [0.02, 1.0], rtol=1e-3)


def test_the_echo_has_the_factor(mi):
    """The echo is that of a wall at 5 m, on the device and on numpy; without the table nothing of (5) changes."""
    described = chain.scene(chain.facing(range_m=5.0))
    with_overlap = chain.sensor("table1-apd", *chain.NARROW, COAXIAL)
    plain = chain.sensor("table1-apd", *chain.NARROW)
    overlapped_w, whole_w = (
        chain.run_stages(described, sensor).light.peak_power_w[4] for sensor in (with_overlap, plain)
    )
    share = with_overlap.optics.overlap.share(np.array([5.0]))[0]
    assert share < 0.5
    assert overlapped_w / whole_w == pytest.approx(share, rel=1e-5)
    by_hand = plane.echoes_of_plane(with_overlap, Target(), 5.0).peak_power_w[0]
    assert overlapped_w == pytest.approx(by_hand, rel=1e-5)


def test_focus_before_the_lens_is_refused():
    with pytest.raises(InputError, match=r"overlap.focus_at_m: must be >= .* \(ten focal lengths\), got"):
        chain.sensor("table1-apd", "optics.overlap.focus_at_m=0.1")


def test_axes_meet_and_the_lens_is_sharp_at_ranges_of_their_own():
    """Parallax and blur are zero there, o / R and r / R much nearer, and o / R_0 and r / R_f far away."""
    for angle, ranges in (
        (lambda r: receiver.parallax_rad(offset_m=0.05, crossing_m=20.0, range_m=r), (20.0, 1e-3, 1e9)),
        (lambda r: receiver.blur_radius_rad(aperture_radius_m=0.05, focus_m=20.0, range_m=r), (20.0, 1e-3, 1e9)),
    ):
        sharp, near, far = angle(np.array(ranges))
        assert sharp == pytest.approx(0.0, abs=1e-15)
        assert (near, far) == pytest.approx((50.0, 0.05 / 20.0), rel=1e-3)


def test_nothing_is_seen_nearer_than_the_blind_range():
    """A beam with straight edges that starts 5 mm wide, beside the lens: its inner edge, blurred, leaves the field."""
    optics = {"exit_radius_m": 0.005, "aperture_radius_m": 0.01, "field_rad": 3e-3}
    blind_m = float(reference_optics.blind_range_m(offset_m=np.array(0.05), edge_rad=1e-3, **optics))
    for range_m, visible in ((0.99 * blind_m, False), (1.01 * blind_m, True)):
        share = receiver.spot_share(
            profile="top_hat",
            spot_rad=np.array([0.005 / range_m + 1e-3]),
            off_axis_rad=0.05 / range_m,
            field_rad=3e-3,
            blur_rad=0.01 / range_m,
        )
        assert (share[0] > 0.0) == visible
    assert reference_optics.blind_range_m(offset_m=np.array(0.014), edge_rad=1e-3, **optics) == 0.0
