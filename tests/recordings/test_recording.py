"""Frames of a recording by number, from both ends."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.mistakes import told

from lidarscene.errors import OptionWarning
from lidarscene.maths.pose import Pose
from lidarscene.recordings.recording import Recording
from lidarscene.recordings.sweep import Second, Sweep


def sweep(*ranges_m: float, second: Second | None = None) -> Sweep:
    count = len(ranges_m)
    direction = np.broadcast_to([1.0, 0.0, 0.0], (count, 3))
    return Sweep(range_m=np.array(ranges_m), recorded=np.ones(count, bool), direction=direction, second=second)


def test_frames_are_counted_from_both_ends() -> None:
    recording = Recording(path=Path("a"), count=3, read=lambda frame: sweep(1.0 + frame))
    assert [recording[place].range_m[0] for place in (0, 1, 2, -1, -2, -3)] == [1, 2, 3, 3, 2, 1]
    assert [frame.range_m[0] for frame in recording] == [1, 2, 3]
    assert [frame.range_m[0] for frame in recording[-2:]] == [2, 3]
    for place in (3, -4):
        with told(f"frame | 0 | 2 | {place}"):
            recording[place]


@pytest.mark.parametrize("close", [Recording.__exit__, lambda recording: recording.close_file()])
def test_a_closed_recording_is_told(close: Callable[[Recording], None]) -> None:
    """Rationale: a frame of a closed pcap of an Ouster ended Python."""
    closed: list[bool] = []
    recording = Recording(
        path=Path("a"), count=3, read=lambda frame: sweep(1.0 + frame), close_file=lambda: closed.append(True)
    )
    assert recording[2].range_m[0] == 3.0
    close(recording)
    assert closed
    with told("a | closed"):
        recording[2]


def test_places_of_no_number_are_told() -> None:
    """Rationale: an infinite number in the metadata of an Ouster made NaN of every point."""
    whole, nan = sweep(5.0, np.nan), np.full((2, 3), np.nan)
    for changes, named in (
        ({"direction": nan}, "directions of returns"),
        ({"origin_m": nan}, "places that returns count from"),
        ({"pose": Pose(position_m=np.array([np.inf, 0.0, 0.0]))}, "the sensor's pose"),
    ):
        damaged = replace(whole, **changes)
        with told(f"a.pcd | {named} | finite numbers"):
            Recording(path=Path("a.pcd"), count=1, read=lambda _, damaged=damaged: damaged)[0]
    lost_only = replace(whole, direction=np.array([[1.0, 0.0, 0.0], [np.nan] * 3]))
    assert Recording(path=Path("a.pcd"), count=1, read=lambda _: lost_only)[0].range_m[0] == 5.0


def test_returns_that_no_lidar_sees_are_left_out() -> None:
    """Rationale: one damaged point at 3e8 m made a histogram of heights of 12 GB. The second returns likewise."""
    second = Second(range_m=np.array([np.nan, 2e4, 30.0]))
    recording = Recording(path=Path("a.pcd"), count=1, read=lambda _: sweep(5.0, 20.0, 3e8, second=second))
    with pytest.warns(OptionWarning, match=r"^a.pcd: 2 of 5 returns are farther than 10 km and left out$"):
        read = recording[0]
    np.testing.assert_array_equal(read.range_m, [5.0, 20.0, np.nan])
    np.testing.assert_array_equal(read.recorded, [True, True, False])
    assert read.second is not None
    np.testing.assert_array_equal(read.second.range_m, [np.nan, np.nan, 30.0])
    with told("a.pcd | sensor's frame | 10000 m"):  # as of a survey in UTM
        Recording(path=Path("a.pcd"), count=1, read=lambda _: sweep(5e5, 5.4e6))[0]


def test_points_in_centimetres_are_told() -> None:
    """Rationale: `fit` and `twin` of such a cloud gave nonsense without a word."""
    recording = Recording(path=Path("a.pcd"), count=1, read=lambda _: sweep(300.0, 900.0, 4000.0, np.nan))
    with pytest.warns(OptionWarning, match=r"^a.pcd: .* metres, .* 500 m, .* centimetres"):
        assert np.nanmax(recording[0].range_m) == 4000.0
    assert Recording(path=Path("a.pcd"), count=1, read=lambda _: sweep(3.0, 900.0))[0].range_m[1] == 900.0
