"""Where the sensor stood."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.twins import room_sweep

from lidarscene.errors import OptionWarning
from lidarscene.maths.pose import Pose
from lidarscene.sensor.pose_file import angles_deg
from lidarscene.studies.twin import frame_poses
from lidarscene.studies.twin.frame_poses import is_at_rest, place_frames

MOVED = Pose.from_degrees(position_m=(0.6, -0.3, 0.05), yaw_deg=3.0, pitch_deg=0.5)


def test_own_poses_are_told_from_the_first_frame() -> None:
    start = Pose.from_degrees(position_m=(5e5, 5e6, 100.0), yaw_deg=90.0)
    sweeps = {2: room_sweep(pose=None), 5: room_sweep(pose=MOVED)}
    sweeps = {2: _with_pose(sweeps[2], start), 5: _with_pose(sweeps[5], start @ MOVED)}
    places = place_frames(sweeps, 2)
    assert np.allclose(places[2].position_m, 0.0, atol=1e-6)
    assert np.allclose(places[5].position_m, MOVED.position_m, atol=1e-6)
    assert np.allclose(places[5].rotation, MOVED.rotation)


def test_frames_without_poses_are_laid_on_each_other(open3d: Any) -> None:
    """Rationale: a room fixes all six numbers; 10 mm of noise over some hundred voxels leave a few millimetres."""
    sweeps = {0: room_sweep(noise_m=0.01), 1: room_sweep(pose=MOVED, noise_m=0.01, seed=1)}
    pose = place_frames(sweeps, 0)[1]
    assert np.abs(pose.position_m - MOVED.position_m).max() < 0.03
    assert angles_deg(pose) == pytest.approx(angles_deg(MOVED), abs=0.2)


def test_frames_that_do_not_fit_are_told(open3d: Any) -> None:
    """Rationale: files of two drives made one twin, in silence."""
    elsewhere = room_sweep(pose=Pose.from_degrees(position_m=(0.0, 0.0, 30.0), yaw_deg=50.0))
    with pytest.warns(OptionWarning, match="frame 4 does not fit frame 2"):
        place_frames({2: room_sweep(), 4: elsewhere}, 2)


def test_frames_are_laid_on_the_one_before_and_chained(monkeypatch: pytest.MonkeyPatch) -> None:
    """Five turned and shifted poses; each frame is laid on its neighbour towards the first, without an error."""
    truth = {
        number: Pose.from_degrees(position_m=(3.0 * number, number**2, 0.1), yaw_deg=25.0 * number, pitch_deg=3.0)
        for number in range(5)
    }
    pairs = []

    def laid(_: Any, cloud: int, target: int) -> Pose:
        pairs.append((cloud, target))
        return truth[target].inverse() @ truth[cloud]

    sweeps = {number: room_sweep() for number in truth}
    monkeypatch.setattr(frame_poses, "is_at_rest", lambda *_: False)
    monkeypatch.setattr(frame_poses, "_register", laid)
    laid_places = place_frames(sweeps, 2)
    assert sorted(pairs) == [(0, 1), (1, 2), (3, 2), (4, 3)]
    for number, pose in truth.items():
        expected = truth[2].inverse() @ pose
        np.testing.assert_allclose(laid_places[number].position_m, expected.position_m, atol=1e-9)
        np.testing.assert_allclose(laid_places[number].rotation, expected.rotation, atol=1e-9)


@pytest.mark.parametrize(
    ("pose", "at_rest"),
    [
        ({}, True),
        ({"position_m": (0.01, 0.0, 0.0)}, False),
        ({"position_m": (0.0, 0.0, -0.01)}, False),
        ({"yaw_deg": 1.0}, False),
    ],
)
def test_a_sensor_at_rest_keeps_its_pose_exactly(pose: Any, at_rest: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A centimetre, three times what counts as rest, or one column; 5 mm of noise on 8,000 pixels leave 0.1 mm."""
    sweeps = {0: room_sweep(noise_m=0.005), 1: room_sweep(pose=Pose.from_degrees(**pose), noise_m=0.005, seed=1)}
    assert is_at_rest(sweeps[1], sweeps[0]) is at_rest
    if at_rest:
        monkeypatch.setattr(frame_poses, "_thin", lambda _: None)
        monkeypatch.setattr(frame_poses, "_register", lambda *_: pytest.fail("registered"))
        assert not place_frames(sweeps, 0)[1].position_m.any()


def test_rows_at_one_height_are_at_rest_though_noise_lifts_them() -> None:
    """10 mm of noise on 1,080 pixels lift three rows by 4 mm, more than counts as rest; 3 cm aside are a move."""

    def three_rows(**changed: Any) -> Any:
        sweep = room_sweep(noise_m=0.01, **changed)
        return replace(sweep, range_m=np.where(np.abs(np.arange(24) - 12)[:, None] < 2, sweep.range_m, np.nan))

    first, moved = three_rows(), Pose.from_degrees(position_m=(0.03, 0.03, 0.0))
    assert all(is_at_rest(three_rows(seed=seed), first) for seed in range(1, 9))
    assert not is_at_rest(three_rows(seed=9, pose=moved), first)


def test_angles_make_the_pose_again() -> None:
    yaw, pitch, roll = 130.0, -20.0, 7.0
    assert angles_deg(Pose.from_degrees(yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll)) == pytest.approx(
        (yaw, pitch, roll)
    )


def _with_pose(sweep: Any, pose: Pose) -> Any:
    return replace(sweep, pose=pose)
