"""Motion in the chain: against scenes rebuilt for single pulses, and against closed forms."""

import dataclasses

import numpy as np
import pytest
from helpers import chain
from helpers.mistakes import told
from helpers.traffic import SENSOR, direction, frozen, traffic

from lidarscene.maths.pose import Pose
from lidarscene.maths.trajectory import Riding, States, pose_at
from lidarscene.rendering.simulator import Simulator
from lidarscene.scan import Pattern

pytestmark = pytest.mark.usefixtures("mi")


def test_hits_are_those_of_a_scene_rebuilt_for_each_pulse() -> None:
    """Reference: for each of 32 pulses all that moves is put where it is then, in a scene of its own.

    Tolerances: single precision of positions 50 m from the origin is 4 um, and 0.02 mm is some of them in a row; beams
    that graze an edge may fall to either side, of which 32 have none.
    """
    scene, sensor = traffic(), chain.sensor("table1-apd", *SENSOR)
    simulator = Simulator(scene, sensor)
    cloud = simulator.render(seed=1)
    echoes = np.flatnonzero(cloud.status == 0)
    rng = np.random.default_rng(2)
    chosen = np.concatenate(
        [
            rng.choice(body_echoes, min(len(body_echoes), 8), replace=False)
            for body_echoes in (echoes[cloud.body[echoes] == b] for b in range(4))
        ]
    )
    assert len(chosen) == 32
    for point in chosen:
        time_s = float(cloud.time_s[point])
        beam = Pattern.create(
            azimuth_rad=cloud.azimuth_rad[[point]].astype(np.float64),
            elevation_rad=cloud.elevation_rad[[point]].astype(np.float64),
            time_s=np.zeros(1),
            channel=None,
            frame_s=1e-3,
            jitter_rad=None,
            encoder_rad=None,
        )
        low = dataclasses.replace(sensor.tdc, threshold_to_noise=0.01)
        alone = dataclasses.replace(sensor, scanner=beam, tdc=low, mounting=Pose())
        rebuilt = Simulator(frozen(scene, time_s), alone, pose=pose_at(simulator.motion, time_s)).render()
        assert rebuilt.body[0] == cloud.body[point]
        assert rebuilt.true_range_m[0] == pytest.approx(cloud.true_range_m[point], abs=2e-5)
        assert rebuilt.incidence_angle_rad[0] == pytest.approx(cloud.incidence_angle_rad[point], abs=1e-4)
        assert rebuilt.sun_angle_rad[0] == pytest.approx(cloud.sun_angle_rad[point], abs=1e-4)
        assert rebuilt.in_shadow[0] == cloud.in_shadow[point]


def test_radial_velocity_is_that_of_the_point_that_was_hit() -> None:
    """Reference: where the point of the surface is 0.1 ms before and after, against where the sensor is, along the
    beam. Tolerances: 1e-3 m/s for the difference (accelerations of 30 m/s2 are even in time and fall out, the rest is
    the single precision of the range over 30 m of arm at 1 rad/s) and for that of the velocities.
    """
    scene, step_s = traffic(), 1e-4
    simulator = Simulator(scene, chain.sensor("table1-apd", *SENSOR))
    cloud = simulator.render(seed=8)
    cloud = cloud.select(cloud.status == 0)
    times = cloud.time_s
    sensor_points = cloud.true_range_m[:, None] * direction(cloud)
    sensor = [simulator.motion.at(times + shift) for shift in (-step_s, 0.0, step_s)]
    points = to_parent_frame(sensor[1], sensor_points)
    beam = points - sensor[1].position_m
    beam /= np.linalg.norm(beam, axis=1, keepdims=True)
    for number, body in enumerate(scene.bodies):
        on_body = cloud.body == number
        assert on_body.sum() > 20
        moved = [points[on_body], points[on_body]]
        if body.motion is not None:
            states = [body.motion.at(times[on_body] + shift) for shift in (-step_s, 0.0, step_s)]
            within = np.einsum("nji,nj->ni", states[1].rotation, points[on_body] - states[1].position_m)
            moved = [to_parent_frame(states[0], within), to_parent_frame(states[2], within)]
        surface = (moved[1] - moved[0]) / (2.0 * step_s)
        origin = (sensor[2].position_m - sensor[0].position_m)[on_body] / (2.0 * step_s)
        expected = ((surface - origin) * beam[on_body]).sum(axis=1)
        np.testing.assert_allclose(cloud.radial_velocity_m_s[on_body], expected, atol=2e-3)


def to_parent_frame(states: States, points_m: np.ndarray) -> np.ndarray:
    """(n, 3) points of a frame at n moments, in its parent."""
    return states.position_m + np.einsum("nij,nj->ni", states.rotation, points_m)


def test_frames_follow_each_other() -> None:
    """Frame 3 begins where frame 2 ends, has noise of its own, and is the same whatever was rendered before."""
    scene, sensor = traffic(), chain.sensor("table1-apd", *SENSOR)
    simulator = Simulator(scene, sensor)
    frame_s = sensor.scanner.frame_s
    moved = dataclasses.replace(scene, bodies=scene.bodies[:3], ego=Riding(carrier=scene.ego, pose=Pose()))
    simulator = Simulator(moved, sensor)
    clouds = [simulator.render(seed=6, number=number) for number in (0, 1, 2, 1)]
    assert [float(cloud.metadata["frame_start_s"]) for cloud in clouds] == pytest.approx(
        [0.0, frame_s, 2 * frame_s, frame_s], rel=1e-12
    )
    assert all(cloud.time_s.min() >= 0.0 and cloud.time_s.max() < frame_s for cloud in clouds)
    np.testing.assert_array_equal(clouds[1].xyz_m, clouds[3].xyz_m)
    early = simulator.render(seed=6, begin_s=frame_s)  # the same places, other pulse numbers: other noise
    np.testing.assert_array_equal(np.unique(early.body), np.unique(clouds[1].body))
    assert len(np.intersect1d(early.range_m, clouds[1].range_m)) < 0.1 * len(early)


def test_a_motion_that_ends_too_early_is_told() -> None:
    simulator = Simulator(traffic(), chain.sensor("table1-apd", *SENSOR))
    with told("motion of body 'flying' | 0.9"):
        simulator.render(begin_s=0.9)
