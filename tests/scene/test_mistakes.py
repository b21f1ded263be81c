"""Mistakes in scene and rig files: one line each, with file and key, what came and what was expected."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from helpers.mistakes import calls, given_file, mistakes, told
from helpers.walker import write_walker
from helpers.walls import ROOF_AND_LEFT, WALL

from lidarscene.catalog import path_of
from lidarscene.errors import InputError, OutputError
from lidarscene.scene.scene import Scene
from lidarscene.scene.scene_file import load_scene
from lidarscene.sensor.rig_file import load_rig

NOISE = np.random.default_rng(7).bytes(2000)
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
PLY = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
    "property list uchar int vertex_indices\nproperty float reflectivity\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2 {}\n"
)
FILES: dict[str, str | bytes] = {
    "ok.obj": TRIANGLE,
    "nan.obj": TRIANGLE.replace("v 1", "v nan"),
    "huge.obj": TRIANGLE.replace("v 1", "v 1e308"),
    "number.obj": TRIANGLE.replace("2 3", "2 9"),
    "point.obj": "v 2 2 2\nv 2 2 2\nv 2 2 2\nf 1 2 3\n",
    "corner.obj": "v 0 0 0\n",
    "empty.obj": "",
    "empty.stl": "",
    **{f"noise.{suffix}": NOISE for suffix in ("obj", "ply", "glb", "stl")},
    "a.fbx": "1",
    "a.STEP": "1",
    "a.xyzw": "1",
    "plain.ply": PLY.replace("reflectivity", "value").format(1),
    "bright.ply": PLY.format(35),
    "nan.ply": PLY.format("nan"),
    "white.ply": PLY.format(1),
    "walker.ply": "ply\n",
    "few.csv": "time_s,y_m,z_m\n0,0,0\n1,0,0\n",
    "bad.txt": "1 2 3\n",
    "word.txt": "1 2 3 x 5 6 7 8\n",
    "nan.csv": "time_s,x_m,y_m,z_m\n0,0,0,0\n1,0,nan,0\n",
    "empty.txt": "",
    "empty.csv": "",
    "semicolons.csv": "time_s;x_m;y_m;z_m\n0;0;0;0\n1;0;0;0\n",
    "quat.csv": "time_s,x_m,y_m,z_m,qx,qy,qz,qw\n0,0,0,0,0,0,0,2\n1,0,0,0,0,0,0,1\n",
    "both.csv": "time_s,x_m,y_m,z_m,qx,yaw_deg\n0,0,0,0,0,0\n1,0,0,0,0,0\n",
    "short.txt": "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 0.985\n",
    "long.txt": "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1.02\n",
    "below.toml": 'bodies = ["x"]',
    "circle.toml": 'extends = "scene.toml"',
    "own.toml": path_of("sensors", "table1-sipm").read_bytes(),
}
"""What the scenes name: meshes, poses, a sensor."""


@pytest.fixture(autouse=True, scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenes")
    for name, content in FILES.items():
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    write_walker(folder / "walker.glb")
    (folder / "folder").mkdir()
    return folder


@pytest.fixture(autouse=True)
def _in_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)


@mistakes(
    r"""
    a = = 3 | TOML | line 9, column 5
    colour = 1 | 'bodies[0 "wall"].colour' | position_m, yaw_deg
    instances = [{ yaw = 1 }] | 'bodies[0 "wall"].instances[0].yaw' | yaw_deg
    instances = [] | bodies[0 "wall"].instances | at least 1 | []
    scale = '2' | bodies[0 "wall"].scale | number | "2"
    scale = 0 | bodies[0 "wall"].scale | > 0 | 0
    scale = nan | bodies[0 "wall"].scale | finite number | NaN
    scale = 1e-9 | bodies[0 "wall"] | scale | >= 1e-06 m
    scale = 1e300 | bodies[0 "wall"].scale | <= 1e+06 | 1e+300
    [4, 4] -> [4] | bodies[0 "wall"] | size_m | plane | 2 numbers | 1
    [4, 4] -> [4, 0] | bodies[0 "wall"].size_m[1] | > 0 | 0
    [10, 0, 1.8] -> [1, 0] | bodies[0 "wall"].position_m | longer | [1, 0]
    [10, 0, 1.8] -> [1e30, 0, 0] | bodies[0 "wall"].position_m[0] | <= 1e+08 | 1e+30
    concrete -> concrate | bodies[0 "wall"].material | 'concrate' | concrete
    material = "concrete" -> | bodies[0 "wall"] | 'material'
    name = "wall" -> | 'bodies[0].name'
    "wall" -> "" | bodies[0 ""].name | empty | ""
    mesh = "a.obj" | bodies[0 "wall"] | mesh | primitive | both
    radius_m = 1 | bodies[0 "wall"] | plane | size_m | size_m and radius_m
    materials = { a = "brick" } | bodies[0 "wall"] | materials | sub-meshes
    "plane" -> "cone" | bodies[0 "wall"].primitive | 'plane', 'ground', 'box', 'sphere' or 'cylinder' | "cone"
    [sun]\nazimut_deg = 1 | 'sun.azimut_deg' | azimuth_deg?
    [air]\nvisibility_km = 1\ntransmittance = 1 | air | extinction_per_m | transmittance and visibility_km
    [weather]\nrain = 5 | 'weather.rain' | weather.rain_mm_h?
    [base_materials]\ngrey = "brick" | base_materials | base
    [materials.x]\nreflectivity = [{wavelength_nm = 905, value = 2}] | materials.x.reflectivity[0].value | <= 1 | 2
    [materials.x]\nreflectivity = 0.6\ntransmittance = 0.5 | materials.x | transmittance | <= 1 together | 1.1
    [materials.x]\nreflectivity = 0.6\ntransmittance = [{wavelength_nm = 905, value = 0.45}] | 1.05 at 905 nm | <= 1
    [materials.x]\nreflectivity = 0.6\nbsdf = 'mirror'\ncover = 0.5 | materials.x | mirror | cover
    [materials.x]\nreflectivity = 0.6\nfree_path_m = 0.2 | materials.x | free_path_m | cover below 1
    [materials.x]\nreflectivity = 0.1\nroughness = 0.1 | materials.x | diffuse | roughness
    [materials.x]\nreflectivity = 0.1\nbsdf = 'coated' | materials.x | coated | coat_ior | coat_roughness
    [ego]\nspeed = 3 | 'ego.speed' | ego.speed_m_s?
    [ego]\nwith_ego = true | 'ego.with_ego'
    [ego]\nspeed_m_s = 1\nposes_file = 'a.csv' | ego | speed_m_s and poses_file
    [ego]\nposes = [{time_s = 0}] | ego.poses | at least 2
    [ego]\nposes = [{time_s = 0}, {}] | ego.poses[1].time_s
    [ego]\nposes = [{time_s = 1}, {time_s = 1, yaw_deg = 0}] | ego.poses | two poses or more | rising times
    [ego]\nposes = [{time_s = 0}, {time_s = 1, yaw_deg = 180}] | ego.poses | <= 170 degrees | 180
    [ego]\nposes = [{time_s = 0}, {time_s = 1}]\nat_end = 'hide' | at_end | hold, repeat or leave
    [ego]\nposes = [{time_s = 0}, {time_s = 1, yaw_deg = 90}]\nat_end = 'repeat' | ego.at_end | repeat | last pose
    [ego]\nat_end = 'repeat'\n[street]\nlength_m = 60 | ego | at_end | poses_file in the same table
    [ego]\nposes_file = 'none.csv' | ego.poses_file | none.csv | no such file
    [ego]\nposes_file = 'few.csv' | few.csv | x_m
    [ego]\nposes_file = 'bad.txt' | bad.txt | 8 numbers | 3
    [ego]\nposes_file = 'word.txt' | word.txt | read
    [ego]\nposes_file = 'nan.csv' | nan.csv | y_m | pose 2 | finite number
    [ego]\nposes_file = 'quat.csv' | quat.csv | length 1 | 2 | pose 1
    [ego]\nposes_file = 'short.txt' | short.txt | length 1 | 0.985 | pose 2
    [ego]\nposes_file = 'long.txt' | long.txt | length 1 | 1.02 | pose 2
    [ego]\nposes_file = 'both.csv' | both.csv | qx, qy, qz, qw | yaw_deg
    [ego]\nposes_file = 'empty.txt' | empty.txt | two poses or more
    [ego]\nposes_file = 'empty.csv' | empty.csv | the columns
    [ego]\nposes_file = 'semicolons.csv' | semicolons.csv | the columns | commas | 'time_s;x_m;y_m;z_m'
    [ego]\nmesh = "none.obj" | ego.mesh | none.obj | no such file
    [bodies.motion]\nwith_ego = true | 'wall' | with_ego | [ego]
    [bodies.motion]\nwith_ego = true\nspeed_m_s = 1\n[ego] | with_ego and speed_m_s
    [bodies.motion]\nwith_ego = true\nride = {}\n[ego] | with_ego alone | ride
    [bodies.motion]\nspeed_m_s = 1\nat_end = 'hold' | at_end | poses or poses_file
    """
)
def test_wall(given: str, named: str) -> None:
    """A scene of a wall, with a line more or something else in place of what it had."""
    old, replaced, new = given.partition("->")
    text = WALL.replace(old.strip(), new.strip()) if replaced else f"{WALL}{given}\n"
    assert text != WALL
    Path("scene.toml").write_text(text)
    with told(f"scene.toml | {named}"):
        load_scene("scene.toml")


@mistakes(
    r"""
    x = 1 | 'x' | name, description, extends, without, base
    | [[bodies]], [street] or base = | none
    bodies = ["x"] | bodies[0] | table | "x"
    bodies = 3 | bodies | list | 3
    without = [["x"]] | without[0] | text | ["x"]
    BALLBALL | unique | 'b' twice
    BALL pattern = "colour" | pattern | meshes | sphere
    BALL up = "y" | up | meshes | sphere
    BALL animation = "walk" | animation | meshes | sphere
    BALL crown_m = 1 | crown_m | ground | sphere
    BALL offset_m = 1 | offset_m | ground | sphere
    base = "none.xml" | base | none.xml | no such file
    base = "LONG.xml" | base | LONG.xml | no such file
    base = "ok.obj" | base | ok.obj | .xml
    MESH "nan.obj" | bodies[0 "thing"] | nan.obj | 1 of 3 vertices | finite
    MESH "huge.obj" | bodies[0 "thing"] | huge.obj | 1 of 3 vertices | finite
    MESH "number.obj" | bodies[0 "thing"] | number.obj | a mesh
    MESH "point.obj" | bodies[0 "thing"] | <= 1e+08 m | 0 m and 2 m
    MESH "corner.obj" | bodies[0 "thing"] | corner.obj | at least one triangle | none
    MESH "empty.obj" | bodies[0 "thing"] | empty.obj | at least one triangle | none
    MESH "empty.stl" | bodies[0 "thing"] | empty.stl | at least one triangle | none
    MESH "noise.ply" | bodies[0 "thing"] | noise.ply | a mesh
    MESH "noise.glb" | bodies[0 "thing"] | noise.glb | a mesh
    MESH "a.fbx" | bodies[0 "thing"] | a.fbx | FBX | Blender | glTF
    MESH "a.STEP" | bodies[0 "thing"] | a.STEP | STEP | OBJ or STL | FreeCAD
    MESH "a.xyzw" | bodies[0 "thing"] | a.xyzw | 'xyzw'
    MESH "none.glb" | bodies[0 "thing"].mesh | none.glb | no such file
    MESH "folder" | bodies[0 "thing"].mesh | folder | mesh file
    MESH "LONG" | bodies[0 "thing"].mesh | LONG | no such file
    MESH "ok.obj"\nmaterials = { roof = "brick" } | bodies[0 "thing"].materials | 'roof' | ok.obj
    MESH "plain.ply"\npattern = "reflectivity" | bodies[0 "thing"].pattern | plain.ply | reflectivity
    MESH "plain.ply"\npattern = "colour" | bodies[0 "thing"].pattern | plain.ply | colour
    MESH "bright.ply"\npattern = "reflectivity" | bodies[0 "thing"] | 'reflectivity' | >= 0 and <= 1 | 35
    MESH "nan.ply"\npattern = "reflectivity" | bodies[0 "thing"] | 'reflectivity' | >= 0 and <= 1 | nan
    [[bodies]]\nname = "x"\nclass = "a"\nmesh = "ok.obj" | bodies[0 "x"] | sub-mesh 'ok.obj' | colour | a material
    [[bodies]]\nname = "x"\nmaterial = "chrome"\nmesh = "white.ply"\npattern = "reflectivity" | diffuse | chrome
    WALK animation = "run"\nmotion = { speed_m_s = 1 } | walker.glb | 'run' | walk, stand
    WALK animation = "stand"\nmotion = { speed_m_s = 1 } | animation | a stride | none does
    WALK standing = "stand" | standing | animation | no animation
    MESH "walker.ply"\nanimation = "walk" | animation | glTF | '.ply'
    reach_m = 50\nBALL | reach_m | [ego]
    BOX on_ground = true | on_ground | ground | none at 0, 0 m
    BOX crown_m = 0.1 | crown_m | ground | box
    [ego]\nROAD size_m = [80, 8]\nBOX on_ground = true\n[bodies.motion]\nwith_ego = true | on_ground | motion.with_ego
    ROAD size_m = [80, 8]\npitch_deg = 1 | ground | level
    ROAD size_m = [80, 8]\n[bodies.motion]\nspeed_m_s = 1 | ground | stand still
    ROAD size_m = [80, 8]\non_ground = true | ground below it
    ROAD size_m = [800, 800] | ground | <= 4000000 vertices | 4004001
    ROAD size_m = [80] | size_m | ground | 2 numbers
    ROAD size_m = [80, 8]\nwidth_m = 3 | line and width_m | width_m
    ROAD line = [[0, 0, 0], [9, 0, 0], [3, 2, 0]]\nwidth_m = 8 | bend at 0, 0 m
    ROAD outline = [[0, 0, 0], [9, 9, 0], [9, 0, 0], [0, 9, 0]] | outline | cross itself
    [street]\nblock_m = [200, 100] | street.block_m | lowest and a highest | 200 and 100
    [street]\nloop = true\nlength_m = 300 | scene.toml | length_m | loop | >= 443 m | 300
    [street]\ncorners = "junctions" | scene.toml | street | corners | needs loop = true
    [street]\nloop = true\ncorners = "junctions"\nbend_radius_m = [20, 40] | bend_radius_m | corners = "junctions"
    [street]\nlane = 2 | 'street.lane'
    extends = "drove" | scene 'drove' | drive
    extends = "scene.toml" | extends | scene.toml extends this file
    extends = "circle.toml" | circle.toml | extends
    extends = "below.toml" | below.toml | bodies[0] | table | "x"
    extends = "none.toml" | none.toml | no such file
    extends = "ok.obj" | extends | TOML scene file | ok.obj
    extends = "drive"\nwithout = ["lorry"] | without | 'lorry'
    extends = "drive"\n[ego]\nmesh = "none.obj" | ego.mesh | none.obj | no such file
    """,
    MESH='[[bodies]]\nname = "thing"\nmaterial = "concrete"\nmesh =',
    WALK='[ego]\nspeed_m_s = 1\n[[bodies]]\nname = "a"\nmaterial = "denim"\nmesh = "walker.glb"\n',
    BALL='[[bodies]]\nname = "b"\nprimitive = "sphere"\nradius_m = 1\nmaterial = "concrete"\n',
    ROAD='[[bodies]]\nname = "road"\nprimitive = "ground"\ncrown_m = 0.1\nspacing_m = 0.4\nmaterial = "asphalt"\n',
    BOX='[[bodies]]\nname = "box"\nprimitive = "box"\nsize_m = [1, 1, 1]\nmaterial = "brick"\n',
    LONG="long" * 99,
)
def test_scene(given: str, named: str) -> None:
    """A scene of its own, or a file that extends the same one."""
    Path("scene.toml").write_text(given)
    with told(named):
        load_scene("scene.toml")


@mistakes(
    r"""
    [[sensors]] -> [[sensor]] | 'sensors'
    "left" -> "roof" | unique | 'roof' twice
    "left" -> "../left" | letters, digits, - and _ | '../left'
    "left" -> "" | sensors[1].label | empty | ""
    own.toml -> none.toml | rig.toml | sensors[1 "left"] | none.toml | no such file
    table1-apd -> no-such | rig.toml | sensors[0 "roof"] | 'no-such'
    detector.gain -> detector.gian | sensors[0 "roof"] | 'detector.gian'
    yaw_deg -> yaw | 'sensors[1].yaw' | yaw_deg?
    """
)
def test_rig(given: str, named: str) -> None:
    old, _, new = given.partition(" -> ")
    Path("rig.toml").write_text(ROOF_AND_LEFT.replace(old, new))
    with told(named):
        load_rig("rig.toml")


def box() -> trimesh.Trimesh:
    return trimesh.creation.box()


@pytest.mark.parametrize(
    ("call", "first"),
    [
        (lambda: load_scene("car", overrides=[1]), "overrides: must be"),
        (lambda: load_scene("car", overrides={"sun.x": 1}), " overrides sun.x=1: unknown key"),
        (lambda: load_scene("car", overrides=["sun"]), "overrides sun: must be"),
        (lambda: load_scene("car").replace({"sun.x": 1}), "car changes sun.x=1: unknown key"),
    ],
)
def test_a_call_names_only_options_that_it_has(call: Callable[[], Any], first: str) -> None:
    with pytest.raises(InputError) as caught:
        call()
    assert first in str(caught.value)
    assert "scene_overrides" not in str(caught.value)


test_calls = calls(
    (lambda: load_scene("scenes/none/car.toml"), "no such file | its name, car"),
    (lambda: load_scene("kar"), "scene 'kar' | car"),
    (lambda: load_scene("car", overrides={"laser.x": 1}), "'laser' | sensor | render | by overrides"),
    (lambda: load_scene("car", overrides={"wear.x": 1}), "'wear' | sensor | render | by overrides"),
    (lambda: load_scene(given_file("a\udcff.obj", TRIANGLE)), "a\udcff.obj | UTF-8"),
    (lambda: load_scene("car", overrides={"bodies.car.mesh": "a\udcff.obj"}), "bodies.car.mesh | UTF-8 text"),
    (lambda: load_scene("car", option=1, scene_overrides="a.b=1"), "option | car.toml"),
    (lambda: load_scene("out/kar"), "out/kar | no such file"),
    (lambda: load_rig("rig", overrides=["rear:a.b=1"]), "overrides rear:a.b=1 | 'rear' | roof"),
    (lambda: Scene().add(box(), "asphalt", (0, 0, 0), position=(2.0, 0.0, 1.0)), "pose | position"),
    (lambda: Scene().add(box(), "asphalt", position="here"), "position | x, y, z | 'here'"),
    (lambda: Scene().add(box(), "asphalt", position=(1, 2)), "position | x, y, z | (1, 2)"),
    (lambda: load_scene("car").replace("sun.illuminace_klux=3"), "sun.illuminace_klux | illuminance_klux?"),
    (lambda: load_scene("car").add(box(), "brick").replace("bodies.house.yaw_deg=3"), "before bodies are added"),
    (lambda: Scene().replace("sun.illuminance_klux=3"), "load_scene"),
    (lambda: load_scene("car").remove("road").save("mine.toml"), "'road' | removed"),
    (lambda: load_scene("car").save("mine.glb"), "mine.glb | .toml"),
    (lambda: load_scene("car").add(box(), "asphalt").save("/dev/null/mine.toml"), "/dev/null", OutputError),
    *(
        (lambda wrong=wrong: load_scene(given_file("a.obj", TRIANGLE), overrides=[f"bodies.mesh.{wrong}"]), named)
        for wrong, named in (
            ("scale=-1", "bodies | a.obj | scale | > 0 | -1"),
            ("scale=big", 'bodies | a.obj | scale | number | "big"'),
            ("roll_deg=left", 'bodies | a.obj | roll_deg | number | "left"'),
            ("unit=mile", "bodies | a.obj | unit | 'mm' | \"mile\""),
            ("up=w", "bodies | a.obj | up | 'z' | \"w\""),
        )
    ),
)
