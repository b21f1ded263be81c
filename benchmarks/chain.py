"""Times from beams to kept numpy points: against Open3D, against Mitsuba's bare trace, and stage by stage."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import clock
import numpy as np
from table import Row, Section, verdict

from lidarscene import load_scene, load_sensor
from lidarscene.detection import receiver
from lidarscene.errors import LidarSceneError
from lidarscene.files.open3d import open3d
from lidarscene.kernel.device import transfer
from lidarscene.kernel.device.backend import mitsuba
from lidarscene.kernel.rays.onward import START_OFFSET_M
from lidarscene.kernel.rays.trace import trace
from lidarscene.light import beams, echoes
from lidarscene.rendering.simulator import Simulator, Summary
from lidarscene.rendering.stages import ambient_of

SENSORS = ("table1-apd", "table1-sipm")
GOAL = 2.0
BARE_GOAL = 1.0 / 0.8
OPEN3D = {
    "Open3D, bare": "beam and sun rays ready as tensors; queries and numpy() only",
    "Open3D": "beam rays ready as a tensor; sun rays from its hits by numpy",
    "Open3D with rays": "beam rays from angles too",
}
JUDGED = ("Open3D", "Open3D with rays")  # nobody has the sun rays before the hits
BARE = "Mitsuba, bare"
THROUGH_GLASS = "table1-apd, through glass"


def measure(scene_file: Path, *, step_deg: float, rounds: int) -> list[Section]:
    """All sections of this file."""
    steps = [f"scanner.{axis}_step_deg={step_deg}" for axis in ("azimuth", "elevation")]
    scene = load_scene(scene_file)
    first = Simulator(scene, load_sensor(SENSORS[0], overrides=steps), interactions=0)
    simulators = {
        name: Simulator(scene, load_sensor(name, overrides=steps), world=first.world, interactions=0)
        for name in SENSORS
    }
    tasks: dict[str, Callable[[], Any]] = {name: simulator.render for name, simulator in simulators.items()}
    tasks[BARE] = _bare(first)
    missing = ""
    try:
        peers = open3d_tasks(first)
    except LidarSceneError as error:
        peers, missing = {}, f"not measured: {error}"
    seconds = clock.in_turns(tasks | peers, rounds=rounds)
    pulses = first.sensor.scanner.pulses
    ratios = [
        Row(f"{peer} / {task}", "-", "", missing) if missing else _ratio_row(seconds, peer, task)
        for task in (*SENSORS, BARE)
        for peer in OPEN3D
    ]
    size = f"{pulses:,} beams on the {len(first.world.face_body):,} triangles of {scene_file.name}"
    stages = [row for name, simulator in simulators.items() for row in _stage_rows(name, simulator, rounds)]
    return [
        Section("Seconds", f"{size}.\n{SECONDS}", [_seconds_row(*task, pulses) for task in seconds.items()]),
        Section("Times as fast", RATIOS, ratios + [_ratio_row(seconds, name, BARE) for name in SENSORS]),
        Section("Where the time goes", SHARES, stages),
        Section("Through glass", GLASS, _glass_rows(Simulator(scene, first.sensor), first, peers, rounds)),
    ]


def _glass_rows(glass: Simulator, first: Simulator, peers: dict[str, Callable[[], Any]], rounds: int) -> list[Row]:
    """The default of `render`, in turns with the first surface and with others' first surface."""
    tasks = {SENSORS[0]: first.render, THROUGH_GLASS: glass.render} | peers
    seconds = clock.in_turns(tasks, rounds=rounds)
    rows = [_seconds_row(name, seconds[name], glass.sensor.scanner.pulses) for name in tasks if name not in peers]
    return [*rows, *(_ratio_row(seconds, peer, THROUGH_GLASS) for peer in (SENSORS[0], *peers))]


SECONDS = """`table1-apd` and `table1-sipm` are the whole chain, from pulse numbers to a `PointCloud` of numpy
columns, with beams that end at the first surface, as those of the others do. `Mitsuba, bare` is ray_intersect, the BSDF
back and towards the sun, and ray_test, in firing order, evaluated on the device and left there. The three of Open3D are
cast_rays, and test_occlusions for the hits that face the sun, with numpy() of all answers: no BSDF, no physics. All
tasks take turns in one process; what they return is freed off the clock."""

GLASS = """`table1-apd, through glass` is what `render` does by default: on through panes and off mirrors, of which
street.toml has many. Ratios are to it; the others stop at the first surface. Two compiled worlds are in the process
here, which costs all but Open3D some time."""

RATIOS = """How many times as long the first took as the second, in the same round: above 1 the second is faster."""

SHARES = """Shares of a frame's time by stage, then of the device's time by how much longer the kernel takes with each
further stage."""


def _seconds_row(name: str, values: np.ndarray, beams_each: int) -> Row:
    median = float(np.median(values))
    rate = f"{beams_each / median / 1e6:.2f} million beams a second"
    return Row(name, f"{median:.3f} s", f"{values.min():.3f} to {values.max():.3f}", rate)


def _ratio_row(seconds: clock.Seconds, slow: str, fast: str) -> Row:
    median, low, high = clock.ratio(seconds, slow, fast)
    goal = ""
    if slow in JUDGED and fast in SENSORS:
        goal = verdict(f"at least {GOAL}", median >= GOAL)
    if slow in SENSORS and fast == BARE:
        goal = verdict(f"at most {BARE_GOAL}", median <= BARE_GOAL)
    return Row(f"{slow} / {fast}", f"{median:.2f}", f"{low:.2f} to {high:.2f}", OPEN3D.get(slow, ""), goal)


# --- the same work by others ------------------------------------------------------------------------


def _rays(simulator: Simulator) -> tuple[Any, Any]:
    """Origin (one) and directions (n) on the device, as the chain fires them."""
    import drjit as dr

    rays = beams.fire(
        transfer.opaque(simulator.sensor),
        pulse=transfer.counter(0, simulator.sensor.scanner.pulses),
        origin_m=transfer.opaque(origin(simulator)),
        rotation=transfer.opaque(tuple(float(x) for x in simulator.pose.rotation.ravel())),
    )
    mi = mitsuba()
    place, direction = mi.Point3f(*rays.origin_m), mi.Vector3f(*rays.direction)
    dr.eval(place, direction)
    return place, direction


def origin(simulator: Simulator) -> tuple[float, float, float]:
    """Origin of the rays where they are traced."""
    x, y, z = (float(x) for x in simulator.pose.position_m - simulator.world.centre_m)
    return x, y, z


def _bare(simulator: Simulator) -> Callable[[], Any]:
    """Closest hit, BSDF back and towards the sun, sun test; evaluated on the device and left there."""
    import drjit as dr

    mi = mitsuba()
    scene = simulator.world.scene
    place, direction = _rays(simulator)
    sun = mi.Vector3f(*transfer.opaque(tuple(float(x) for x in simulator.scene.sun.direction)))
    context = mi.BSDFContext()

    def task() -> Any:
        ray = mi.Ray3f(place, direction)
        surface = scene.ray_intersect(ray, mi.RayFlags.All, coherent=True)
        is_hit = surface.is_valid()
        normal = surface.n * dr.select(dr.dot(surface.n, direction) > 0.0, -1.0, 1.0)
        sunny = is_hit & (dr.dot(normal, sun) > 0.0)
        shadow = mi.Ray3f(surface.p + normal * START_OFFSET_M, sun)
        lit = sunny & ~scene.ray_test(shadow, coherent=True, active=sunny)
        bsdf = surface.bsdf()
        backscatter = bsdf.eval(context, surface, surface.wi, is_hit)
        towards_sun = bsdf.eval(context, surface, surface.to_local(sun), lit)
        dr.eval(surface.t, backscatter, towards_sun, lit)
        dr.sync_thread()
        return surface.t, backscatter, towards_sun, lit

    return task


def open3d_tasks(simulator: Simulator, *, threads: int = 0) -> dict[str, Callable[[], Any]]:
    """Open3D on the same triangles, rays and sun; only rays that hit a side facing the sun ask for it.

    Args:
        threads: 0 for as many as there are
    """
    module = open3d()
    tensor = module.core.Tensor
    scene = module.t.geometry.RaycastingScene()
    scene.add_triangles(*(tensor(array) for array in triangles(simulator)))
    sun = simulator.scene.sun.direction.astype(np.float32)

    def sun_rays(rays: np.ndarray, answer: dict[str, np.ndarray]) -> np.ndarray:
        direction, normal, t = rays[:, 3:], answer["primitive_normals"], answer["t_hit"]
        facing = -np.sign(np.einsum("ij,ij->i", normal, direction))
        chosen = np.flatnonzero(np.isfinite(t) & ((normal @ sun) * facing > 0.0))
        sun_rays_made = np.zeros((len(chosen), 6), dtype=np.float32)
        np.multiply(direction[chosen], t[chosen, None], out=sun_rays_made[:, :3])
        sun_rays_made[:, :3] += rays[chosen, :3] + normal[chosen] * (facing[chosen, None] * np.float32(START_OFFSET_M))
        sun_rays_made[:, 3:] = sun
        return sun_rays_made

    def cast_rays(rays: Any) -> dict[str, np.ndarray]:
        return {name: values.numpy() for name, values in scene.cast_rays(rays, nthreads=threads).items()}

    def in_the_dark(rays: Any) -> np.ndarray:
        answer: np.ndarray = scene.test_occlusions(rays, nthreads=threads).numpy()
        return answer

    traced_rays = beam_rays(simulator)
    ready = tensor(traced_rays)
    towards_sun = tensor(sun_rays(traced_rays, cast_rays(ready)))

    def sun_from_hits() -> Any:
        answer = cast_rays(ready)
        return answer, in_the_dark(tensor(sun_rays(traced_rays, answer)))

    def all_built() -> Any:
        rays = beam_rays(simulator)
        answer = cast_rays(tensor(rays))
        return answer, in_the_dark(tensor(sun_rays(rays, answer)))

    bodies: tuple[Callable[[], Any], ...] = (
        lambda: (cast_rays(ready), in_the_dark(towards_sun)),
        sun_from_hits,
        all_built,
    )
    return dict(zip(OPEN3D, bodies, strict=True))


def beam_rays(simulator: Simulator) -> np.ndarray:
    """(n, 6) float32, origins and directions from angles, by numpy."""
    scanner = simulator.sensor.scanner
    azimuth, elevation = (np.float32(angle) for angle in scanner.angles(np.arange(scanner.pulses, dtype=np.uint32)))
    rays = np.zeros((scanner.pulses, 6), dtype=np.float32)
    rays[:, :3] = origin(simulator)
    level = np.cos(elevation)
    local = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=1)
    np.matmul(local, simulator.pose.rotation.astype(np.float32).T, out=rays[:, 3:])
    return rays


def triangles(simulator: Simulator) -> tuple[np.ndarray, np.ndarray]:
    """All triangles as they are traced: vertices (v, 3) float32, faces (f, 3) uint32."""
    vertices, faces, start = [], [], 0
    for shape in simulator.world.scene.shapes():
        vertices.append(shape.vertex_positions_buffer().numpy().reshape(-1, 3))
        faces.append(shape.faces_buffer().numpy().reshape(-1, 3) + np.uint32(start))
        start += len(vertices[-1])
    return np.concatenate(vertices), np.concatenate(faces)


# --- where the time goes ----------------------------------------------------------------------------

STAGES = {
    "record": "Python: the stages written down for the device",
    "trace": "device: beams, hits, echoes, returns in one kernel",
    "collect": "numpy: kept points as columns",
    "assemble": "numpy: columns checked and joined",
}
DEVICE = {
    "hits": "beams, closest hit, BSDF, sun test",
    "echoes": "optical powers",
    "returns": "signal, noise, comparator, time",
}


def _stage_rows(name: str, simulator: Simulator, rounds: int) -> list[Row]:
    spent: dict[str, list[float]] = {stage: [] for stage in STAGES}
    for _ in range(rounds):
        summary = Summary()
        simulator.render(summary=summary)
        for stage, values in spent.items():
            values.append(summary.seconds.get(stage, 0.0))
    medians = {stage: float(np.median(values)) for stage, values in spent.items()}
    total = sum(medians.values())
    rows = [
        Row(f"{name}: {stage}", f"{medians[stage] / total:.0%}", f"{medians[stage]:.3f} s", meaning)
        for stage, meaning in STAGES.items()
    ]
    return rows + _device_rows(name, simulator, rounds)


def _device_rows(name: str, simulator: Simulator, rounds: int) -> list[Row]:
    """Shares of the device's time: what the kernel takes longer with each further stage."""
    import drjit as dr

    sensor = transfer.opaque(simulator.sensor)
    ambient = transfer.opaque(ambient_of(simulator.scene, simulator.sensor))
    sun = transfer.opaque(tuple(float(x) for x in simulator.scene.sun.direction))
    place = transfer.opaque(origin(simulator))
    rotation = transfer.opaque(tuple(float(x) for x in simulator.pose.rotation.ravel()))
    seed = transfer.opaque_uint32(0)
    order = simulator.numbering.lane_order(simulator.sensor.scanner.pulses)

    def task_up_to(last: str) -> Callable[[], None]:
        def task() -> None:
            pulse = transfer.counter(0, simulator.sensor.scanner.pulses) if order is None else order.on_device(0)
            rays = beams.fire(sensor, pulse=pulse, origin_m=place, rotation=rotation)
            hits, *_ = trace(simulator.world, rays, sun=sun, interactions=0)
            outputs = [hits.range_m, hits.cos_incidence, hits.reflectivity, hits.cos_sun, hits.lit, hits.face]
            if last == "hits":
                outputs += [hits.backscatter_per_sr, hits.sun_scatter_per_sr]
            else:
                light = echoes.receive(rays, hits, sensor, ambient)
                if last == "echoes":
                    outputs += [light.peak_power_w, light.background_power_w]
                else:
                    detection = receiver.detect(light, sensor, seed=seed, pulse=pulse)
                    outputs += [detection.snr, detection.detection_probability, detection.outcome, detection.ambient]
                    for stop in detection.stops:
                        outputs += [stop.reported, stop.status, stop.range_m, stop.intensity]
            dr.eval(*outputs)
            dr.sync_thread()

        return task

    seconds = clock.in_turns({last: task_up_to(last) for last in DEVICE}, rounds=rounds)
    medians = [float(np.median(values)) for values in seconds.values()]
    added = np.diff([0.0, *medians])
    return [
        Row(
            f"{name}: device, {stage}",
            f"{round(stage_s / medians[-1], 2) + 0.0:.0%}",
            f"{round(stage_s, 3) + 0.0:.3f} s",
            meaning,
        )
        for (stage, meaning), stage_s in zip(DEVICE.items(), added, strict=True)
    ]
