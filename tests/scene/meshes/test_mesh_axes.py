"""Units and axes of mesh files: turns that are exact, what each format means, and a turn too much is told."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.scene_text import scene_of

from lidarscene.errors import OptionWarning
from lidarscene.maths.arrays import Numbers
from lidarscene.maths.pose import Pose
from lidarscene.scene.meshes.mesh_axes import UNITS, Axis, turn_upright
from lidarscene.scene.scene import Part

BOX = (2.0, 1.0, 3.0)
TURNS = {"x": Pose.from_degrees(pitch_deg=90.0), "y": Pose.from_degrees(roll_deg=90.0), "z": Pose()}


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_a_turn_is_a_rotation_that_lifts_the_axis(up: Axis) -> None:
    """Compared with the rotation matrix of the same turn, and to the last bit of what was given."""
    points = np.random.default_rng(1).normal(size=(20, 3))
    turned = turn_upright(points, up)
    np.testing.assert_array_equal(turned[:, 2], points[:, "xyz".index(up)])
    np.testing.assert_allclose(turned, TURNS[up].apply(points), atol=1e-15)
    np.testing.assert_array_equal(np.sort(np.abs(turned), axis=1), np.sort(np.abs(points), axis=1))


def extent_m(folder: Path, mesh: str, keys: str = "") -> Numbers:
    """(3,) size of a body that is this mesh."""
    body = scene_of(folder, f'[[bodies]]\nname = "b"\nmesh = "{mesh}"\nmaterial = "concrete"\n{keys}\n').bodies[0]
    points = np.concatenate([body.pose.apply(p.vertices_m) for p in body.parts if isinstance(p, Part)])
    return np.ptp(points, axis=0)


@pytest.mark.parametrize(
    ("suffix", "keys", "size"),
    [
        ("glb", "", (2, 3, 1)),
        ("gltf", "", (2, 3, 1)),
        ("glb", 'up = "z"', BOX),
        ("glb", 'up = "z"\nroll_deg = 90', (2, 3, 1)),
        ("stl", "", BOX),
        ("obj", "", BOX),
        ("obj", 'up = "y"', (2, 3, 1)),
        ("stl", 'up = "x"\nunit = "ft"\nscale = 2', (3 * 0.6096, 0.6096, 2 * 0.6096)),
    ],
)
def test_formats_mean_what_their_standards_say(tmp_path: Path, suffix: str, keys: str, size: tuple[float, ...]) -> None:
    trimesh.Scene(trimesh.creation.box(BOX)).export(tmp_path / f"a.{suffix}")
    np.testing.assert_allclose(extent_m(tmp_path, f"a.{suffix}", keys), size, rtol=1e-6)


def test_the_units() -> None:
    """A yard is 0.9144 m exactly: 3 ft, 36 in."""
    assert UNITS["ft"] * 3 == pytest.approx(0.9144, rel=1e-15)
    assert UNITS["in"] * 36 == pytest.approx(0.9144, rel=1e-15)
    assert [UNITS[unit] for unit in ("mm", "cm", "m", "km")] == [1e-3, 1e-2, 1.0, 1e3]


def test_a_turn_too_much_is_told(tmp_path: Path) -> None:
    """What set glTF upright before it was read as y up."""
    trimesh.creation.box(BOX).export(tmp_path / "a.glb")
    with pytest.warns(OptionWarning, match=r'a\.glb is y up by its standard.*leave roll_deg out, or say up = "z"'):
        extent_m(tmp_path, "a.glb", "roll_deg = 90")


def test_our_own_meshes_are_proper_gltf() -> None:
    """Other viewers see them stand: their y extent is a car's height."""
    car = trimesh.load_scene(Path(__file__).parents[3] / "assets" / "meshes" / "car.glb")
    np.testing.assert_allclose(car.extents, (4.42, 1.49, 2.12), atol=0.01)
