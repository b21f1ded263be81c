"""Beams through panes and off mirrors: powers, ranges and places against closed forms and a ray tracer in numpy."""

import dataclasses
import math

import numpy as np
import pytest
from helpers import chain, launches, rounding
from helpers.panes import MATERIALS, MIDDLE, both_sides, mirror_material, pane

from lidarscene.materials.material_file import catalogue_material
from lidarscene.maths.pose import Pose
from lidarscene.maths.trajectory import Course
from lidarscene.rendering.simulator import Simulator
from lidarscene.scene.scene import Body, Sun

pytestmark = pytest.mark.usefixtures("mi")


def board_beside(distance_m, at_m=10.0, size_m=4.0) -> Body:
    """A board to the left of x = at_m that faces the x axis."""
    board = chain.facing(range_m=0.0, size_m=size_m)
    turned = Pose.from_degrees(position_m=(at_m, distance_m, 0.0), yaw_deg=90.0)
    return dataclasses.replace(
        board, name="beside", pose=Pose(position_m=turned.position_m, rotation=turned.rotation @ board.pose.rotation)
    )


def trace_bodies(*bodies, interactions=3, materials=MATERIALS, overrides=(), **scene):
    described = chain.scene(*bodies, materials=materials, **scene)
    return chain.run_stages(described, chain.sensor("table1-apd", *chain.NARROW, *overrides), interactions=interactions)


# Single precision through some twenty operations, and directions that turn by 1e-7.
CLOSE = {"rel": 2e-5}


@pytest.mark.parametrize(
    ("theta_deg", "moves"), [(0.0, False), (40.0, False), (60.0, False), (75.0, False), (60.0, True)]
)
def test_absorption_at_an_angle(theta_deg, moves):
    """Light goes d / cos(theta inside) through the pane: 50 passages to and fro between its faces, added up."""
    tinted = catalogue_material("tinted_glass")
    glass = pane(10.0, theta_deg, material=tinted.name, size_m=8.0)
    if moves:
        glass = dataclasses.replace(glass, motion=Course(start=glass.pose))
    lanes = trace_bodies(glass, chain.facing(range_m=50.0), materials=(tinted,))
    values, theta = tinted.at(905e-9), max(math.radians(theta_deg), 1e-4)
    inside = math.asin(math.sin(theta) / values["index_n"])
    r = 0.5 * (
        (math.sin(theta - inside) / math.sin(theta + inside)) ** 2
        + (math.tan(theta - inside) / math.tan(theta + inside)) ** 2
    )
    passage = math.exp(-4 * math.pi * values["index_k"] * 4e-3 / math.cos(inside) / 905e-9)
    series = sum((r * passage) ** (2 * k) for k in range(50))
    through, mirrored = (1 - r) ** 2 * passage * series, r + (1 - r) ** 2 * r * passage**2 * series
    assert lanes.ways[0].throughput[MIDDLE] == pytest.approx(through, **CLOSE)
    assert lanes.ways[1].throughput[MIDDLE] == pytest.approx(mirrored, **CLOSE)


@pytest.mark.parametrize("described_by", ["reflectivity", "index"])
def test_a_mirror_at_45_degrees(described_by):
    """The only way goes off the mirror: R there and R back, at the whole length; no second way without panes.

    R of a metal by the complex Fresnel equations.
    """
    n, k = 2.052, 8.257  # aluminium at 905 nm
    parameters = {"index_n": n, "index_k": k} if described_by == "index" else {}
    material = mirror_material(**parameters)
    lanes = trace_bodies(pane(10.0, -45.0, material="mirror"), board_beside(5.0), materials=(material,))
    cosine, index = math.cos(math.radians(45.0)), complex(n, k)
    inside = np.sqrt(1.0 - (1.0 - cosine**2) / index**2)
    s = abs((cosine - index * inside) / (cosine + index * inside)) ** 2
    p = abs((index * cosine - inside) / (index * cosine + inside)) ** 2
    r = 0.5 * (s + p) if described_by == "index" else 0.9
    direct = trace_bodies(chain.facing(range_m=15.0)).light.peak_power_w[MIDDLE]
    assert len(lanes.ways) == 1
    assert lanes.light.peak_power_w[MIDDLE] / direct == pytest.approx(r**2, rel=1e-4)
    assert lanes.hits.range_m[MIDDLE] == pytest.approx(15.0, rel=1e-6)
    assert lanes.hits.mirrored[MIDDLE]
    assert lanes.hits.interactions[MIDDLE] == 1


def test_a_beam_meets_no_more_than_its_interactions():
    """The beam ends at the pane after the last one, with neither echo nor light of sun and sky; with 0 at the first."""
    board = chain.facing(range_m=50.0)
    panes = [pane(10.0 + k) for k in range(3)]
    for allowed in range(5):
        lanes = trace_bodies(board, *panes, interactions=allowed, sky=0.2)
        ends_at = 50.0 if allowed >= 3 else 10.0 + allowed
        assert lanes.hits.has_surface[MIDDLE]
        assert lanes.hits.range_m[MIDDLE] == pytest.approx(ends_at, rel=1e-6)
        assert (lanes.light_of_ways[0].peak_power_w[MIDDLE] > 0.0) == (allowed >= 3)
        assert (lanes.light_of_ways[0].background_power_w[MIDDLE] > 0.0) == (allowed >= 3)
        assert len(lanes.ways) == (1 if allowed == 0 else 2)


def test_a_beam_that_passes_into_the_sky():
    """Nothing is found, and the sky is seen through the pane and in it: together as without."""
    lanes, free = (
        trace_bodies(pane(10.0, 20.0), sky=0.2),
        trace_bodies(chain.facing(range_m=5.0, at=(0, 50, 0)), sky=0.2),
    )
    assert not free.hits.has_surface[MIDDLE]
    assert not lanes.ways[0].has_surface[MIDDLE]
    assert not lanes.ways[1].has_surface[MIDDLE]
    assert lanes.hits.face[MIDDLE] == -1
    assert lanes.light.background_power_w[MIDDLE] == pytest.approx(free.light.background_power_w[MIDDLE], **CLOSE)


def test_background_is_what_is_behind_and_what_is_mirrored():
    """T times the board's radiance rho E / pi, R times the sky's E / pi."""
    board = chain.facing(range_m=50.0)
    dark = Sun(azimuth_rad=0.0, elevation_rad=math.radians(-60.0))
    lanes = trace_bodies(board, pane(10.0, 30.0), sun=dark, sky=0.3)
    free = trace_bodies(board, sun=dark, sky=0.3)
    r = both_sides(math.cos(math.radians(30.0)))
    ratio = lanes.light.background_power_w[MIDDLE] / free.light.background_power_w[MIDDLE]
    assert ratio == pytest.approx((1.0 - r) + r / 0.1, **CLOSE)


def roof(height_m, material="pane", size_m=20.0, name="roof"):
    """A level plane above the x axis."""
    body = chain.facing(range_m=0.0, size_m=size_m, material=material)
    return dataclasses.replace(body, name=name, pose=Pose(position_m=np.array([30.0, 0.0, height_m])))


@pytest.mark.parametrize("panes", [0, 1, 2])
def test_the_sun_comes_through_panes(panes):
    """A board in the sun under level panes: its radiance falls by T at the sun's zenith angle for each."""
    sun = Sun(azimuth_rad=math.pi, elevation_rad=math.radians(60.0))
    board = chain.facing(range_m=30.0)
    lanes = trace_bodies(board, *(roof(5.0 + k, name=f"roof {k}") for k in range(panes)), sun=sun)
    free = trace_bodies(board, sun=sun)
    t = 1.0 - both_sides(math.cos(math.radians(30.0)))
    assert lanes.hits.lit[MIDDLE]
    ratio = lanes.hits.sun_scatter_per_sr[MIDDLE] / free.hits.sun_scatter_per_sr[MIDDLE]
    assert ratio == pytest.approx(t**panes, **CLOSE)


def test_the_sun_does_not_come_through_boards_and_mirrors():
    sun = Sun(azimuth_rad=math.pi, elevation_rad=math.radians(60.0))
    for blocking in ("grey", "mirror"):
        for order in (("pane", blocking), (blocking, "pane")):
            roofs = [roof(5.0 + k, material, name=f"{k}") for k, material in enumerate(order)]
            lanes = trace_bodies(chain.facing(range_m=30.0), *roofs, sun=sun)
            assert not lanes.hits.lit[MIDDLE]
            assert lanes.hits.sun_scatter_per_sr[MIDDLE] == 0.0


@pytest.mark.parametrize("range_m", [5.0, 100.0, 250.0])
def test_panes_that_are_6_mm_apart_are_two(range_m):
    """Far from the origin as well: Mitsuba's own offset would jump over the second from 100 m on."""
    lanes = trace_bodies(pane(range_m, 10.0), pane(range_m + 0.006, 10.0), chain.facing(range_m=300.0))
    np.testing.assert_array_equal(lanes.hits.interactions, 2)


@pytest.mark.parametrize("theta_deg", [80.0, 87.0, 89.0])
def test_grazing_beams_meet_a_surface_once(theta_deg):
    """Tolerance: 0.3 mm of height over the mirror is the start's own; a second meeting would count one more."""
    for material in ("pane", "mirror"):
        lanes = trace_bodies(
            pane(20.0, theta_deg, material=material, size_m=10.0), chain.facing(range_m=50.0, size_m=200.0)
        )
        for way in lanes.ways:
            assert way.interactions[MIDDLE] == 1
            assert way.has_surface[MIDDLE]


class Reference:
    """A ray tracer of endless planes, in double precision: who is hit, how far, and what is left of the light."""

    def __init__(self, planes):
        self.planes = planes  # (point, normal, "pane" | "mirror" | "grey")

    def hit(self, start, way, skip):
        best = (math.inf, None)
        for number, (point, normal, _) in enumerate(self.planes):
            slope = way @ normal
            t = (point - start) @ normal / slope if slope else math.inf
            if number != skip and 0.0 < t < best[0]:
                best = (t, number)
        return best

    def follow(self, start, way, *, reflect_first, allowed):
        """(range, plane, one-way share, interactions, mirrored); plane None for the sky, share 0 for no such way."""
        length, share, count, mirrored, waiting, on_surface = 0.0, 1.0, 0, False, reflect_first, None
        while True:
            t, number = self.hit(start, way, on_surface)
            if number is None:
                return (1.0, None, share, count, mirrored) if not waiting else None
            _, normal, kind = self.planes[number]
            length += t
            if kind == "grey" or count == allowed:
                return (length, number, share, count, mirrored) if not waiting else None
            start, on_surface, count = start + t * way, number, count + 1
            cosine = abs(way @ normal)
            turn = kind == "mirror" or waiting
            if kind == "pane":
                share *= both_sides(cosine) if waiting else 1.0 - both_sides(cosine)
                waiting = False
            else:
                share *= 0.9
            if turn:
                way, mirrored = way - 2.0 * (way @ normal) * normal, True


def test_against_a_ray_tracer_of_planes():
    """Panes, mirrors and walls at random angles, 121 beams, both ways; the reference shares no code with ours.

    The reference's planes are endless, ours 250 m wide: ways of at most 60 m do not come to their edges. Tolerances:
    ranges in single precision over five segments, and cosines of 1e-6 on which Fresnel's equations depend steeply.
    """
    rng = np.random.default_rng(12)
    overrides = chain.raster(8, 8, 0.8)
    compared = {0: 0, 1: 0}
    for _ in range(6):
        bodies, planes = [], []
        kinds = ["pane", "mirror", "pane", "grey", "pane"]
        rng.shuffle(kinds)
        for number, (kind, x_m) in enumerate(zip(["grey", *kinds, "grey"], (-8, 6, 13, 20, 27, 34, 41), strict=True)):
            turn = Pose.from_degrees(
                position_m=(x_m, *rng.uniform(-1.0, 1.0, 2)),
                yaw_deg=rng.uniform(-25.0, 25.0),
                pitch_deg=rng.uniform(-15.0, 15.0),
            )
            board = chain.facing(range_m=0.0, size_m=250.0, material=kind)
            pose = Pose(position_m=turn.position_m, rotation=turn.rotation @ board.pose.rotation)
            bodies.append(dataclasses.replace(board, name=f"{number}", pose=pose))
            planes.append((turn.position_m, turn.rotation @ np.array([1.0, 0.0, 0.0]), kind))
        lanes = trace_bodies(*bodies, interactions=4, overrides=overrides)
        tracer = Reference(planes)
        for lane, way in enumerate(lanes.direction.astype(float)):
            for number, hits in enumerate(lanes.ways):
                expected = tracer.follow(np.zeros(3), way, reflect_first=number == 1, allowed=4)
                if expected is None:
                    assert hits.throughput[lane] == 0.0
                    continue
                length, plane, share, count, mirrored = expected
                if plane is None or length > 60.0:
                    continue
                compared[number] += 1
                assert hits.range_m[lane] == pytest.approx(length, abs=2e-4)
                assert hits.throughput[lane] == pytest.approx(share, rel=1e-4)
                assert (hits.interactions[lane], hits.mirrored[lane]) == (count, mirrored)
    assert compared[0] > 300
    assert compared[1] > 100


def test_a_moving_pane_and_a_moving_mirror():
    """What moves is met where it stands when the pulse leaves, and a mirror's motion lengthens the way.

    A mirror at 45 degrees that comes at 12 m/s: the way is its x plus the board's distance, so it shortens at 12 m/s;
    a board behind a pane that moves stands still; a board that recedes at 3 m/s behind a moving pane does so.
    """
    sensor = chain.sensor("table1-apd", *chain.NARROW)
    coming = (-12.0, 0.0, 0.0)
    for material, more_bodies, length_m, rate in (
        ("mirror", (board_beside(5.0, size_m=8.0),), 15.0, -12.0),
        ("pane", (chain.facing(range_m=30.0),), 30.0, 0.0),
    ):
        still = pane(10.0, -45.0, material=material)
        body = dataclasses.replace(still, motion=Course(start=still.pose, velocity_m_s=coming))
        described = chain.scene(body, *more_bodies, materials=MATERIALS)
        for begin_s in (0.0, 0.1):
            cloud = Simulator(described, sensor).render(seed=1, begin_s=begin_s)
            on_axis = cloud.select((np.abs(cloud.azimuth_rad) < 1e-6) & (np.abs(cloud.elevation_rad) < 1e-6))
            assert len(on_axis) == 1
            when = begin_s + on_axis.time_s[0]
            assert on_axis.true_range_m[0] == pytest.approx(length_m + rate * when, abs=1e-4)
            assert on_axis.radial_velocity_m_s[0] == pytest.approx(rate, abs=1e-5)
            assert on_axis.interactions[0] == 1
            assert on_axis.ghost[0] == (material == "mirror")
    receding = Course(start=chain.facing(range_m=30.0).pose, velocity_m_s=(3.0, 0.0, 0.0))
    board = dataclasses.replace(chain.facing(range_m=30.0), motion=receding)
    glass = dataclasses.replace(pane(10.0, -45.0), motion=Course(start=pane(10.0, -45.0).pose, velocity_m_s=coming))
    cloud = Simulator(chain.scene(board, glass, materials=MATERIALS), sensor).render(seed=1)
    np.testing.assert_allclose(cloud.radial_velocity_m_s, 3.0 * np.cos(cloud.azimuth_rad), atol=1e-4)


def test_moving_bodies_that_stand_still_are_still_ones():
    """Panes and mirrors in their own frames: the same ways."""
    bodies = [
        pane(10.0, 30.0),
        pane(14.0, -40.0, material="mirror", name="m"),
        board_beside(-6.0, at_m=14.0, size_m=40.0),
    ]
    standing = [dataclasses.replace(body, motion=Course(start=body.pose)) for body in bodies]
    bodies, standing = ([*group, chain.facing(range_m=30.0)] for group in (bodies, standing))
    sun = Sun(azimuth_rad=2.0, elevation_rad=math.radians(50.0))  # grazes none of them
    still, moved = trace_bodies(*bodies, sun=sun), trace_bodies(*standing, sun=sun)
    for still_way, moved_way in zip(still.ways, moved.ways, strict=True):
        np.testing.assert_allclose(still_way.range_m, moved_way.range_m, rtol=1e-5)
        np.testing.assert_allclose(still_way.throughput, moved_way.throughput, rtol=1e-5)
        np.testing.assert_array_equal(still_way.interactions, moved_way.interactions)
        np.testing.assert_array_equal(still_way.lit, moved_way.lit)
        np.testing.assert_allclose(still_way.sun_scatter_per_sr, moved_way.sun_scatter_per_sr, rtol=1e-5)


def test_points_are_where_the_sensor_places_them():
    """Points off a mirror lie along the beam, at the length of the way; the body is the one that was seen in it."""
    described = chain.scene(pane(10.0, -45.0, material="mirror"), board_beside(5.0), materials=MATERIALS)
    cloud = Simulator(described, chain.sensor("table1-apd", *chain.NARROW)).render(seed=2)
    assert len(cloud) == 9
    assert {cloud.body_names[body] for body in cloud.body} == {"beside"}
    np.testing.assert_allclose(np.linalg.norm(cloud.xyz_m, axis=1), cloud.range_m, rtol=1e-6)
    assert np.all(np.abs(cloud.xyz_m[:, 0] - 15.0) < 0.2)
    np.testing.assert_array_equal(cloud.ghost, 1)
    np.testing.assert_array_equal(cloud.interactions, 1)


def test_a_pane_gives_two_echoes_of_a_pulse():
    """What it mirrors at 15 m, a ghost, and what is behind it at 50 m, in its place: two returns of each pulse."""
    described = chain.scene(pane(10.0, -45.0), board_beside(5.0), chain.facing(range_m=50.0), materials=MATERIALS)
    sensor = chain.sensor("table1-apd", *chain.NARROW, "tdc.stops=2")
    cloud = Simulator(described, sensor).render(seed=2)
    assert len(cloud) == 18
    for number, name, ghost, range_m in ((1, "beside", 1, 15.0), (2, "plane", 0, 50.0)):
        echoes = cloud.select(cloud.return_number == number)
        assert {echoes.body_names[body] for body in echoes.body} == {name}
        np.testing.assert_array_equal(echoes.ghost, ghost)
        np.testing.assert_array_equal(echoes.interactions, 1)
        np.testing.assert_allclose(echoes.true_range_m, range_m, rtol=1e-3)
        np.testing.assert_allclose(echoes.xyz_m[:, 0], range_m, atol=0.3)


def kernels(simulator, **render):
    with launches.launched() as launched:
        cloud = simulator.render(**render)
    return cloud, launched


def test_without_panes_and_mirrors_nothing_changes():
    """The very kernels that run where a beam may go on nowhere, and the same bits."""
    described = chain.scene(chain.facing(range_m=20.0), chain.box(at=(12.0, 3.0, 0.0)), chain.ball(at=(9, -2, 0)))
    sensor = chain.sensor("table1-apd", "scanner.azimuth_step_deg=1", "scanner.elevation_step_deg=1")
    cloud_0, ran = kernels(Simulator(described, sensor, interactions=0), seed=1)
    cloud_3, ran_too = kernels(Simulator(described, sensor, interactions=3), seed=1)
    assert [k["hash"] for k in ran] == [k["hash"] for k in ran_too]
    np.testing.assert_array_equal(cloud_0.xyz_m, cloud_3.xyz_m)
    np.testing.assert_array_equal(cloud_3.interactions, 0)


def test_a_single_pulse_that_meets_glass_is_told_once():
    """It is traced on two lanes. A pane that a single beam meets."""
    described = chain.scene(pane(10.0, 20.0, size_m=0.15), chain.facing(range_m=30.0, size_m=60.0), materials=MATERIALS)
    sensor = chain.sensor("table1-apd", "scanner.azimuth_step_deg=1", "scanner.elevation_step_deg=1")
    simulator, outputs = Simulator(described, sensor), []
    for chunk in (2**20, 100):
        batches = []
        cloud = simulator.render(
            seed=1,
            chunk=chunk,
            pose=Pose.from_degrees(pitch_deg=0.5),
            points=lambda *all_of, batches=batches: batches.append(all_of),
        )
        pulse = np.concatenate([columns["pulse"] for _, columns in batches])
        assert sum(cloud.interactions > 0) == 1
        assert len(np.unique(pulse)) == len(pulse) > 1000
        outputs.append((np.sort(pulse), np.concatenate([points for points, _ in batches]), cloud.xyz_m))
    for whole, parts in zip(*outputs, strict=True):
        np.testing.assert_array_equal(whole, parts)


def test_what_meets_glass_for_the_first_time_is_compiled_then_and_only_then():
    """What ARCHITECTURE.md says: a frame that glass has left needs nothing new; one that it has come into does."""
    aside = dataclasses.replace(
        pane(10.0, 6.0), motion=Course(start=pane(10.0, 6.0).pose, velocity_m_s=(0.0, 100.0, 0.0))
    )
    described = chain.scene(aside, chain.facing(range_m=30.0, size_m=60.0), materials=MATERIALS)
    sensor = chain.sensor("table1-apd", "scanner.azimuth_step_deg=1", "scanner.elevation_step_deg=1")
    leaving, coming = Simulator(described, sensor), Simulator(described, sensor, interactions=2)
    cloud, before = kernels(leaving, seed=1)
    assert set(cloud.interactions) == {0, 1}
    cloud, later = kernels(leaving, seed=2, begin_s=2.0)
    assert set(cloud.interactions) == {0}
    launches.assert_none_is_new(later, before)
    _, before = kernels(coming, seed=1, begin_s=2.0)
    _, first = kernels(coming, seed=1)
    _, later = kernels(coming, seed=2)
    assert max(kernel["operation_count"] for kernel in launches.new(first, before)) > 3000
    launches.assert_none_is_new(later, [*before, *first])


def test_a_world_that_nothing_sees_through_is_the_first_surface_of_one_that_can_be():
    """Rationale: with no interactions it makes no difference whether panes are traced apart. Reference: each other."""
    described = chain.scene(
        pane(10.0, 20.0),
        pane(14.0, 20.0, material="mirror", name="m"),
        chain.facing(range_m=30.0, size_m=60.0),
        materials=MATERIALS,
        sky=0.2,
    )
    sensor = chain.sensor("table1-apd", "scanner.azimuth_step_deg=1", "scanner.elevation_step_deg=1")
    apart = Simulator(described, sensor).world
    assert apart.panes is not None
    plain = Simulator(described, sensor, interactions=0)
    assert plain.world.panes is None
    assert plain.world.speculars is None
    separate = Simulator(described, sensor, interactions=0, world=apart)
    first, second = plain.render(seed=1), separate.render(seed=1)
    for name in ("xyz_m", "ambient", "intensity", "body", "in_shadow"):
        rounding.assert_same(getattr(first, name), getattr(second, name))
    assert 0 < len(first) < sensor.scanner.pulses
