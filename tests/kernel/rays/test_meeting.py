"""Interactions with plain meshes, which are put together from a table of normals, against Mitsuba's own."""

import dataclasses

import numpy as np
import pytest
from helpers import chain
from helpers.panes import MATERIALS, pane

from lidarscene.formats.cloud_columns import attributes
from lidarscene.kernel.device import transfer
from lidarscene.kernel.rays.gaps import Draws
from lidarscene.kernel.rays.meeting import Moment
from lidarscene.kernel.world.mitsuba_world import build_world
from lidarscene.maths.pose import Pose
from lidarscene.maths.trajectory import Course
from lidarscene.rendering.simulator import Simulator
from lidarscene.rendering.stages import Stages

pytestmark = pytest.mark.usefixtures("mi")

WAVELENGTH_M = 905e-9


def crossing():
    """Boxes at odd angles before a wall, a pane, a mirror, and two boxes of one shape that move."""
    still = [chain.box(at=(12.0 + 3.0 * i, 4.0 * i - 6.0, 0.2 * i), yaw_deg=17.0 * i) for i in range(4)]
    starts = [Pose.from_degrees(position_m=(9.0, 5.0 * i - 2.0, 0.0), yaw_deg=40.0 * i) for i in range(2)]
    moving = [
        dataclasses.replace(still[1], name=f"moving {i}", motion=Course(start=start, speed_m_s=9.0))
        for i, start in enumerate(starts)
    ]
    bodies = [*still, *moving, pane(8.0, 10.0, size_m=3.0), pane(30.0, 40.0, material="mirror", name="mirror")]
    return chain.scene(*bodies, chain.facing(range_m=50.0, size_m=90.0, theta_deg=12.0), materials=MATERIALS)


def moment_and_rays():
    """The still boxes of `crossing`, and 20,000 rays of all directions, of which some thousand meet one."""
    import mitsuba as mi

    world = build_world(dataclasses.replace(crossing(), bodies=crossing().bodies[:4]), wavelength_m=WAVELENGTH_M)
    assert world.face_normal is not None
    rng = np.random.default_rng(4)
    directions = rng.normal(size=(3, 20_000)) * [[1.0], [0.3], [0.05]]
    directions /= np.linalg.norm(directions, axis=0)
    ray = mi.Ray3f(mi.Point3f(0.0, 0.0, 0.1), mi.Vector3f(*directions.astype(np.float32)))
    zero = transfer.opaque_uint32(0)
    draws = Draws(seed=zero, pulse=zero, ray=zero)
    return Moment(world=world, sun=(0.0, 0.0, 1.0), coherent=False, draws=draws), ray


def test_surface_is_mitsubas():
    """Tolerances: single precision of a few dozen metres, some ten of them in a row; directions some ten of 1."""
    moment, ray = moment_and_rays()
    without = dataclasses.replace(moment, world=dataclasses.replace(moment.world, face_normal=None))
    meetings = [moment.meet(ray), without.meet(ray)]
    valid = np.array(meetings[0].valid)
    assert 1000 < valid.sum() < len(valid)
    ours, mitsubas = (meeting.surface for meeting in meetings)
    for name, tolerance in (("p", 2e-5), ("n", 2e-6)):
        difference = np.array(getattr(ours, name)) - np.array(getattr(mitsubas, name))
        assert np.abs(difference[:, valid]).max() < tolerance, name
    np.testing.assert_array_equal(np.array(ours.prim_index)[valid], np.array(mitsubas.prim_index)[valid])
    # Where the frame's other axes point has no meaning: no material of ours knows a direction in the surface.
    assert np.array(ours.wi)[2, valid] == pytest.approx(np.array(mitsubas.wi)[2, valid], abs=2e-5)
    assert np.array(ours.sh_frame.n)[:, valid] == pytest.approx(np.array(mitsubas.sh_frame.n)[:, valid], abs=2e-6)


def test_survey_is_believed():
    """A hit is the same from its range and face, bit by bit; without a face it is asked for."""
    import mitsuba as mi

    moment, ray = moment_and_rays()
    asked = moment.meet(ray)
    valid, number = np.array(asked.valid), np.arange(20_000)
    known = valid & (number % 3 > 0)
    face = mi.Int32(np.where(known, np.array(asked.row).astype(np.int32), -1))
    told, off = (moment.meet(ray, True, (asked.t + extra_m, face)) for extra_m in (0.0, 0.25))
    for name in ("prim_index", "p", "n", "wi"):
        ours, theirs = (np.array(getattr(meeting.surface, name))[..., valid] for meeting in (told, asked))
        np.testing.assert_array_equal(ours, theirs, name)
    np.testing.assert_array_equal(np.array(told.valid), valid)
    np.testing.assert_array_equal(np.array(told.row)[valid], np.array(asked.row)[valid])
    np.testing.assert_array_equal(np.array(off.t)[valid], np.array(asked.t + mi.Float(0.25 * known))[valid])


def test_frame_after_a_survey_is_that_of_rays_that_ask_again(monkeypatch):
    """No direction here meets an edge, where a ray may meet either of two faces, by the rays beside it."""
    still = [body for body in crossing().bodies if body.motion is None]
    sensor = chain.sensor("table1-apd", "scanner.azimuth_step_deg=0.5", "scanner.elevation_step_deg=0.5")
    first = Simulator(chain.scene(*still, materials=MATERIALS), sensor)
    cloud = first.render(seed=3)
    assert (cloud.interactions > 0).sum() > 100
    monkeypatch.setattr(Stages, "known_hits", lambda *_: ())
    other = Simulator(first.scene, sensor, world=first.world).render(seed=3)
    for name in attributes(truth=True, vectors=False):
        np.testing.assert_array_equal(getattr(cloud, name), getattr(other, name), name)


def test_frame_is_the_same():
    """The scene has panes, mirrors and what moves. Powers differ by rounding: 1e-4 of them; a shadow's edge may fall to
    either side of one of some hundred points on one, of which there is none here.
    """
    sensor = chain.sensor("table1-apd", "scanner.azimuth_step_deg=0.5", "scanner.elevation_step_deg=0.5")
    first = Simulator(crossing(), sensor)
    second = Simulator(first.scene, sensor, world=dataclasses.replace(first.world, face_normal=None))
    ours, mitsubas = first.render(seed=3), second.render(seed=3)
    assert len(ours) > 2000
    assert ours.interactions.any()
    assert {"moving 0", "moving 1"} <= {ours.body_names[i] for i in np.unique(ours.body)}
    np.testing.assert_array_equal(ours.body, mitsubas.body)
    np.testing.assert_array_equal(ours.in_shadow, mitsubas.in_shadow)
    np.testing.assert_allclose(ours.true_range_m, mitsubas.true_range_m, rtol=1e-6)
    np.testing.assert_allclose(ours.snr, mitsubas.snr, rtol=1e-4)
    np.testing.assert_allclose(ours.incidence_angle_rad, mitsubas.incidence_angle_rad, atol=1e-3)


def test_spheres_are_left_to_mitsuba():
    world = build_world(chain.scene(chain.ball(at=(9.0, 0.0, 0.0))), wavelength_m=WAVELENGTH_M)
    assert world.face_normal is None
