"""Mistakes: each gives one clear line, exit code 2, and leaves nothing behind."""

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from helpers.command_line import COARSE, WALL, Ran, Run
from helpers.folders import raise_disk_full

from lidarscene.rendering.simulator import Simulator

NOISE = np.random.default_rng(7).bytes(2000)
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
MESH = '[[bodies]]\nname = "thing"\nmaterial = "concrete"\nmesh = "{}"\n'
XML = "<scene version='3.0.0'><bsdf type='diffuse' id='grey'/><shape type='sphere' id='ball'/></scene>"


def files_in(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def error_line(run: Run, folder: Path, *argv: str) -> str:
    """The one line that this command line gets, without the program's name."""
    before = files_in(folder)
    ran: Ran = run(*argv)
    assert ran.code == 2, ran
    assert ran.out == ""
    assert ran.err.startswith("lidarscene: error: ")
    assert ran.err.count("\n") == 1
    assert ran.err.endswith("\n")
    assert files_in(folder) == before
    return ran.err.removeprefix("lidarscene: error: ").rstrip("\n")


def error_line_of_scene(run: Run, folder: Path, text: str, *more: str) -> str:
    (folder / "scene.toml").write_text(text)
    return error_line(run, folder, "render", "scene.toml", "-o", "new/out.ply", *COARSE, *more)


def test_files_come_behind_the_mistake(run: Run, tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text("lenght = 3")
    line = error_line(run, tmp_path, "render", str(scene), "-o", "out.ply")
    assert line.startswith("unknown key 'lenght'")
    assert line.endswith(f" ({scene})")
    assert error_line(run, tmp_path, "render", str(tmp_path / "none.toml"), "-o", "out.ply").startswith(
        "no such file ("
    )


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.obj", TRIANGLE.replace("v 1", "v nan"), "a.obj: 1 of 3 vertices are not finite numbers"),
        ("a.obj", TRIANGLE.replace("v 1", "v 1e308"), "a.obj: 1 of 3 vertices are not finite numbers"),
        ("a.obj", TRIANGLE.replace("2 3", "2 9"), "a.obj: cannot be read as a mesh: "),
        ("a.obj", "", "a.obj: the mesh must have at least one triangle, got none"),
        ("a.stl", "", "a.stl: the mesh must have at least one triangle, got none"),
        ("a.obj", "v 0 0 0\n", "a.obj: the mesh must have at least one triangle"),
        ("a.ply", NOISE, "a.ply: cannot be read as a mesh: "),
        ("a.glb", NOISE, "a.glb: cannot be read as a mesh: "),
        ("a.obj", NOISE, "a.obj: "),
        ("a.stl", NOISE, "a.stl: "),
        ("a.fbx", b"1", "a.fbx: an FBX file, which is not read; import it into Blender and export glTF (File, Export,"),
        ("a.STEP", b"1", "a.STEP: a STEP file of CAD, which is not read; export OBJ or STL from FreeCAD; or import"),
        ("a.xyzw", b"1", "a.xyzw: cannot be read as a mesh: file_type 'xyzw' not supported"),
        (
            "a.obj",
            "v 2 2 2\nv 2 2 2\nv 2 2 2\nf 1 2 3\n",
            "across and reach <= 1e+08 m from its origin, got 0 m and 2 m",
        ),
    ],
)
def test_bad_mesh(run: Run, tmp_path: Path, name: str, content: str | bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    line = error_line_of_scene(run, tmp_path, MESH.format(name))
    assert line.startswith('bodies[0 "thing"]')
    assert line.endswith(" (scene.toml)")
    assert message in line


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("none.glb", "none.glb: no such file"),
        ("folder", "folder: must be a mesh file, got a folder"),
        ("long" * 99, f"{'long' * 99}: no such file"),
    ],
)
def test_mesh_that_is_not_there(run: Run, tmp_path: Path, name: str, message: str) -> None:
    (tmp_path / "folder").mkdir()
    line = error_line_of_scene(run, tmp_path, MESH.format(name))
    assert line == f'bodies[0 "thing"].mesh: {message} (scene.toml)'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the scene must have [[bodies]], [street] or base = ..., got none"),
        (WALL + "a = = 3\n", "not valid TOML: Invalid value (at line 9, column 5)"),
        ("x = 1\n" + WALL, "unknown key 'x'; known here: name, description, extends, without, base,"),
        (WALL + "colour = 1\n", "unknown key 'bodies[0 \"wall\"].colour'; known here: position_m, yaw_deg,"),
        (WALL + "[sun]\nazimut_deg = 1\n", "unknown key 'sun.azimut_deg'; did you mean azimuth_deg? all known "),
        (WALL + "instances = [{ yaw = 1 }]\n", "unknown key 'bodies[0 \"wall\"].instances[0].yaw'; did you mean yaw"),
        (WALL + "instances = []\n", 'bodies[0 "wall"].instances: must be a list of at least 1, got []'),
        (WALL + "scale = '2'\n", 'bodies[0 "wall"].scale: must be a number, got "2"'),
        (WALL + "scale = true\n", 'bodies[0 "wall"].scale: must be a number, got true'),
        (WALL + "scale = 0\n", 'bodies[0 "wall"].scale: must be > 0, got 0'),
        (WALL + "scale = -1.5\n", 'bodies[0 "wall"].scale: must be > 0, got -1.5'),
        (WALL + "scale = nan\n", 'bodies[0 "wall"].scale: must be a finite number, got NaN'),
        (WALL + "scale = 1e-9\n", 'bodies[0 "wall"]: with its scale a body must be >= 1e-06 m across'),
        (WALL + "scale = 1e300\n", 'bodies[0 "wall"].scale: must be <= 1e+06, got 1e+300'),
        (WALL.replace("[4, 4]", "4"), 'bodies[0 "wall"].size_m: must be a list, got 4'),
        (WALL.replace("[4, 4]", "[4]"), 'bodies[0 "wall"]: size_m of a plane must have 2 numbers, got 1'),
        (WALL.replace("[4, 4]", "[4, 0]"), 'bodies[0 "wall"].size_m[1]: must be > 0, got 0'),
        (WALL.replace("[10, 0, 1.8]", "[1, 0]"), 'bodies[0 "wall"].position_m: must be a longer list, got [1, 0]'),
        (WALL.replace("[10, 0, 1.8]", "[1e30, 0, 0]"), 'bodies[0 "wall"].position_m[0]: must be <= 1e+08'),
        (WALL.replace('"concrete"', "3"), 'bodies[0 "wall"].material: must be text, got 3'),
        (
            WALL.replace("concrete", "concrate"),
            "bodies[0 \"wall\"].material: no material 'concrate' in the catalogue; did you mean concrete or ",
        ),
        (WALL.replace('material = "concrete"', ""), "bodies[0 \"wall\"]: key 'material' is missing"),
        (WALL.replace('name = "wall"', ""), "key 'bodies[0].name' is missing"),
        (WALL.replace('"wall"', '""'), 'bodies[0 ""].name: must be text that is not empty, got ""'),
        (WALL + WALL, "names of bodies must be unique, got 'wall' twice"),
        (WALL + 'mesh = "a.obj"\n', 'bodies[0 "wall"]: one of mesh and primitive must be given, got both or none'),
        (WALL + "radius_m = 1\n", 'bodies[0 "wall"]: a plane must have size_m, got size_m and radius_m'),
        (WALL + 'materials = { a = "brick" }\n', 'bodies[0 "wall"]: materials is for the sub-meshes of a mesh'),
        (
            WALL.replace('"plane"', '"cone"'),
            "bodies[0 \"wall\"].primitive: must be 'plane', 'ground', 'box', 'sphere' or 'cylinder', got \"cone\"",
        ),
        (WALL + "[air]\nvisibility_km = 0\n", "air.visibility_km: must be >= 0.0001, got 0"),
        (
            WALL + "[air]\nvisibility_km = 1\ntransmittance = 1\n",
            (
                "air: must have only one of transmittance, "
                "extinction_per_m, visibility_km, got transmittance and visibility_km"
            ),
        ),
        (
            WALL + "[weather]\nfog = 'thick'\n",
            (
                "weather.fog: must be 'strong_advection', 'moderate_advection', "
                "'radiation', 'strong_spray', 'moderate_spray' or 'chu_hogg', got \"thick\""
            ),
        ),
        (WALL + "[weather]\nfog_visibility_km = 0\n", "weather.fog_visibility_km: must be >= 0.005, got 0"),
        (WALL + "[weather]\nsnow = 'powder'\n", "weather.snow: must be 'dry' or 'wet', got \"powder\""),
        (WALL + "[weather]\nrain = 5\n", "unknown key 'weather.rain'; did you mean weather.rain_mm_h?"),
        (WALL + "[sun]\nilluminance_klux = -1\n", "sun.illuminance_klux: must be >= 0, got -1"),
        (WALL + "[sensor]\nname = 'none.toml'\n", "no such file"),
        (WALL + "[sensor]\nname = 'table2'\n", "no sensor 'table2' in the catalogue; did you mean table1-"),
        (WALL + "[materials.x]\nreflectivity = 2\n", "materials.x.reflectivity: must be <= 1, got 2"),
        (
            WALL + "[materials.x]\nreflectivity = [{ wavelength_nm = 905, value = 2 }]\n",
            "materials.x.reflectivity[0].value: must be <= 1, got 2",
        ),
        (
            WALL + "[materials.x]\nreflectivity = 0.6\ntransmittance = 0.5\n",
            "materials.x: reflectivity and transmittance: must be <= 1 together, got 1.1",
        ),
        (
            WALL + "[materials.x]\nreflectivity = 0.6\ntransmittance = [{ wavelength_nm = 905, value = 0.45 }]\n",
            "materials.x: reflectivity and transmittance: must be <= 1 together, got 1.05 at 905 nm",
        ),
        (
            WALL + "[materials.x]\nreflectivity = 0.6\nbsdf = 'mirror'\ncover = 0.5\n",
            "materials.x: a mirror material has no cover",
        ),
        (WALL + "[materials.x]\nreflectivity = 0.6\ncover = 0\n", "materials.x.cover: must be > 0, got 0"),
        (
            WALL + "[materials.x]\nreflectivity = 0.1\nroughness = 0.1\n",
            ("materials.x: a diffuse material has no roughness"),
        ),
        (
            WALL + "[materials.x]\nreflectivity = 0.1\nbsdf = 'coated'\n",
            ("materials.x: a coated material needs coat_ior and coat_roughness"),
        ),
        (
            MESH.format("ok.obj") + 'materials = { roof = "brick" }\n',
            ("bodies[0 \"thing\"].materials: no sub-mesh 'roof' in ok.obj; it has ok.obj"),
        ),
        (
            MESH.format("ok.obj").replace("material =", "class ="),
            ("bodies[0 \"thing\"]: sub-mesh 'ok.obj' of ok.obj has no colour of its own and must have a material"),
        ),
        ('base = "none.xml"\n', "base: none.xml: no such file"),
        (f'base = "{"long" * 99}.xml"\n', f"base: {'long' * 99}.xml: no such file"),
        ('base = "ok.obj"\n', "base: ok.obj: the name of a Mitsuba scene must end in .xml"),
        (WALL + '[base_materials]\ngrey = "brick"\n', "base_materials must go with base, got no base"),
    ],
)
def test_bad_scene(run: Run, tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "ok.obj").write_text(TRIANGLE)
    line = error_line_of_scene(run, tmp_path, text)
    assert line.startswith(message)


def test_several_mistakes_are_counted(run: Run, tmp_path: Path) -> None:
    line = error_line_of_scene(run, tmp_path, WALL + "scale = 0\n[sky]\ndiffuse_share = -1\n")
    assert line.endswith(("got 0 (and 1 more) (scene.toml)", "got -1 (and 1 more) (scene.toml)"))


def test_text_that_is_not_utf_8(run: Run, tmp_path: Path) -> None:
    (tmp_path / "latin.toml").write_bytes(b'\nname = "caf\xe9"\n')
    assert error_line(run, tmp_path, "render", "latin.toml", "-o", "o.ply") == "not UTF-8 text (at line 2) (latin.toml)"


def test_scene_that_is_not_there(run: Run, tmp_path: Path) -> None:
    (tmp_path / "folder.toml").mkdir()
    (tmp_path / "folder.xml").mkdir()
    for name, message in (
        ("none.toml", "no such file"),
        ("none.xml", "no such file"),
        ("folder.toml", "must be a TOML file, got a folder"),
        ("folder.xml", "must be a Mitsuba XML scene, got a folder"),
    ):
        assert error_line(run, tmp_path, "render", name, "-o", "o.ply") == f"{message} ({name})"


def test_name_of_two_lines_is_told_in_one(run: Run, tmp_path: Path) -> None:
    assert error_line(run, tmp_path, "render", "two\nlines.toml", "-o", "o.ply") == "no such file (two\\nlines.toml)"


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("laser.peak_power_w=-3", "laser.peak_power_w: must be >= 1e-06, got -3"),
        ("laser.peak_power_w=big", 'laser.peak_power_w: must be a number, got "big"'),
        ("laser.peak_power_w=nan", "laser.peak_power_w: must be a finite number, got NaN"),
        (
            "laser.pek_power_w=3",
            "unknown key 'laser.pek_power_w'; did you mean peak_power_w? all known here: wavelength_nm, ",
        ),
        (
            "lasr.peak_power_w=3",
            "unknown key 'lasr'; did you mean laser? all known here: name, description, laser, optics, ",
        ),
        ("laser=3", "laser: must be a table, got 3"),
        ("scanner.azimuth_fov_deg=0", "scanner.azimuth_fov_deg: must be > 0, got 0"),
        ("scanner.elevation_fov_deg=0.0", "scanner.elevation_fov_deg: must be > 0, got 0.0"),
        ("scanner.azimuth_step_deg=41", "scanner: azimuth_step_deg: must be <= 40, azimuth_fov_deg, got 41"),
        ("scanner.type=galvo", "scanner.type: must be one of '"),
        ("detector.type=ccd", "detector.type: must be one of '"),
        ("detector.cells=3", "unknown key 'detector.cells'; known here: type, gain, "),
        ("detector.gain=0.5", "detector.gain: must be >= 1, got 0.5"),
        ("detector.ionisation_ratio=0.1", "one of excess_noise_index and ionisation_ratio must be given, got both"),
        ("tdc.threshold_level=1", "one of threshold_to_noise and threshold_level must be given, got both or none"),
        ("tdc.threshold_to_noise=1e-30", "tdc.threshold_to_noise: must be >= 0.01, got 1e-30"),
        ("tdc.stops=1.5", "tdc.stops: must be a whole number, got 1.5"),
        ("tdc.stops=0", "tdc.stops: must be >= 1, got 0"),
        ("mounting.position_m=[1, 2]", "mounting.position_m: must be a longer list, got [1, 2]"),
        ("mounting.position_m=[1, 2, 3, 4]", "mounting.position_m: must be a list of at most 3, "),
    ],
)
def test_bad_value_in_set(run: Run, tmp_path: Path, wall: str, assignment: str, message: str) -> None:
    line = error_line(run, tmp_path, "render", wall, "-o", "o.ply", *COARSE, "--set", assignment)
    assert "table1-apd.toml" in line
    assert f"--set {assignment}: " in line
    assert message in line


def test_more_pulses_than_there_are_numbers_for(run: Run, tmp_path: Path, wall: str) -> None:
    finest = ("--set=scanner.azimuth_step_deg=1e-6", "--set=scanner.elevation_step_deg=1e-6")
    line = error_line(run, tmp_path, "render", wall, "-o", "o.ply", *finest)
    assert "must have fewer than 2^31 pulses in a frame, got" in line


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("detector.gain", "must be KEY=VALUE, such as detector.gain=60"),
        ("=60", "must be KEY=VALUE, such as detector.gain=60"),
        ("detector..gain=60", "must be KEY=VALUE, such as detector.gain=60"),
        ("laser.peak_power_w.x=1", "laser.peak_power_w is a value, not a table"),
    ],
)
def test_bad_form_of_set(run: Run, tmp_path: Path, wall: str, assignment: str, message: str) -> None:
    line = error_line(run, tmp_path, "render", wall, "-o", "o.ply", "--set", assignment)
    assert line == f"--set {assignment}: {message}"


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["--seed", "-1"], "argument --seed: must be a whole number from 0 to 4294967295, got -1"),
        (["--seed", "4294967296"], "must be a whole number from 0 to 4294967295, got 4294967296"),
        (["--seed", "1.5"], "must be a whole number from 0 to 4294967295, got 1.5"),
        (["--chunk", "0"], "argument --chunk: must be a whole number from 1 to 2147483647, got 0"),
        (["--chunk", "many"], "must be a whole number from 1 to 2147483647, got many"),
        (
            ["--pose", "1,2"],
            ("argument --pose: must be X,Y,Z[,YAW,PITCH,ROLL] in metres (to 1e+08) and degrees, got 1,2"),
        ),
        (["--pose", "1,2,3,4,5,6,7"], "and degrees, got 1,2,3,4,5,6,7"),
        (["--pose", "nan,0,0"], "and degrees, got nan,0,0"),
        (["--pose", "-inf,0,0"], "and degrees, got -inf,0,0"),
        (["--pose", "1e300,0,0"], "and degrees, got 1e300,0,0"),
        (["--pose", "a,b,c"], "and degrees, got a,b,c"),
        (["--pose", "1,,2"], "and degrees, got 1,,2"),
        (["--pose", "--json"], "argument --pose: expected one argument"),
        (["--coordinates", "car"], "argument --coordinates/--frame: invalid choice: 'car'"),
        (["--sensor", "table1-apx"], "no sensor 'table1-apx' in the catalogue; did you mean table1-apd?"),
        (["--sensor", "none.toml"], "no such file"),
        (["--sensor", "long" * 99], f"no sensor '{'long' * 99}' in the catalogue; it has apd-905"),
        (["--sensor", "wall.toml"], "this looks like a scene file (wall.toml)"),
        (["--sensor", "./sensor"], "the name of a sensor file ends in .toml (./sensor)"),
        (["--picture", "o.gif"], "--picture o.gif: the name must end in .png or .svg"),
        (["--keep-missed", "o.csv"], "--keep-missed o.csv: the name must end in .npz"),
        (["--sed", "1"], "unrecognized arguments: --sed 1"),
    ],
)
def test_bad_option(run: Run, tmp_path: Path, wall: str, argv: list[str], message: str) -> None:
    (tmp_path / "sensor").write_text("")
    assert message in error_line(run, tmp_path, "render", wall, "-o", "new/o.ply", *argv)


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["rendr"], "argument COMMAND: invalid choice: 'rendr'"),
        (["render"], "the following arguments are required: SCENE, -o/--output; see lidarscene render -h"),
        (["catalog", "lasers"], "argument kind: invalid choice: 'lasers'"),
        (["catalog", "sensors", "table1"], "no sensor 'table1' in the catalogue; did you mean table1-"),
        (["catalog", "materials", "xyzzy"], "no material 'xyzzy' in the catalogue; it has asphalt, "),
        (["catalog", "materials", "../sensors/table1-apd"], "no material '../sensors/table1-apd' in the catalogue"),
        (["schema", "cloud"], "argument kind: invalid choice: 'cloud'"),
    ],
)
def test_bad_command(run: Run, tmp_path: Path, argv: list[str], message: str) -> None:
    assert error_line(run, tmp_path, *argv).startswith(message)


def test_wavelength_that_no_material_knows(run: Run, tmp_path: Path, wall: str, mi: ModuleType) -> None:
    argv = ("render", wall, "-o", "o.ply", *COARSE, "--set")
    line = error_line(run, tmp_path, *argv, "laser.wavelength_nm=800")
    assert line == "material 'concrete': no reflectivity at 800 nm; its table reaches from 850 to 1550 nm"
    assert run(*argv, "laser.wavelength_nm=1400").code == 0


@pytest.mark.parametrize(
    ("output", "message"),
    [
        ("wall.toml/o.ply", "is a file, not a folder"),
        ("/proc/none/o.ply", "cannot be written: "),
        (".", "the name must end in one of .ply, "),
        ("", "an argument is empty, behind -o"),
        ("folder.ply", "must be the name of a file, got a folder"),
        ("o.abc", "--output o.abc: the name must end in one of .ply, "),
        ("wall.toml", "--output wall.toml: the name must end in one of .ply, "),
    ],
)
def test_output_that_cannot_be(
    run: Run, tmp_path: Path, wall: str, monkeypatch: pytest.MonkeyPatch, output: str, message: str
) -> None:
    """It is told before anything is computed."""
    (tmp_path / "folder.ply").mkdir()
    monkeypatch.setattr("lidarscene.outputs.record.load_scene", lambda *_, **__: pytest.fail("the scene was read"))
    assert message in error_line(run, tmp_path, "render", wall, "-o", output)


def test_no_input_is_overwritten(run: Run, tmp_path: Path) -> None:
    (tmp_path / "mesh.ply").write_bytes(
        b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )
    (tmp_path / "link.ply").symlink_to("mesh.ply")
    content = (tmp_path / "mesh.ply").read_bytes()
    (tmp_path / "base.xml").write_text(
        "<scene version='3.0.0'><shape type='ply'><string name='filename' value='mesh.ply'/></shape></scene>"
    )
    (tmp_path / "scene.toml").write_text(MESH.format("mesh.ply"))
    (tmp_path / "based.toml").write_text('base = "base.xml"\n')
    for scene in ("scene.toml", "based.toml", "base.xml"):
        for output in ("mesh.ply", "./mesh.ply", "link.ply"):
            line = error_line(run, tmp_path, "render", scene, "-o", output, *COARSE)
            assert line == f"--output {Path(output)}: must be another name, got an input of this run"
    assert (tmp_path / "mesh.ply").read_bytes() == content


@pytest.mark.parametrize(
    ("target", "argv", "message", "kept_files"),
    [
        ("lidarscene.files.atomic._sync", [], "new/o.ply: cannot be written: No space left on device", set()),
        (
            "zipfile.ZipFile",
            ["--keep-missed", "new/m.npz"],
            "new/m.npz: cannot be written: No space left on device",
            set(),
        ),
        (
            "lidarscene.files.spool.Spool.append",
            ["--keep-missed", "new/m.npz"],
            "new/m.npz: cannot be written: No space left on device",
            set(),
        ),
    ],
)
def test_a_full_disk(
    run: Run,
    tmp_path: Path,
    wall: str,
    mi: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    target: str,
    argv: list[str],
    message: str,
    kept_files: set[str],
) -> None:
    """Nothing half written stays, not even a new folder; what was complete before does."""
    before = files_in(tmp_path)
    monkeypatch.setattr(target, raise_disk_full)
    ran = run("render", wall, "-o", "new/o.ply", *COARSE, *argv)
    assert (ran.code, ran.out, ran.err) == (2, "", f"lidarscene: error: {message}\n")
    assert files_in(tmp_path) - before == kept_files


def test_interrupt_leaves_nothing(
    run: Run, tmp_path: Path, wall: str, mi: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    before = files_in(tmp_path)
    for target in ("lidarscene.rendering.simulator.Simulator.stream", "lidarscene.files.atomic._sync"):
        with monkeypatch.context() as patch:
            patch.setattr(target, interrupted)
            ran = run("render", wall, "-o", "new/o.ply", *COARSE)
        assert (ran.code, ran.out, ran.err) == (130, "", "lidarscene: interrupted\n")
        assert files_in(tmp_path) == before


def test_memory_that_is_not_there(
    run: Run, tmp_path: Path, wall: str, mi: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    def too_much(*_: Any, **__: Any) -> None:
        raise MemoryError

    monkeypatch.setattr(Simulator, "stream", too_much)
    ran = run("render", wall, "-o", "new/o.ply", *COARSE)
    assert (ran.code, ran.err) == (1, "lidarscene: error: out of memory; a smaller --chunk needs less\n")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hello", "not valid XML: syntax error: line 1, column 0"),
        (NOISE, "not valid XML: "),
        ("<?xml version='1.0' encoding='klingon'?><scene/>", "not valid XML: "),
        ("<page/>", "not a Mitsuba scene: "),
        ("<scene version='3.0.0'/>", "the scene has no shapes"),
        (XML.replace("sphere", "spher"), "shape type: must be one of Mitsuba's own plugins, got 'spher'"),
        (
            XML.replace("'ball'>", "'ball'><float name='size' value='2'/>").replace(
                "'ball'/>", "'ball'><float name='size' value='2'/></shape>"
            ),
            "not a Mitsuba scene: Found 1 unreferenced",
        ),
        (
            "<scene version='3.0.0'><shape type='obj'><string name='filename' value='none.obj'/></shape></scene>",
            'not a Mitsuba scene: failed to instantiate shape plugin of type "obj"',
        ),
        ("<scene version='3.0.0'><include filename='none.xml'/></scene>", "no such file"),
        ("<scene version='3.0.0'><include filename='a.xml'/></scene>", "files include each other"),
        ("<scene version='3.0.0'><include filename='$part.xml'/></scene>", "not a Mitsuba scene: "),
        (
            "<scene version='3.0.0'><shape type='sphere' id='one'><bsdf type='hair' id='h'/></shape></scene>",
            "BSDF 'h' of shape 'one': cannot be used: ",
        ),
    ],
)
def test_bad_mitsuba_scene(run: Run, tmp_path: Path, mi: ModuleType, text: str | bytes, message: str) -> None:
    (tmp_path / "a.xml").write_bytes(text if isinstance(text, bytes) else text.encode())
    assert error_line(run, tmp_path, "render", "a.xml", "-o", "o.ply", *COARSE).startswith(message)


@pytest.mark.parametrize(
    ("mapped", "message"),
    [
        ('gray = "brick"', "base_materials: no BSDF with id 'gray'; it has grey"),
        ('grey = "brik"', "base_materials.grey: no material 'brik' in the catalogue; did you mean brick"),
    ],
)
def test_bad_base_materials(run: Run, tmp_path: Path, mi: ModuleType, mapped: str, message: str) -> None:
    (tmp_path / "a.xml").write_text(XML)
    line = error_line_of_scene(run, tmp_path, f'base = "a.xml"\n[base_materials]\n{mapped}\n')
    assert line.startswith(message)
