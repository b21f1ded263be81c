"""Plausible mistakes over all commands and in Python, as typed: each gets one line that says what to do."""

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.clouds import small_cloud
from helpers.command_line import Run
from helpers.documentation import ROOT

import lidarscene
from lidarscene import catalog
from lidarscene.errors import LidarSceneError

JOB = catalog.path_of("examples", "job")

LONGEST = 460
"""Characters of an answer: all keys of a table, or all formats, in some lines of a terminal."""

TYPED = [
    # render
    ("render", "required: SCENE, -o/--output; see lidarscene render -h"),
    ("render car", "required: -o/--output; see lidarscene render -h"),
    ("render cars -o a.ply", "no scene 'cars' in the catalogue; did you mean car?"),
    ("render table1-apd -o a.ply", "no scene 'table1-apd' in the catalogue; table1-apd is a sensor"),
    ("render wall.toml -o a.txt", "--output a.txt: the name must end in one of .ply,"),
    ("render wall.toml -o a.ply --format las", "--output a.ply: the name must end in .las"),
    ("render wall.toml -o a.ply --format pdc", "invalid choice: 'pdc'; did you mean pcd?"),
    ("render wall.toml -o a.ply --verbose", "unrecognized arguments: --verbose; see lidarscene render -h"),
    ("render wall.toml -o a.ply --colour", "unrecognized arguments: --colour; did you mean --colours?"),
    ("render wall.toml -o a.ply --sensors vlp-16", "unrecognized arguments: --sensors vlp-16; did you mean --sensor?"),
    ("render wall.toml -o a.ply --sensor vlp17", "no sensor 'vlp17' in the catalogue; did you mean vlp-16"),
    ("render wall.toml -o a.ply --sensor car", "no sensor 'car' in the catalogue; car is a scene"),
    ("render wall.toml -o a.ply --sensor wall.toml", "(and 5 more); this looks like a scene file"),
    ("render wall.toml -o a.ply --rig wall.toml", "key 'sensors' is missing (and 1 more); this looks like a scene"),
    ("render wall.toml -o a.ply --rig rig --sensor vlp-16", "must be only one of them, got both"),
    (f"render {JOB} -o a.ply", "this looks like a job file"),
    ("render job -o a.ply", "no scene 'job' in the catalogue; job is an example"),
    ("render wall.toml -o a.ply --set gain=60", "unknown key 'gain'; did you mean detector.gain?"),
    ("render wall.toml -o a.ply --set peak_power=60", "unknown key 'peak_power'; did you mean laser.peak_power_w?"),
    ("render wall.toml -o a.ply --set laser.power=3", "unknown key 'laser.power'; did you mean laser.peak_power_w?"),
    ("render wall.toml -o a.ply --set power=50", "power: must be a table, got 50; did you mean laser.peak_power_w?"),
    ("render wall.toml -o a.ply --set led.power_w=50", "unknown key 'led'; did you mean laser.peak_power_w?"),
    ("render wall.toml -o a.ply --set lasr.power=50", "unknown key 'lasr'; did you mean laser? all known here: "),
    ("render wall.toml -o a.ply --set laser.w=50", "unknown key 'laser.w'; known here: wavelength_nm,"),
    ("render wall.toml -o a.ply --set scanner.fov=9", "mean scanner.azimuth_fov_deg or scanner.elevation_fov_deg?"),
    ("render wall.toml -o a.ply --scene-set sun.klux=1", "unknown key 'sun.klux'; did you mean sun.illuminance_klux?"),
    ("render wall.toml -o a.ply --set laser.peak_power_w", "must be KEY=VALUE, such as detector.gain=60"),
    ("render wall.toml -o a.ply --set sun.illuminance_klux=1", "unknown key 'sun'; known here: "),
    ("render wall.toml -o a.ply --set sun.elevation_deg=1", "; try --scene-set"),
    ("render wall.toml -o a.ply --scene-set laser.peak_power_w=5", "; try --set"),
    ("render wall.toml -o a.ply --scene-set sun.illuminance_klux=100000", "got 100000: did you mean 100?"),
    ("render wall.toml -o a.ply --scene-set bodies.car.yaw_deg=3", "must be bodies.NAME.KEY, with a name of wall"),
    ("render wall.toml -o a.ply --seed abc", "must be a whole number from 0 to 4294967295, got abc"),
    ("render wall.toml -o a.ply --frames 3", "--output a.ply: must be a folder with --frames"),
    ("render wall.toml -o a --frames 0", "--frames: must be a whole number from 1 to 10000, got 0"),
    ("render wall.toml -o a.ply --rays 5000", "--rays: must be a whole number from 1 to 1024, got 5000"),
    ("render wall.toml -o a.ply --picture a.jpg", "--picture a.jpg: the name must end in .png or .svg"),
    ("render wall.toml -o a.ply --pulses 3", "--pulses goes with --waveforms"),
    ("render wall.toml -o a.ply --waveforms w.npz --pulses 5-1", "such as 0,100,2000-2010, got 5-1"),
    ("render wall.toml -o a.ply --pose 1 2 3", "--pose: must be X,Y,Z[,YAW,PITCH,ROLL] in metres"),
    ("render wall.toml -o a --dataset kitty", "invalid choice: 'kitty'; did you mean kitti?"),
    ("render notes.txt -o a.ply", "not valid TOML: "),
    ("render car.fbx -o a.ply", "car.fbx: an FBX file, which is not read; import it into Blender and export glTF"),
    # the command itself
    ("Render car -o a.ply", "invalid choice: 'Render'; did you mean render?"),
    ("compare apd-905 sipm-905", "required: -o/--output; sensors go behind --sensors, with commas: --sensors A,B"),
    ("ls", "invalid choice: 'ls'; lists are lidarscene catalog, catalog sensors"),
    ("plot car", "invalid choice: 'plot'; choose from render, stream, batch,"),
    # view
    ("view", "required: CLOUD|DIR|SCENE|REC; see lidarscene view -h"),
    ("render car apd-905 -o a.ply", "unrecognized arguments: apd-905; a sensor goes behind --sensor: --sensor apd-905"),
    ("render wall.toml -o a.ply --colors range", "did you mean --colours?"),
    ("view none.ply", "no such file"),
    ("view a.blend", "a.blend: a Blender file, which is not read; open it in Blender and export glTF"),
    ("view notes.txt", "suffix '.txt' names no point cloud format; known: .ply,"),
    ("view wall.toml --port 99999", "--port: must be a whole number from 0 to 65535, got 99999"),
    ("view wall.toml --frame 1", "--frame: goes with a recording, got wall.toml"),
    ("view empty.pcap", "must have points or packets, got an empty file"),
    # compare
    ("compare wall.toml --sensors table1-apd -o out", "must be 2 to 7 names or files with commas between them"),
    (
        "compare wall.toml --sensors table1-apd table1-sipm -o out",
        "; sensors go behind --sensors, with commas: --sensors A,B",
    ),
    ("compare wall.toml --sensors table1-apd,table1-apx -o out", "did you mean table1-apd?"),
    ("compare wall.toml --sensors table1-apd,table1-sipm", "required: -o/--output; see lidarscene compare -h"),
    # range
    ("range", "required: SENSOR; see lidarscene range -h"),
    ("range wall.toml", "(and 5 more); this looks like a scene file"),
    ("range table1-apd,table1-sipm", "must be one sensor; several go with spaces between them"),
    ("range table1-apd --over detector.gian", "did you mean detector.gain?"),
    ("range table1-apd --over ranges", "must be one of distance, illuminance_klux,"),
    ("range table1-apd --distance -5", "--distance -5: must be more than 0 and up to 1e+06 m"),
    ("range table1-apd --reflectivity 10", "--reflectivity 10: must be 0 or more and up to 1"),
    ("range table1-apd --over distance --from 10 --to 5", "--from must be below --to"),
    ("range table1-apd --plot a.png", "--plot goes with --over: say what is swept"),
    ("range table1-apd --quantity snrs", "invalid choice: 'snrs'; did you mean snr?"),
    ("range table1-apd --set table1-sipm:detector.pde=1", "'table1-sipm' is not among the sensors here: table1-apd"),
    ("compare wall.toml --sensors table1-apd,table1-sipm -o out --illuminance-klux 1,20000", "klux: did you mean 20?"),
    # fov
    (
        "fov table1-apd -o out --illuminance-klux 100000",
        "--illuminance-klux 100000: must be 0 or more and up to 10000 klux: did",
    ),
    ("fov table1-apd", "required: -o/--output; see lidarscene fov -h"),
    ("fov table1-apd -o out --cell 0", "--cell: must be 0.02 to 10 degrees, got 0"),
    ("fov table1-apd -o out --time a,b", "must be seconds that rise, such as 0.1,0.5,1, got a,b"),
    ("fov table1-apd --rig rig -o out", "SENSOR and --rig: one of them must be given"),
    # batch
    ("batch wall.toml -o out", "key 'scenes' is missing (and 1 more); this looks like a scene file"),
    ("batch none.toml -o out", "no such file"),
    ("batch job -o notes.txt", "--output notes.txt: must be a folder, got a file"),
    ("batch job -o out --workers 0", "--workers: must be a whole number from 1 to 1024, got 0"),
    # check, sensor, twin, fit, stream
    ("check", "required: FILE; see lidarscene check -h"),
    ("sensor vlp-16", "required: --from, -o/--output; see lidarscene sensor -h"),
    (
        "sensor --from notes.txt -o a.toml",
        "must be json, OSF or pcap with a json (Ouster), YAML or XML (Velodyne), CSV or dat (Hesai)",
    ),
    ("sensor --from . -o a.toml", "must be a file, got a folder (.)"),
    ("render '' -o a.ply", "an argument is empty, behind render: is a variable of the shell not set?"),
    ("view ''", "an argument is empty, behind view"),
    ("'' view", "an argument is empty, behind lidarscene"),
    ("range vlp-16 --csv ''", "an argument is empty, behind --csv"),
    ("twin none.pcap -o out", "no such recording"),
    ("fit", "see lidarscene fit -h"),
    ("stream wall.toml --sensor vlp-16", "see lidarscene stream -h"),
    # in another order, in another place, of another kind
    ("--sensor vlp-16 render car -o a.ply", "the command goes first: lidarscene COMMAND --sensor ...; see"),
    ("render wall.toml -o a.ply --set laser.peak_power_w 75", "arguments: 75; a value goes with =: --set laser.peak"),
    ("render nowhere/street.toml -o a.ply", "goes by its name, street"),
    ("view nowhere/street.toml --save a.html", "goes by its name, street"),
    ("render cloud.ply -o a.ply", "got none; a point cloud is for `lidarscene view`"),
    ("range table1-apd --over gain", "has no numeric key of that name; did you mean detector.gain?"),
    # catalog, schema, doctor, paper
    ("catalog sensor", "invalid choice: 'sensor'; did you mean sensors?"),
    ("catalog materials brik", "no material 'brik' in the catalogue; did you mean brick"),
    ("catalog check vlp17", "no sensor 'vlp17' in the catalogue; did you mean vlp-16"),
    ("schema scenes", "invalid choice: 'scenes'; did you mean scene?"),
    ("doctor --jsn", "unrecognized arguments: --jsn; did you mean --json?; see lidarscene doctor -h"),
    ("paper out", "see lidarscene paper -h"),
    ("paper -o notes.txt", "notes.txt' is a file, not a folder"),
]

CALLED: list[tuple[Callable[[], Any], str]] = [
    (lambda: lidarscene.load_scene("cars"), "no scene 'cars' in the catalogue; did you mean car"),
    (lambda: lidarscene.load_scene(3), "scene: must be a name, a file, a Scene, (vertices, faces) or a mesh"),
    (lambda: lidarscene.load_sensor(None), "sensor: must be a name, a file or a Sensor, got NoneType"),
    (lambda: lidarscene.load_rig("wall.toml"), "this looks like a scene file"),
    (lambda: lidarscene.render("wall.toml", "vlp17"), "no sensor 'vlp17' in the catalogue; did you mean vlp-16"),
    (lambda: lidarscene.render("wall.toml", seed=1.5), "seed: must be a whole number from 0 to 4294967295, got 1.5"),
    (lambda: lidarscene.render("wall.toml", pose=(1, 2)), "pose: must be a Pose, or x, y, z in metres"),
    (lambda: lidarscene.render("wall.toml", coordinates="car"), "must be 'world' or 'vehicle' or 'sensor', got 'car'"),
    (lambda: lidarscene.render("wall.toml", overrides="gain=3"), "unknown key 'gain'; did you mean detector.gain?"),
    (lambda: lidarscene.render("wall.toml", overrides=3), 'overrides: must be "key=value", a list of these, or a dict'),
    (lambda: lidarscene.render("wall.toml", colour=1), "unknown option 'colour'; known here: rays,"),
    (lambda: lidarscene.render(lidarscene.load_sensor("vlp-16")), "Mitsuba, got Sensor"),
    (lambda: lidarscene.record("wall.toml", outputs="a.abc"), "path a.abc: the name must end in one of .ply,"),
    (lambda: lidarscene.render("wall.toml", pose=np.eye(4)), "yaw, pitch, roll in degrees, got array([[1., 0.,"),
    (lambda: small_cloud().column("intesity"), "column 'intesity': not in this cloud; did you mean intensity?"),
    (lambda: small_cloud().select(small_cloud().status), "select: must be a mask such as cloud.status == 0"),
    (lambda: small_cloud().view(scene="kar"), "no scene 'kar' in the catalogue; did you mean car"),
    (lambda: lidarscene.deskewed(small_cloud(), (1, 0, 0)), "must be a motion such as Simulator.motion, got tuple"),
    (lambda: lidarscene.PointCloud.load("wall.toml"), "suffix '.toml' names no point cloud format; known: .ply,"),
]


@pytest.fixture
def place(tmp_path: Path, wall: str) -> Path:
    """A folder with a wall, the shipped scenes, a text, an empty recording; the working directory of ``run``."""
    (tmp_path / "scenes").symlink_to(ROOT / "scenes")
    (tmp_path / "notes.txt").write_text("hello")
    (tmp_path / "empty.pcap").write_bytes(b"")
    small_cloud().save(tmp_path / "cloud.ply")
    return tmp_path


def test_there_are_enough() -> None:
    """The issue asks for sixty, over all commands."""
    commands = {line.split()[0] for line, _ in TYPED}
    assert len({line for line, _ in TYPED}) >= 60
    assert {"check", "sensor", "twin", "fit", "stream", "catalog", "schema"} <= commands
    assert {"render", "view", "compare", "range", "fov", "batch", "doctor", "paper"} <= commands


@pytest.mark.parametrize(("line", "message"), TYPED, ids=[line for line, _ in TYPED])
def test_typed(run: Run, place: Path, line: str, message: str) -> None:
    before = sorted(place.rglob("*"))
    ran = run(*shlex.split(line))
    assert (ran.code, ran.out, ran.err.count("\n")) == (2, "", 1), ran
    assert ran.err.startswith("lidarscene: error: ")
    assert message in ran.err
    assert len(ran.err) <= LONGEST
    assert sorted(place.rglob("*")) == before


@pytest.mark.parametrize(("call", "message"), CALLED, ids=[message for _, message in CALLED])
def test_called(place: Path, monkeypatch: pytest.MonkeyPatch, call: Callable[[], Any], message: str) -> None:
    monkeypatch.chdir(place)
    with pytest.raises(LidarSceneError) as caught:
        call()
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
