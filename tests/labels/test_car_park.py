"""A car park of 400 vehicles and people: boxes as the KITTI loader of Open3D-ML reads them, points by Open3D."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.scene_text import scene_of

from lidarscene import catalog, load_sensor
from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.labels import kitti_dataset
from lidarscene.labels.boxes import boxes
from lidarscene.labels.kinds import kind_of
from lidarscene.rendering.simulator import Simulator
from lidarscene.scene.scene import Scene

pytestmark = pytest.mark.usefixtures("mi")

PLACES, ACROSS_M, ROW_M = 300, 3.6, 100.0
HEIGHT_M = 40.0
RINGS = (0.0, *(round(float(-np.degrees(np.arctan2(HEIGHT_M, radius_m))), 3) for radius_m in np.arange(1.0, 75.0, 0.8)))
COLUMNS = 1000
SCANNER = f"""
[scanner]
type = "spinning"
rotation_hz = 1
columns_per_turn = {COLUMNS}
elevation_deg = {list(RINGS)}
"""


def shown() -> dict[str, Any]:
    """Name of a mesh -> what the catalogue knows of it, of all vehicles and people."""
    names = {*catalog.vehicles(), "car", "wheelchair_user", "pram"}
    return {n: kind for n, kind in catalog.shipped_meshes().items() if n in names or "standing" in kind}


def car_park(folder: Path) -> Scene:
    """Rows of all kinds in turn, a metre apart, one behind the other; rows are turned by 30 degrees."""
    kinds = shown()
    places: dict[str, list[str]] = {name: [] for name in kinds}
    x_m, row = 0.0, 0
    for number in range(PLACES):
        name = list(kinds)[number % len(kinds)]
        room_m = 1.0 + (
            catalog.vehicles()[name].size_m[0] if name in catalog.vehicles() else 4.5 if name == "car" else 1.8
        )
        if x_m + room_m > ROW_M:
            x_m, row = 0.0, row + 1
        at_m = x_m + 0.5 * room_m - 0.5 * ROW_M, ACROSS_M * row - 0.5 * ROW_M
        places[name].append(f"{{ position_m = [{at_m[0]:.2f}, {at_m[1]:.2f}, 0], yaw_deg = {180 * (number % 2)} }}")
        x_m += room_m
    lines = [f"[sensor]\nposition_m = [0, 0, {HEIGHT_M}]"]
    lines += [
        '[[bodies]]\nname = "ground"\nclass = "road"\nprimitive = "plane"\nmaterial = "asphalt"\nsize_m = [300, 300]'
    ]
    for name, kind in kinds.items():
        materials = {"paint": "car_paint_white"} if name == "car" or name in catalog.vehicles() else {}
        parts = ", ".join(f'{part} = "{material}"' for part, material in (materials | kind["materials"]).items())
        lines += [f'[[bodies]]\nname = "{name}"\nclass = "{kind["class"]}"\nmesh = "{catalog.path_of("meshes", name)}"']
        lines += [f"yaw_deg = 30\nmaterials = {{ {parts} }}\ninstances = [{', '.join(places[name])}]"]
    return scene_of(folder, "\n".join(lines))


def from_above(folder: Path, scene: Scene) -> PointCloud:
    """A frame of the paper's lidar on a mast, whose rings are 0.8 m apart on the ground."""
    text = catalog.path_of("sensors", "table1-apd").read_text(encoding="utf-8")
    before, after = text.split("[scanner]")
    rate = f"repetition_rate_khz = {len(RINGS) * COLUMNS / 1000}"
    text = before.replace("repetition_rate_khz = 50", rate) + SCANNER + after[after.index("[detector]") :]
    (folder / "mast.toml").write_text(text.replace("window_us = 4", "window_us = 2"), encoding="utf-8")
    return Simulator(scene, load_sensor(folder / "mast.toml")).render(seed=1)


def test_sizes_and_counts_of_all_objects_are_those_of_a_foreign_loader(tmp_path, library, open3d):
    """Open3D-ML reads type, size, place and direction; Open3D counts the points in its boxes.

    Sizes are those of vehicles.toml. Every box of ten points and more holds points of its class, half of them nine
    tenths and more; the rest is of the ground. Tolerances: four decimals in the label file, by which a point in a
    thousand may be in or out.
    """
    scene = car_park(tmp_path)
    cloud = from_above(tmp_path, scene)
    with kitti_dataset.frame_stream("kitti", tmp_path / "kitti", 0, scene, all_around=True) as append:
        append(cloud)
    found = [box.seen_from(scene.sensor_pose) for box in boxes(cloud, scene) if box.has_points]
    loader = library("open3d._ml3d.datasets.kitti")
    split = loader.KITTI(str(tmp_path / "kitti"), cache_dir=str(tmp_path / "cache")).get_split("training")
    data = split.get_data(0)
    theirs = data["bounding_boxes"]
    assert len(theirs) == len(found) >= 0.8 * PLACES
    # It has no trucks, and nothing that KITTI calls Misc.
    kinds = [kind_of(box.class_name).kitti for box in found]
    known = set(loader.KITTI.get_label_to_names().values())
    assert [box.label_class for box in theirs] == [kind if kind in known else "DontCare" for kind in kinds]
    assert {"Car", "Van", "Cyclist", "Pedestrian"} <= known
    points = open3d.utility.Vector3dVector(data["full_point"][:, :3].astype(float))
    of_class = np.array(cloud.class_names)[cloud.class_id]
    assert len(of_class) == len(points)
    off, own = [], []
    for ours, box in zip(found, theirs, strict=True):
        width_m, height_m, length_m = box.size
        body = scene.bodies[ours.body].name.rpartition(".")[0]
        if body in catalog.vehicles():
            np.testing.assert_allclose((length_m, width_m, height_m), catalog.vehicles()[body].size_m, atol=1.1e-3)
        axes = np.stack([box.front, np.cross((0.0, 0.0, 1.0), box.front), (0.0, 0.0, 1.0)], axis=1)
        block = open3d.geometry.OrientedBoundingBox(box.center, axes, (length_m, width_m, height_m))
        inside = block.get_point_indices_within_bounding_box(points)
        off.append(abs(len(inside) - ours.points_inside))
        if len(inside) >= 10:
            own.append(np.mean(of_class[inside] == ours.class_name))
    assert len(own) > 0.48 * PLACES
    assert min(own) > 0.0
    assert np.median(own) > 0.9
    assert sum(off) < 1e-3 * sum(box.points_inside for box in found)
