"""Quads of a list of points."""

from typing import Any

import numpy as np
import pytest
from helpers.twins import COLUMNS, HEIGHT_M, RINGS, room_sweep

from lidarscene.recordings.sweep import Sweep
from lidarscene.studies.twin import listed
from lidarscene.studies.twin.reflect import Gauge
from lidarscene.studies.twin.surfels import GROUND, SMOOTH

GROUND_PLANE = np.array([-HEIGHT_M, 0.0, 0.0])


def points(**changed: Any) -> Sweep:
    plain = room_sweep()
    return Sweep(
        range_m=plain.range_m.ravel(), direction=plain.direction.reshape(-1, 3),
        recorded=np.ones(RINGS * COLUMNS, bool), intensity=np.asarray(plain.reflectivity).ravel(),
        metadata={"format": "velodyne pcap"}, **changed,
    )  # fmt: skip


def test_quads_of_a_list_lie_on_the_room(open3d: Any) -> None:
    sweep = points()
    quads = listed.surfels_of(sweep, Gauge.of(sweep), GROUND_PLANE)
    smooth = quads.corners_m[quads.kind == SMOOTH]
    assert len(smooth) > 0.6 * len(sweep.range_m)
    x, y, z = np.moveaxis(np.abs(smooth), -1, 0)
    off_m = np.min([np.abs(x - 10.0), np.abs(y - 8.0), np.abs(z - HEIGHT_M)], axis=0)
    assert np.quantile(off_m, 0.9) < 1e-4
    ground = quads.corners_m[quads.kind == GROUND]
    assert np.all(ground[..., 2] == pytest.approx(-HEIGHT_M - listed.BELOW_M))


def test_reflectivities_are_those_of_the_intensities(open3d: Any) -> None:
    """A quarter of the law of incidence is off where 20 neighbours span a corner; the median is not."""
    sweep = points()
    quads = listed.surfels_of(sweep, Gauge.of(sweep), None)
    straight = (np.abs(quads.corners_m[:, :, 0] + 10.0).max(axis=1) < 1e-3) & (
        np.abs(quads.corners_m[:, :, 1]).max(axis=1) < 2.0
    )
    assert straight.sum() > 50
    assert np.median(quads.reflectivity[straight]) == pytest.approx(0.4, rel=0.02)
