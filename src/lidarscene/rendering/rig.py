"""Simulators of a rig: one for each of its sensors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ..errors import InputError
from ..kernel.rays.trace import INTERACTIONS
from ..kernel.world.build import World
from ..maths.pose import Pose
from ..scene.model import Scene
from ..sensor.rig import Mounted
from .simulator import Simulator


def simulators(
    scene: Scene,
    sensors: Sequence[Mounted],
    *,
    pose: Pose | None = None,
    rays: int = 1,
    interactions: int = INTERACTIONS,
    background_rays: int | None = None,
) -> Iterator[tuple[str, Simulator]]:
    """Label and simulator of each sensor; those of one wavelength share one compiled world.

    pose  of the vehicle, in the world or, of a scene in which it moves, in the ego frame
    rays, interactions, background_rays  as of `Simulator`
    """
    worlds: dict[float, World] = {}
    vehicle = pose or Pose()
    for one in sensors:
        wavelength = one.sensor.laser.wavelength_m
        simulator = Simulator(
            scene,
            one.sensor,
            pose=vehicle @ one.pose,
            world=worlds.get(wavelength),
            rays=rays,
            interactions=interactions,
            background_rays=background_rays,
        )
        worlds.setdefault(wavelength, simulator.world)
        yield one.label, simulator


def require_common_frames(sensors: Sequence[Mounted], frames: int) -> None:
    """Raises InputError where the n-th frames of these sensors are of different times, so that none can be merged.

    Turns of 99.99 and 100 ms are no mistake: the last of the frames may begin half a frame apart.
    """
    lengths = {one.label: one.sensor.scanner.frame_s for one in sensors}
    short, long = (
        min(lengths, key=lambda label: lengths[label]),
        max(lengths, key=lambda label: lengths[label]),
    )
    if (frames - 1) * (lengths[long] - lengths[short]) > lengths[short] / 2.0:
        raise InputError(
            f"{frames} merged frames: frames that begin together were expected, '{short}' has them of "
            f"{lengths[short]:g} s and '{long}' of {lengths[long]:g} s"
        )
