"""Saved scenes: `Scene.save` writes what `load_scene` reads again, number by number."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.mistakes import told
from helpers.run_seed import chosen

import lidarscene
from lidarscene import Pose, Scene, Sun, load_scene
from lidarscene.catalog import sensor_path
from lidarscene.materials.material import Material, Spectrum
from lidarscene.materials.material_file import catalogue_material
from lidarscene.maths.trajectory import Course, Spline
from lidarscene.scene.scene import Air, Ball, Body, Interferer, Part, View
from lidarscene.scene.weather import Weather

PAINT = Material(
    name="paint",
    bsdf="glass",
    reflectivity=Spectrum(wavelength_m=(850e-9, 1550e-9), value=(0.07, 0.31)),
    parameters={
        "index_n": Spectrum(wavelength_m=(900e-9, 905e-9), value=(1.5, 1.51)),
        "index_k": Spectrum(wavelength_m=(900e-9, 905e-9), value=(1e-7, 3e-7)),
        "thickness_m": 0.0037,
    },
)


def triangles(body: Body) -> list[object]:
    """Corners of each part's triangles, with its material."""
    return [
        (part.radius_m, part.material)
        if isinstance(part, Ball)
        else (
            part.vertices_m[part.faces].tolist(),
            part.material,
            part.in_box,
            None if part.stride_m is None else part.stride_m.sum(),
        )
        for part in body.parts
    ]


def assert_same(first: Scene, second: Scene) -> None:
    assert [body.name for body in first.bodies] == [body.name for body in second.bodies]
    for one, other in zip(first.bodies, second.bodies, strict=True):
        assert triangles(one) == triangles(other), one.name
        assert one.pose.position_m.tolist() == other.pose.position_m.tolist(), one.name
        assert one.pose.rotation.tolist() == other.pose.rotation.tolist(), one.name
        assert (one.class_name, one.present_s, type(one.motion)) == (
            other.class_name,
            other.present_s,
            type(other.motion),
        )
    used = {part.material for body in first.bodies for part in body.parts}
    for name in used:
        wavelength_m = 903e-9
        assert first.materials[name].at(wavelength_m) == second.materials[name].at(wavelength_m), name
    for field in ("sun", "sky", "air", "lamps_w_m2", "interferers", "sensor_name", "camera", "reach_m", "base", "name"):
        assert getattr(first, field) == getattr(second, field), field
    assert first.sensor_pose.position_m.tolist() == second.sensor_pose.position_m.tolist()
    assert first.sensor_pose.rotation.tolist() == second.sensor_pose.rotation.tolist()


def saved(scene: Scene, folder: Path, name: str = "mine.toml") -> Scene:
    scene.save(folder / name)
    return load_scene(folder / name)


@pytest.mark.parametrize("name", ["glass", *chosen(1, ["car", "drive", "street"])])
def test_a_scene_of_a_file_is_read_again(name: str, tmp_path: Path) -> None:
    scene = load_scene(name, overrides={"sun.illuminance_klux": 12.3})
    assert_same(scene, saved(scene, tmp_path))
    assert [file.name for file in tmp_path.iterdir()] == ["mine.toml"], "all meshes stay where they are"


def test_a_scene_outlives_a_change_of_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: `os.chdir` in a notebook. The scene's sensor, base and meshes were read by a relative path."""
    (tmp_path / "sub").mkdir()
    trimesh.creation.box().export(tmp_path / "sub" / "box.ply")
    place = '<transform name="to_world"><translate x="8" z="2"/></transform>'
    base = f'<scene version="3.0.0"><shape type="cube">{place}</shape></scene>'
    (tmp_path / "sub" / "base.xml").write_text(base)
    (tmp_path / "sub" / "vlp.toml").write_text(sensor_path("vlp-16").read_text())
    body = '[[bodies]]\nname = "box"\nmesh = "box.ply"\nmaterial = "asphalt"\ninstances = [{}, {yaw_deg = 45}]'
    (tmp_path / "sub" / "a.toml").write_text(f'base = "base.xml"\n[sensor]\nname = "vlp.toml"\n{body}')
    monkeypatch.chdir(tmp_path)
    scenes = load_scene("sub/a.toml"), load_scene("sub/base.xml")
    monkeypatch.chdir(tmp_path / "sub")
    for scene in (*scenes, scenes[0].remove("box.1")):
        again = saved(scene, tmp_path)
        assert_same(scene, again)
        assert len(lidarscene.render(again)) == len(lidarscene.render(scene)) > 0


def test_an_edited_scene_gives_the_same_cloud(tmp_path: Path) -> None:
    shapes = trimesh.Scene({"box": trimesh.creation.box(), "ball": trimesh.creation.icosphere(subdivisions=1)})
    corners = np.random.default_rng(5).normal(size=(30, 3))
    trimesh.creation.box().export(tmp_path / "box.ply")
    dark, light = (
        trimesh.creation.box(
            visual=trimesh.visual.TextureVisuals(
                material=trimesh.visual.material.PBRMaterial(baseColorFactor=(level, 20, 30, 255))
            )
        )
        for level in (10, 250)
    )
    scene = (
        load_scene("car")
        .remove("car")
        .add(shapes, "asphalt", position=(8.1, 1.3, 0.7), name="two shapes")
        .add((corners, np.arange(30).reshape(10, 3)), "concrete", pose=(5.3, -2.1, 1.0, 33.3, 12.7, -5.1))
        .add(tmp_path / "box.ply", "brick", pose=(6.0, 3.0, 0.5, 20.0))
        .add(dark, position=(4.0, 0.0, 1.0), name="coloured")
        .add(light, position=(4.0, 2.0, 1.0), name="coloured")
        .remove("coloured")
        .add(light, position=(4.0, 4.0, 1.0), name="coloured")
    )
    assert [body.name for body in scene.bodies[-2:]] == ["coloured 2", "coloured"]
    assert [body.parts[0].material for body in scene.bodies[-2:]] == ["colour of coloured 2"] * 2
    levels = [scene.materials[f"colour of coloured{number}"].at(903e-9)["reflectivity"] for number in ("", " 2")]
    assert levels[0] < 0.1 < 0.3 < levels[1]
    again = saved(scene, tmp_path)
    assert_same(scene, again)
    first, second = (lidarscene.render(of, "vlp-16", seed=1) for of in (scene, again))
    assert len(first) > 500
    for column in first.columns:
        assert np.array_equal(np.asarray(first.column(column.name)), np.asarray(second.column(column.name)))
    assert (first.body_names, first.material_names) == (second.body_names, second.material_names)
    assert_same(again, saved(again, tmp_path / "further", "copy.toml"))


def test_instances_keep_their_names(tmp_path: Path) -> None:
    scene = load_scene("car")
    name = next(body.name for body in scene.bodies if body.name == "house.0")
    scene = scene.remove(name)
    assert "house.1" in [body.name for body in saved(scene, tmp_path).bodies]
    assert_same(scene, saved(scene, tmp_path))


def test_a_scene_made_in_python_is_written_whole(tmp_path: Path) -> None:
    box = trimesh.creation.box()
    ego = Course(start=Pose.from_degrees(position_m=(1.0, 2.0, 0.0), yaw_deg=7.3), speed_m_s=3.3, yaw_rate_rad_s=0.1)
    parts = (Part(vertices_m=box.vertices, faces=box.faces, material="paint"),)
    scene = Scene(
        name="made",
        bodies=(
            Body(
                name="box",
                class_name="thing",
                parts=parts,
                pose=Pose.from_degrees(position_m=(5, 0, 1), yaw_deg=12.345),
            ),
            Body(name="ball", class_name="ball", parts=(Ball(radius_m=0.37, material="concrete"),)),
            Body(name="mover", class_name="thing", parts=parts, motion=replace(ego, velocity_m_s=(0.1, 0.2, 0.0))),
        ),
        materials={"paint": PAINT, "concrete": load_scene("car").materials.get("concrete") or PAINT},
        sun=Sun(azimuth_rad=math.radians(33.3), elevation_rad=0.7, illuminance_klux=55.5),
        air=Air(visibility_m=2345.0, weather=Weather(rain_mm_h=3.3)),
        lamps_w_m2=0.003,
        interferers=(Interferer(rate_hz=1e4, irradiance_w_m2=0.01),),
        sensor_name="vlp-16",
        sensor_pose=Pose.from_degrees(position_m=(0.0, 0.0, 1.9), yaw_deg=0.7, pitch_deg=-1.3),
        ego=ego,
        camera=View(eye_m=(0.0, 0.0, 5.0), target_m=(9.0, 0.0, 0.0), fov_deg=44.0),
        reach_m=120.0,
    )
    assert_same(scene, saved(scene, tmp_path))


def test_mirrors_stay_out_of_the_box(tmp_path: Path) -> None:
    box = trimesh.creation.box()
    parts = tuple(
        Part(vertices_m=box.vertices + np.array([0.0, y_m, 0.0]), faces=box.faces, material="brick", in_box=y_m == 0.0)
        for y_m in (1.0, 0.0, -1.0)
    )
    bodies = (Body(name="car", class_name="car", parts=parts),)
    scene = Scene(bodies=bodies, materials={"brick": catalogue_material("brick")})
    assert_same(scene, saved(scene, tmp_path))


def test_a_motion_that_no_file_can_have_writes_nothing(tmp_path: Path) -> None:
    scene = load_scene("car")
    poses = Spline(time_s=np.arange(2.0), poses=(Pose(), Pose.from_degrees(position_m=(1.0, 0.0, 0.0))))
    mover = replace(scene.bodies["car"], name="mover", motion=poses)
    with told("'mover' | motion | speeds"):
        replace(scene, bodies=(*scene.bodies, mover)).save(tmp_path / "mine.toml")
    assert not any(tmp_path.iterdir())


def test_a_body_is_added_at_a_position() -> None:
    body = Scene().add(trimesh.creation.box(), "asphalt", position=(20.0, 0.0, 1.0)).bodies["body"]
    assert body.pose.position_m.tolist() == [20.0, 0.0, 1.0]


def test_colours_of_several_pieces_are_several_materials(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    for shade in (20, 200):
        box = trimesh.creation.box(visual=trimesh.visual.TextureVisuals())
        box.visual.material = trimesh.visual.material.PBRMaterial(
            name=f"m{shade}", baseColorFactor=(shade,) * 3 + (255,)
        )
        scene.add_geometry(box)
    added = Scene().add(scene, name="two")
    assert len({part.material for part in added.bodies["two"].parts}) == 2


def test_values_of_the_file_are_replaced(tmp_path: Path) -> None:
    scene = load_scene("car")
    dim = scene.replace(sun={"illuminance_klux": 1.5}).replace("weather.rain_mm_h=4")
    assert (dim.sun.illuminance_klux, dim.air.weather.rain_mm_h) == (1.5, 4)
    assert dim.replace({"bodies.car.class": "taxi"}).bodies["car"].class_name == "taxi"
    edited = dim.add(trimesh.creation.box(), "brick").remove("car").replace("sky.diffuse_share=0.3")
    assert (edited.sun.illuminance_klux, edited.sky.diffuse_share) == (1.5, 0.3)
    assert [body.name for body in edited.bodies] == [b.name for b in scene.bodies if b.name != "car.0"] + ["body"]
    assert_same(edited, saved(edited, tmp_path))
