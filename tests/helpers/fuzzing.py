"""Inputs that no one would write, from a seed: spoilt files of every kind that is read, and command lines.

Each is made of something that is whole, spoilt in a few places, so that it gets past the first check. What comes of it
must be an answer, or one line that says what is wrong: no traceback, no wait without end, no file left.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import random
import shutil
import signal
import threading
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from helpers.clouds import small_cloud
from helpers.command_line import COARSE
from helpers.foreign_files import ForeignFiles, spoilt_in_place
from helpers.small_job import JOB
from helpers.spoiling import number, spoilt, spoilt_bytes, text, toml_value
from helpers.walls import LEFT_AND_RIGHT, MOVING, WALL
from lidarscene import LiveSimulator, PointCloud, catalog, load_scene, load_sensor
from lidarscene.batch.tasks import Job
from lidarscene.cli import main
from lidarscene.errors import LONGEST, BackendError, LidarSceneError
from lidarscene.figures.report import Report
from lidarscene.formats.registry import FORMATS
from lidarscene.recordings.as_cloud import cloud_of
from lidarscene.recordings.opening import open_recording
from lidarscene.scene.meshes import mesh_cache
from lidarscene.scene.meshes.reading import read_mesh
from lidarscene.view.controls import Equipment
from lidarscene.view.page_sources import settings_from

PATIENCE_S = 120
"""After which an input counts as one that hangs: a hundred times what the slowest of them takes."""

MEMORY = 8 << 30
"""Bytes of address space that an input may take beyond what the process has: more ends in a MemoryError."""

MOST_RESIDENT = 3 << 29
"""Bytes of memory that an input may use beyond what the process has, 1.5 GiB: a few copies of what may be unpacked."""

Work = Callable[[], object]


@dataclass(frozen=True)
class Input:
    """What is tried: where it comes from, and a call that answers or raises LidarSceneError."""

    about: str
    work: Work


BALL = "<scene version='3.0.0'>\n<bsdf type='diffuse' id='grey'>\n<rgb name='reflectance' value='0.5'/>\n</bsdf>\n"
XML = (
    f"{BALL}<shape type='sphere' id='ball'>\n<point name='center' x='9' y='0' z='0'/>\n<ref id='grey'/>\n</shape>\n"
    "<shape type='cube'>\n<transform name='to_world'>\n<scale value='0.3'/>\n<translate x='7' y='1'/>\n</transform>\n"
    "<bsdf type='conductor'/>\n</shape>\n</scene>\n"
)
OBJ = "mtllib a.mtl\nusemtl steel\nv 8 0 0\nv 8 1 0\nv 8 0 1\nvn 1 0 0\nf 1 2 3\nf 1//1 3//1 2//1\n"
STL = (
    "solid a\nfacet normal 1 0 0\nouter loop\nvertex 8 0 0\nvertex 8 1 0\nvertex 8 0 1\nendloop\nendfacet\nendsolid a\n"
)
PLY = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
    "property list uchar int vertex_indices\nend_header\n8 0 0\n8 1 0\n8 0 1\n3 0 1 2\n"
)
OFF = "OFF\n3 1 0\n8 0 0\n8 1 0\n8 0 1\n3 0 1 2\n"
MESHES = {"a.obj": OBJ, "a.stl": STL, "a.ply": PLY, "a.off": OFF}
PATTERN = "azimuth_deg,elevation_deg,time_us,channel\n" + "".join(
    f"{n % 5 - 2},{n // 5 - 2},{n},0\n" for n in range(25)
)
POSES = "time_s,x_m,y_m,z_m,yaw_deg\n0,0,0,0,0\n1,2,0,0,5\n2,4,1,0,9\n3,6,2,0,0\n"
TUM = "0 0 0 0 0 0 0 1\n1 2 0 0 0 0 0 1\n2 4 1 0 0 0 0.1 0.995\n3 6 1 0 0 0 0 1\n"
FILTER = "wavelength_nm,transmittance\n880,0\n895,0.9\n915,0.9\n930,0\n"
BODY = '[[bodies]]\nname = "thing"\nmaterial = "concrete"\nmesh = "in/{}"\n'
SENSORS = ("table1-apd", "table1-sipm", "vlp-16", "livox-avia", "mems-1550", "sony-spad-189x600", "os1-128")
SMALL = [*COARSE]


class Workshop:
    """Whole files that are spoilt, in a folder that is the current one."""

    def __init__(self, folder: Path) -> None:
        self.living: LiveSimulator | None = None  # compiled when it is first drawn
        self.inside = folder / "in"
        self.inside.mkdir()
        (self.inside / "folder").mkdir()
        os.mkfifo(self.inside / "pipe")
        (folder / "wall.toml").write_text(WALL)
        (folder / "rig.toml").write_text(LEFT_AND_RIGHT)
        cloud = small_cloud(5)
        self.clouds: dict[str, bytes] = {}
        for name, file_format in FORMATS.items():
            if file_format.read is not None:
                with contextlib.suppress(LidarSceneError):
                    path = folder / f"whole{file_format.suffix}"
                    cloud.save(path, format=name)
                    self.clouds[f"{name}{file_format.suffix}"] = path.read_bytes()
        cloud.save(folder / "text.ply", ascii=True)
        self.clouds["text.ply"] = (folder / "text.ply").read_bytes()
        cloud.save(folder / "text.pcd", ascii=True)
        self.clouds["text.pcd"] = (folder / "text.pcd").read_bytes()
        buffer = io.BytesIO()
        rows = np.loadtxt(io.StringIO(PATTERN), delimiter=",", skiprows=1).T
        np.savez_compressed(buffer, **dict(zip(PATTERN.split("\n")[0].split(","), rows, strict=True)))
        self.pattern = buffer.getvalue()
        self.meshes = {name: whole.encode() for name, whole in MESHES.items()}
        import trimesh

        box = trimesh.creation.box()
        self.meshes |= {"a.glb": box.export(file_type="glb"), "b.stl": box.export(file_type="stl")}
        self.meshes["b.ply"] = box.export(file_type="ply")
        self.equipment = Equipment(load_scene(folder / "wall.toml"), "table1-apd")
        self.foreign = ForeignFiles(folder / "whole", self.inside)
        (folder / "moving.toml").write_text(MOVING)
        cloud.save(folder / "cloud.ply")

    def write(self, name: str, data: bytes) -> str:
        path = self.inside / name
        path.write_bytes(data)
        return f"in/{name}"

    def next_input(self, rng: random.Random) -> Input:
        """The next input of this stream."""
        files = (self.sensor, self.scene, self.rig, self.job, self.cloud, self.mesh, self.table, self.xml, self.unit)
        others = (self.line, self.line, self.settings, self.no_file, self.stage, self.mesh_with_parts, self.live)
        kinds = (*files, *others, *3 * [self.recording], self.mesh_cache_entry)
        return rng.choice(kinds)(rng)

    def sensor(self, rng: random.Random) -> Input:
        name = rng.choice(SENSORS)
        whole = catalog.path_of("sensors", name).read_bytes()
        path = self.write("s.toml", spoilt(rng, whole))
        commands = (
            ("range", path, "--json"),
            ("render", "wall.toml", "-o", "out/o.ply", "--sensor", path),
            ("render", "wall.toml", "-o", "out/o.ply", "--sensor", path),
            ("range", path, "--over", "distance"),
        )
        return command_input(f"sensor {name}", *rng.choice(commands))

    def scene(self, rng: random.Random) -> Input:
        wholes = [WALL, MOVING, *(file.read_text() for file in sorted((ROOT / "scenes").glob("*.toml")))]
        # Those of the project have hundreds of bodies, which take their time.
        whole = rng.choice(
            wholes[:2] if rng.random() < 0.9 else [scene_text for scene_text in wholes if "[[bodies]]" in scene_text]
        )
        path = self.write("s.toml", spoilt(rng, whole.replace('mesh = "', f'mesh = "{ROOT}/scenes/').encode()))
        return command_input("scene", "render", path, "-o", "out/o.ply", "--sensor", "table1-apd", *SMALL)

    def rig(self, rng: random.Random) -> Input:
        path = self.write("r.toml", spoilt(rng, LEFT_AND_RIGHT.encode()))
        return command_input("rig", "render", "wall.toml", "--rig", path, "-o", "out", *SMALL)

    def job(self, rng: random.Random) -> Input:
        shutil.copy("wall.toml", self.inside / "wall.toml")
        path = self.write("j.toml", spoilt(rng, JOB.format(step=2.0).encode()))

        def work() -> None:
            next(Job.read(Path(path)).tasks(), None)

        return Input("job", work)

    def cloud(self, rng: random.Random) -> Input:
        name = rng.choice(list(self.clouds))
        path = self.write(name, spoilt(rng, self.clouds[name]))
        if rng.random() < 0.1:
            return command_input(f"cloud {name}", "view", path, "--save", "out/v.html")
        return Input(f"cloud {name}", lambda: PointCloud.load(path))

    def mesh(self, rng: random.Random) -> Input:
        name = rng.choice(list(self.meshes))
        self.write(name, spoilt(rng, self.meshes[name]))
        scene = self.write("s.toml", BODY.format(name).replace("in/", "").encode())
        return Input(f"mesh {name}", lambda: load_scene(scene))

    def table(self, rng: random.Random) -> Input:
        """Patterns, poses and filters."""
        kind = rng.choice(("p.csv", "p.npz", "poses.csv", "poses.txt", "filter.csv"))
        if kind.startswith("p."):
            self.write(kind, spoilt(rng, self.pattern if kind == "p.npz" else PATTERN.encode()))
            text = f'{_without_scanner()}[scanner]\ntype = "table"\nfile = "{kind}"\nframe_ms = 1\n'
            return command_input(kind, "range", self.write("s.toml", text.encode()), "--json")
        if kind == "filter.csv":
            self.write(kind, spoilt(rng, FILTER.encode()))
            text = _apd().replace("sun_irradiance_w_m2", f'filter = {{csv = "{kind}"}}\n#')
            return command_input(kind, "range", self.write("s.toml", text.encode()), "--json")
        self.write(kind, spoilt(rng, (POSES if kind == "poses.csv" else TUM).encode()))
        scene = self.write("s.toml", (WALL + f'\n[bodies.motion]\nposes_file = "{kind}"\n').encode())
        return command_input(kind, "render", scene, "-o", "out/o.ply", "--sensor", "table1-apd", *SMALL)

    def xml(self, rng: random.Random) -> Input:
        whole = spoilt(rng, XML.encode())
        if rng.random() < 0.05:
            depth = rng.choice((200, 5000, 20_000))
            whole = XML.replace("</scene>", "<a>" * depth + "</a>" * depth + "</scene>").encode()
        return command_input("xml", "render", self.write("a.xml", whole), "-o", "out/o.ply", *SMALL)

    def recording(self, rng: random.Random) -> Input:
        """Read as a recording, and by each command that takes one."""
        kind, path = self.foreign.recording(rng)
        with_metadata: list[str] = []
        metadata: Path | None = None
        if "pcap" in kind and rng.random() < 0.25:
            metadata = self.foreign.description(rng, rng.choice((None, _DESCRIBED_BY.get(kind.partition(" ")[0]))))
            with_metadata = ["--metadata", str(metadata)]
        recorded, sensor = str(path), rng.choice(SENSORS)
        if rng.random() < 0.6:
            return Input(f"recording {kind}", lambda: _read_recording(path, metadata))
        return command_input(
            f"recording {kind}",
            *rng.choice(
                (
                    ("view", recorded, "--save", "out/v.html"),
                    ("twin", recorded, "-o", "out", "--sensor", sensor),
                    ("twin", recorded, "-o", "out"),
                    ("certify", recorded, "-o", "out"),
                    ("certify", recorded, "-o", "out", "--sensor", sensor),
                    ("fit", recorded, "-o", "out/f.toml", "--report", "out/r", "--sensor", sensor),
                )
            ),
            *with_metadata,
        )

    def unit(self, rng: random.Random) -> Input:
        """What a maker says of a unit, as a sensor file that must be one."""
        described = str(self.foreign.description(rng))
        command = ["sensor", "--from", described, "-o", "out/u.toml"]
        if rng.random() < 0.4:
            command += ["--like", rng.choice(SENSORS)]
        if rng.random() < 0.2:
            command += ["--mode", rng.choice(("1024x10", "2048x10", "512x20", "0x0", "99999999x10", text(rng)))]

        def work() -> None:
            _command([word.replace("\0", "0") for word in command])
            if Path("out/u.toml").exists():
                load_sensor("out/u.toml")

        return Input(f"unit {Path(described).name}: {' '.join(command)[:200]}", work)

    def stage(self, rng: random.Random) -> Input:
        try:
            path = self.foreign.stage(rng)
        except ImportError:  # usd-core is missing
            return self.mesh(rng)
        return Input(f"stage {path.name}", lambda: read_mesh(path))

    def mesh_with_parts(self, rng: random.Random) -> Input:
        path = self.foreign.mesh(rng)
        pattern = rng.choice((None, "reflectivity", "colour"))
        if pattern is None:
            return Input(f"mesh with parts {path.name}", lambda: read_mesh(path))
        text = BODY.format(path.name).replace("in/", "") + f'pattern = "{pattern}"\n'
        scene = self.write("s.toml", text.encode())
        return Input(f"mesh with parts {path.name}, {pattern}", lambda: load_scene(scene))

    def mesh_cache_entry(self, rng: random.Random) -> Input:
        """A spoilt entry counts as none: the mesh is read from its file."""
        path = self.inside / "whole.obj"
        path.write_text(OBJ)
        (whole,) = read_mesh(path)
        entry = mesh_cache._entry(path, None)
        if entry is None or not entry.exists():
            return self.mesh(rng)
        data = entry.read_bytes()
        entry.write_bytes(rng.choice((spoilt_bytes, spoilt_in_place))(rng, data))

        def work() -> None:
            try:
                (piece,) = read_mesh(path)
                assert np.array_equal(piece.vertices_m, whole.vertices_m)
                assert np.array_equal(piece.faces, whole.faces)
            finally:
                entry.unlink(missing_ok=True)

        return Input("mesh cache entry", work)

    def live(self, rng: random.Random) -> Input:
        """Calls with slips of the hand: a line that says so, and the world as it was."""
        if self.living is None:
            self.living = LiveSimulator("moving.toml", "table1-apd", spares={"wall": 2})
        living = self.living
        calls = [_slip(rng) for _ in range(rng.randint(1, 4))]

        def work() -> None:
            for name, arguments, keywords in calls:
                before, clock = living.scene, living._now_s
                try:
                    with mock.patch.object(living, "render", return_value=None):
                        getattr(living, name)(*arguments, **keywords)
                except LidarSceneError:
                    assert living.scene is before, "the scene has changed"
                    assert living._now_s == clock, "the clock has changed"

        return Input(f"live {calls}", work)

    def settings(self, rng: random.Random) -> Input:
        """Settings as the page sends them."""
        keys = ["detector", "detector.gain", "sun.azimuth_deg", "sun.illuminance_klux", "laser.peak_power_w", text(rng)]
        values = ["1", "-1", "1e308", "NaN", "Infinity", "null", "[]", "{}", '"x"', "true", number(rng), "9" * 400]
        pairs = [f"{json.dumps(rng.choice(keys))}: {rng.choice(values)}" for _ in range(rng.randint(0, 4))]
        body = spoilt_bytes(rng, b"{}") if rng.random() < 0.1 else ("{" + ", ".join(pairs) + "}").encode()
        return Input("settings", lambda: self.equipment.with_settings(settings_from(body)))

    def no_file(self, rng: random.Random) -> Input:
        """What is there and is no file, wherever a file is named."""
        name = rng.choice(("in/pipe", "/dev/zero", "in/folder", "in/none", "a\0b", "x" * 3000, "/proc/self/mem"))
        ending = rng.choice(("", ".toml", ".csv", ".xml", ".ply", ".npz", ".obj", ".laz"))
        link = self.inside / f"link{ending}"
        link.unlink(missing_ok=True)
        with contextlib.suppress(OSError, ValueError):
            link.symlink_to((Path.cwd() / name) if name.startswith("in/") else name)
        not_a_file = str(link) if "\0" not in name else name + ending
        works: list[Input] = [
            command_input("no file", "render", not_a_file, "-o", "out/o.ply"),
            command_input("no file", "render", "wall.toml", "--sensor", not_a_file, "-o", "out/o.ply", *SMALL),
            command_input("no file", "render", "wall.toml", "--rig", not_a_file, "-o", "out"),
            command_input("no file", "range", not_a_file),
            command_input("no file", "compare", not_a_file, not_a_file, "-o", "out"),
            command_input("no file", "view", not_a_file, "--save", "out/v.html"),
            command_input("no file", "render", "wall.toml", "-o", not_a_file, *SMALL),
            Input("no file", lambda: PointCloud.load(not_a_file)),
            Input("no file", lambda: load_scene(not_a_file)),
            Input("no file", lambda: Job.read(Path(not_a_file))),
        ]
        for key in ("mesh", "base", "poses"):
            scene = {
                "mesh": f'[[bodies]]\nname = "a"\nmaterial = "concrete"\nmesh = {json.dumps(not_a_file)}\n',
                "base": f"base = {json.dumps(not_a_file)}\n",
                "poses": f"{WALL}\n[bodies.motion]\nposes_file = {json.dumps(not_a_file)}\n",
            }[key]
            path = self.write(f"{key}.toml", scene.encode())
            works.append(command_input(f"no file {key}", "render", path, "-o", "out/o.ply", *SMALL))
        return rng.choice(works)

    def line(self, rng: random.Random) -> Input:
        """A command line of our own options with values that may be anything."""
        parser = main._parser()
        commands = next(a for a in parser._actions if isinstance(a, argparse._SubParsersAction)).choices
        name = rng.choice(
            ("render", "render", "render", "range", "fov", "compare", "catalog", "schema", "batch", "view")
        )
        arguments: list[str] = {
            "render": ["wall.toml", "-o", "out/o.ply", *SMALL],
            "range": ["table1-apd"],
            "fov": ["--no-such"],
            "compare": ["wall.toml", "-o", "out"],
            "catalog": ["sensors"],
            "schema": ["sensor"],
            "batch": ["in/none.toml", "-o", "out"],
            "view": ["wall.toml", "--save", "out/v.html"],
        }[name]
        options = [a for a in commands[name]._actions if a.option_strings and "-h" not in a.option_strings]
        for action in rng.sample(options, min(len(options), rng.randint(1, 3))):
            arguments.append(rng.choice(action.option_strings))
            if action.nargs != 0:
                arguments.append(self.value(rng, action))
        if rng.random() < 0.2:
            arguments[rng.randrange(len(arguments))] = text(rng)
        if rng.random() < 0.1:
            arguments.insert(rng.randrange(len(arguments)), text(rng))
        # What would serve a page or start processes until it is ended is for other tests.
        if name == "view" and not any(argument.startswith("--save") for argument in arguments):
            arguments.append("--save=out/v.html")
        return command_input("line", name, *(argument.replace("\0", "0") for argument in arguments))

    def value(self, rng: random.Random, action: argparse.Action) -> str:
        kind = rng.randint(0, 14)
        if kind == 0:
            return text(rng)
        if kind >= 10:  # what may well be meant
            return rng.choice(("1", "2", "0.5", "4", "0.1,0.2", "0,0,1", "detector.gain=60", "sun.illuminance_klux=1"))
        if kind >= 7 and action.choices:
            return str(rng.choice(list(action.choices)))
        if kind == 2:
            return ",".join(number(rng) for _ in range(rng.randint(1, 7)))
        if kind == 3:
            return f"{rng.choice(KEYS)}={rng.choice((number, text, toml_value))(rng)}"
        if kind in (1, 4):
            return rng.choice(
                ("in/none.npz", "out/a.png", "out/a.npz", "out/o.ply", "wall.toml", "rig.toml", "in/pipe")
            )
        return number(rng)


_DESCRIBED_BY = {
    "velodyne": "velodyne.yaml",
    "vls": "velodyne.yaml",
    "hesai": "hesai.csv",
    "pandar64": "hesai.csv",
    "ouster": "ouster.json",
    "our": "ouster.json",
}
"""First word of a kind of recording -> description that goes with it."""

SLIPS: tuple[Any, ...] = (
    *(None, True, "wall", "wal", b"wall", "", "ego", 0, -1, 1.5, 10**400, 1e300, float("nan"), float("inf"), 1j),
    *((), [], {}, set(), [1, 2], (1, 2, 3), (1.0, 2.0, 3.0, 4.0, 5.0, 6.0), (1, 2, "3"), ("a",) * 6, [[1, 2], 3]),
    *(np.zeros(3), np.full(6, np.nan), np.eye(4), np.zeros((0, 3)), np.array(["a"] * 3), np.array(5), {"wall": 3}),
    *({"wall": (1, 2, 3)}, {3: (1, 2, 3)}, {"wall": None}, {"wall": (30.0, 2, 1, 90, 0, 0)}, object(), len),
)
"""Values that a caller may pass where another is meant."""


def _slip(rng: random.Random) -> tuple[str, tuple[Any, ...], dict[str, Any]]:
    """Name of a method of LiveSimulator, arguments and keywords."""
    name, mandatory = rng.choice((("place", 2), ("add", 2), ("move_ego", 1), ("remove", 1), ("advance", 1)))
    meant = {"place": ("wall", (9, 0, 0)), "add": ("wall", (12, 0, 0)), "move_ego": ((1, 0, 0),), "remove": ("wall.1",)}
    arguments = list(meant.get(name, (rng.uniform(0.0, 0.05),)))
    if rng.random() < 0.7:
        arguments[rng.randrange(mandatory)] = rng.choice(SLIPS)
    keys = ("poses", "ego", "seed", "number", "frame") if name == "advance" else ("velocity_m_s", "yaw_rate_deg_s")
    # `remove` has no keywords: Python's own error says so.
    known = (*keys, "time_s", "nothing") if name != "remove" else ()
    count = rng.choice((0, 0, 1, 2)) if known else 0
    return name, tuple(arguments), {rng.choice(known): rng.choice(SLIPS) for _ in range(count)}


def _read_recording(path: Path, metadata: Path | None) -> None:
    """Read two frames, and make a cloud of each."""
    with open_recording(path, metadata) as recording:
        for number in {0, len(recording) - 1}:
            cloud_of(recording[number])


ROOT = Path(__file__).parents[2]
WORDS = """
    detector.gain detector.pde laser.peak_power_w laser.pulse_ns laser.divergence_mrad optics tdc tdc.window_us
    tdc.threshold_to_noise scanner.azimuth_step_deg scanner.type scanner a.b.c sun.illuminance_klux bodies.wall.size_m
    bodies.0.size_m bodies.wall.pitch_deg air.visibility_m weather.rain_mm_h bodies sensor.name laser.wavelength_nm
"""
KEYS = (*WORDS.split(), "", ".".join("a" * 500))


def _apd() -> str:
    return catalog.path_of("sensors", "table1-apd").read_text()


def _without_scanner() -> str:
    before, _, after = _apd().partition("[scanner]")
    return before + ("[" + after.partition("\n[")[2] if "\n[" in after else "")


def command_input(about: str, *argv: str) -> Input:
    """A command line in this process."""
    return Input(f"{about}: lidarscene {' '.join(word[:60] for word in argv)}", lambda: _command(argv))


def _command(argv: Sequence[str]) -> None:
    """Run it; AssertionError unless it ends as a command may."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main.main(list(argv))
        except SystemExit as end:
            code = int(end.code or 0)
    lines = [line for line in err.getvalue().split("\n") if line and not line.startswith("lidarscene: note: ")]
    if code == 3:
        raise BackendError(err.getvalue())
    assert code in (0, 1, 2), code
    if code == 2:
        assert len(lines) == 1, lines[:3]
        assert lines[0].startswith("lidarscene: error: "), lines
        assert not Path("out").exists(), "out was left"
    assert max(map(len, lines), default=0) <= LONGEST + 100, "the line is too long"
    assert not list(Path().rglob("*.part")), "a temporary was left"


class Hung(BaseException):
    """Raised in what takes longer than anything may."""


@contextlib.contextmanager
def watched() -> Iterator[None]:
    """Raise `Hung` after PATIENCE_S, where signals arrive."""
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "setitimer"):
        yield
        return

    def hang_up(*_: Any) -> None:
        raise Hung

    before = signal.signal(signal.SIGALRM, hang_up)
    signal.setitimer(signal.ITIMER_REAL, PATIENCE_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@contextlib.contextmanager
def bounded_memory() -> Iterator[None]:
    """No more address space than MEMORY beyond what there is."""
    import resource

    pages = int(Path("/proc/self/statm").read_text().split()[0]) if Path("/proc/self/statm").exists() else 0
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    if pages:
        resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


@contextlib.contextmanager
def untraced() -> Iterator[None]:
    """Frames are not traced, and nothing is drawn: what is read and checked before is what is tried."""
    with (
        mock.patch("lidarscene.outputs.frame_files.FrameFiles.write"),
        mock.patch(
            "lidarscene.studies.compare.comparison_study.comparison_page", return_value=Report("Comparison", numbers={})
        ),
        mock.patch("lidarscene.view.page_sources.Live", side_effect=LidarSceneError("not here")),
    ):
        yield


def _resident_bytes(key: str) -> int:
    """Memory of this process, "VmRSS" or its peak "VmHWM"; 0 where the system does not say."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith(key):
                return int(line.split()[1]) << 10
    return 0


def failure(drawn_input: Input) -> str:
    """What is wrong with what comes of it; "" if nothing is."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")  # the peak counts from here
    before = _resident_bytes("VmRSS")
    reason = _failure(drawn_input)
    taken = _resident_bytes("VmHWM") - before
    return reason or (f"it takes {taken / 1e9:.1f} GB" if taken > MOST_RESIDENT else "")


def _failure(drawn_input: Input) -> str:
    try:
        with watched():
            drawn_input.work()
    except LidarSceneError as error:
        message = str(error)
        if "\n" in message.strip() and not isinstance(error, BackendError):
            pass  # the command line prints it in one line
        return "" if len(message) <= LONGEST + 100 or isinstance(error, BackendError) else "the message is too long"
    except MemoryError:
        return ""
    except Hung:
        return "it hangs"
    except BaseException as error:
        import traceback

        if isinstance(error, KeyboardInterrupt):
            raise
        return f"{type(error).__name__}: {str(error)[:300]}\n" + "".join(traceback.format_tb(error.__traceback__)[-6:])
    finally:
        shutil.rmtree("out", ignore_errors=True)
    return ""


def failures(
    folder: Path, seed: int, count: int, *, stride: int = 1, first: int = 0
) -> Iterator[tuple[str, Input, str]]:
    """Try these inputs of a seed in a folder, which is the current one; the name of each that fails, and why."""
    workshop = Workshop(folder)
    for index in range(first, first + count, stride):
        rng = random.Random(zlib.crc32(f"{seed} {index}".encode()))
        drawn_input = workshop.next_input(rng)
        why = failure(drawn_input)
        if why:
            yield f"seed {seed} input {index}", drawn_input, why
