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
import re
import shutil
import signal
import struct
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
from helpers.small_job import JOB
from helpers.walls import LEFT_AND_RIGHT, MOVING, WALL
from lidarscene import PointCloud, catalog, load_scene
from lidarscene.batch.tasks import Job
from lidarscene.cli import main
from lidarscene.errors import LONGEST, BackendError, LidarSceneError
from lidarscene.formats.registry import FORMATS
from lidarscene.view.controls import Equipment
from lidarscene.view.page_sources import settings_from

PATIENCE_S = 120
"""After which an input counts as one that hangs: a hundred times what the slowest of them takes."""

MEMORY = 8 << 30
"""Bytes of address space that an input may take beyond what the process has: more ends in a MemoryError."""

NUMBERS = (
    "0",
    "-0.0",
    "1",
    "-1",
    "2",
    "1e-300",
    "1e-30",
    "1e-9",
    "1e9",
    "1e30",
    "1e300",
    "1e308",
    "-1e308",
    "nan",
    "inf",
    "-inf",
    "4294967295",
    "4294967296",
    "2147483648",
    "9223372036854775808",
    "1" + "0" * 400,
    "0x10",
    "1_000",
    "0.1",
    "3.7",
    "65536",
    "true",
    "9" * 5000,
)
TEXTS = (
    "",
    " ",
    "a",
    "\u0000",
    "../../etc/passwd",
    "/dev/null",
    "/dev/zero",
    ".",
    "..",
    "/",
    "a\nb",
    "\u202e",
    "ü" * 300,
    "x" * 20_000,
    "{0}",
    "{path}",
    "%s",
    "$HOME",
    "None",
    "[a](b)",
    "\x1b[31m",
    "in/pipe",
    "in/folder",
    "in",
    "--",
    "-",
    "NaN",
    "a.toml",
    "C:\\a",
    "\ud800",
    "0" * 4301,
)
SHARES_OF_A_FRAME = ("--no-truth", "--json", "--ascii", "--profile", "--deskew")

Work = Callable[[], object]


@dataclass(frozen=True)
class Input:
    """What is tried: where it comes from, and a call that answers or raises LidarSceneError."""

    about: str
    work: Work


def number(rng: random.Random) -> str:
    if rng.random() < 0.5:
        return rng.choice(NUMBERS)
    return repr(rng.choice((1, -1)) * rng.random() * 10.0 ** rng.randint(-12, 12))


def text(rng: random.Random) -> str:
    if rng.random() < 0.6:
        return rng.choice(TEXTS)
    return "".join(chr(rng.randint(1, 0x2FF)) for _ in range(rng.randint(1, 12)))


def toml_value(rng: random.Random, depth: int = 0) -> str:
    kind = rng.randint(0, 5 if depth < 3 else 3)
    if kind <= 1:
        return number(rng)
    if kind <= 3:
        return json.dumps(text(rng))
    inner = [toml_value(rng, depth + 1) for _ in range(rng.randint(0, 4))]
    if kind == 4:
        return f"[{', '.join(inner)}]"
    return "{" + ", ".join(f"k{number} = {entry}" for number, entry in enumerate(inner)) + "}"


def scale_number(line: str, factor: float) -> str:
    """The first number of a line times a factor."""
    return re.sub(r"\d+(\.\d+)?", lambda match: f"{float(match[0][:300]) * factor:g}", line, count=1)


def spoilt_lines(rng: random.Random, whole: str) -> str:
    """Text of lines KEY = VALUE, CSV, OBJ, XML: values, lines and letters are changed."""
    lines = whole.split("\n")
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        line_index = rng.randrange(len(lines))
        kind = rng.randint(0, 14)
        key, equals, _ = lines[line_index].partition("=")
        if kind >= 10:
            factor = rng.choice((0.0, -1.0, 0.5, 2.0, 10.0 ** rng.randint(-9, 9)))
            lines[line_index] = scale_number(lines[line_index], factor)
        elif kind <= 3 and equals:
            lines[line_index] = f"{key}= {toml_value(rng)}"
        elif kind == 4:
            del lines[line_index]
            lines = lines or [""]
        elif kind == 5:
            lines.insert(line_index, lines[rng.randrange(len(lines))])
        elif kind == 6:
            other_index = rng.randrange(len(lines))
            lines[line_index], lines[other_index] = lines[other_index], lines[line_index]
        elif kind == 7:
            words = lines[line_index].split(" ")
            words[rng.randrange(len(words))] = rng.choice((number, text))(rng)
            lines[line_index] = " ".join(words)
        elif kind == 8:
            cells = lines[line_index].split(",")
            cells[rng.randrange(len(cells))] = number(rng)
            lines[line_index] = ",".join(cells)
        else:
            column = rng.randint(0, len(lines[line_index]))
            lines[line_index] = lines[line_index][:column] + text(rng) + lines[line_index][column + rng.randint(0, 3) :]
    if rng.random() < 0.03:
        lines.append("a = " + "[" * 3000 + "]" * 3000)
    if rng.random() < 0.03:
        lines.append(".".join("a" * 2000) + " = 1")
    return "\n".join(lines)


def spoilt_bytes(rng: random.Random, whole: bytes) -> bytes:
    """Bytes changed, cut, doubled, and numbers in them made extreme."""
    data = bytearray(whole)
    for _ in range(rng.choice((1, 1, 2, 4, 16))):
        if not data:
            break
        offset = rng.randrange(len(data)) if rng.random() < 0.5 else rng.randrange(min(len(data), 600))
        kind = rng.randint(0, 6)
        if kind == 0:
            data[offset] ^= 1 << rng.randint(0, 7)
        elif kind == 1:
            data[offset : offset + 4] = struct.pack("<I", rng.choice((0, 1, 2**31 - 1, 2**31, 2**32 - 1, 65536)))
        elif kind == 2:
            del data[offset:]
        elif kind == 3:
            del data[offset : offset + rng.randint(1, 40)]
        elif kind == 4:
            data[offset:offset] = data[offset : offset + rng.randint(1, 400)]
        elif kind == 5:
            data[offset : offset + 8] = struct.pack("<d", float(rng.choice(("nan", "inf", "-inf", "1e308", "0"))))
        else:
            data[offset:offset] = rng.randbytes(rng.randint(1, 16))
    return bytes(data)


def spoilt(rng: random.Random, whole: bytes) -> bytes:
    """As lines if it is text, mostly."""
    try:
        lines = whole.decode("utf-8")
    except UnicodeDecodeError:
        return spoilt_bytes(rng, whole)
    if rng.random() < 0.15:
        return spoilt_bytes(rng, whole)
    return spoilt_lines(rng, lines).encode("utf-8", "surrogatepass")


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

    def write(self, name: str, data: bytes) -> str:
        path = self.inside / name
        path.write_bytes(data)
        return f"in/{name}"

    def next_input(self, rng: random.Random) -> Input:
        """The next input of this stream."""
        kinds = (
            self.sensor,
            self.scene,
            self.rig,
            self.job,
            self.cloud,
            self.mesh,
            self.table,
            self.xml,
            self.line,
            self.line,
            self.settings,
            self.no_file,
        )
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

    def settings(self, rng: random.Random) -> Input:
        """As the page sends them."""
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


ROOT = Path(__file__).parents[2]
KEYS = (
    "detector.gain",
    "detector.pde",
    "laser.peak_power_w",
    "laser.pulse_ns",
    "laser.divergence_mrad",
    "optics",
    "tdc",
    "tdc.window_us",
    "tdc.threshold_to_noise",
    "scanner.azimuth_step_deg",
    "scanner.type",
    "scanner",
    "a.b.c",
    "",
    "sun.illuminance_klux",
    "bodies.wall.size_m",
    "bodies.0.size_m",
    "bodies.wall.pitch_deg",
    "air.visibility_m",
    "weather.rain_mm_h",
    "bodies",
    "sensor.name",
    "laser.wavelength_nm",
    ".".join("a" * 500),
)


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
        mock.patch("lidarscene.studies.compare.comparison_study.write_comparison", return_value=""),
        mock.patch("lidarscene.view.page_sources.Live", side_effect=LidarSceneError("not here")),
    ):
        yield


def failure(drawn_input: Input) -> str:
    """What is wrong with what comes of it; "" if nothing is."""
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
    for number in range(first, first + count, stride):
        rng = random.Random(zlib.crc32(f"{seed} {number}".encode()))
        drawn_input = workshop.next_input(rng)
        why = failure(drawn_input)
        if why:
            yield f"seed {seed} input {number}", drawn_input, why
