"""Tables of motions: what curves between their steps miss, every turn, and numpy against the device."""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.motions import BEND, MOTIONS, SPLINE, START
from scipy.spatial.transform import Rotation

from lidarscene.kernel.device import transfer
from lidarscene.maths.motion_table import FINE_STEP_S, NOWHERE, STEP_S, MotionTable, Placement
from lidarscene.maths.pose import Pose
from lidarscene.maths.trajectory import Course, HeldAtEnds, Motion, Spline, States

FRAME_S = 0.1


def look_up(motion: Motion, time_s: np.ndarray, *, start_s: float = 1.05) -> Placement:
    return MotionTable.from_motions([motion], start_s=start_s, length_s=FRAME_S, centre_m=np.zeros(3)).placement(
        time_s, 0
    )


def stack_rows(numbers: tuple[np.ndarray, ...]) -> np.ndarray:
    return np.stack(np.broadcast_arrays(*numbers), axis=-1)


@pytest.mark.parametrize("name", MOTIONS)
def test_tables_meet_the_motion(name: str) -> None:
    """A cubic curve misses a path by h^4 / 384 of its fourth derivative, and so each of the four numbers kept.

    Here that is below 1e4 m/s4, 16 nm. Velocities miss by h^2 / 8 of their own second derivative, below 1e3 m/s3.
    """
    motion, time_s = MOTIONS[name], np.linspace(0.0, FRAME_S, 997)
    placement, expected = look_up(motion, time_s), motion.at(1.05 + time_s)
    np.testing.assert_allclose(stack_rows(placement.origin_m), expected.position_m, atol=1.6e-8)
    np.testing.assert_allclose(stack_rows(placement.rotation).reshape(-1, 3, 3), expected.rotation, atol=1e-9)
    assert placement.velocity_m_s is not None
    assert placement.turning_rad_s is not None
    np.testing.assert_allclose(stack_rows(placement.velocity_m_s), expected.velocity_m_s, atol=3.1e-3)
    np.testing.assert_allclose(stack_rows(placement.turning_rad_s), expected.turning_rad_s, atol=5e-4)


@pytest.mark.parametrize(
    ("motion", "step_s", "miss_m", "miss_m_s"),
    [
        # The figures of STEP_S: an arc at 30 m/s and 30 degrees/s.
        (Course(speed_m_s=30.0, yaw_rate_rad_s=math.radians(30.0)), STEP_S, 7.0e-12, 2.6e-5),
        # That of FASTEST_TURN_RAD_S, and those of FINE_STEP_S: ten turns a second.
        (Course(speed_m_s=8.0, yaw_rate_rad_s=8.0), STEP_S, 6.7e-9, 1.6e-3),
        (Course(speed_m_s=62.83, yaw_rate_rad_s=62.83), FINE_STEP_S, 2.5e-9, 7.75e-3),
    ],
)
def test_stated_errors_are_right(motion: Motion, step_s: float, miss_m: float, miss_m_s: float) -> None:
    """Largest halfway between two steps, v w^3 h^4 / 384 and v w^2 h^2 / 8; no more, and not much less."""
    time_s = (np.arange(FRAME_S / step_s) + 0.5) * step_s
    placement, expected = look_up(motion, time_s, start_s=0.0), motion.at(time_s)
    assert placement.velocity_m_s is not None
    for value, true, miss in (
        (placement.origin_m, expected.position_m, miss_m),
        (placement.velocity_m_s, expected.velocity_m_s, miss_m_s),
    ):
        assert np.linalg.norm(stack_rows(value) - true, axis=1).max() == pytest.approx(miss, rel=0.1)


def test_a_straight_line_is_exact_whatever_the_origin() -> None:
    """UTM coordinates: the centre is taken off in double precision. To its rounding, 1e-9 of 5e6 m."""
    far = np.array([5e5, 5.4e6, 300.0])
    line = Course(velocity_m_s=(30.0, -20.0, 1.0))
    paths = MotionTable.from_motions([line], start_s=0.0, length_s=FRAME_S, centre_m=-far)
    time_s = np.linspace(0.0, FRAME_S, 77)
    offset_m = stack_rows(paths.placement(time_s, 0).origin_m) - far
    np.testing.assert_allclose(offset_m, line.at(time_s).position_m, atol=3e-9)


def test_the_ends_and_a_frame_of_no_length() -> None:
    time_s = np.array([-1.0, 0.0, FRAME_S, 2.0])
    placement, expected = look_up(BEND, time_s), BEND.at(1.05 + np.clip(time_s, 0.0, FRAME_S))
    np.testing.assert_allclose(stack_rows(placement.origin_m), expected.position_m, atol=1e-12)
    flash = MotionTable.from_motions([BEND], start_s=0.0, length_s=1e-9, centre_m=np.zeros(3)).placement(np.zeros(3), 0)
    np.testing.assert_allclose(stack_rows(flash.origin_m), np.tile(START.position_m, (3, 1)), atol=1e-15)


def test_turning_on_through_180_degrees() -> None:
    """Signs of quaternions follow each other: no table interpolates across a flip."""
    spin = Course(yaw_rate_rad_s=2.0 * math.pi / FRAME_S)  # once around in the frame
    time_s = np.linspace(0.0, FRAME_S, 1234)
    rotations = stack_rows(look_up(spin, time_s).rotation).reshape(-1, 3, 3)
    # 63 rad/s in steps of 5e-4 s: (w / 2)^4 h^4 / 384 of a quaternion, twice that of an entry.
    np.testing.assert_allclose(rotations, spin.at(1.05 + time_s).rotation, atol=1e-9)


@pytest.mark.parametrize("stop_s", [0.03, 0.0301, 0.0337])
@pytest.mark.parametrize(("speed_m_s", "step_s"), [(2.5, STEP_S), (30.0, FINE_STEP_S)])
def test_a_jump_of_the_speed_misses_as_stated(speed_m_s: float, step_s: float, stop_s: float) -> None:
    """The miss is 4/27 v h and less, wherever in the step the motion stops; boxes hold what the curve bulges."""
    far = Pose(position_m=(speed_m_s * (1.0 + stop_s), 0, 0))
    stops = HeldAtEnds(motion=Spline(time_s=np.array([-1.0, stop_s]), poses=(Pose(), far)))
    carried = np.array([[[-1e-3] * 3, [1e-3] * 3]])
    table = MotionTable.from_motions(
        [stops, stops], start_s=0.0, length_s=FRAME_S, centre_m=np.zeros(3), carried_m=carried
    )
    assert table.last == pytest.approx(FRAME_S / step_s)
    time_s = np.linspace(0.0, FRAME_S, 10001)
    place_m = stack_rows(table.placement(time_s, 1).origin_m)
    assert np.abs(place_m - stops.at(time_s).position_m).max() < 1.001 * 4.0 / 27.0 * speed_m_s * step_s
    assert table.boxes is not None
    assert table.boxes.high[0] > place_m[:, 0].max() + 1e-3


def test_placements_there_and_back() -> None:
    place = look_up(SPLINE, np.linspace(0.0, FRAME_S, 5))
    point = (1.0, -2.0, 3.0)
    round_trip = place.point_within(place.point(point))
    np.testing.assert_allclose(stack_rows(round_trip), np.tile(point, (5, 1)), atol=1e-13)
    np.testing.assert_allclose(stack_rows(place.vector_within(place.vector(point))), np.tile(point, (5, 1)), atol=1e-13)
    assert Placement(origin_m=(0, 0, 0), rotation=place.rotation).velocity_at(point) == (0.0, 0.0, 0.0)


def test_numpy_and_device_agree(mi) -> None:
    """The same source; single precision of 20 m, of unit vectors, and of 20 m/s."""
    paths = MotionTable.from_motions([BEND, SPLINE], start_s=0.5, length_s=FRAME_S, centre_m=np.array([4.0, 1.0, 0.0]))
    on_device = replace(transfer.opaque(paths), table=transfer.from_numpy(paths.table))
    time_s = np.linspace(0.0, FRAME_S, 333)
    for path_index in (0, 1):
        host, device = paths.placement(time_s, path_index), on_device.placement(transfer.from_numpy(time_s), path_index)
        for name, tolerance in (
            ("origin_m", 1e-5),
            ("rotation", 1e-6),
            ("velocity_m_s", 1e-5),
            ("turning_rad_s", 1e-5),
        ):
            column = np.stack([np.array(x.numpy()) for x in getattr(device, name)], axis=-1)
            np.testing.assert_allclose(column, stack_rows(getattr(host, name)), atol=tolerance)


@pytest.mark.parametrize("name", MOTIONS)
def test_boxes_hold_all_that_is_carried(name: str) -> None:
    """Corners of a box at 4001 instants, between those of the table too; and no wider than they need by 0.1 m."""
    carried = np.array([[[-1.0, -0.5, 0.0], [2.5, 0.5, 1.5]]])
    paths = MotionTable.from_motions(
        [BEND, MOTIONS[name]], start_s=1.05, length_s=FRAME_S, centre_m=np.ones(3), carried_m=carried
    )
    assert paths.boxes is not None
    low, high = paths.boxes.low, paths.boxes.high
    corners = np.stack(np.meshgrid(*carried[0].T, indexing="ij"), axis=-1).reshape(-1, 3)
    placements = paths.placement(np.linspace(0.0, FRAME_S, 4001), 1)
    points = np.stack([stack_rows(placements.point(tuple(corner))) for corner in corners]).reshape(-1, 3)
    assert (low < points.min(axis=0)).all()
    assert (high > points.max(axis=0)).all()
    np.testing.assert_allclose([low, high], [points.min(axis=0), points.max(axis=0)], atol=0.1)


def test_what_carries_nothing_has_a_box_that_nothing_is_in() -> None:
    carried = np.array([np.broadcast_to(np.reshape(NOWHERE, (2, 3)), (2, 3)), [[-1.0] * 3, [1.0] * 3]])
    paths = MotionTable.from_motions(
        [BEND, BEND], start_s=0.0, length_s=FRAME_S, centre_m=np.zeros(3), carried_m=carried
    )
    assert paths.boxes is not None
    leaves = {int(node[7]): node for node in paths.boxes.nodes.reshape(-1, 8)}
    empty, box = (leaves[number][[0, 1, 2, 4, 5, 6]] for number in (0, 1))
    assert (empty.reshape(2, 3) == NOWHERE).all()
    alone = MotionTable.from_motions([BEND], start_s=0.0, length_s=FRAME_S, centre_m=np.zeros(3), carried_m=carried[1:])
    assert alone.boxes is not None
    expected = (*alone.boxes.low, *alone.boxes.high)
    np.testing.assert_allclose(box, expected, atol=1e-3)  # room for the rounding of all


def test_a_straight_motion_has_two_instants() -> None:
    """And is where it has to be between them; with one that bends beside it there are as many as that needs."""
    line = Course(velocity_m_s=(30.0, -20.0, 1.0))
    alone, together = (
        MotionTable.from_motions(motions, start_s=0.0, length_s=FRAME_S, centre_m=np.zeros(3))
        for motions in ([line], [line, BEND])
    )
    assert (alone.last, together.last) == (1.0, FRAME_S / STEP_S)
    time_s = np.linspace(0.0, FRAME_S, 77)
    np.testing.assert_allclose(stack_rows(alone.placement(time_s, 0).origin_m), line.at(time_s).position_m, atol=1e-12)


def test_velocity_of_a_point_of_a_turning_frame() -> None:
    """v + w x (p - o): of a frame that turns about any axis, and by differences of where the point is."""
    velocity, turning = np.array([1.0, -2.0, 0.5]), np.array([0.3, -0.7, 1.1])
    origin, point = np.array([4.0, 5.0, 6.0]), np.array([5.5, 3.0, 7.0])
    placement = Placement(
        origin_m=tuple(origin),
        rotation=tuple(np.eye(3).ravel()),
        velocity_m_s=tuple(velocity),
        turning_rad_s=tuple(turning),
    )
    step_s = 1e-6
    moved = origin + velocity * step_s + Rotation.from_rotvec(turning * step_s).apply(point - origin)
    np.testing.assert_allclose(placement.velocity_at(tuple(point)), (moved - point) / step_s, atol=1e-5)


def test_one_motion_of_several_bodies_is_computed_once() -> None:
    """What rests, and what rides on one vehicle: each has its rows and its box all the same."""
    asked: list[int] = []

    class Counted:
        span_s, is_straight, fastest_turn_rad_s = (0.0, 5.0), False, 1.0

        def at(self, time_s: np.ndarray) -> States:
            asked.append(len(time_s))
            return BEND.at(time_s)

    carried_m = np.array([[[-1, -1, -1], [1, 1, 1]], NOWHERE, [[-2, -1, 0], [2, 3, 1]]], dtype=np.float64)
    options = {"start_s": 1.0, "length_s": 0.01, "centre_m": np.zeros(3), "carried_m": carried_m}
    motion = Counted()
    tables = [MotionTable.from_motions(motions, **options) for motions in ([BEND, motion, BEND, motion], [BEND] * 4)]
    assert len(asked) == 1
    np.testing.assert_array_equal(tables[0].table, tables[1].table)
    np.testing.assert_array_equal(tables[0].boxes.nodes, tables[1].boxes.nodes)


def test_frames_behind_each_other() -> None:
    """Each ray has the motions and boxes of its own frame: those of the frame's own table, to the last bit."""
    carried = np.array([[[-1.0, -0.5, 0.0], [2.5, 0.5, 1.5]]] * 6)

    def table(start_s: float, motions: int = 6, length_s: float = FRAME_S) -> MotionTable:
        return MotionTable.from_motions(
            [BEND, *[BEND, SPLINE] * 3][: motions + 1],
            start_s=start_s,
            length_s=length_s,
            centre_m=np.zeros(3),
            carried_m=carried[:motions],
        )

    tables = [table(start_s) for start_s in (0.1, 0.2, 0.3)]
    assert tables[0].goes_with(tables[1])
    assert not any(tables[0].goes_with(other) for other in (table(0.1, 5), table(0.1, 6, 1.001 * FRAME_S)))
    joined = MotionTable.joined(tables)
    time_s, number = np.linspace(0.0, FRAME_S, 21), np.arange(21) % 3
    placed = joined.of_frame(number).placement(time_s, 2)
    assert joined.boxes is not None
    nodes = joined.boxes.nodes.reshape(-1, 8)
    for frame, alone in enumerate(tables):
        own, mine = alone.placement(time_s, 2), number == frame
        for name in ("origin_m", "rotation", "velocity_m_s", "turning_rad_s"):
            assert np.array_equal(stack_rows(getattr(placed, name))[mine], stack_rows(getattr(own, name))[mine])
        assert alone.boxes is not None
        size, walks = alone.boxes.size, list[list[int]]()
        for skips in (False, True):  # through all nodes, or past those below each
            node, walk = frame * size + 1, list[int]()
            while node != 0:
                walk.append(node - frame * size)
                node = int(nodes[node, 3]) if skips or nodes[node, 7] >= 0.0 else node + 1
            walks.append(walk)
        assert walks[0] == list(range(1, size))
        assert len(walks[1]) == 2
        boxes = [0, 1, 2, 4, 5, 6, 7]
        assert np.array_equal(
            nodes[frame * size : (frame + 1) * size, boxes], alone.boxes.nodes.reshape(-1, 8)[:, boxes]
        )
        assert (np.array(joined.boxes.low) <= alone.boxes.low).all()
        assert (np.array(joined.boxes.high) >= alone.boxes.high).all()
