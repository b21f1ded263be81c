"""Trace chosen pulses again and return their light, as NumPy.

A frame keeps no light of pulses that reported nothing: 2^20 of them at a time would not be worth their memory. A user
who asks for the light of some pulses gets it from the same stages, run once more: same seed, same rays, same numbers.
"""

from __future__ import annotations

from ...light import beams, echoes
from ...light.echoes import Ambient, Echoes
from ...light.footprint import polarisation
from ...maths.arrays import Numbers
from ...maths.motion_table import MovingBodies, Placement
from ...maths.random import Seed
from ...sensor.sensor_model import Sensor
from ..device import transfer
from ..device.gate import exclusive
from ..world.mitsuba_world import World
from .trace import Firing, trace

LIGHT_COLUMNS = ("has_surface", "range_m", "peak_power_w", "background_power_w")


@exclusive
def retraced_light(
    world: World,
    sensor: Sensor,
    ambient: Ambient,
    *,
    sun: Numbers,
    placements: tuple[Placement, MovingBodies | None],
    pulses: range,
    seed: Seed,
) -> Echoes:
    """Trace pulses again and return their mean light on the beam's first path, without pulses of other lidars.

    Args:
        sensor: with its scanner `at_phase` of the frame
        pulses: consecutive pulse numbers since the rollover
        sun: (3,) unit vector towards the sun
        placements: of the sensor and of the movers, as `rendering.frame.Frame.placements` returns them for these pulses
        seed: of the frame, on the device; it decides the pointing jitter and the gaps
    """
    place, movers = placements
    equipment = transfer.opaque(sensor)
    rays = beams.fire(
        equipment,
        pulse=transfer.counter(pulses.start, len(pulses)),
        origin_m=place.origin_m,
        rotation=place.rotation,
        seed=seed,
    )
    towards = transfer.opaque(tuple(float(component) for component in sun))
    air = transfer.opaque(ambient)
    swing = None if world.speculars is None else polarisation(rays, equipment.laser, rotation=place.rotation)
    firing = Firing(seed=seed, polarisation=swing)
    paths = trace(world, rays, sun=towards, moving=movers, firing=firing)
    light = echoes.gather_background([echoes.receive(rays, hits, equipment, air) for hits in paths])[0]
    return Echoes(**transfer.fetch_columns({name: getattr(light, name) for name in LIGHT_COLUMNS}))
