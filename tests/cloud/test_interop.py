"""Clouds in other libraries and in notebooks; scenes from other libraries."""

import base64
import io
import re
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import PIL.Image
import pytest
import trimesh
from helpers.child import assert_ended
from helpers.clouds import small_cloud
from helpers.mistakes import calls, told

import lidarscene
from lidarscene import load_scene
from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.errors import LidarSceneError
from lidarscene.formats.category_array import CategoryArray
from lidarscene.materials.material import Material, Spectrum
from lidarscene.maths.pose import Pose
from lidarscene.scene.scene import Scene, box_of


def test_structured() -> None:
    cloud = small_cloud(9)
    rows = cloud.to_numpy()
    assert rows.dtype.names == tuple(c.name for c in cloud.columns)
    for name in rows.dtype.names:
        np.testing.assert_array_equal(rows[name], cloud.column(name), strict=True)


def test_pandas_shares_the_memory(library: Any) -> None:
    library("pandas")
    cloud = small_cloud(9)
    frame = cloud.to_pandas()
    assert list(frame.columns) == [c.name for c in cloud.columns]
    assert frame.attrs == cloud.metadata
    for name in frame.columns:
        values = frame[name].to_numpy()
        if isinstance(cloud.column(name), CategoryArray) and cloud.column(name).names:
            assert list(frame[name].cat.categories) == list(cloud.column(name).names)
            np.testing.assert_array_equal(frame[name].cat.codes, cloud.column(name))
            continue
        np.testing.assert_array_equal(values, cloud.column(name), strict=True)
        assert np.shares_memory(values, cloud.column(name)), name


def test_torch_gets_the_arrays_themselves(monkeypatch: pytest.MonkeyPatch) -> None:
    """PyTorch has a stand-in here, which keeps what it is given: PyTorch is too large for the development group."""
    stand_in = ModuleType("torch")
    stand_in.from_numpy = lambda array: array
    monkeypatch.setitem(sys.modules, "torch", stand_in)
    cloud = small_cloud(9)
    tensors = cloud.to_torch()
    assert tensors["xyz"] is cloud.xyz_m
    assert set(tensors) == {"xyz", *(c.name for c in cloud.columns[3:])}
    assert np.shares_memory(tensors["snr"], cloud.snr)


@pytest.mark.parametrize(("method", "named"), [("to_torch", "pip install torch"), ("to_pandas", "lidarscene[pandas]")])
def test_without_the_library(monkeypatch: pytest.MonkeyPatch, method: str, named: str) -> None:
    monkeypatch.setitem(sys.modules, method.removeprefix("to_"), None)
    with told(named, LidarSceneError):
        getattr(small_cloud(), method)()


def test_notebooks_show_a_picture(street_cloud: PointCloud) -> None:
    """The near points are of the one colour, far ones of the other, and most of the picture shows points."""
    text = street_cloud._repr_html_()
    picture = re.search(r"base64,([^\"]+)", text)
    assert picture
    assert "6,891 points" in text or "6891 points" in text
    data = base64.b64decode(picture[1])
    assert data == street_cloud._repr_png_()
    with PIL.Image.open(io.BytesIO(data)) as image:
        pixels = np.asarray(image).astype(int)
    assert pixels.shape == (405, 720, 3)
    bright = pixels.sum(axis=2) > 100
    assert bright.mean() > 0.05
    bottom, top = (
        part[part.sum(axis=1) > 100].mean(axis=0)
        for part in (pixels[-150:].reshape(-1, 3), pixels[:200].reshape(-1, 3))
    )
    assert bottom[0] > bottom[2]
    assert top[2] > top[0]
    assert small_cloud(0)._repr_png_().startswith(b"\x89PNG")


def test_nothing_heavy_is_imported_to_save_and_show(run_python: Any) -> None:
    code = (
        "import sys\nfrom lidarscene import PointCloud\nfrom lidarscene.cloud.builder import CloudBuilder\n"
        "c = PointCloud(**CloudBuilder().fields())\nc._repr_png_(); c.to_numpy()\n"
        "print(*(n for n in ('matplotlib', 'mitsuba', 'open3d', 'pandas', 'PIL') if n in sys.modules))"
    )
    process = run_python(code)
    assert_ended(process, stdout="\n", stderr=None)


# --- scenes -----------------------------------------------------------------------------------------


def test_a_trimesh_is_a_body(mi: ModuleType) -> None:
    """A wall 10 m ahead, rendered: every echo is from it."""
    wall = trimesh.creation.box((0.2, 4.0, 4.0), trimesh.transformations.translation_matrix((10.1, 0, 0)))
    scene = load_scene(wall, material="concrete", name="wall")
    assert (scene.name, len(scene.bodies), len(scene.bodies[0].parts)) == ("wall", 1, 1)
    np.testing.assert_array_equal(scene.bodies[0].parts[0].vertices_m, wall.vertices)
    cloud = lidarscene.render(scene, overrides=["scanner.azimuth_step_deg=2", "scanner.elevation_step_deg=2"])
    echoes = cloud.select(cloud.status == 0)
    assert len(echoes) > 20
    assert set(echoes.body.tolist()) == {0}
    np.testing.assert_allclose(echoes.true_range_m * np.cos(echoes.incidence_angle_rad), 10.0, rtol=1e-5)


def scene_of_two() -> trimesh.Scene:
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box((1, 2, 3)), geom_name="body", node_name="van")
    shift = trimesh.transformations.translation_matrix((5, 6, 7))
    scene.add_geometry(trimesh.creation.icosphere(radius=0.5), geom_name="ball", node_name="ball", transform=shift)
    return scene


def test_nodes_of_a_trimesh_scene_are_bodies() -> None:
    material = Material(name="mine", bsdf="diffuse", reflectivity=Spectrum.constant(0.3), description="")
    scene = load_scene(
        scene_of_two(),
        material="asphalt",
        materials={"ball": material},
        classes={"van": "car"},
        sensor_name="vlp-16",
        sensor_pose=Pose(position_m=np.array([0.0, 0.0, 2.0])),
    )
    assert [(b.name, b.class_name, b.parts[0].material) for b in scene.bodies] == [
        ("van", "car", "asphalt"),
        ("ball", "ball", "mine"),
    ]
    np.testing.assert_allclose(scene.bodies[1].parts[0].vertices_m.mean(axis=0), [5, 6, 7], atol=1e-12)
    assert scene.materials["mine"] is material
    assert (scene.sensor_name, scene.sensor_pose.position_m[2]) == ("vlp-16", 2.0)


MITSUBA = """<scene version="3.0.0">
  <bsdf type="diffuse" id="grey"><rgb name="reflectance" value="0.5"/></bsdf>
  <shape type="cube" id="block"><transform name="to_world"><translate x="10"/></transform><ref id="grey"/></shape>
</scene>"""


def test_a_mitsuba_file_is_a_scene(mi: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "block.xml").write_text(MITSUBA)
    scene = load_scene(tmp_path / "block.xml", materials={"grey": "concrete"}, sensor_name="table1-sipm")
    assert (scene.name, scene.base_materials, list(scene.materials)) == ("block", {"grey": "concrete"}, ["concrete"])
    cloud = lidarscene.render(scene, overrides=["scanner.azimuth_step_deg=1", "scanner.elevation_step_deg=1"])
    echoes = cloud.select(cloud.status == 0)
    assert echoes.body_names == ("block",)
    np.testing.assert_allclose(echoes.true_range_m * np.cos(echoes.incidence_angle_rad), 9.0, rtol=1e-5)
    with told("none.xml | no such file"):
        load_scene(tmp_path / "none.xml")


BOX = trimesh.creation.box((2.0, 4.0, 6.0))


def mitsuba_box(mi: Any) -> Any:
    return mi.load_dict({"type": "scene", "box": {"type": "cube", "to_world": mi.ScalarTransform4f().scale([1, 2, 3])}})


def test_a_body_is_added_from_any_library(mi: Any, tmp_path: Path) -> None:
    """A box of 2 x 4 x 6 m from each; PyVista's PolyData is drawn with its attributes, as the library is not here."""
    BOX.export(tmp_path / "box.stl")
    polydata = SimpleNamespace(
        points=BOX.vertices, faces=np.column_stack([np.full(len(BOX.faces), 3), BOX.faces]).ravel()
    )
    polydata.triangulate = lambda: polydata
    scene = load_scene("car")
    for mesh in (BOX, trimesh.Scene(BOX), mitsuba_box(mi), polydata, (BOX.vertices, BOX.faces), tmp_path / "box.stl"):
        more = scene.add(mesh, "brick", (3, 2, 3, 90), name="box", class_name="building")
        body = more.bodies[-1]
        assert (body.name, body.class_name, len(more.bodies)) == ("box", "building", len(scene.bodies) + 1)
        np.testing.assert_allclose(box_of(body.parts), [[-1, -2, -3], [1, 2, 3]], atol=1e-6)
        np.testing.assert_allclose(body.pose.apply(np.array([[1.0, 0, 0]])), [[3, 3, 3]], atol=1e-12)
        assert more.materials[body.parts[0].material].name == "brick"
    assert scene.add(BOX, "brick").add(BOX, "brick").bodies[-1].name == "body 2"
    assert "brick" not in scene.materials or scene.materials is not more.materials


def test_a_body_from_open3d(open3d: Any) -> None:
    legacy = open3d.geometry.TriangleMesh.create_box(2.0, 4.0, 6.0)
    tensors = open3d.t.geometry.TriangleMesh.from_legacy(legacy)
    for mesh in (legacy, tensors):
        (part,) = Scene().add(mesh, "brick").bodies[0].parts
        np.testing.assert_allclose(box_of([part]), [[0, 0, 0], [2, 4, 6]])
        assert load_scene(mesh, material="brick").bodies[0].name == "mesh"


test_mistakes = calls(
    (lambda: load_scene(3), "name | file | Scene | (vertices, faces) | mesh"),  # type: ignore[arg-type]
    (lambda: load_scene(trimesh.Trimesh()), "load_scene | at least one triangle | none"),
    (lambda: load_scene(scene_of_two()), "'van' | colour | material"),
    (lambda: load_scene(scene_of_two(), material="unobtainium"), "'unobtainium'"),
    (
        lambda: load_scene(scene_of_two(), material="asphalt", materials={"x": "bark"}),
        "materials | 'x' | ball, body, van",
    ),
    (lambda: load_scene(scene_of_two(), material="asphalt", classes={"x": "car"}), "classes | 'x' | ball, van"),
    (lambda: Scene().add(3, "brick"), "scene.add | mesh file | (vertices, faces) | trimesh, Open3D, PyVista"),
    (lambda: Scene().add(BOX, "brik"), "material 'brik' | brick"),
    (lambda: Scene().add((np.zeros((3, 3)), np.array([[0, 1, 7]])), "brick"), "scene.add | vertex 7 | 3"),
    (lambda: Scene().add("car.blend", "brick"), "car.blend | Blender"),
)


CORNERS = np.array([(x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
QUADS = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
"""A cube of 1 m, outward."""


def test_quads_are_two_triangles_each() -> None:
    """Rationale: the six quads of a cube became eight triangles of another body."""
    (part,) = Scene().add((CORNERS, QUADS), "brick").bodies[0].parts
    assert part.faces.tolist() == [[*q[:1], *q[k : k + 2]] for q in QUADS.tolist() for k in (1, 2)]
    cube = trimesh.Trimesh(part.vertices_m, part.faces, process=False)
    assert cube.is_watertight
    assert cube.volume == pytest.approx(1.0)
    assert cube.area == pytest.approx(6.0)
    for same in (QUADS.astype(float), QUADS.astype(np.uint8), QUADS.tolist(), np.ma.array(QUADS)):
        assert np.array_equal(Scene().add((CORNERS.tolist(), same), "brick").bodies[0].parts[0].faces, part.faces)


@pytest.mark.parametrize(
    ("vertices", "faces", "named"),
    [
        (CORNERS.T, QUADS, "vertices | finite real numbers | float64 | (3, 8)"),
        (CORNERS.ravel(), QUADS, "vertices | finite | float64 | (24,)"),
        (np.hstack([CORNERS, CORNERS]), QUADS, "vertices | finite | float64 | (8, 6)"),
        (CORNERS + 0j, QUADS, "vertices | real numbers | complex128 | (8, 3)"),
        (np.ma.masked_less(CORNERS, 0.5), QUADS, "vertices | finite | masked numbers"),
        ([[0, 0, 0], [1, 1]], QUADS, "vertices | finite | different lengths"),
        (CORNERS.astype(str), QUADS, "vertices | finite | <U32 | (8, 3)"),
        (CORNERS > 0, QUADS, "vertices | finite | bool | (8, 3)"),
        (CORNERS * np.nan, QUADS, "8 of 8 vertices | finite"),
        (CORNERS, QUADS.T, "faces | whole numbers | (m, 3) | (m, 4) | (4, 6)"),
        (CORNERS, QUADS.ravel(), "faces | whole | int64 | (24,)"),
        (CORNERS, np.insert(QUADS, 0, 4, axis=1), "faces | whole | int64 | (6, 5)"),
        (CORNERS, QUADS + 0.5, "faces | whole numbers | 0.5"),
        (CORNERS, QUADS * np.nan, "faces | whole numbers | nan"),
        (CORNERS, np.insert(QUADS[:, :3], 0, 3, axis=1), "faces | 3 first in each | faces[:, 1:]"),
        (CORNERS, QUADS - 1, "vertex -1 | 8"),
        (CORNERS, QUADS * 1e30, "vertex 1e+30 | 8"),
        (CORNERS, np.full((1, 3), 2**64 - 1, np.uint64), "vertex 18446744073709551615 | 8"),
        (CORNERS, QUADS[:0], "at least one triangle | none"),
    ],
)  # fmt: skip
def test_arrays_that_are_no_mesh(vertices: Any, faces: Any, named: str) -> None:
    """The error is one line with the shape that came."""
    with told(f"scene.add | {named}"):
        Scene().add((vertices, faces), "brick")
    with told(named):
        load_scene((vertices, faces), material="brick")
