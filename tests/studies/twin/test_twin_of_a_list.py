"""Twins of lists of points: simulated points are where something was recorded in their direction."""

from pathlib import Path

import numpy as np
import pytest
from helpers.run_seed import chosen
from scipy.spatial import KDTree

from lidarscene import Simulator, load_scene, load_sensor
from lidarscene.recordings.opening import open_recording
from lidarscene.studies.twin.certificate import judge_in_twin
from lidarscene.studies.twin.twin_files import SCENE, TwinFrames, build_twin

NEARER_M, MOST_NEARER = 0.3, 0.02


@pytest.mark.usefixtures("mi")
@pytest.mark.parametrize("name", chosen(1, ["vlp-16", "hdl-64e", "pandar64"]))
def test_points_of_a_twin_are_not_before_what_was_recorded(tmp_path: Path, name: str) -> None:
    """A street, recorded at 20 turns a second and listed without order, rings or lost pulses, in a file of KITTI.

    Rationale: of the twins of such lists 20 to 75 % of the points beyond 10 m were more than 0.3 m too near, since
    squares as wide as the distance of two rows stood before what lies between them.
    """
    columns = ["scanner.columns_per_turn=900"] if name == "pandar64" else []
    recorder = load_sensor(name, overrides=["scanner.rotation_hz=-20", *columns])
    cloud = Simulator(load_scene("street"), recorder).render()
    cloud = cloud.in_sensor_frame()
    rows = np.column_stack([cloud.xyz_m, cloud.intensity]).astype(np.float32)
    (tmp_path / "list.bin").write_bytes(np.random.default_rng(0).permutation(rows).tobytes())
    with open_recording(tmp_path / "list.bin") as recording:
        text = build_twin(recording, TwinFrames(frames=(0,)), tmp_path / "twin", sensor=name)
        _, rows = judge_in_twin(tmp_path / "twin" / SCENE, recording)
    assert "columns a turn" in text
    scene = load_scene(tmp_path / "twin" / SCENE)
    sensor = load_sensor(scene.sensor_name)
    twin = Simulator(scene, sensor).render().in_sensor_frame()
    assert len(twin) == pytest.approx(len(cloud), rel=0.05)
    recorded_m, range_m = (np.linalg.norm(xyz_m, axis=1) for xyz_m in (cloud.xyz_m, twin.xyz_m))
    _, nearest = KDTree(cloud.xyz_m / recorded_m[:, None]).query(twin.xyz_m / range_m[:, None])
    is_far = recorded_m[nearest] > 10.0
    assert is_far.sum() > 1000
    assert np.mean(range_m[is_far] < recorded_m[nearest][is_far] - NEARER_M) < MOST_NEARER
    assert {row.quantity: row.verdict for row in rows}["returns 0.3 m nearer than recorded"]
