"""The chain by hand, every lane kept: what the tests look at between the stages."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lidarscene import Scene, Sensor, load_sensor
from lidarscene.detection import receiver
from lidarscene.kernel.device import transfer
from lidarscene.kernel.rays.trace import Firing, trace
from lidarscene.kernel.world.mitsuba_world import World, build_world
from lidarscene.light import beams, echoes
from lidarscene.light.footprint import aim, footprint
from lidarscene.materials.material import Material, Spectrum
from lidarscene.maths.pose import Pose
from lidarscene.rendering.stages import ambient_of
from lidarscene.scene.meshes.primitives import box_mesh, plane_mesh
from lidarscene.scene.scene import Air, Ball, Body, Part, Sky, Sun


def raster(azimuth_fov_deg: float, elevation_fov_deg: float, *step_deg: float) -> list[str]:
    """Overrides for a raster: its fields in azimuth and elevation, and its steps there, or one step for both."""
    numbers = {"fov": (azimuth_fov_deg, elevation_fov_deg), "step": (step_deg[0], step_deg[-1])}
    return [
        f"scanner.{axis}_{key}_deg={number}"
        for key, pair in numbers.items()
        for axis, number in zip(("azimuth", "elevation"), pair, strict=True)
    ]


NARROW = raster(0.02, 0.02, 0.01)
"""A raster of 3 x 3 beams around the x axis; the middle one, number 4, is exactly on it."""


def words(*overrides: str) -> list[str]:
    """Overrides one by one, where a text may have several; a table in braces is one."""
    return [word for text in overrides for word in re.split(r" (?=[\w.]+=)(?![^{]*})", text)]


def sensor(name: str, *overrides: str) -> Sensor:
    return load_sensor(name, overrides=words(*overrides))


def diffuse(name: str = "grey", reflectivity: float = 0.1) -> Material:
    return Material(name=name, bsdf="diffuse", reflectivity=Spectrum.constant(reflectivity))


def facing(
    *,
    range_m: float,
    theta_deg: float = 0.0,
    size_m: float | None = None,
    at: Sequence[float] = (0.0, 0.0, 0.0),
    material: str = "grey",
) -> Body:
    """A plane at this range on the x axis of a sensor at ``at``, its normal theta away from the beam."""
    size = size_m or max(4.0, range_m / 10.0)
    vertices, faces = plane_mesh(size_m=(size, size))
    # The plane's normal is +z; pitching by -90 degrees turns it to -x, towards the sensor.
    turn = Pose.from_degrees(yaw_deg=theta_deg) @ Pose.from_degrees(pitch_deg=90.0)
    place = Pose(position_m=np.add(at, (range_m, 0.0, 0.0)), rotation=turn.rotation)
    return Body(
        name="plane", class_name="plane", pose=place, parts=(Part(vertices_m=vertices, faces=faces, material=material),)
    )


def box(
    *,
    at: tuple[float, float, float],
    size_m: tuple[float, float, float] = (2.0, 3.0, 1.5),
    yaw_deg: float = 0.0,
    material: str = "grey",
) -> Body:
    vertices, faces = box_mesh(size_m=size_m)
    return Body(
        name="box",
        class_name="box",
        pose=Pose.from_degrees(position_m=at, yaw_deg=yaw_deg),
        parts=(Part(vertices_m=vertices, faces=faces, material=material),),
    )


def ball(*, at: tuple[float, float, float], radius_m: float = 1.0, material: str = "grey") -> Body:
    return Body(
        name="ball",
        class_name="ball",
        pose=Pose.from_degrees(position_m=at),
        parts=(Ball(radius_m=radius_m, material=material),),
    )


def scene(
    *bodies: Body,
    materials: Sequence[Material] = (),
    klux: float = 100.0,
    sun: Sun | None = None,
    sky: float = 0.0,
    air: Air | None = None,
    pose: Pose | None = None,
) -> Scene:
    """A scene of these bodies, grey (10 %) unless said otherwise, under Table 1's light and air."""
    by_name = {material.name: material for material in (diffuse(), *materials)}
    return Scene(
        name="test",
        bodies=tuple(bodies),
        materials=by_name,
        sky=Sky(diffuse_share=sky),
        sun=sun or Sun(azimuth_rad=math.pi, elevation_rad=math.radians(60.0), illuminance_klux=klux),
        air=air or Air(transmittance=0.98),
        sensor_pose=pose or Pose(),
    )


@dataclass(frozen=True)
class Lanes:
    """Every pulse's numbers between the stages, numpy; ``hits`` of the first way, and of all of them."""

    direction: Any
    hits: Any
    light: Any
    detection: Any
    ways: Any
    light_of_ways: Any


def run_stages(
    described: Scene,
    equipped: Sensor,
    *,
    seed: int = 0,
    centre: Sequence[float] | None = None,
    world: World | None = None,
    glints: bool = False,
    **tracing: Any,
) -> Lanes:
    """One frame, stage by stage, on the device; every lane comes back. ``tracing`` goes to `trace`.

    Args:
        world: of the scene, if there is one already
        glints: whether panes and mirrors may throw beams back, as in `Simulator`
    """
    place = described.sensor_pose @ equipped.mounting
    centre_m = place.position_m if centre is None else np.asarray(centre)
    world = world or build_world(described, wavelength_m=equipped.laser.wavelength_m, centre_m=centre_m)
    on_device = transfer.opaque(equipped)
    pulse = transfer.counter(0, equipped.scanner.pulses)
    rotation = transfer.opaque(tuple(float(x) for x in place.rotation.ravel()))
    rays = beams.fire(
        on_device,
        pulse=pulse,
        origin_m=transfer.opaque(tuple(float(x) for x in place.position_m - world.centre_m)),
        rotation=rotation,
    )
    aimed = None
    if glints:
        shape = transfer.opaque(footprint(equipped.laser, 1))
        aimed = aim(rays, shape, profile=equipped.laser.profile, rotation=rotation)
    tracing.setdefault("firing", Firing(seed=transfer.seed_word(seed), aim=aimed))
    sun = transfer.opaque(tuple(float(x) for x in described.sun.direction))
    ways = trace(world, rays, sun=sun, **tracing)
    ambient = transfer.opaque(ambient_of(described, equipped))
    light_of_ways = [echoes.receive(rays, hits, on_device, ambient) for hits in ways]
    light = echoes.gather_background(light_of_ways)[0]
    detection = receiver.detect(light, on_device, seed=transfer.seed_word(seed), pulse=pulse)
    # In one kernel: each array alone would take one of its own, with all that comes before it.
    stages = (rays.direction, tuple(ways), tuple(light_of_ways), light, detection)
    direction, ways, light_of_ways, light, detection = transfer.fetch(stages)
    return Lanes(np.stack(direction, axis=1), ways[0], light, detection, ways, light_of_ways)
