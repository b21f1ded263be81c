"""Scenes made of others: what a file inherits, changes and leaves out; the own van; copies of shipped scenes."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.command_line import Run
from helpers.scene_text import scene_of

from lidarscene import catalog
from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.scene.scene import Part, Scene, box_of
from lidarscene.scene.scene_file import files_of_scene, load_scene, scene_model

VAN_M = (5.3, 2.0, 2.4)


def van(folder: Path, name: str = "van.obj") -> Path:
    """A box as a van, on the ground."""
    mesh = trimesh.creation.box(VAN_M)
    mesh.apply_translation((0.0, 0.0, 0.5 * VAN_M[2]))
    mesh.export(folder / name)
    return folder / name


def size_of(scene: Scene, body_name: str) -> np.ndarray:
    box = box_of(next(body.parts for body in scene.bodies if body.name == body_name))
    assert box is not None
    return np.ptp(box, axis=0)


def test_a_scene_adds_to_another(tmp_path: Path) -> None:
    """All of drive but for one car; another sun, by place and time; a box more, and a car that is a box now."""
    text = (
        'extends = "drive"\nwithout = ["crossing_car"]\n'
        "[sun]\nplace = [48, 11]\ntime = 2026-06-21T12:00:00+02:00\n[sensor]\nposition_m = [0, 0, 2.4]\n"
        '[[bodies]]\nname = "oncoming_car"\nprimitive = "box"\nsize_m = [4, 2, 2]\nmaterial = "brick"\n'
        '[[bodies]]\nname = "crate"\nprimitive = "box"\nsize_m = [1, 1, 1]\nmaterial = "wood"\n'
    )
    (tmp_path / "mine.toml").write_text(text)
    model, base = scene_model(tmp_path / "mine.toml"), scene_model(catalog.path_of("scenes", "drive"))
    names, base_names = [body.name for body in model.bodies], [body.name for body in base.bodies]
    assert names == [name for name in base_names if name != "crossing_car"] + ["crate"]
    assert (model.sensor.name, model.sensor.position_m) == ("os1-128", (0, 0, 2.4))
    assert model.sun.place == (48, 11)
    assert model.sun.illuminance_klux == base.sun.illuminance_klux
    assert (model.ego, model.ground) == (base.ego, base.ground)
    boxed = next(body for body in model.bodies if body.name == "oncoming_car")
    assert (boxed.mesh, boxed.primitive, boxed.position_m) == (None, "box", (84, 1.7, 0))
    assert boxed.motion is not None
    assert catalog.path_of("scenes", "drive").absolute() in {
        path.absolute() for path in files_of_scene(tmp_path / "mine.toml")
    }
    assert scene_of(tmp_path, text, "mine.toml").name == "mine"


def test_one_extends_one_that_extends_a_street(tmp_path: Path) -> None:
    """Files of a middle layer are beside it; the street is that of the last word on its keys."""
    folder = tmp_path / "below"
    folder.mkdir()
    van(folder)
    (folder / "middle.toml").write_text(
        'extends = "town"\n[street]\nloop = false\nlength_m = 60\nshown_m = 50\n'
        '[[bodies]]\nname = "parked_van"\nmesh = "van.obj"\nmaterial = "brick"\nposition_m = [20, 9, 0]\n'
    )
    model_of = {}
    for seed in (4, 5):
        (tmp_path / "top.toml").write_text(f'extends = "below/middle.toml"\n[street]\nseed = {seed}\n')
        model_of[seed] = scene_model(tmp_path / "top.toml")
    assert [model_of[4].bodies[-1].name, model_of[4].bodies[-1].mesh] == ["parked_van", str(folder / "van.obj")]
    assert model_of[4].ego != model_of[5].ego
    assert model_of[4].reach_m == 70


def test_the_own_van_rides(tmp_path: Path) -> None:
    """`ego.mesh` takes the place, the name and the class of the car that rides, with one material where it has none."""
    van(tmp_path)
    scene = scene_of(tmp_path, 'extends = "drive"\n[ego]\nmesh = "van.obj"\n')
    riding = [body for body in scene.bodies if body.rides_with(scene.ego)]
    assert [(body.name, body.class_name) for body in riding] == [("own_car", "car")]
    np.testing.assert_allclose(size_of(scene, "own_car"), VAN_M, atol=1e-6)
    assert {part.material for part in riding[0].parts if isinstance(part, Part)} == {"car_paint_white"}
    assert len(scene.bodies) == len(load_scene("drive").bodies)


def test_the_own_van_drives_along_a_street(tmp_path: Path) -> None:
    """The van drives on the street's way, with a key of its [ego] changed; a motion of the file's own takes its
    place.
    """
    van(tmp_path)
    street = "[street]\nloop = false\nlength_m = 60\nshown_m = 50\n"
    (tmp_path / "mine.toml").write_text(street + '[ego]\nmesh = "van.obj"\n')
    model = scene_model(tmp_path / "mine.toml", overrides=["ego.ride.active=false"])
    assert model.ego is not None
    assert model.ego.poses is not None
    assert model.ego.ride is not None
    assert not model.ego.ride.active
    assert next(body.mesh for body in model.bodies if body.name == "own_car") == "van.obj"
    (tmp_path / "mine.toml").write_text(street + "[ego]\nspeed_m_s = 3\n")
    ego = scene_model(tmp_path / "mine.toml").ego
    assert ego is not None
    assert (ego.poses, ego.at_end, ego.speed_m_s) == (None, None, 3)


def test_the_own_van_by_an_option(run: Run, tmp_path: Path) -> None:
    """`--ego-mesh` from the current folder; a scene without a vehicle has one then, where the world's origin is."""
    van(tmp_path)
    (tmp_path / "scenes").mkdir()
    wall = '[sensor]\nposition_m = [0, 0, 2.6]\n[[bodies]]\nname = "wall"\nprimitive = "box"\nsize_m = [1, 9, 9]\n'
    (tmp_path / "scenes" / "wall.toml").write_text(wall + 'material = "brick"\nposition_m = [9, 0, 0]\n')
    steps = [f"--set=scanner.{name}_step_deg=3" for name in ("azimuth", "elevation")]
    ran = run("render", "scenes/wall.toml", "-o", "o.ply", "--ego-mesh", "van.obj", *steps)
    assert ran.code == 0, ran
    assert PointCloud.load(tmp_path / "o.ply").body_names == ("wall", "own_car")
    ran = run("render", "scenes/wall.toml", "-o", "o.ply", "--ego-mesh", "car.obj")
    assert (ran.code, ran.err.count("\n")) == (2, 1)
    assert "car.obj: no such file" in ran.err


def test_changes_take_files_from_the_current_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A mesh named in `--scene-set` lies where the command is typed; without one there, beside the scene file."""
    scenes, work = tmp_path / "scenes", tmp_path / "work"
    scenes.mkdir()
    work.mkdir()
    box = '[[bodies]]\nname = "a"\nmesh = "van.obj"\nmaterial = "brick"\n'
    (scenes / "mine.toml").write_text(box)
    van(scenes)
    trimesh.creation.box((1, 1, 1)).export(work / "crate.obj")
    monkeypatch.chdir(work)
    changed = load_scene(scenes / "mine.toml", overrides="bodies.a.mesh=crate.obj")
    np.testing.assert_allclose(size_of(changed, "a"), 1.0)
    monkeypatch.chdir(tmp_path)
    van(scenes, "other.obj")
    np.testing.assert_allclose(size_of(load_scene("scenes/mine.toml", overrides="bodies.a.mesh=other.obj"), "a"), VAN_M)


def test_a_copy_of_a_shipped_scene(run: Run, tmp_path: Path) -> None:
    """The copy has its meshes, and nothing of it outside of its folder: the same bodies at the same places."""
    ran = run("catalog", "scenes", "drive", "--copy", "out/mine")
    assert (ran.code, ran.err, ran.out) == (0, "", "wrote out/mine/drive.toml\n")
    folder = tmp_path / "out" / "mine"
    copied, shipped = load_scene(folder / "drive.toml"), load_scene("drive")
    assert [body.name for body in copied.bodies] == [body.name for body in shipped.bodies]
    for a, b in zip(copied.bodies, shipped.bodies, strict=True):
        np.testing.assert_array_equal(a.pose.position_m, b.pose.position_m)
        assert [part.material for part in a.parts] == [part.material for part in b.parts]
    inside = folder.absolute()
    assert all(
        inside in path.absolute().resolve().parents for path in files_of_scene(folder / "drive.toml") if path.is_file()
    )
    assert "Made by" not in (folder / "drive.toml").read_text()


def test_what_a_copy_needs(run: Run) -> None:
    for argv in (("scenes",), ("sensors", "os1-128"), ()):
        ran = run("catalog", *argv, "--copy", "out")
        assert (ran.code, ran.out) == (2, "")
        assert "--copy needs the name of a scene" in ran.err


def test_the_catalogue_says_the_own_cars_size(run: Run) -> None:
    """The size is that of its mesh, to 0.01 m, as `render` and `check` print it."""
    ran = run("catalog", "scenes")
    assert next(line for line in ran.out.splitlines() if line.startswith("  drive ")).endswith(
        "own_car 4.42 x 2.12 x 1.48 m"
    )
