"""A GPU: frames of each sensor, to the device and to NumPy, against bare hits of the same rays, and against Warp.

Run alone: python benchmarks/gpu.py [--variant llvm] [--scene FILE] [--rounds N] [--frames N] [SENSOR ...]. Each sensor
is measured in a process of its own. `uv sync --group gpu` installs NVIDIA Warp.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import chain
import clock
import numpy as np
from table import Row, Section, line, markdown

from lidarscene import Outputs, load_scene, load_sensor, record, render_frames
from lidarscene.kernel.device import backend, blocks, transfer
from lidarscene.rendering.simulator import Simulator

ROOT = Path(__file__).parents[1]
VARIANTS = {"cuda": "cuda_ad_mono", "llvm": "llvm_ad_mono"}
SENSORS = ("vlp-16", "hdl-64e", "os1-128", "table1-apd")
BUSY, MOVING = "os1-128", ("drive", "town")
BARE, WARP, DEVICE, NUMPY = "bare hits", "Warp", "to the device", "to NumPy"
SEQUENCE = "in sequence"
COLUMNS = (
    "scene, sensor",
    "beams",
    f"{BARE}, ms",
    f"{WARP}, ms",
    "kernels, ms",
    f"{DEVICE}, ms",
    f"{NUMPY}, ms",
    f"{SEQUENCE}, ms",
    "first frame, s",
    "memory, MiB",
)

LABELLED = """`record` of consecutive frames into files of SemanticKITTI, from scene and sensor to the last file."""
TEXT = """Medians by the clock of frames by `{variant}`. `bare hits` asks Mitsuba for the closest surface of the same
beams, by OptiX on a GPU, and for nothing else; `Warp` asks NVIDIA Warp's mesh for it, as mujoco-lidar's back end of
that name does, all triangles in one mesh. Both have their rays ready, leave the answers on the device, and in scenes
that move have what stands still alone. `kernels` is the sum of what the device computes for a frame. `to the device`
and `to NumPy` are `render` with `on_device=True` and without. `in sequence` is a frame of `render_frames` to the device
after two launches, which frames that follow each other share. The first frame is that of a fresh process, its world not
included; compiled kernels are cached on disk. Memory is that of the GPU at its peak, or on a CPU of the process."""


def measure(
    scene_file: Path,
    *,
    sensors: Sequence[str] = SENSORS,
    moving: Sequence[str] = MOVING,
    variant: str,
    rounds: int,
    frames: int,
) -> list[Section]:
    """One row for each sensor, one for `BUSY` in each of the moving scenes, and one for labelled frames."""
    if variant == VARIANTS["cuda"] and backend.probe().variant != variant:
        missing = Row("frames", "-", "", "not measured: no GPU that renders as the CPU does")
        return [Section("A GPU", TEXT.format(variant=variant), [missing])]
    cases = [
        *((scene_file, name) for name in sensors),
        *((ROOT / "scenes" / f"{scene}.toml", BUSY) for scene in moving),
    ]
    rows = [_in_process(variant, "row", scene, name, "--rounds", str(rounds)) for scene, name in cases]
    scene, name = cases[-1]
    labelled = _in_process(variant, "labelled", scene, name, "--frames", str(frames))
    return [
        Section("A GPU", TEXT.format(variant=variant), rows, COLUMNS),
        Section("Labelled frames on a GPU", LABELLED, [Row(*labelled)]),
    ]


def _in_process(variant: str, what: str, scene: Path, sensor: str, *options: str) -> tuple[str, ...]:
    """The cells that this file prints for one sensor in one scene, in a process of its own."""
    command = [sys.executable, __file__, sensor, "--alone", what, "--scene", str(scene), *options]
    environment = os.environ | {"LIDARSCENE_VARIANT": variant}
    printed = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env=environment).stdout
    return tuple(cell.strip() for cell in printed.splitlines()[-1].removeprefix("|").removesuffix("|").split("|"))


def _row(scene_file: Path, name: str, rounds: int) -> tuple[str, ...]:
    import drjit as dr

    backend.mitsuba()
    simulator = Simulator(load_scene(scene_file), load_sensor(name))
    since = time.perf_counter()
    simulator.render()
    first_s = time.perf_counter() - since
    tasks: dict[str, Callable[[], Any]] = {
        BARE: _bare(simulator),
        DEVICE: lambda: _finished(simulator.render(on_device=True)),
        NUMPY: simulator.render,
    }
    try:
        tasks[WARP] = _warp(simulator)
    except ModuleNotFoundError:
        print("gpu: Warp is not installed and is left out; uv sync --group gpu installs it", file=sys.stderr)
    seconds = clock.in_turns(tasks, rounds=rounds)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        simulator.render()
        kernels_ms = sum(kernel.get("execution_time") or 0.0 for kernel in dr.kernel_history())
    cells = {task: f"{1e3 * np.median(values):.2f}" for task, values in seconds.items()}
    return (
        f"{scene_file.stem}, {name}",
        f"{simulator.sensor.scanner.pulses:,}",
        cells[BARE],
        cells.get(WARP, "-"),
        f"{kernels_ms:.2f}",
        cells[DEVICE],
        cells[NUMPY],
        f"{1e3 * _in_sequence(simulator):.2f}",
        f"{first_s:.2f}",
        f"{_memory_mib():.0f}",
    )


def _in_sequence(simulator: Simulator) -> float:
    """Seconds of a frame of a sequence, whose launches hold `blocks.lanes_per_launch` rays."""
    launch = max(blocks.lanes_per_launch() // simulator.sensor.scanner.pulses, 1)
    frames = render_frames(simulator.scene, simulator.sensor, frames=8 * launch, on_device=True)
    ends = [time.perf_counter() for cloud in frames if _finished(cloud)]
    return (ends[-1] - ends[2 * launch]) / (len(ends) - 1 - 2 * launch)


def _finished(result: Any) -> Any:
    transfer.wait()
    return result


def _directions(simulator: Simulator) -> np.ndarray:
    """(n, 3) float32 directions in the order in which the frame traces them."""
    order = simulator.numbering.lane_order(simulator.sensor.scanner.pulses)
    directions = chain.beam_rays(simulator)[:, 3:]
    return np.ascontiguousarray(directions if order is None else directions[order.pulse])


def _bare(simulator: Simulator) -> Callable[[], Any]:
    import drjit as dr

    mi = backend.mitsuba()
    ray = mi.Ray3f(mi.Point3f(*chain.origin(simulator)), mi.Vector3f(*np.ascontiguousarray(_directions(simulator).T)))
    dr.make_opaque(ray)

    def task() -> Any:
        hits = simulator.world.scene.ray_intersect_preliminary(ray)
        dr.eval(hits)
        return _finished(hits)

    return task


def _warp(simulator: Simulator) -> Callable[[], Any]:
    """Distances by Warp on the same device, infinite for none.

    Raises:
        ModuleNotFoundError: without Warp
    """
    import warp as wp

    wp.config.quiet = True
    wp.init()

    @wp.kernel
    def cast(mesh: wp.uint64, origin: wp.vec3, direction: wp.array(dtype=wp.vec3), t: wp.array(dtype=float)):
        ray = wp.tid()
        query = wp.mesh_query_ray(mesh, origin, direction[ray], 1.0e6)
        t[ray] = wp.inf
        if query.result:
            t[ray] = query.t

    device = "cuda" if backend.is_cuda() else "cpu"
    vertices, faces = chain.triangles(simulator)
    mesh = wp.Mesh(
        points=wp.array(vertices, dtype=wp.vec3, device=device),
        indices=wp.array(faces.ravel().astype(np.int32), dtype=int, device=device),
    )
    direction = wp.array(_directions(simulator), dtype=wp.vec3, device=device)
    t = wp.zeros(len(direction), dtype=float, device=device)
    origin = wp.vec3(*chain.origin(simulator))

    def task() -> Any:
        wp.launch(cast, dim=len(direction), inputs=[mesh.id, origin, direction, t], device=device)
        wp.synchronize_device(device)
        return t

    return task


def _memory_mib() -> float:
    """Peak of the memory of a GPU that Dr.Jit has had, or of the process on a CPU."""
    import drjit as dr

    if backend.is_cuda():
        return float(dr.detail.malloc_watermark(dr.JitBackend.CUDA)) / 2**20
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10


def _labelled(scene_file: Path, name: str, frames: int) -> tuple[str, ...]:
    with tempfile.TemporaryDirectory() as folder:
        since = time.perf_counter()
        record(scene_file, name, outputs=Outputs(Path(folder) / "set", dataset="semantickitti"), frames=frames)
        spent = time.perf_counter() - since
    note = f"{1e3 * spent / frames:.1f} ms a frame"
    return f"{frames:,} labelled frames, {scene_file.stem}, {name}", f"{spent:.1f} s", "", note, ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sensors", nargs="*", metavar="SENSOR")
    parser.add_argument("--variant", choices=VARIANTS, default="cuda")
    parser.add_argument("--scene", type=Path, default=ROOT / "scenes" / "street.toml")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--frames", type=int, default=1000, help="that are labelled, of os1-128 in the town")
    parser.add_argument("--alone", choices=("row", "labelled"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.alone:
        cells = (
            _row(arguments.scene, arguments.sensors[0], arguments.rounds)
            if arguments.alone == "row"
            else _labelled(arguments.scene, arguments.sensors[0], arguments.frames)
        )
        print(line(cells), end="")
        return
    for section in measure(
        arguments.scene,
        sensors=arguments.sensors or SENSORS,
        moving=() if arguments.sensors else MOVING,
        variant=VARIANTS[arguments.variant],
        rounds=arguments.rounds,
        frames=arguments.frames,
    ):
        print(markdown([section]), flush=True)


if __name__ == "__main__":
    main()
