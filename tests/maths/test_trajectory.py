"""Trajectories: closed forms, finite differences, and SciPy's rotations."""

import itertools
import math
from dataclasses import fields, replace

import numpy as np
import pytest
from helpers.mistakes import told
from helpers.motions import BEND, MOTIONS, SPLINE, START, TIMES, WAY, pose
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from lidarscene.maths.pose import Pose
from lidarscene.maths.trajectory import (
    Course,
    GoingOn,
    HeldAtEnds,
    Repeated,
    Riding,
    Spline,
    States,
    _exp,
    _log,
    motion_in_frame,
    pose_at,
    states_of,
)

STEP_S = 1e-4


def angular_velocity(rotation: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """(n, 3) angular velocity w of R' = [w] R."""
    skew = rate @ rotation.transpose(0, 2, 1)
    return np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)


@pytest.mark.parametrize("name", MOTIONS)
def test_velocities_are_the_derivatives_of_the_pose(name: str) -> None:
    """Central differences over 2e-4 s. Tolerance: third derivatives are below 1e4 m/s3, so h^2/6 of them is 2e-5;
    rounding is 1e-15 of 20 m over 1e-4 s. Times stay clear of the poses, where the second derivative may jump.
    """
    motion = MOTIONS[name]
    time_s = np.setdiff1d(np.linspace(0.01, 2.49, 173), TIMES)
    before, middle, after = (motion.at(time_s + shift) for shift in (-STEP_S, 0.0, STEP_S))
    velocity = (after.position_m - before.position_m) / (2 * STEP_S)
    np.testing.assert_allclose(middle.velocity_m_s, velocity, atol=2e-5)
    rate = (after.rotation - before.rotation) / (2 * STEP_S)
    np.testing.assert_allclose(middle.turning_rad_s, angular_velocity(middle.rotation, rate), atol=2e-5)
    np.testing.assert_allclose(
        middle.rotation @ middle.rotation.transpose(0, 2, 1), np.eye(3)[None] + 0 * middle.rotation, atol=1e-13
    )


def test_a_course_is_an_arc() -> None:
    """Radius v/w about a centre to the left, at constant speed; to rounding. The added velocity comes on top."""
    arc = Course(start=START, speed_m_s=12.0, yaw_rate_rad_s=0.7)
    time_s = np.linspace(-3.0, 5.0, 41)
    states = arc.at(time_s)
    centre = START.apply(np.array([[0.0, 12.0 / 0.7, 0.0]]))
    np.testing.assert_allclose(np.linalg.norm(states.position_m - centre, axis=1), 12.0 / 0.7, rtol=1e-14)
    np.testing.assert_allclose(states.velocity_m_s, 12.0 * states.rotation[:, :, 0], atol=1e-13)
    expected = Rotation.from_matrix(START.rotation) * Rotation.from_rotvec([[0, 0, 0.7 * t] for t in time_s])
    np.testing.assert_allclose(states.rotation, expected.as_matrix(), atol=1e-14)
    moved = BEND.at(time_s).position_m - states.position_m
    np.testing.assert_allclose(moved, time_s[:, None] * [0.5, -0.25, 0.125], atol=1e-13)


def test_a_course_may_start_later() -> None:
    """The same states, so much later; one that does not move rests."""
    time_s = np.linspace(-1.0, 2.0, 7)
    later = replace(BEND, since_s=1.5).at(time_s + 1.5)
    for field in fields(States):
        np.testing.assert_allclose(getattr(later, field.name), getattr(BEND.at(time_s), field.name), atol=1e-14)
    assert Course(start=START, since_s=3.0).rests
    assert not any(
        Course(**options).rests
        for options in ({"speed_m_s": 1.0}, {"yaw_rate_rad_s": 1.0}, {"velocity_m_s": (0.0, 1.0, 0.0)})
    )


def test_a_spline_that_is_not_smooth_goes_evenly() -> None:
    """The spline goes through the poses, with one twist in the body's frame from each to the next; held before and
    after.
    """
    spline = Spline(time_s=TIMES, poses=WAY, smooth=False)
    for number, waypoint in enumerate(WAY):
        np.testing.assert_allclose(spline.at(TIMES[number : number + 1]).position_m[0], waypoint.position_m, atol=1e-12)
    for first, last in itertools.pairwise(TIMES):
        states = spline.at(np.linspace(first, last, 9)[:-1])
        inverse = states.rotation.transpose(0, 2, 1)
        for rate in (states.velocity_m_s, states.turning_rad_s):
            body_rate = np.einsum("nij,nj->ni", inverse, rate)
            np.testing.assert_allclose(body_rate, np.broadcast_to(body_rate[0], body_rate.shape), atol=1e-10)
    held = HeldAtEnds(motion=spline).at(np.array([TIMES[0] - 1.0, TIMES[-1] + 1.0]))
    np.testing.assert_array_equal(held.position_m, [WAY[0].position_m, held.position_m[1]])
    np.testing.assert_allclose(held.position_m[1], WAY[-1].position_m, atol=1e-12)
    assert not held.velocity_m_s.any()
    assert not held.turning_rad_s.any()
    np.testing.assert_array_equal(
        HeldAtEnds(motion=spline).at(TIMES[1:2]).velocity_m_s, spline.at(TIMES[1:2]).velocity_m_s
    )


@pytest.mark.parametrize("rate_rad_s", [0.0, 1e-300, 1e-12, -1e-9, 1e-6])
def test_a_course_that_hardly_turns_is_a_line(rate_rad_s: float) -> None:
    """Aside by v w t^2 / 2, which no cancellation spoils: to 1e-12 of it, and the way ahead to rounding."""
    states = Course(speed_m_s=30.0, yaw_rate_rad_s=rate_rad_s).at(np.array([0.0, 2.0]))
    np.testing.assert_allclose(states.position_m[1], [60.0, 60.0 * rate_rad_s, 0.0], rtol=1e-11, atol=1e-320)
    assert not states.position_m[0].any()


def test_twists_are_scipys() -> None:
    """exp is the matrix exponential of 4 by 4, log its inverse, at angles of 0 to 179 degrees.

    Tolerances: rounding of angles near 180 degrees, whose sine is 0.017, is 60 times that of 1 rad.
    """
    rng = np.random.default_rng(1)
    axes = rng.normal(size=(12, 3))
    angles = [0.0, 1e-12, 1e-8, 9e-5, 1.1e-4, 1e-3, 0.1, 1.0, 2.0, 3.0, math.radians(170), math.radians(179)]
    turns = axes / np.linalg.norm(axes, axis=1, keepdims=True) * np.array(angles)[:, None]
    twists = np.concatenate([rng.normal(0, 5, (12, 3)), turns], axis=1)
    rotation, place = _exp(twists.T)
    for twist, r, p in zip(twists, np.moveaxis(rotation, -1, 0), place.T, strict=True):
        generator = np.zeros((4, 4))
        generator[:3, :3] = np.cross(np.eye(3), twist[3:])
        generator[:3, 3] = twist[:3]
        expected = expm(generator)
        np.testing.assert_allclose(r, expected[:3, :3], atol=2e-14)
        np.testing.assert_allclose(p, expected[:3, 3], atol=5e-13)
    np.testing.assert_allclose(_log(rotation, place), twists.T, atol=2e-12)


def test_a_spline_goes_through_its_poses() -> None:
    states = SPLINE.at(TIMES)
    np.testing.assert_allclose(states.position_m, [p.position_m for p in WAY], atol=1e-12)
    np.testing.assert_allclose(states.rotation, [p.rotation for p in WAY], atol=1e-13)


def test_a_constant_twist_is_met_exactly() -> None:
    """A screw: an arc that climbs, given by poses at uneven times. To rounding of 50 m."""
    climbing = Course(start=START, speed_m_s=15.0, yaw_rate_rad_s=-0.9)
    times = np.array([0.0, 0.4, 0.5, 1.7, 2.0])
    spline = Spline(time_s=times, poses=tuple(pose_at(climbing, t) for t in times))
    time_s = np.linspace(0.0, 2.0, 101)
    states, expected = spline.at(time_s), climbing.at(time_s)
    np.testing.assert_allclose(states.position_m, expected.position_m, atol=1e-12)
    np.testing.assert_allclose(states.rotation, expected.rotation, atol=1e-13)
    np.testing.assert_allclose(states.velocity_m_s, expected.velocity_m_s, atol=1e-11)
    np.testing.assert_allclose(states.turning_rad_s, expected.turning_rad_s, atol=1e-11)


def test_without_turns_it_is_the_hermite_cubic_through_points() -> None:
    """Second road: the cubic with the same velocities at its ends, which for pure translations this must be."""
    from scipy.interpolate import CubicHermiteSpline

    places = np.array([[0, 0, 0], [2, 1, 0], [3, 5, 1], [9, 4, 0], [9, 9, 2.0]])
    spline = Spline(time_s=TIMES, poses=tuple(Pose(position_m=p) for p in places))
    h, rates = np.diff(TIMES), np.diff(places, axis=0) / np.diff(TIMES)[:, None]
    inner = (h[1:, None] * rates[:-1] + h[:-1, None] * rates[1:]) / (h[1:] + h[:-1])[:, None]
    cubic = CubicHermiteSpline(TIMES, places, np.vstack([rates[:1], inner, rates[-1:]]))
    time_s = np.linspace(0.0, 2.5, 61)
    np.testing.assert_allclose(spline.at(time_s).position_m, cubic(time_s), atol=1e-12)
    np.testing.assert_allclose(spline.at(time_s).velocity_m_s, cubic(time_s, 1), atol=1e-11)


def test_beyond_its_ends_it_stands_at_them() -> None:
    assert SPLINE.span_s == (0.0, 2.5)
    np.testing.assert_array_equal(SPLINE.at(np.array([-9.0, 99.0])).position_m, SPLINE.at(TIMES[[0, -1]]).position_m)
    np.testing.assert_array_equal(pose_at(SPLINE, -9.0).rotation, SPLINE.at(TIMES[:1]).rotation[0])
    assert pose_at(BEND).position_m.tolist() == START.position_m.tolist()


def test_a_turn_of_170_degrees_is_the_largest() -> None:
    """Shortest way round: 165 degrees to the right, not 195 to the left."""
    spline = Spline(time_s=np.array([0.0, 1.0]), poses=(pose(0, 0, 0), pose(0, 0, 0, yaw=195)))
    middle = spline.at(np.array([0.5]))
    assert math.degrees(math.atan2(middle.rotation[0, 1, 0], middle.rotation[0, 0, 0])) == pytest.approx(-82.5)
    with told("<= 170 degrees | 171", ValueError):
        Spline(time_s=np.array([0.0, 1.0]), poses=(pose(0, 0, 0), pose(0, 0, 0, yaw=171)))


@pytest.mark.parametrize("times", [[0.0], [0.0, 0.0], [1.0, 0.0], [0.0, np.nan], [0.0, 1.0, 2.0]])
def test_times_must_rise(times: list[float]) -> None:
    with told("two poses | rising times", ValueError):
        Spline(time_s=np.array(times), poses=(Pose(), Pose())[: len(times)])


def test_states_of_a_fixed_frame() -> None:
    """What is fixed on a turning vehicle moves with v + w x r."""
    child = pose(0, 0, 1, roll=90)
    carrier = Course(
        start=replace(START, position_m=np.array([1.0, 2.0, 3.0])), yaw_rate_rad_s=2.0, velocity_m_s=(4.0, 5.0, 6.0)
    )
    combined = Riding(carrier=carrier, pose=child).at(np.zeros(1))
    arm = START.rotation[:, 2]
    np.testing.assert_allclose(combined.position_m[0] - arm, [1, 2, 3], atol=1e-15)
    np.testing.assert_allclose(
        combined.velocity_m_s[0], [4, 5, 6] + 2.0 * np.cross(START.rotation[:, 2], arm), atol=1e-15
    )
    np.testing.assert_allclose(combined.pose().rotation, START.rotation @ child.rotation, atol=1e-15)


def test_going_on_is_straight_at_the_last_velocity() -> None:
    """Position and velocity go on without a step at both ends; beyond them nothing turns. To rounding."""
    motion = GoingOn(motion=SPLINE)
    first_s, last_s = SPLINE.span_s
    for end_s, time_s in ((first_s, first_s - 2.0), (last_s, last_s + 3.0)):
        at_end, beyond = SPLINE.at(np.array([end_s])), motion.at(np.array([time_s]))
        np.testing.assert_allclose(
            beyond.position_m, at_end.position_m + (time_s - end_s) * at_end.velocity_m_s, atol=1e-12
        )
        np.testing.assert_array_equal(beyond.velocity_m_s, at_end.velocity_m_s)
        np.testing.assert_array_equal(beyond.rotation, at_end.rotation)
        np.testing.assert_array_equal(beyond.turning_rad_s, 0.0)
    within = np.linspace(first_s, last_s, 7)
    np.testing.assert_array_equal(motion.at(within).turning_rad_s, SPLINE.at(within).turning_rad_s)


def test_a_loop_goes_round_without_a_kink() -> None:
    """A square's corners: position and velocity agree across the joint, on every round; reference: the limit from
    either side, 1e-9 s apart, in which 10 m/s go 1e-8 m and 100 m/s2 change 1e-7 m/s.
    """
    corners = [(0.0, 0.0, 0.0), (8.0, 0.0, 90.0), (8.0, 8.0, 180.0), (0.0, 8.0, 270.0), (0.0, 0.0, 360.0)]
    poses = tuple(Pose.from_degrees(position_m=(x, y, 0.0), yaw_deg=yaw) for x, y, yaw in corners)
    loop = Repeated(motion=Spline(time_s=np.arange(5.0) + 1.0, poses=poses, closed=True))
    assert not loop.jumps
    assert loop.in_frame(7.3) is loop
    for joint_s in (1.0, 5.0, 9.0, -3.0):
        before, after = (loop.at(np.array([joint_s + shift])) for shift in (-1e-9, 1e-9))
        np.testing.assert_allclose(before.position_m, after.position_m, atol=1e-7)
        np.testing.assert_allclose(before.velocity_m_s, after.velocity_m_s, atol=1e-6)
        assert np.linalg.norm(after.velocity_m_s) > 1.0
    np.testing.assert_allclose(loop.at(np.array([2.4])).position_m, loop.at(np.array([42.4])).position_m, atol=1e-12)


def test_what_is_repeated_jumps_between_frames_only() -> None:
    """A line of 2 s from 0 to 20 m: a frame from 1.95 to 2.05 s holds the end, the next one begins anew."""
    line = Spline(time_s=np.array([0.0, 2.0]), poses=(Pose(), Pose(position_m=np.array([20.0, 0.0, 0.0]))))
    repeated = Repeated(motion=line)
    assert repeated.jumps

    def x_m(start_s: float, time_s: list[float]) -> list[float]:
        return motion_in_frame(repeated, start_s).at(np.array(time_s)).position_m[:, 0].tolist()

    assert x_m(1.95, [1.95, 2.0, 2.05]) == pytest.approx([19.5, 20.0, 20.0])
    assert x_m(2.05, [2.05, 2.15]) == pytest.approx([0.5, 1.5])
    assert x_m(-0.5, [-0.5]) == pytest.approx([15.0])
    assert repeated.at(np.array([2.05, 40.1])).position_m[:, 0] == pytest.approx([0.5, 1.0])


def test_motions_of_all_kinds_together_are_each_of_them() -> None:
    """No tolerance: the table of a frame must not depend on what else moves. One is of a kind of its own."""
    rng = np.random.default_rng(5)

    class Still:
        span_s, is_straight = (0.0, 1.0), True

        def at(self, time_s: np.ndarray) -> States:
            return Course().at(time_s)

    def spline(poses: int) -> Spline:
        turns = (Pose.from_degrees(position_m=rng.normal(size=3), yaw_deg=rng.uniform(-80, 80)) for _ in range(poses))
        return Spline(time_s=np.sort(rng.uniform(0.0, 9.0, poses)), poses=tuple(turns))

    arc = Course(speed_m_s=4.0, yaw_rate_rad_s=0.4, velocity_m_s=(0.1, 0.0, 0.3), start=spline(2).poses[0], since_s=2.0)
    around = [kind(motion=spline(4)) for kind in (HeldAtEnds, GoingOn, Repeated, Repeated)]
    motions = [arc, *around, Still(), spline(5), Riding(carrier=spline(3), pose=arc.start), Course()]
    motions += [motion_in_frame(around[-1], 6.0), spline(2)]
    motions += [Riding(carrier=HeldAtEnds(motion=Riding(carrier=spline(3), pose=arc.start)), pose=arc.start)]
    times = rng.uniform(-3.0, 12.0, (len(motions), 7))
    together = states_of(motions, times)
    for row, motion in enumerate(motions):
        for name in ("position_m", "rotation", "velocity_m_s", "turning_rad_s"):
            np.testing.assert_array_equal(getattr(together, name)[row], getattr(motion.at(times[row]), name))


class CountedMotion:
    """Turns and goes round, and counts how often it is asked."""

    span_s, is_straight = (0.0, 5.0), False

    def __init__(self) -> None:
        self.calls = 0

    def at(self, time_s: np.ndarray) -> States:
        self.calls += 1
        return Course(speed_m_s=3.0, yaw_rate_rad_s=0.2).at(time_s)


def test_what_several_motions_follow_from_is_computed_once() -> None:
    """A sensor, a rack and the body of one vehicle; not at other times."""
    vehicle = CountedMotion()
    motions = [
        Riding(carrier=vehicle, pose=START),
        vehicle,
        HeldAtEnds(motion=vehicle),
        Riding(carrier=vehicle, pose=START),
    ]
    times = np.broadcast_to(np.array([0.5, 1.5]), (4, 2))
    together = states_of(motions, times)
    assert vehicle.calls == 1
    for row, motion in enumerate(motions):
        np.testing.assert_array_equal(together.position_m[row], motion.at(times[row]).position_m)
    vehicle.calls = 0
    states_of(motions[:2], np.array([[0.5], [0.6]]))
    assert vehicle.calls == 2


def test_splines_below_other_motions_are_computed_in_one_go(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes: list[int] = []
    together = Spline.together

    def counted(motions: list[Spline], time_s: np.ndarray) -> States:
        sizes.append(len(motions))
        return together(motions, time_s)

    monkeypatch.setattr(Spline, "together", staticmethod(counted))
    a, b, c = (Spline(time_s=TIMES, poses=WAY) for _ in range(3))
    motions = [Riding(carrier=a, pose=START), HeldAtEnds(motion=Riding(carrier=b, pose=START)), c]
    states_of(motions, np.broadcast_to(TIMES, (3, len(TIMES))))
    assert sizes == [3]


def test_whether_a_motion_jumps_is_computed_once() -> None:
    """Each frame asks: a ride takes a millisecond."""
    motion = CountedMotion()
    repeated = Repeated(motion=motion)
    repeated.in_frame(0.0)
    asked = motion.calls
    repeated.in_frame(7.0)
    assert motion.calls == asked
