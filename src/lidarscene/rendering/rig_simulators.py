"""Simulators of a rig: one for each of its sensors.

Sensors of one wavelength share a world, which takes long to build. Frames that are merged must begin together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Unpack

from ..errors import InputError
from ..kernel.world.mitsuba_world import World
from ..maths.pose import Pose
from ..scene.scene import Scene
from ..sensor.rig_file import Mounted
from .render_options import TraceKeywords, TraceOptions
from .simulator import Simulator


def simulators(
    scene: Scene,
    sensors: Sequence[Mounted],
    trace: TraceOptions | None = None,
    *,
    pose: Pose | None = None,
    **options: Unpack[TraceKeywords],
) -> Iterator[tuple[str, Simulator]]:
    """Iterate over label and simulator of each sensor; those of one wavelength share one compiled world.

    Args:
        pose: pose of the vehicle in the world or, in a scene with an ego vehicle, on that vehicle
        trace: as for `Simulator`
        options: as for `Simulator`
    """
    worlds: dict[float, World] = {}
    vehicle = pose or Pose()
    for number, mounted in enumerate(sensors):
        wavelength = mounted.sensor.laser.wavelength_m
        simulator = Simulator(
            scene,
            mounted.sensor,
            trace,
            pose=vehicle @ mounted.pose,
            world=worlds.get(wavelength),
            rig_number=number,
            **options,
        )
        worlds.setdefault(wavelength, simulator.world)
        yield mounted.label, simulator


def require_common_frames(sensors: Sequence[Mounted], frames: int) -> None:
    """Raise InputError where the last frames of these sensors begin too far apart in time to be one.

    Frames of 99.99 and 100 ms are no mistake: the last ones may begin half a frame apart.
    """
    lengths = {mounted.label: mounted.sensor.scanner.frame_s for mounted in sensors}
    short, long = (min(lengths, key=lambda label: lengths[label]), max(lengths, key=lambda label: lengths[label]))
    if (frames - 1) * (lengths[long] - lengths[short]) > lengths[short] / 2.0:
        raise InputError(
            f"{frames} frames must begin together to be merged or samples, got frames of {lengths[short]:g} s of "
            f"'{short}' and of {lengths[long]:g} s of '{long}'"
        )
