"""Sizes of vehicles: in another unit, on their side, on their end; each is told with what mends it."""

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.command_line import Run
from helpers.mistakes import told
from helpers.scene_text import scene_of

from lidarscene.errors import OptionError, OptionWarning
from lidarscene.scene.bare_mesh import mesh_description
from lidarscene.scene.sizes import size_text

CAR = Path(__file__).parents[2] / "assets" / "meshes" / "car.glb"
"""glTF, y up: 4.42 m long, 2.12 m wide and 1.48 m high."""

BODY = '[[bodies]]\nname = "own"\nclass = "{}"\nmesh = "{}"\nmaterial = "car_paint_white"\n{}\n'


def body(folder: Path, mesh: str, *, class_name: str = "car", keys: str = "") -> np.ndarray:
    """Edges of a body that is this mesh."""
    (part,) = scene_of(folder, BODY.format(class_name, mesh, keys)).bodies[0].parts
    return np.ptp(part.extent_m, axis=0)


def write_car(folder: Path, up: str, *, suffix: str = "glb", scale: float = 1.0) -> None:
    """The catalogue's car as one mesh, with this axis of the file up."""
    car = trimesh.load_scene(CAR).to_mesh()
    car.visual = trimesh.visual.ColorVisuals()
    x, y, z = car.vertices.T * scale
    car.vertices = np.stack({"y": (x, y, z), "z": (x, -z, y), "x": (y, z, x)}[up], axis=1)
    trimesh.Scene(car).export(folder / f"own.{suffix}")


@pytest.mark.parametrize(
    ("per_m", "unit", "class_name"), [(1000, "mm", "car"), (100, "cm", "van"), (39.37, "in", "truck")]
)
def test_a_vehicle_in_another_unit(tmp_path: Path, per_m: float, unit: str, class_name: str) -> None:
    trimesh.creation.box(np.array([4.8, 2.0, 2.3]) * per_m).export(tmp_path / "van.obj")
    size = size_text(np.array([4.8, 2.0, 2.3]) * per_m)
    # A note; where it is a hundred times too long no sensor on it would see anything, and it is refused.
    expected = pytest.warns(OptionWarning) if unit == "in" else pytest.raises(OptionError)
    with expected as caught:
        body(tmp_path, "van.obj", class_name=class_name)
    message = str(caught[0].message if unit == "in" else caught.value)
    assert re.search(
        rf"own.*van\.obj: a vehicle of {size} m .*bodies\.own\.unit={unit} makes it 4\.8 x 2 x 2\.3 m", message
    )
    np.testing.assert_allclose(body(tmp_path, "van.obj", keys=f'unit = "{unit}"'), [4.8, 2.0, 2.3], rtol=1e-4)


@pytest.mark.parametrize(
    ("up", "suffix", "taken", "size"),
    [
        ("z", "glb", "y", "4.42 x 1.48 x 2.12"),
        ("y", "obj", "z", "4.42 x 1.48 x 2.12"),
        ("x", "glb", "y", "1.48 x 4.42 x 2.12"),
    ],
)
def test_a_vehicle_on_its_side(tmp_path: Path, up: str, suffix: str, taken: str, size: str) -> None:
    """A car is the mirror image of itself from left to right, not from top to bottom."""
    write_car(tmp_path, up, suffix=suffix)
    with pytest.warns(
        OptionWarning, match=rf"a vehicle of {size} m, with {taken} up, lies .*bodies\.own\.up={up} makes it"
    ):
        body(tmp_path, f"own.{suffix}")
    assert sorted(np.round(body(tmp_path, f"own.{suffix}", keys=f'up = "{up}"'), 2)[:2]) == [2.12, 4.42]


def test_a_vehicle_on_its_end(tmp_path: Path) -> None:
    """Also one that would be too long if it lay."""
    trimesh.creation.box([2.0, 2.3, 31.0]).export(tmp_path / "van.obj")
    with pytest.warns(OptionWarning, match=r"a vehicle of 2 x 2\.3 x 31 m, with z up, lies .*bodies\.own\.up="):
        body(tmp_path, "van.obj")
    np.testing.assert_allclose(body(tmp_path, "van.obj", class_name="lift"), [2.0, 2.3, 31.0])


def test_what_is_as_it_should_be_is_not_told(tmp_path: Path) -> None:
    """Warnings are errors here. A long bus, a car that the body's own roll sets upright, a house."""
    trimesh.creation.box([24.8, 2.5, 3.3]).export(tmp_path / "bus.obj")
    body(tmp_path, "bus.obj", class_name="bus")
    trimesh.creation.box([60, 20, 70]).export(tmp_path / "house.obj")
    body(tmp_path, "house.obj", class_name="building")
    write_car(tmp_path, "y", suffix="obj")
    body(tmp_path, "own.obj", keys="roll_deg = 90")


def test_the_own_van_in_millimetres_is_one_line(run: Run, tmp_path: Path) -> None:
    trimesh.creation.box([4800, 2000, 2300]).export(tmp_path / "van.obj")
    ran = run("render", "drive", "-o", "o.ply", "--ego-mesh", "van.obj")
    assert (ran.code, ran.err.count("\n")) == (2, 1)
    assert "4,800 x 2,000 x 2,300 m" in ran.err
    assert "--scene-set bodies.own_car.unit=mm makes it 4.8 x 2 x 2.3 m" in ran.err


def test_a_stage_is_mended_by_a_scale(tmp_path: Path) -> None:
    """A stage says its unit itself. This one says metres, and is in centimetres; the body makes it half as large."""
    pytest.importorskip("pxr")
    stage = '#usda 1.0\n( metersPerUnit = 1\n  upAxis = "Z" )\ndef Cube "van"\n{\n    double size = 960\n}\n'
    (tmp_path / "van.usda").write_text(stage)
    with told("480 x 480 x 480 m | bodies.own.scale=0.005 | 4.8 x 4.8 x 4.8 m", OptionError):
        body(tmp_path, "van.usda", keys="scale = 0.5")


def test_sizes_read_alike(run: Run, tmp_path: Path) -> None:
    """The catalogue, a mesh alone, and the note on a vehicle on its side say one size of one mesh."""
    assert mesh_description(CAR) == "4.42 x 2.12 x 1.48 m"
    write_car(tmp_path, "y")
    ran = run("render", "own.glb", "-o", "o.ply", "--set=scanner.azimuth_step_deg=3", "-q")
    assert "own.glb: a mesh alone is taken as 4.42 x 2.12 x 1.48 m with y up" in ran.err
    assert "--scene-set bodies.mesh.unit and bodies.mesh.up change size and axis" in ran.err
