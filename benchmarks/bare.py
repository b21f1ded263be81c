"""The chain against a C++ program on bare Embree: what no change to the chain can ever beat.

The program (`bare.cpp`) is compiled where there is a C++ compiler, with the Embree that comes with Mitsuba, or that of
libembree-dev.
"""

import contextlib
import ctypes
import functools
import shutil
import subprocess
import tempfile
import warnings
from collections.abc import Callable
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import chain
import clock
import numpy as np
from table import Row, Section, verdict

from lidarscene import load_scene, load_sensor
from lidarscene.errors import LidarSceneError
from lidarscene.kernel.device.backend import mitsuba
from lidarscene.kernel.device.blocks import usable_cores
from lidarscene.kernel.rays.onward import START_OFFSET_M
from lidarscene.maths.pose import Pose
from lidarscene.rendering.simulator import Simulator, Summary
from lidarscene.scene.scene import Scene

OURS, BARE, OPEN3D = "lidarscene", "bare Embree", "Open3D"
MOST = {"30k": 1.8}
LEAST = {"65k": 1.5, "1M": 3.0}

CITY = "Munich"
STREET_M = (45.0, 90.0, 1.5)
"""A place in a street of that city."""

TEXT = f"""`bare Embree` is a C++ program that asks for the same closest hits and shadow rays of the same triangles, in
the same order and in packets of 16, with as many threads and with Mitsuba's own Embree, and does nothing else.
`lidarscene` is the whole chain of `table1-apd` with beams that end at the first surface; `Open3D` has its rays ready,
and makes the sun rays of its hits. Nothing that asks Embree for these rays is faster than `bare Embree`: a goal for
`Open3D / lidarscene` above the `Open3D / bare Embree` of the same run is out of reach on that machine, and says so. CPU
is the ratio of the time of all threads, which other programs on the machine lengthen less; Dr.Jit's threads spend some
of it waiting for work while Python prepares it. {CITY} is a city of Sionna RT."""


def measure(
    scene_file: Path, *, sizes: dict[str, float], triangles: int, middle: str, city: bool, rounds: int
) -> Section:
    """Rows of a scene with each size, and with one of them of a ground of so many triangles and of a city.

    Args:
        middle: the size with which those are seen
        city: whether it is asked for
    """
    import peers

    scene = load_scene(scene_file)
    library = compile_library()
    rows, world = [], None
    for beams, step_deg in sizes.items():
        simulator = _simulator(scene, step_deg, world=world)
        world = simulator.world
        rows += _rows(library, simulator, scene_file.name, beams, rounds)
    ground = _simulator(peers.ground(scene, triangles), sizes[middle])
    rows += _rows(library, ground, f"{triangles:,} triangles", middle, rounds)
    if city:
        try:
            place = Pose.from_degrees(position_m=STREET_M)
            with warnings.catch_warnings(action="ignore"):  # which materials stand in for those of radio
                simulator = _simulator(load_scene(_city()), sizes[middle], pose=place)
            rows += _rows(library, simulator, CITY, middle, rounds)
        except (ModuleNotFoundError, FileNotFoundError) as error:
            rows.append(Row(CITY, "-", "", f"not measured: {error}"))
    return Section("Against bare Embree", TEXT, rows)


def _city() -> Path:
    """The scene file of a city in the package sionna-rt, which need not be importable."""
    path = Path(str(distribution("sionna-rt").locate_file("sionna/rt/scenes/munich/munich.xml")))
    if not path.is_file():
        raise FileNotFoundError(f"no {path}")
    return path


def _simulator(scene: Scene, step_deg: float, **options: Any) -> Simulator:
    steps = [f"scanner.{axis}_step_deg={step_deg}" for axis in ("azimuth", "elevation")]
    return Simulator(scene, load_sensor("table1-apd", overrides=steps), interactions=0, **options)


def _rows(library: Any | None, simulator: Simulator, scene: str, beams: str, rounds: int) -> list[Row]:
    case = f"{scene}, {beams} beams"
    if library is None:
        return [Row(f"{case}: {OURS} / {BARE}", "-", "", "not measured: no C++ compiler with Embree")]
    tasks: dict[str, Callable[[], Any]] = {OURS: simulator.render, BARE: task(library, simulator)}
    with contextlib.suppress(LidarSceneError):  # without Open3D its rows are left out
        tasks[OPEN3D] = chain.open3d_tasks(simulator)[OPEN3D]
    seconds, busy = clock.both_in_turns(tasks, rounds=rounds)
    summary = Summary()
    simulator.render(summary=summary)
    hits = int(np.isfinite(tasks[BARE]()[0]).sum())
    if abs(hits - summary.hits) > 1e-3 * summary.beams:  # a ray that grazes an edge may miss it
        raise SystemExit(f"benchmarks: {case}: bare Embree finds {hits:,} hits, lidarscene {summary.hits:,}")
    rows = []
    for slow, fast in ((OURS, BARE), (OPEN3D, BARE), (OPEN3D, OURS)):
        if slow not in tasks:
            continue
        median, low, high = clock.ratio(seconds, slow, fast)
        cpu, *_ = clock.ratio(busy, slow, fast)
        note = f"CPU {cpu:.2f}; {1e3 * np.median(seconds[fast]):.1f} ms"
        goal = _goal(slow, fast, beams, median)
        if (slow, fast) == (OPEN3D, OURS) and goal and (bound := clock.ratio(seconds, OPEN3D, BARE)[0]) < LEAST[beams]:
            goal += f"; bare Embree itself reaches {bound:.2f}"
        rows.append(Row(f"{case}: {slow} / {fast}", f"{median:.2f}", f"{low:.2f} to {high:.2f}", note, goal))
    return rows


def _goal(slow: str, fast: str, beams: str, median: float) -> str:
    if (slow, fast) == (OURS, BARE) and beams in MOST:
        return verdict(f"at most {MOST[beams]:g}", median <= MOST[beams])
    if (slow, fast) == (OPEN3D, OURS) and beams in LEAST:
        return verdict(f"at least {LEAST[beams]:g}", median >= LEAST[beams])
    return ""


@functools.cache
def compile_library() -> Any:
    """`bare.cpp` as a library; None without a C++ compiler."""
    compiler = next((path for name in ("c++", "g++", "clang++") if (path := shutil.which(name))), None)
    if compiler is None:
        return None
    embree = Path(str(mitsuba().__file__)).parent
    folder = Path(tempfile.mkdtemp(prefix="bare-"))
    target = folder / "bare.so"
    embree_options = [f"-I{embree / 'include'}", f"-L{embree}", f"-Wl,-rpath,{embree}"] if _has_embree(embree) else []
    command = [
        compiler,
        "-O3",
        "-march=native",
        "-std=c++17",
        "-shared",
        "-fPIC",
        "-pthread",
        *embree_options,
        str(Path(__file__).with_name("bare.cpp")),
        "-o",
        str(target),
        "-lembree3",
    ]
    try:
        subprocess.run(command, check=True, capture_output=True, timeout=300)
        library = ctypes.CDLL(str(target))
    except (subprocess.CalledProcessError, OSError):
        return None
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    pointer, size = ctypes.c_void_p, ctypes.c_size_t
    library.bare_scene.argtypes, library.bare_scene.restype = [pointer, size, pointer, size], pointer
    library.bare_trace.argtypes = [
        pointer,
        pointer,
        pointer,
        pointer,
        pointer,
        size,
        pointer,
        ctypes.c_float,
        ctypes.c_int,
        pointer,
        pointer,
    ]
    library.bare_trace.restype = None
    return library


def _has_embree(folder: Path) -> bool:
    return (folder / "include" / "embree3" / "rtcore.h").is_file() and (folder / "libembree3.so").is_file()


def task(
    library: Any, simulator: Simulator, *, lanes: np.ndarray | None = None
) -> Callable[[], tuple[np.ndarray, np.ndarray]]:
    """Distances (n,), infinite for none, and whether the sun is seen (n,), by lane.

    Args:
        lanes: which of the frame's beams are traced, in order; None: all
    """
    vertices, faces = (np.ascontiguousarray(array) for array in chain.triangles(simulator))
    scene = library.bare_scene(vertices.ctypes.data, len(vertices), faces.ctypes.data, len(faces))
    pulses = simulator.sensor.scanner.pulses
    order = simulator.numbering.lane_order(pulses)
    pulse = np.arange(pulses) if order is None else order.pulse
    if lanes is not None:
        pulse, pulses = pulse[lanes], len(lanes)
    rays = chain.beam_rays(simulator)[pulse]
    origin = np.array(chain.origin(simulator), np.float32)
    axes = [np.ascontiguousarray(rays[:, 3 + axis]) for axis in range(3)]
    sun = np.asarray(simulator.scene.sun.direction, np.float32)
    threads = usable_cores()

    def run() -> tuple[np.ndarray, np.ndarray]:
        t, lit = np.zeros(pulses, np.float32), np.zeros(pulses, np.uint8)
        library.bare_trace(
            scene,
            origin.ctypes.data,
            *(axis.ctypes.data for axis in axes),
            pulses,
            sun.ctypes.data,
            START_OFFSET_M,
            threads,
            t.ctypes.data,
            lit.ctypes.data,
        )
        return t, lit

    return run
