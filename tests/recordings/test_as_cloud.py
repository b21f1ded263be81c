"""Sweeps as clouds, and what a sweep refuses."""

import numpy as np
import pytest
from helpers.mistakes import told

from lidarscene.maths.pose import Pose
from lidarscene.recordings.as_cloud import cloud_of
from lidarscene.recordings.sweep import Second, Sweep


def sweep(**changes: object) -> Sweep:
    """Two rows, two columns: one pulse is lost, one has two returns."""
    direction = np.array([[[1, 0, 0], [0, 1, 0]], [[0, 0, 1], [-1, 0, 0]]], float)
    fields: dict[str, object] = {
        "range_m": [[2.0, np.nan], [4.0, 5.0]],
        "recorded": [[True, True], [True, False]],
        "direction": direction,
        "origin_m": direction * 0.5,
        "signal": [[9, 8], [7, 6]],
        "near_ir": [[1, 2], [3, 4]],
        "ring": [[0, 0], [1, 1]],
        "start_s": 3.0,
        "includes_lost": True,
        "metadata": {"sensor": "OS"},
        "second": Second(range_m=np.array([[np.nan, np.nan], [6.0, np.nan]]), signal=np.full((2, 2), 5.0)),
        "pose": Pose(position_m=np.array([1.0, 2.0, 3.0])),
    }
    return Sweep(**(fields | changes))


def test_both_returns_are_points() -> None:
    cloud = cloud_of(sweep())
    np.testing.assert_allclose(cloud.range_m, [2.0, 4.0, 5.0, 6.0])
    np.testing.assert_allclose(cloud.xyz_m, [[2.5, 0, 0], [0, 0, 4.5], [-5.5, 0, 0], [0, 0, 6.5]])
    assert cloud.return_number.tolist() == [1, 1, 1, 2]
    assert cloud.signal.tolist() == cloud.intensity.tolist() == [9, 7, 6, 5]
    assert cloud.ambient.tolist() == [1, 3, 4, 3]
    assert "snr" not in cloud.metadata["recorded"].split()
    assert cloud.metadata["intensity_unit"] == "photons"
    assert {"signal", "ambient"} <= set(cloud.metadata["recorded"].split())
    assert cloud.frame_start_s == 3.0
    assert cloud.sensor_to_world is not None
    np.testing.assert_array_equal(cloud.sensor_to_world.position_m, [1, 2, 3])


def test_kept_and_lost() -> None:
    recorded = sweep()
    assert recorded.has_return.tolist() == [[True, False], [True, True]]
    assert recorded.lost.tolist() == [[False, True], [False, False]]


def test_shapes_are_checked_and_arrays_frozen() -> None:
    with told("Sweep.signal | (2, 2) | (3,)", ValueError):
        sweep(signal=[1, 2, 3])
    with told("Sweep.second.signal | (2, 2) | (2,)", ValueError):
        sweep(second=Second(range_m=np.ones((2, 2)), signal=np.ones(2)))
    with pytest.raises(ValueError, match=r"read-only"):
        sweep().range_m[0, 0] = 1.0


def test_beams_have_the_angles_of_their_points() -> None:
    """Azimuth counter-clockwise from x, elevation up from the plane, as the points themselves say."""
    angles = np.radians([[30.0, 5.0], [100.0, -20.0], [-135.0, 60.0]])
    azimuth, elevation = angles.T
    level = np.cos(elevation)
    direction = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1)
    cloud = cloud_of(Sweep(range_m=np.ones(3), recorded=np.ones(3, bool), direction=direction))
    np.testing.assert_allclose(cloud.azimuth_rad, azimuth, atol=1e-7)
    np.testing.assert_allclose(cloud.elevation_rad, elevation, atol=1e-7)


def test_the_intensity_is_the_first_that_is_known() -> None:
    """Intensity, else signal, else reflectivity; of the second return likewise."""
    readings = {"intensity": 1.0, "signal": 2.0, "reflectivity": 3.0}
    for first in range(3):
        reported = {name: np.full((2, 2), value) for name, value in list(readings.items())[first:]}
        later = {name: 10 * values for name, values in reported.items()}
        second = Second(range_m=np.array([[np.nan, np.nan], [6.0, np.nan]]), **later)
        cloud = cloud_of(sweep(**({"intensity": None, "signal": None, "reflectivity": None} | reported), second=second))
        assert cloud.intensity.tolist() == [first + 1.0] * 3 + [10.0 * (first + 1)]
