"""A mesh file as a scene: where it stands, what is assumed, and units that cannot be right."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.mistakes import told

from lidarscene import render
from lidarscene.errors import OptionWarning
from lidarscene.scene.scene import Part
from lidarscene.scene.scene_file import load_scene

BOX = (2.0, 1.0, 3.0)


@pytest.fixture
def box(tmp_path: Path) -> Path:
    """An STL file of a box, z up, off the origin: a format without colours and units."""
    mesh = trimesh.creation.box(BOX)
    mesh.apply_translation((100.0, -50.0, 7.0))
    mesh.export(tmp_path / "box.stl")
    return tmp_path / "box.stl"


def corners(path: Path, *overrides: str) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner of the mesh in the world."""
    with pytest.warns(OptionWarning, match=r"a mesh alone .* high; overrides bodies\.mesh\.unit"):
        scene = load_scene(path, overrides=overrides)
    body = next(body for body in scene.bodies if body.name == "mesh")
    points = np.concatenate([body.pose.apply(p.vertices_m) for p in body.parts if isinstance(p, Part)])
    return points.min(axis=0), points.max(axis=0)


def test_it_stands_on_the_ground_around_the_origin(box: Path) -> None:
    low, high = corners(box)
    np.testing.assert_allclose(low, (-1.0, -0.5, 0.0), atol=1e-5)  # STL is single precision: 4e-6 at 100 m
    np.testing.assert_allclose(high, (1.0, 0.5, 3.0), atol=1e-5)


def test_y_is_up_in_gltf(tmp_path: Path) -> None:
    trimesh.creation.box(BOX).export(tmp_path / "box.glb")
    low, high = corners(tmp_path / "box.glb")
    np.testing.assert_allclose(high - low, (2.0, 3.0, 1.0), atol=1e-6)
    low, high = corners(tmp_path / "box.glb", "bodies.mesh.up=z")
    np.testing.assert_allclose(high - low, BOX, atol=1e-6)
    np.testing.assert_allclose(low[2], 0.0, atol=1e-6)


@pytest.mark.parametrize("across", [(0.3, 0.3, 0.3), BOX, (4.0, 40.0, 10.0), (300.0, 60.0, 80.0)])
def test_the_sensor_sees_all_of_it(tmp_path: Path, across: tuple[float, float, float]) -> None:
    """The mesh lies within the field of view of Table 1: 120 by 25 degrees."""
    trimesh.creation.box(across).export(tmp_path / "box.stl")
    with pytest.warns(OptionWarning):
        scene = load_scene(tmp_path / "box.stl")
    (mesh,) = (body for body in scene.bodies if body.name == "mesh")
    part = mesh.parts[0]
    assert isinstance(part, Part)
    x, y, z = scene.sensor_pose.inverse_apply(mesh.pose.apply(part.vertices_m)).T
    assert (x > 4.9).all()
    assert np.degrees(np.abs(np.arctan2(y, x))).max() < 60.0
    assert np.degrees(np.abs(np.arctan2(z, np.hypot(x, y)))).max() < 12.5


def test_a_mesh_in_millimetres_is_noticed_and_mended(tmp_path: Path) -> None:
    trimesh.creation.box(np.multiply(BOX, 1000.0)).export(tmp_path / "box.stl")
    with told("box.stl | 0.05 | 2000 m | 3000 m | millimetres, add overrides bodies.mesh.unit=mm"):
        load_scene(tmp_path / "box.stl")
    with told("add scene_overrides bodies.mesh.unit=mm"):
        render(tmp_path / "box.stl", "vlp-16")
    for suggestion in ("unit=mm", "scale=0.001"):
        low, high = corners(tmp_path / "box.stl", f"bodies.mesh.{suggestion}")
        np.testing.assert_allclose(high - low, BOX, atol=1e-5)


def test_colours_of_its_own_are_kept(tmp_path: Path) -> None:
    mesh = trimesh.creation.box(BOX)
    material = trimesh.visual.material.PBRMaterial(baseColorFactor=(51, 51, 51, 255))
    mesh.visual = trimesh.visual.TextureVisuals(material=material)
    mesh.export(tmp_path / "grey.glb")
    with pytest.warns(OptionWarning) as caught:
        scene = load_scene(tmp_path / "grey.glb")
    assert "concrete" not in str(caught[0].message)
    (mesh_body,) = (body for body in scene.bodies if body.name == "mesh")
    part = mesh_body.parts[0]
    assert isinstance(part, Part)
    assert scene.materials[part.material].reflectivity.at(905e-9) == pytest.approx(0.2)
