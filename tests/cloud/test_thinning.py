"""Thinned clouds: the same points however a frame is cut, few enough, and of every channel."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from helpers.clouds import assert_same, small_cloud
from helpers.drawn_street import street

from lidarscene.cloud import thinning
from lidarscene.cloud.thinning import Thinned
from lidarscene.detection.outcomes import Status
from lidarscene.figures.pictures import frame_picture

N = 1000
SMALL = (480, 400)


@pytest.mark.parametrize("cuts", [[0, N], [0, 1, 1, 400, N], list(range(0, N + 1, 10))], ids=len)
@pytest.mark.parametrize(("most_points", "step"), [(N, 1), (N - 1, 3), (334, 3), (333, 9), (20, 81)])
def test_every_kth_point_of_the_frame(monkeypatch, cuts, most_points, step):
    """Computed by hand: steps of 1, 3, 9, 27, 81 leave 1000, 334, 112, 38, 13 of a thousand points."""
    monkeypatch.setattr(thinning, "MOST_POINTS", most_points)
    cloud, thinned = small_cloud(N), Thinned()
    for begin, end in itertools.pairwise(cuts):
        thinned.append(cloud.select(slice(begin, end)))
    assert thinned.step == step
    assert_same(thinned.cloud(), cloud.select(np.arange(0, N, step)))
    assert thinned.points == N
    np.testing.assert_array_equal(thinned.statuses, np.bincount(cloud.status, minlength=len(Status)))


def test_all_channels_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """All 64 channels of a scanner that fires them one after the other."""
    monkeypatch.setattr(thinning, "MOST_POINTS", 200)
    cloud = small_cloud(64 * 100, channel=np.tile(np.arange(64, dtype=np.int32), 100))
    assert len(np.unique(Thinned.of_cloud(cloud).cloud().channel)) == 64


def test_the_picture_is_the_same_by_either_road(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The picture of a cloud is that of its pieces, and another one than that of all points."""
    cloud, thinned = street(), Thinned()
    frame_picture(cloud, tmp_path / "all.png", size_px=SMALL)
    monkeypatch.setattr(thinning, "MOST_POINTS", len(cloud) // 2)
    for first in range(0, len(cloud), 700):
        thinned.append(cloud.select(slice(first, first + 700)))
    frame_picture(thinned, tmp_path / "pieces.png", size_px=SMALL)
    frame_picture(cloud, tmp_path / "whole.png", size_px=SMALL)
    assert (tmp_path / "pieces.png").read_bytes() == (tmp_path / "whole.png").read_bytes()
    assert (tmp_path / "all.png").read_bytes() != (tmp_path / "whole.png").read_bytes()
