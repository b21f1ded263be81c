"""The meshes of road vehicles, read by trimesh: of the stated size, closed, standing on their wheels, seen through."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from helpers.scene_text import scene_of

from lidarscene import catalog
from lidarscene.labels.boxes import boxes_of_bodies
from lidarscene.scene.scene_file import load_scene

SKIN = ("paint", "glass", "trim", "headlamp", "taillamp")
"""Parts that close the skin of a vehicle together."""


def parts_of(name: str) -> dict[str, trimesh.Trimesh]:
    """Part name -> mesh, z up as in the file."""
    return dict(trimesh.load_scene(catalog.path_of("meshes", name), process=False).geometry)


def joined(parts: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """One mesh, points merged."""
    mesh = trimesh.util.concatenate(parts)
    return trimesh.Trimesh(mesh.vertices, mesh.faces)


@pytest.mark.parametrize("name", catalog.vehicles())
def test_a_vehicle_has_the_stated_size_on_its_wheels_and_is_closed(name: str) -> None:
    """Mirrors are outside of the size; all but panes, lamps and linings are closed alone, these with the paint."""
    body, parts = catalog.vehicles()[name], parts_of(name)
    assert {mesh.visual.material.name for mesh in parts.values()} == {
        "paint",
        *catalog.shipped_meshes()[name]["materials"],
    }
    points_m = np.concatenate([mesh.vertices for part, mesh in parts.items() if part != "mirrors"])
    np.testing.assert_allclose(np.ptp(points_m, axis=0), body.size_m, atol=1e-3)
    np.testing.assert_allclose(points_m.min(axis=0)[:2], -0.5 * np.array(body.size_m[:2]), atol=1e-3)
    tyres = parts["tyre"].vertices
    assert tyres[:, 2].min() == points_m[:, 2].min() == 0.0
    assert np.count_nonzero(tyres[:, 2] < 0.01) >= 2
    assert 900 < sum(len(mesh.faces) for mesh in parts.values()) < 9500
    skin = joined([parts[part] for part in SKIN if part in parts])
    assert skin.is_watertight
    assert skin.volume > 0.0
    open_parts = {*SKIN, "interior"} if "glass" in parts else set()
    assert [part for part, mesh in parts.items() if part not in open_parts and not mesh.is_watertight] == []


@pytest.mark.parametrize("name", [name for name, body in catalog.vehicles().items() if body.class_name == "car"])
def test_the_cabin_is_seen_through_its_panes(name: str, open3d: Any) -> None:
    """A level ray from the side, above the beltline, meets seats or the other pane, not paint."""
    parts = parts_of(name)
    panes = parts["glass"]
    solid = joined([mesh for part, mesh in parts.items() if part not in ("glass", "mirrors")])
    beside = panes.triangles_center[np.abs(panes.face_normals[:, 1]) > 0.8]
    start_m = beside[beside[:, 1] > 0.0] + (0.0, 1.0, 0.0)
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(solid.vertices.astype(np.float32), solid.faces.astype(np.uint32))
    rays = np.hstack([start_m, np.tile([0.0, -1.0, 0.0], (len(start_m), 1))]).astype(np.float32)
    assert np.median(scene.cast_rays(open3d.core.Tensor(rays))["t_hit"].numpy()) > 1.2


def test_boxes_of_labels_are_those_of_the_table_without_mirrors(tmp_path: Path) -> None:
    """All vehicles in one scene: length, width and height to a millimetre; mirrors would add 0.3 m to the width."""
    table = catalog.vehicles()
    lines = []
    for name, body in table.items():
        mesh = str(catalog.path_of("meshes", name))
        lines += ["[[bodies]]", f"name = '{name}'", f"mesh = '{mesh}'", f"class = '{body.class_name}'"]
    bodies = scene_of(tmp_path, "\n".join(lines)).bodies
    with_mirrors = next(body for body in bodies if body.name == "bus_1195")
    assert np.ptp(np.concatenate([part.vertices_m for part in with_mirrors.parts])[:, 1]) > 2.9
    boxes = boxes_of_bodies(list(enumerate(bodies)))
    np.testing.assert_allclose([box.size_m for box in boxes], [body.size_m for body in table.values()], atol=1e-3)


def test_mirrors_of_the_car_of_the_scenes_have_its_materials_and_are_not_in_its_box() -> None:
    """Mirrors of three materials, as trimesh reads them, reach 0.14 m beyond the box on either side."""
    scene = trimesh.load_scene(catalog.path_of("meshes", "car"), process=False)
    parts = scene.geometry
    mirrors = {part: mesh.visual.material.name for part, mesh in parts.items() if part.startswith("mirrors")}
    assert sorted(mirrors.values()) == ["chrome", "paint", "trim"]
    points_m, all_m = (
        np.concatenate([mesh.vertices for part, mesh in parts.items() if part not in left_out])
        for left_out in (mirrors, {})
    )
    car = load_scene("car").bodies["car"]
    assert {part.material for part in car.parts if not part.in_box} == {"car_paint_white", "black_plastic", "chrome"}
    (box,) = boxes_of_bodies([(0, car)])
    np.testing.assert_allclose(box.size_m, np.ptp(points_m, axis=0), atol=1e-6)
    assert np.ptp(all_m[:, 1]) == pytest.approx(box.size_m[1] + 0.27, abs=0.01)
