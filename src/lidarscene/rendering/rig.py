"""Simulators of a rig: one for each of its sensors.

Sensors of one wavelength share a world, which is dear to build. Frames that are to be merged must begin together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Unpack

from ..errors import InputError
from ..kernel.world.mitsuba_world import World
from ..maths.pose import Pose
from ..scene.scene import Scene
from ..sensor.rig import Mounted
from .options import TraceKeywords, TraceOptions
from .simulator import Simulator


def simulators(
    scene: Scene,
    sensors: Sequence[Mounted],
    trace: TraceOptions | None = None,
    *,
    pose: Pose | None = None,
    **options: Unpack[TraceKeywords],
) -> Iterator[tuple[str, Simulator]]:
    """Label and simulator of each sensor; those of one wavelength share one compiled world.

    pose            of the vehicle, in the world or, of a scene in which it moves, in the ego frame
    trace, options  as of `Simulator`
    """
    worlds: dict[float, World] = {}
    vehicle = pose or Pose()
    for one in sensors:
        wavelength = one.sensor.laser.wavelength_m
        simulator = Simulator(
            scene, one.sensor, trace, pose=vehicle @ one.pose, world=worlds.get(wavelength), **options
        )
        worlds.setdefault(wavelength, simulator.world)
        yield one.label, simulator


def require_common_frames(sensors: Sequence[Mounted], frames: int) -> None:
    """Raises InputError where the n-th frames of these sensors are of different times, so that none can be merged.

    Turns of 99.99 and 100 ms are no mistake: the last of the frames may begin half a frame apart.
    """
    lengths = {one.label: one.sensor.scanner.frame_s for one in sensors}
    short, long = (min(lengths, key=lambda label: lengths[label]), max(lengths, key=lambda label: lengths[label]))
    if (frames - 1) * (lengths[long] - lengths[short]) > lengths[short] / 2.0:
        raise InputError(
            f"{frames} merged frames must begin together, got frames of {lengths[short]:g} s of '{short}' and "
            f"of {lengths[long]:g} s of '{long}'"
        )
