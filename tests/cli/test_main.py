"""The command line: what it writes and says, and what its options mean."""

import io
import json
import math
import re
import signal
import subprocess
import sys
import tomllib
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import jsonschema
import numpy as np
import pytest
from helpers.child import assert_ended
from helpers.command_line import COARSE, WALL, Run
from helpers.run_seed import chosen

from lidarscene import __version__, catalog
from lidarscene.cli import terminal
from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.detection.outcomes import Status
from lidarscene.errors import OptionWarning

ROOT = Path(__file__).parents[2]
RIGS = [catalog.path_of("examples", "rig")]
JOBS = [catalog.path_of("examples", "job")]
SCENES = sorted((ROOT / "scenes").glob("*.toml"))

# A wall of which some echoes are kept, some are lost in noise, and beside which false alarms come.
HARD = (
    "--set=laser.peak_power_w=0.0009",
    "--set=tdc.threshold_to_noise=2.5",
    "--set=tdc.window_us=1",
    "--set=scanner.azimuth_step_deg=0.5",
    "--set=scanner.elevation_step_deg=0.5",
)


def render(run: Run, scene: str, *argv: str, output: str = "o.ply") -> PointCloud:
    run.well("render", scene, "-o", output, *COARSE, *argv)
    return PointCloud.load(output)


def summary(run: Run, scene: str, *argv: str) -> dict[str, Any]:
    printed = run.well("render", scene, "-o", "o.ply", *COARSE, "--json", *argv)
    summary_read: dict[str, Any] = json.loads(printed)
    return summary_read


def test_no_command_prints_help(run: Run) -> None:
    ran = run()
    assert (ran.code, ran.out) == (2, "")
    assert "render" in ran.err
    assert "doctor" in ran.err


@pytest.mark.parametrize("command", ["", "render", "catalog", "doctor", "schema"])
def test_help(run: Run, command: str) -> None:
    printed = run.well(*([command] if command else []), "-h")
    assert printed.startswith(f"usage: lidarscene {command}".rstrip())


@pytest.mark.parametrize(("words", "option"), [(["help", "schema"], ["schema", "-h"]), (["help"], ["-h"])])
def test_help_is_a_command_too(run: Run, words: list[str], option: list[str]) -> None:
    assert run(*words) == run(*option)


def test_version(run: Run) -> None:
    assert run("--version").out == run("version").out == f"lidarscene {__version__}\n"


def test_bash_completes_commands_and_options(run: Run, tmp_path: Path) -> None:
    """Reference: Bash itself, which runs the script and completes two lines."""
    (tmp_path / "completion.sh").write_text(run("completion", "bash").out)
    for line, completed in (("lidarscene ren", "render"), ("lidarscene render --pict", "--picture")):
        words = line.split()
        script = f"source completion.sh; COMP_WORDS=({line}); COMP_CWORD={len(words) - 1}; "
        script += "_shtab_lidarscene; echo ${COMPREPLY[@]}"
        ran = subprocess.run(["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True)
        assert ran.stdout == f"{completed}\n"
    ran = run("completion", "fish")
    assert (ran.code, ran.out) == (2, "")
    assert "'fish'" in ran.err


def test_a_quiet_command_prints_no_summary(run: Run, tmp_path: Path) -> None:
    """Errors and notes remain: they say that something is wrong."""
    (tmp_path / "wall.toml").write_text(WALL)
    ran = run("render", "wall.toml", "-o", "a.ply", *COARSE, "-q")
    assert (ran.code, ran.out, (tmp_path / "a.ply").is_file()) == (0, "", True)
    assert json.loads(run("render", "wall.toml", "-o", "a.ply", *COARSE, "-q", "--json").out)["points"] > 0
    assert "no scene 'kar'" in run("render", "kar", "-o", "a.ply", "-q").err


def test_catalog(run: Run) -> None:
    whole_catalog = run("catalog")
    assert (whole_catalog.code, whole_catalog.err) == (0, "")
    assert whole_catalog.out == "".join(run("catalog", kind).out for kind in catalog.KINDS)
    for kind in catalog.KINDS:
        listed = {line.split()[0] for line in run("catalog", kind).out.splitlines()[1:]}
        assert listed == set(catalog.names(kind))
    entry = run("catalog", "materials", "concrete").out
    assert tomllib.loads(entry) == tomllib.loads(catalog.path_of("materials", "concrete").read_text("utf-8"))


def test_a_terminal_of_few_letters_has_escapes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: the catalogue, which was printed to it, has no such letters."""
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, "ascii"))
    terminal.print_text("50 \u00b5m")
    assert written.getvalue().split() == [b"50", b"\\xb5m"]


@pytest.mark.parametrize(
    ("kind", "files", "wrong"),
    [
        ("scene", SCENES, ({"sun": {"azimut_deg": 1}}, {"sky": {"diffuse_share": -1}})),
        ("sensor", sorted(catalog.folder("sensors").glob("*.toml")), ({"laser": {}}, {"detector": {"type": "ccd"}})),
        ("material", sorted(catalog.folder("materials").glob("*.toml")), ({"reflectivity": 2},)),
        ("rig", RIGS, ({"sensors": []}, {"sensors": [{"label": "a"}]})),
        ("job", JOBS, ({"format": "docx"}, {"sweep": {"scene": {"sun.azimuth_deg": 5}}})),
    ],
    ids=("scene", "sensor", "material", "rig", "job"),
)
def test_schema_takes_what_we_ship_and_no_more(run: Run, kind: str, files: list[Path], wrong: Any) -> None:
    """Each file as it is; the first and the last with each mistake."""
    schema = json.loads(run("schema", kind).out)
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    shipped = [tomllib.loads(file.read_text(encoding="utf-8")) for file in files]
    assert shipped
    assert [file for file, tables in zip(files, shipped, strict=True) if not validator.is_valid(tables)] == []
    for mistake in wrong:
        for tables in (shipped[0], shipped[-1]):
            assert not validator.is_valid(tables | mistake), mistake


def test_the_summary_says_what_walk_may_be_left(run: Run, wall: str, mi: ModuleType) -> None:
    """The line stands for SPADs whose echoes of different powers look alike, and for no others."""
    text = run("render", wall, "--sensor", "sony-spad-189x600", "-o", "o.ply").out
    assert re.search(r"^walk +up to 0\.75 m of pile-up may be left", text, re.MULTILINE)
    assert "walk" not in run("render", wall, "-o", "o.ply").out


def test_summary_adds_up(run: Run, wall: str, mi: ModuleType) -> None:
    """A pulse with one stop gives an echo, or is missed for one reason."""
    counts_of_run = summary(run, wall, *HARD)
    cloud = PointCloud.load("o.ply")
    assert counts_of_run["beams"] == 81 * 41
    assert counts_of_run["hits"] + counts_of_run["missed"]["no_surface"] == counts_of_run["beams"]
    assert counts_of_run["echoes"] + sum(counts_of_run["missed"].values()) == counts_of_run["beams"]
    assert counts_of_run["echoes"] + counts_of_run["false_alarms"] == counts_of_run["points"] == len(cloud)
    assert counts_of_run["false_alarms"] == np.count_nonzero(cloud.status)
    for count in (
        counts_of_run["echoes"],
        counts_of_run["false_alarms"],
        *(counts_of_run["missed"][k] for k in ("no_surface", "below_threshold")),
    ):
        assert count > 20
    assert set(counts_of_run["seconds"]) == {"load", "build", "record", "trace", "collect", "write"}
    assert all(seconds >= 0 for seconds in counts_of_run["seconds"].values())
    assert counts_of_run["beams_per_second"] > 0
    assert counts_of_run["output"] == "o.ply"


def test_text_says_what_json_says(run: Run, wall: str, mi: ModuleType) -> None:
    counts_of_run = summary(run, wall, *HARD)
    lines = run("render", wall, "-o", "o.ply", *COARSE, *HARD).out.splitlines()
    numbers = {line[26:].strip() or line.split()[0]: line[:26].split()[-1] for line in lines[1:8]}
    assert numbers["beams"] == f"{counts_of_run['beams']:,}"
    assert numbers["hits"] == f"{counts_of_run['hits']:,}"
    assert numbers[f"of which {counts_of_run['false_alarms']:,} false alarms"] == f"{counts_of_run['points']:,}"
    for reason, count in counts_of_run["missed"].items():
        assert numbers[reason.replace("_", " ")] == f"{count:,}"
    assert all(stage in lines[8] for stage in counts_of_run["seconds"])
    assert lines[10].split() == ["wrote", "o.ply"]


def test_missed_pulses_and_echoes_are_all_pulses(run: Run, wall: str, mi: ModuleType) -> None:
    counts_of_run = summary(run, wall, *HARD, "--keep-missed", "m.npz")
    cloud = PointCloud.load("o.ply")
    with np.load("m.npz") as file:
        missed = dict(file)
    assert counts_of_run["keep_missed"] == "m.npz"
    echoes = cloud.status == 0
    angles = np.stack([cloud.azimuth_rad[echoes], cloud.elevation_rad[echoes]], axis=1)
    missed_angles = np.stack([missed["azimuth_rad"], missed["elevation_rad"]], axis=1)
    all_angles = np.concatenate([angles, missed_angles])
    assert len(np.unique(all_angles, axis=0)) == len(all_angles) == counts_of_run["beams"]
    assert len(np.unique(missed["pulse"])) == len(missed["pulse"]) == len(missed_angles)
    names = [str(name) for name in missed["reason_names"]]
    counts = np.bincount(missed["reason"], minlength=len(names))
    assert (
        dict(zip((name.replace(" ", "_") for name in names), counts, strict=True))
        == {"kept": 0} | counts_of_run["missed"]
    )
    np.testing.assert_array_equal(missed["channel"], missed["pulse"] // 81)
    np.testing.assert_allclose(missed["time_s"], missed["pulse"] / 50e3, rtol=1e-12)


def test_ascii_and_no_truth(run: Run, wall: str, mi: ModuleType) -> None:
    binary, text = render(run, wall), render(run, wall, "--ascii", output="t.ply")
    assert b"format ascii 1.0" in Path("t.ply").read_bytes()
    np.testing.assert_allclose(text.xyz_m, binary.xyz_m, rtol=1e-6)
    assert binary.has_truth
    assert not render(run, wall, "--no-truth").has_truth


def test_picture_and_new_folders(run: Run, wall: str, small_pictures: None, mi: ModuleType) -> None:
    counts_of_run = summary(run, wall, "--picture", "new/deep/o.PNG")
    assert counts_of_run["picture"] == "new/deep/o.PNG"
    assert Path("new/deep/o.PNG").read_bytes().startswith(b"\x89PNG")
    assert "picture" in counts_of_run["seconds"]


def test_sensor_of_the_scene_by_name_and_by_file(run: Run, tmp_path: Path, wall: str, mi: ModuleType) -> None:
    text = catalog.path_of("sensors", "table1-sipm").read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(text.replace('"table1-sipm"', '"mine"'), encoding="utf-8")
    (tmp_path / "own.toml").write_text('[sensor]\nname = "mine.toml"\n' + WALL)
    assert render(run, wall).metadata["sensor"] == "table1-apd"
    assert render(run, wall, "--sensor", "table1-sipm").metadata["sensor"] == "table1-sipm"
    assert render(run, wall, "--sensor", "mine.toml").metadata["sensor"] == "mine"
    assert render(run, "own.toml").metadata["sensor"] == "mine"
    assert render(run, "own.toml", "--sensor", "table1-apd").metadata["sensor"] == "table1-apd"


def position_m(cloud: PointCloud) -> list[float]:
    return [float(x) for x in cloud.sensor_position_m]


@pytest.mark.parametrize("form", [("--pose", "-5,0,2"), ("--pose=-5,0,2",), ("--pose", "-5.0,0,2e0,0,0,0")])
def test_pose_may_begin_with_a_minus(run: Run, wall: str, mi: ModuleType, form: tuple[str, ...]) -> None:
    assert position_m(render(run, wall, *form)) == [-5, 0, 2]


def test_pose_stands_over_the_scenes_own(run: Run, tmp_path: Path, mi: ModuleType) -> None:
    (tmp_path / "own.toml").write_text("[sensor]\nposition_m = [1, 2, 3]\nyaw_deg = 180\n" + WALL)
    empty_cloud = render(run, "own.toml")
    assert position_m(empty_cloud) == [1, 2, 3]
    assert not (empty_cloud.status == Status.ECHO).any()
    towards = render(run, "own.toml", "--pose", "1,0,0")
    assert position_m(towards) == [1, 0, 0]
    assert (towards.status == Status.ECHO).any()


def centre_deg(cloud: PointCloud) -> tuple[float, float]:
    """Where the sensor sees the middle of the wall."""
    assert len(cloud) > 5
    return float(np.degrees(cloud.azimuth_rad.mean())), float(np.degrees(cloud.elevation_rad.mean()))


@pytest.mark.parametrize(
    ("pose", "azimuth_deg", "elevation_deg"),
    [("0,0,0", 0, 0), ("0,0,0,6", -6, 0), ("0,0,0,0,4", 0, -4), ("0,0,0,-6,-4", 6, 4), ("0,0,0,4,0,90", 0, 4)],
)
def test_yaw_turns_left_pitch_up_and_roll_the_left_side_up(
    run: Run, tmp_path: Path, mi: ModuleType, pose: str, azimuth_deg: float, elevation_deg: float
) -> None:
    """Rationale: a sensor turned left sees the wall on its right; looking up, below. Rolled by 90 degrees its
    left side is up, so what is on the right of an upright sensor is up in its own frame.
    Tolerance: half a step of the raster.
    """
    (tmp_path / "small.toml").write_text(WALL.replace("[4, 4]", "[2, 2]").replace("10, 0, 1.8", "10, 0, 0"))
    azimuth, elevation = centre_deg(render(run, "small.toml", f"--pose={pose}"))
    assert azimuth == pytest.approx(azimuth_deg, abs=1.0)
    assert elevation == pytest.approx(elevation_deg, abs=1.0)


def test_frames(run: Run, wall: str, mi: ModuleType) -> None:
    argv = ("--pose", "2,-1,1,10,3,5")
    clouds = render(run, wall, *argv), render(run, wall, *argv, "--frame", "sensor", output="s.ply")
    world, sensor = (cloud.select(status="echo") for cloud in clouds)
    np.testing.assert_allclose(world.xyz_m[:, 0], 10, atol=0.3)
    range_m = np.linalg.norm(sensor.xyz_m, axis=1)
    np.testing.assert_allclose(np.linalg.norm(world.xyz_m - [2, -1, 1], axis=1), range_m, rtol=1e-5)
    np.testing.assert_allclose(np.arcsin(sensor.xyz_m[:, 2] / range_m), sensor.elevation_rad, atol=1e-5)


def test_flipped_faces_lose_no_points(run: Run, tmp_path: Path, mi: ModuleType) -> None:
    """Inconsistent winding: every other triangle of a sphere turned inside out gives the same hits and echoes.

    The sphere is a little off, so that no ray meets an edge exactly.
    """
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=2, radius=3.0)
    turned = ball.faces.copy()
    turned[::2] = turned[::2, ::-1]
    clouds = []
    for name, faces in (("good", ball.faces), ("bad", turned)):
        trimesh.Trimesh(ball.vertices, faces, process=False).export(tmp_path / f"{name}.ply")
        (tmp_path / f"{name}.toml").write_text(
            f'[[bodies]]\nname = "ball"\nmesh = "{name}.ply"\nmaterial = "brick"\nposition_m = [12, 0.013, 0.007]\n'
        )
        clouds.append(render(run, f"{name}.toml"))
    good, bad = clouds
    assert len(good) > 40
    np.testing.assert_array_equal(good.azimuth_rad, bad.azimuth_rad)
    np.testing.assert_array_equal(good.elevation_rad, bad.elevation_rad)
    np.testing.assert_allclose(good.true_range_m, bad.true_range_m, rtol=1e-6)
    np.testing.assert_allclose(good.intensity, bad.intensity, rtol=1e-4)


def test_bodies_classes_and_materials_in_the_cloud(run: Run, tmp_path: Path, mi: ModuleType) -> None:
    """A wall in front, two instances of a box beside it: who was hit is who stands there."""
    (tmp_path / "three.toml").write_text(
        WALL + '[[bodies]]\nname = "post"\nclass = "pole"\nprimitive = "box"\nsize_m = [1, 1, 6]\nmaterial = "brick"\n'
        "instances = [{ position_m = [9, 3, 0] }, { position_m = [9, -3, 0] }]\n"
    )
    cloud = render(run, "three.toml")
    assert cloud.body is not None
    assert cloud.class_id is not None
    assert cloud.material is not None
    body = np.array(cloud.body_names)[cloud.body]
    assert set(body) == {"wall", "post.0", "post.1"}
    for name, side in (("post.0", 1), ("post.1", -1)):
        assert (np.sign(cloud.xyz_m[body == name, 1]) == side).all()
    assert (np.abs(cloud.xyz_m[body == "wall", 1]) < 2.1).all()
    is_post = np.char.startswith(body, "post")
    np.testing.assert_array_equal(np.array(cloud.class_names)[cloud.class_id] == "pole", is_post)
    np.testing.assert_array_equal(np.array(cloud.material_names)[cloud.material] == "brick", is_post)


def test_names_of_all_kinds_of_letters(run: Run, tmp_path: Path, wall: str, mi: ModuleType) -> None:
    """Reports and pages escape the bytes of a name that are no text."""
    cloud = "Köln \udcff\n.ply"
    for words in (["render", wall, "-o", cloud, *COARSE], ["view", cloud, "--save", "a.html"]):
        run.well(*words)
    assert len(list(tmp_path.glob("K*.ply"))) == 1
    run("compare", cloud, cloud, "-o", "report")  # matplotlib draws no such letter, which is a note
    assert "Köln \\udcff" in (tmp_path / "report" / "index.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("scene", chosen(3, SCENES), ids=lambda path: path.stem)
def test_shipped_scene_renders(run: Run, mi: ModuleType, scene: Path) -> None:
    raster = scene.stem not in ("drive", "town")  # whose sensor turns, and has no steps
    coarse = (
        ("--set=scanner.azimuth_step_deg=2", "--set=scanner.elevation_step_deg=2")
        if raster
        else ("--set=scanner.columns_per_turn=64", "--set=laser.repetition_rate_khz=81.92")
    )
    printed = run.well("render", str(scene), "-o", "o.ply", *coarse, "--json")
    counts_of_run = json.loads(printed)
    assert counts_of_run["points"] > 20
    cloud = PointCloud.load("o.ply")
    assert cloud.class_names
    assert math.isfinite(float(cloud.xyz_m.sum()))


@pytest.fixture
def own_handlers() -> Iterator[None]:
    """Handlers of signals are those of before when the test ends; Ctrl-C has Python's own."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    for number, handler in handlers.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("own_handlers")
@pytest.mark.parametrize(
    ("number", "raised", "told_line"),
    [(signal.SIGTERM, SystemExit, ""), (signal.SIGINT, KeyboardInterrupt, "lidarscene: interrupted\n")],
)
def test_a_signal_that_a_library_makes_an_error_of(
    number: signal.Signals, raised: type[BaseException], told_line: str, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SIGTERM within Dr.Jit comes out as a RuntimeError, Ctrl-C while it is imported as a NameError, or as a machine
    that has no back end: the code is still that of the signal, without a traceback.
    """

    def end_within_a_library(_: object) -> None:
        with pytest.raises(raised):
            signal.raise_signal(number)
        raise NameError("_drjit_ext")

    monkeypatch.setattr(terminal, "_ENDED_BY", [])
    monkeypatch.setattr("lidarscene.cli.catalog_commands.run_schema", end_within_a_library)
    terminal.end_cleanly()
    ran = run("schema", "scene")
    assert (ran.code, ran.out, ran.err) == (128 + number, "", told_line)


@pytest.mark.usefixtures("own_handlers")
def test_ctrl_c_that_is_ignored_stays_so() -> None:
    """What a shell starts with nohup or in the background goes on."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    terminal.end_cleanly()
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


FIRST_CLOUD = """
import json, sys
from lidarscene.kernel.device.backend import drjit
dr = drjit()
from drjit import ast
from lidarscene.cli.main import main
with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
    code = main(["render", {scene!r}, "-o", {path!r}])
    kernels = {{one["hash"] for one in dr.kernel_history((dr.KernelType.JIT,))}}
print(json.dumps([code, ast._syntax_counter, len(kernels), sorted(sys.modules)]))
"""

NOT_FOR_A_CLOUD = """
    scipy matplotlib PIL pandas pyarrow laspy dask distributed open3d http.server numpy.ma unittest asyncio mitsuba.test
"""


def test_the_first_cloud_takes_no_more_than_it_needs(tmp_path: Path, run_python) -> None:
    """What a start costs, by construction: no library that a PLY does not need, no integrator of Mitsuba rewritten, and
    not many kernels to compile where none is cached. A scene without mesh files: the first read of one takes trimesh.
    """
    process = run_python(
        FIRST_CLOUD.format(scene=str(ROOT / "scenes" / "edges.toml"), path=str(tmp_path / "edges.ply"))
    )
    assert_ended(process, stderr=None)
    code, rewritten, kernels, modules = json.loads(process.stdout.splitlines()[-1])
    assert code == 0
    assert (tmp_path / "edges.ply").is_file()
    assert rewritten == 0
    assert 5 <= kernels <= 24
    assert [name for name in NOT_FOR_A_CLOUD.split() if name in modules] == []


def test_warnings_of_libraries_do_not_reach_a_user(capsys: pytest.CaptureFixture[str]) -> None:
    """Rationale: NumPy tells of numbers of a damaged file that overflow, which says nothing to whoever reads it."""
    with terminal.notes():
        warnings.simplefilter("always")
        warnings.warn("overflow encountered in cast", RuntimeWarning, stacklevel=1)
        warnings.warn(OptionWarning("{seed} has no effect"), stacklevel=1)
    assert capsys.readouterr().err == "lidarscene: note: --seed has no effect\n"
