"""The whole chain against other ray casters: scenes, numbers of beams, one thread and all of them."""

import dataclasses
import functools
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import chain
import clock
import numpy as np
from table import Row, Section, verdict

from lidarscene import load_scene, load_sensor
from lidarscene.errors import LidarSceneError
from lidarscene.kernel.rays.onward import START_OFFSET_M
from lidarscene.rendering.simulator import Simulator
from lidarscene.scene.scene import Body, Part, Scene

OURS, EMBREEX, MUJOCO = "lidarscene", "trimesh + embreex", "mujoco-lidar"
MUJOCO_BEAMS, MUJOCO_TRIANGLES = 70_000, 2_000_000

TEXT = """`lidarscene` is the whole chain of `table1-apd`, with its detector, from pulse numbers to a `PointCloud`.
`Open3D` is cast_rays and test_occlusions towards the sun, rays ready as a tensor; `Open3D with rays` begins with
angles, as lidarscene does; `trimesh + embreex` has rays ready, and asks intersects_location and intersects_any, which
know one thread; `mujoco-lidar` the closest hit alone, by its CPU back end, from angles, on one thread. None of the
three has a BSDF or a detector. They take turns in one process. Figures are how many times as long the other took in
the same round."""


def measure(
    scene_file: Path, *, sizes: dict[str, float], synthetic: tuple[int, ...], middle: str, rounds: int
) -> Section:
    """Rows of a scene with each size, and of grounds with one.

    Args:
        sizes: steps of the raster in degrees by number of beams
        synthetic: triangles of each ground
        middle: the size with which those are seen
    """
    street = load_scene(scene_file)
    scenes = {scene_file.name: street} | {f"{count:,} triangles": ground(street, count) for count in synthetic}
    rows: list[Row] = []
    for name, scene in scenes.items():
        world = None
        measured_sizes = sizes if scene is street else {middle: sizes[middle]}
        for beams, step_deg in measured_sizes.items():
            steps = [f"scanner.{axis}_step_deg={step_deg}" for axis in ("azimuth", "elevation")]
            sensor = load_sensor("table1-apd", overrides=steps)
            simulator = Simulator(scene, sensor, world=world, interactions=0)
            world = simulator.world
            for threads in sorted({1, os.cpu_count() or 1}):
                rows += _rows(simulator, f"{name}, {beams} beams, {threads} threads", threads, rounds)
    return Section("Against other ray casters", TEXT, rows)


def ground(scene: Scene, triangles: int) -> Scene:
    """Rough ground that rises like a bowl around the sensor, 800 m wide, in place of a scene's bodies."""
    side = round((triangles / 2) ** 0.5) + 1
    x, y = np.meshgrid(np.linspace(-400, 400, side), np.linspace(-400, 400, side), indexing="ij")
    bumps = np.random.default_rng(1).uniform(-0.1, 0.1, x.shape)
    vertices = np.stack([x, y, (x**2 + y**2) / 1500 + bumps], axis=-1).reshape(-1, 3)
    corner = np.arange(side * side).reshape(side, side)[:-1, :-1].ravel()
    lower = np.stack([corner, corner + side, corner + side + 1], axis=1)
    upper = np.stack([corner, corner + side + 1, corner + 1], axis=1)
    material = next(part.material for part in scene.bodies[0].parts)
    part = Part(vertices_m=vertices, faces=np.concatenate([lower, upper]).astype(np.uint32), material=material)
    return dataclasses.replace(scene, bodies=(Body(name="ground", class_name="ground", parts=(part,)),))


def _rows(simulator: Simulator, case: str, threads: int, rounds: int) -> Iterator[Row]:
    import drjit as dr

    tasks: dict[str, Callable[[], Any]] = {OURS: simulator.render}
    missing: dict[str, str] = {}
    open3d = functools.cache(lambda: chain.open3d_tasks(simulator, threads=threads))
    makers: dict[str, Callable[[], Callable[[], Any]]] = {
        name: lambda name=name: open3d()[name] for name in chain.JUDGED
    }
    if threads == 1:
        makers[EMBREEX] = lambda: _embreex(simulator)
        small = simulator.sensor.scanner.pulses <= MUJOCO_BEAMS
        if small and len(simulator.world.face_body) <= MUJOCO_TRIANGLES:
            makers[MUJOCO] = lambda: _mujoco(simulator)
    for name, make in makers.items():
        try:
            tasks[name] = make()
        except (ImportError, LidarSceneError, ValueError) as error:  # not installed, or not for this scene
            missing[name] = f"not measured: {' '.join(str(error).split())[:100]}"
    before = dr.thread_count()
    dr.set_thread_count(threads)
    try:
        seconds = clock.in_turns(tasks, rounds=rounds)
    finally:
        dr.set_thread_count(before)
    rate = simulator.sensor.scanner.pulses / seconds[OURS] / 1e6
    spread = f"{rate.min():.2f} to {rate.max():.2f}"
    yield Row(f"{case}: {OURS}", f"{np.median(rate):.2f}", spread, "million beams a second")
    for name in makers:
        if name in missing:
            yield Row(f"{case}: {name}", "-", "", missing[name])
            continue
        median, low, high = clock.ratio(seconds, name, OURS)
        goal = verdict(f"at least {chain.GOAL}", median >= chain.GOAL) if name in chain.JUDGED else ""
        yield Row(f"{case}: {name}", f"{median:.2f}", f"{low:.2f} to {high:.2f}", "times as long", goal)


def _embreex(simulator: Simulator) -> Callable[[], Any]:
    import trimesh
    from trimesh.ray.ray_pyembree import RayMeshIntersector

    vertices, faces = chain.triangles(simulator)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    caster, normals = RayMeshIntersector(mesh), mesh.face_normals
    rays = chain.beam_rays(simulator)
    origins, directions = rays[:, :3].astype(np.float64), rays[:, 3:].astype(np.float64)
    sun = np.asarray(simulator.scene.sun.direction)

    def task() -> Any:
        place, ray, face = caster.intersects_location(origins, directions, multiple_hits=False)
        normal = normals[face]
        normal = normal * -np.sign(np.einsum("ij,ij->i", normal, directions[ray]))[:, None]
        sunny = normal @ sun > 0.0
        start = place[sunny] + START_OFFSET_M * normal[sunny]
        return place, ray, caster.intersects_any(start, np.broadcast_to(sun, start.shape))

    return task


def _mujoco(simulator: Simulator) -> Callable[[], Any]:
    import mujoco
    from mujoco_lidar import MjLidarWrapper

    vertices, faces = chain.triangles(simulator)
    description = mujoco.MjSpec()
    mesh = description.add_mesh(name="scene")
    mesh.uservert, mesh.userface = vertices.ravel(), faces.astype(np.int32).ravel()
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    shape = description.worldbody.add_geom()
    shape.type, shape.meshname = mujoco.mjtGeom.mjGEOM_MESH, "scene"
    shape.contype = shape.conaffinity = 0
    description.worldbody.add_site(name="lidar")
    model = description.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    wrapper = MjLidarWrapper(model, "lidar", backend="cpu", cutoff_dist=1000.0)
    scanner = simulator.sensor.scanner
    azimuth, elevation = scanner.angles(np.arange(scanner.pulses, dtype=np.uint32))
    return lambda: wrapper.trace_rays(data, azimuth, elevation)
