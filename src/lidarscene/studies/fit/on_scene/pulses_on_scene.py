"""Recorded pulses matched to a scene: what each one reported, and the light that the scene sends back.

The light is traced once for each frame. Pulses that meet no surface of the scene are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ....errors import InputError, OptionError
from ....light.echoes import EchoTrain, SubEchoes
from ....maths.arrays import Numbers, map_arrays
from ....maths.pose import Pose
from ....recordings.sweep import Sweep
from ....rendering.simulator import Simulator
from ....scene.scene import Scene as World
from ....sensor.sensor_model import Sensor
from ...twin.apparent_reflectivity import withheld_mask
from ...twin.matched_pulses import match_pulses, ranges_from_exit
from ...twin.surfels import BRIGHT, KINDS, ROUGH, SMOOTH
from ..near_field import spot_over_field
from ..recorded_pulses import BLOCK_COLUMNS, fitted_blocks
from ..tuning import POWERS_W, TRACED_SURFACE_M
from .known_scene import KnownScene, Observations

PATCH_ROWS = 8
"""Rows of a patch, `BLOCK_COLUMNS` columns wide, whose surfaces share one unknown factor of the reflectivity."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PulsesOnScene:
    """Pulses of all frames, by frame and column; those of a patch share one ``scene.group``.

    Attributes:
        block: (n,) index of the block of columns
    """

    scene: KnownScene
    reported: Observations
    block: Numbers

    def select(self, mask: Numbers) -> PulsesOnScene:
        """Keep only the pulses of a mask."""
        return _map_pulses(lambda values: values[mask], self)

    @property
    def fitted(self) -> Numbers:
        """(n,) mask of the fitted pulses; the others judge the fit."""
        return fitted_blocks(self.block)


def _keep_kinds(world: World, *kinds: int) -> World:
    """Keep only these kinds of a twin's surfaces."""
    names = {KINDS[kind] for kind in kinds}
    return replace(world, bodies=tuple(body for body in world.bodies if body.class_name in names))


def lay_on_scene(
    world: World, sensor: Sensor, frames: Sequence[tuple[Sweep, Pose | None]], *, twin: bool = False
) -> PulsesOnScene:
    """Match the pulses of frames to the light of a scene, each frame from its pose; None: the scene's own.

    Args:
        twin: True: leave out surfaces that fill in for lost pulses; use signals and ranges of smooth surfaces only,
            since leaves and edges differ from the twin's; take the background from NEAR_IR

    Raises:
        InputError: where the sensor does not fire the recording's pulses, or no surface stands before them
    """
    # Two scenes of a twin: all measured surfaces, and the smooth ones alone.
    worlds = [_keep_kinds(world, SMOOTH, ROUGH, BRIGHT), _keep_kinds(world, SMOOTH)] if twin else [world]
    simulators = [Simulator(simulated_world, sensor) for simulated_world in worlds]
    parts = [_lay_frame(simulators, sweep, pose, number=number) for number, (sweep, pose) in enumerate(frames)]
    if not sum(len(part.block) for part in parts):
        raise OptionError("{scene}: must have surfaces before the recorded pulses, got none")
    joined = _map_pulses(lambda *values: np.concatenate(values), *parts)
    group = np.unique(joined.scene.group, return_inverse=True)[1]
    return replace(joined, scene=replace(joined.scene, group=group))


def _lay_frame(simulators: Sequence[Simulator], sweep: Sweep, pose: Pose | None, *, number: int) -> PulsesOnScene:
    """Match a frame to the first simulator's light; where another one sees otherwise, signal and range are NaN."""
    sensor = simulators[0].sensor
    numbers, _ = match_pulses(sensor, sweep)
    rows, columns = sweep.shape
    if sweep.signal is None:
        raise InputError("must have SIGNAL, as Ousters record, got none")
    # Column by column, so that blocks of pulses in order are sectors.
    fired_mask = (sweep.recorded & ~withheld_mask(sweep)).T
    pulse = numbers.T[fired_mask]
    column = np.broadcast_to(np.arange(columns)[:, None], fired_mask.shape)[fired_mask]
    row = np.broadcast_to(np.arange(rows)[None, :], fired_mask.shape)[fired_mask]
    block = number * (columns // BLOCK_COLUMNS + 1) + column // BLOCK_COLUMNS
    lights = [
        _select_light(simulator.light() if pose is None else simulator.light(pose=pose), pulse)
        for simulator in simulators
    ]
    light = lights[0]
    met_surface = np.asarray(light.has_surface)
    smooth = np.ones(len(pulse), bool)
    for other_light in lights[1:]:
        difference_m = np.asarray(other_light.parts[0].range_m - light.parts[0].range_m)
        smooth &= np.asarray(other_light.has_surface) & (np.abs(difference_m) < TRACED_SURFACE_M)
    group = block * (rows // PATCH_ROWS + 1) + row // PATCH_ROWS
    scene = KnownScene.from_light(light, sensor, group, spot_over_field=spot_over_field(sensor))
    near_ir = None if sweep.near_ir is None else np.asarray(sweep.near_ir, np.float64).T[fired_mask][met_surface]
    if len(simulators) > 1 and near_ir is not None:
        scene = replace(scene, background_w=_power_w(sensor, near_ir), light_measured=True)
    range_m = ranges_from_exit(sensor, sweep, numbers).T[fired_mask][met_surface]
    returned = np.isfinite(range_m)
    on_smooth = returned & smooth[met_surface]
    signal = np.asarray(sweep.signal, np.float64).T[fired_mask][met_surface]
    if near_ir is None or scene.light_measured:
        near_ir = np.full(len(returned), np.nan)
    return PulsesOnScene(
        scene=scene,
        reported=Observations(
            has_return=returned,
            signal=np.where(on_smooth, signal, np.nan),
            range_m=np.where(on_smooth, range_m, np.nan),
            near_ir=near_ir,
        ),
        block=block[met_surface],
    )


def _select_light(light: EchoTrain, pulse: Numbers) -> EchoTrain:
    """Select the light of these pulses, from surfaces only."""
    parts: list[SubEchoes] = []
    for part in light.parts[: light.surfaces]:
        range_m, power_w = (np.asarray(values)[pulse] for values in (part.range_m, part.peak_power_w))
        parts.append(replace(part, range_m=range_m, peak_power_w=power_w))
    met_surface = np.asarray(light.has_surface)
    background = np.broadcast_to(np.asarray(light.background_power_w, np.float64), met_surface.shape)
    return EchoTrain(
        parts=tuple(parts), surfaces=len(parts), has_surface=met_surface[pulse], background_power_w=background[pulse]
    )


def _power_w(sensor: Sensor, near_ir: Numbers) -> Numbers:
    """Background power whose expected count is NEAR_IR; 0 below the dark counts."""
    counts = np.asarray(sensor.background_counts(POWERS_W)[0]) * float(sensor.tdc.ambient_s)
    return np.interp(near_ir, counts, POWERS_W, left=0.0)


def _map_pulses(function: Callable[..., Numbers], first: PulsesOnScene, *others: PulsesOnScene) -> PulsesOnScene:
    """Apply a function to the arrays of pulses."""
    parts = (first, *others)
    return PulsesOnScene(
        scene=map_arrays(function, *(part.scene for part in parts)),
        reported=map_arrays(function, *(part.reported for part in parts)),
        block=function(*(part.block for part in parts)),
    )
