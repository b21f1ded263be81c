"""Scene files: bodies, materials, instances, light and air, as they become a Scene."""

import math
from pathlib import Path

import numpy as np
import pytest
from helpers.scene_text import scene_of as written

from lidarscene import catalog
from lidarscene.scene.scene import Ball, Part, Scene
from lidarscene.scene.scene_file import files_of_scene, load_scene

HOUSE = "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 0 1\nusemtl wall\nf 1 2 3\nusemtl roof\nf 1 2 4\n"


def scene_of(folder: Path, text: str) -> Scene:
    (folder / "house.obj").write_text(HOUSE)
    return written(folder, text)


def body(more: str) -> str:
    return f'[[bodies]]\nname = "house"\nmesh = "house.obj"\n{more}\n'


def materials_of(scene: Scene) -> list[str]:
    return [part.material for part in scene.bodies[0].parts]


def test_defaults(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, body('material = "brick"'))
    assert (scene.name, scene.sensor_name) == ("scene", "table1-apd")
    assert scene.bodies[0].class_name == "house"
    assert materials_of(scene) == ["brick", "brick"]
    assert set(scene.materials) == {"brick"}
    assert (scene.sun.illuminance_klux, scene.sky.diffuse_share) == (100, 0)
    assert scene.air.transmittance == 1
    assert scene.air.extinction_at_per_m(905e-9) == 0
    assert scene.base is None


def test_light_and_air(tmp_path: Path) -> None:
    scene = scene_of(
        tmp_path,
        'name = "n"\n[sun]\nazimuth_deg = 90\nelevation_deg = 30\nilluminance_klux = 50\n[sky]\ndiffuse_share = 0.2\n'
        '[air]\nvisibility_km = 10\nmodel = "kruse"\n' + body('material = "brick"'),
    )
    np.testing.assert_allclose(scene.sun.direction, [0, math.sqrt(0.75), 0.5], atol=1e-15)
    assert (scene.name, scene.sun.illuminance_klux, scene.sky.diffuse_share) == ("n", 50, 0.2)
    # Kruse at 10 km: q = 1.3.
    assert scene.air.extinction_at_per_m(905e-9) == pytest.approx(3.912e-4 * (905 / 550) ** -1.3, rel=1e-6)


def test_materials_by_sub_mesh(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, body('class = "home"\nmaterial = "brick"\nmaterials = { roof = "concrete" }'))
    parts = {part.name: part.material for part in scene.bodies[0].parts if isinstance(part, Part)}
    assert parts == {"wall": "brick", "roof": "concrete"}
    assert scene.bodies[0].class_name == "home"


def test_inline_material_comes_before_the_catalogue(tmp_path: Path) -> None:
    scene = scene_of(
        tmp_path,
        body('material = "brick"')
        + "[materials.brick]\nreflectivity = 0.125\n[materials.mirror]\nbsdf = 'conductor'\nroughness = 0.1\n"
        "reflectivity = [{ wavelength_nm = 900, value = 0.5 }, { wavelength_nm = 1000, value = 0.7 }]\n",
    )
    assert scene.materials["brick"].at(2000e-9)["reflectivity"] == 0.125
    assert scene.materials["mirror"].at(950e-9)["reflectivity"] == pytest.approx(0.6)


def test_a_leaf_and_a_net_by_wavelength(tmp_path: Path) -> None:
    scene = scene_of(
        tmp_path,
        body('material = "leaf"')
        + "[materials.net]\nreflectivity = 0.3\ncover = 0.25\ncover_source = 'estimate'\n[materials.thin]\n"
        "reflectivity = 0.4\ntransmittance = [{ wavelength_nm = 900, value = 0.5 }, "
        "{ wavelength_nm = 1000, value = 0.6 }]\n",
    )
    assert scene.materials["net"].at(905e-9)["cover"] == 0.25
    assert scene.materials["thin"].at(950e-9)["transmittance"] == pytest.approx(0.55)
    assert scene.materials["leaf"].at(1550e-9)["transmittance"] == pytest.approx(0.34)


def test_colour_of_the_mesh_file_is_an_estimate(tmp_path: Path) -> None:
    (tmp_path / "a.mtl").write_text("newmtl wall\nKd 0.2 0.3 0.4\nnewmtl roof\nKd 1 1 1\n")
    (tmp_path / "b.obj").write_text("mtllib a.mtl\n" + HOUSE)
    scene = scene_of(tmp_path, body('materials = { roof = "brick" }').replace("house.obj", "b.obj"))
    assert sorted(materials_of(scene)) == ["b.obj:wall", "brick"]
    material = scene.materials["b.obj:wall"]
    assert material.at(905e-9)["reflectivity"] == pytest.approx(0.3, abs=0.002)
    assert "estimate" in material.description


def test_scale_pose_and_instances(tmp_path: Path) -> None:
    """Instances stand in the frame of their body."""
    more = 'material = "brick"\nscale = 2\nposition_m = [10, 0, 0]\nyaw_deg = 90\n'
    single = scene_of(tmp_path, body(more)).bodies[0]
    assert isinstance(single.parts[0], Part)
    top = max(p.vertices_m[:, 2].max() for p in single.parts if isinstance(p, Part))
    assert top == 2
    np.testing.assert_allclose(single.pose.apply(np.array([[4.0, 0, 0]])), [[10, 4, 0]], atol=1e-12)
    scene = scene_of(tmp_path, body(more + "instances = [{}, { position_m = [1, 0, 0], yaw_deg = 90 }]"))
    assert [b.name for b in scene.bodies] == ["house.0", "house.1"]
    assert {b.class_name for b in scene.bodies} == {"house"}
    np.testing.assert_allclose(scene.bodies[0].pose.position_m, [10, 0, 0], atol=1e-12)
    np.testing.assert_allclose(scene.bodies[1].pose.position_m, [10, 1, 0], atol=1e-12)
    np.testing.assert_allclose(scene.bodies[1].pose.rotation @ [1, 0, 0], [-1, 0, 0], atol=1e-12)
    assert scene.bodies[0].parts is scene.bodies[1].parts


@pytest.mark.parametrize(
    ("shape", "extent_m"),
    [
        ('primitive = "plane"\nsize_m = [1, 2]', (2, 4, 0)),
        ('primitive = "box"\nsize_m = [1, 2, 3]', (2, 4, 6)),
        ('primitive = "cylinder"\nradius_m = 1\nheight_m = 3', (4, 4, 6)),
    ],
)
def test_primitives_take_the_scale(tmp_path: Path, shape: str, extent_m: tuple[float, ...]) -> None:
    scene = scene_of(tmp_path, f'[[bodies]]\nname = "a"\nmaterial = "brick"\nscale = 2\n{shape}\n')
    (part,) = scene.bodies[0].parts
    assert isinstance(part, Part)
    np.testing.assert_allclose(np.ptp(part.vertices_m, axis=0), extent_m, rtol=1e-12)


def test_sphere_is_exact(tmp_path: Path) -> None:
    scene = scene_of(
        tmp_path, '[[bodies]]\nname = "a"\nmaterial = "brick"\nscale = 2\nprimitive = "sphere"\nradius_m = 0.5\n'
    )
    assert scene.bodies[0].parts == (Ball(radius_m=1.0, material="brick"),)


def test_sensor_of_the_scene(tmp_path: Path) -> None:
    """A sensor file is relative to the scene file."""
    text = '[sensor]\nname = "{}"\nposition_m = [1, 2, 3]\npitch_deg = 90\n' + body('material = "brick"')
    assert scene_of(tmp_path, text.format("table1-sipm")).sensor_name == "table1-sipm"
    scene = scene_of(tmp_path, text.format("mine.toml"))
    assert scene.sensor_name == str(tmp_path / "mine.toml")
    np.testing.assert_allclose(scene.sensor_pose.position_m, [1, 2, 3])
    np.testing.assert_allclose(scene.sensor_pose.rotation @ [1, 0, 0], [0, 0, 1], atol=1e-15)


def test_files_of_a_scene(tmp_path: Path) -> None:
    (tmp_path / "base.xml").write_text(
        "<scene version='3.0.0'><shape type='ply'><string name='filename' value='sub/m.ply'/></shape></scene>"
    )
    scene_of(tmp_path, 'base = "base.xml"\n[sensor]\nname = "mine.toml"\n' + body('material = "brick"'))
    file_names = {path.relative_to(tmp_path).as_posix() for path in files_of_scene(tmp_path / "scene.toml")}
    assert file_names == {"scene.toml", "house.obj", "mine.toml", "base.xml", "sub/m.ply"}


def test_scenes_of_the_package_go_by_their_names() -> None:
    """The catalogue has every scene file of the repository; a wheel carries them to where `load_scene` looks."""
    scenes = Path(__file__).parents[2] / "scenes"
    files = {path.stem for path in scenes.glob("*.toml")} - {"job", "rig"}
    assert set(catalog.names("scenes")) == files
    by_name, pathed = load_scene("edges"), load_scene(scenes / "edges.toml")
    assert [body.name for body in by_name.bodies] == [body.name for body in pathed.bodies]
    assert next(files_of_scene("edges")) == scenes / "edges.toml"
    assert load_scene("edges", overrides=["sun.illuminance_klux=1"]).sun.illuminance_klux == 1
