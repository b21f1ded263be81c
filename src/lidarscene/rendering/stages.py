"""Stages: the chain on the device, from pulse numbers to what the electronics report. Reads as the picture in
docs/architecture.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from ..detection import receivers, returns
from ..kernel.device import transfer
from ..kernel.device.replay import Replay
from ..kernel.rays import kept
from ..kernel.rays.trace import Firing, trace
from ..kernel.world.mitsuba_world import World
from ..light import beams, echoes
from ..light.air_light import AirLight, air_light
from ..light.beams import Beams
from ..light.echoes import Ambient, EchoTrain
from ..light.field_of_view import background_power_w, field_of_view
from ..light.footprint import Footprint, aim, footprint, spread
from ..light.hits import Hits
from ..light.pulse_train import LitAir, together
from ..maths.arrays import Array, Lanes
from ..maths.paths import Moving, Paths, Placement
from ..maths.vectors import Vector
from ..physics.optics import sunlight
from ..scene.scene import Scene
from ..sensor.model import Sensor
from .chunk import Chunk, Lit, needed_of, numbers_of, of_light, without_continuing
from .frame import Frame, placements
from .options import TraceOptions
from .tiles import Pulses

Places = Callable[[int], tuple[Placement, Moving | None]]
"""Where the sensor and what moves are when pulses of so many rays leave, ray by ray; None: nothing moves."""

OfRays = Mapping[int, Any]
"""By rays of a pulse, (n rays,) pulse of each ray, computed already."""

NO_RAYS: OfRays = {}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stages:
    """What the stages are made for; numbers are on the device, so that others compile nothing.

    rays          of each pulse
    interactions  panes and mirrors that a beam may meet
    vectors       whether normals and velocities of surfaces are wanted
    footprint     of the laser's rays
    field         of the receiver's, over which the background is gathered, or None: what the laser's rays see
    air           light of fog, rain and snow, or None
    sun           unit vector towards it
    """

    world: World
    rays: int
    interactions: int
    vectors: bool
    sensor: Sensor
    ambient: Ambient
    footprint: Footprint
    field: Footprint | None
    air: AirLight | None
    sun: Any

    @classmethod
    def of(cls, scene: Scene, sensor: Sensor, world: World, how: TraceOptions) -> Stages:
        """For `Simulator`."""
        ambient = ambient_of(scene, sensor)
        air = air_light(scene.air.weather, sensor, extinction_per_m=float(ambient.extinction_per_m))
        field = None if how.background_rays is None else field_of_view(sensor, how.background_rays)
        return cls(
            world=world,
            rays=how.rays,
            interactions=how.interactions,
            vectors=how.vectors,
            sensor=transfer.opaque(sensor),
            ambient=transfer.opaque(ambient),
            footprint=transfer.opaque(footprint(sensor.laser, how.rays, sensor.optics.halo)),
            field=transfer.opaque(field),
            air=transfer.opaque(air),
            sun=transfer.opaque(numbers_of(scene.sun.direction)),
        )

    def chain(self, places: Places, pulse: Array, seed: Lanes, *, survey: bool, of_rays: OfRays | None = None) -> Chunk:
        """Beams, hits, echoes, returns of some pulses, on the device.

        survey   leave out the pulses that meet panes or mirrors, and say which these are
        of_rays  `of_rays` of these pulses, where they are known
        """
        sensor, lit = self.sensor, self._lit(places, pulse, seed, survey=survey, of_rays=of_rays or {})
        # One echo at most, and a converter that keeps the first: detection has a closed form, and no search for peaks.
        if self.rays == len(lit.paths) == 1 and self.air is None and receivers.is_plain(sensor):
            detection = returns.detect(lit.light[0], sensor, seed=seed, pulse=pulse)
            return without_continuing(pulse, lit.paths, detection, lit.goes_on)
        whole = self._together(lit, seed)
        goes_on = None if lit.goes_on is None else kept.any_of_pulse(lit.goes_on, self.rays)
        return without_continuing(pulse, lit.paths, receivers.detect(whole, sensor, seed=seed, pulse=pulse), goes_on)

    def pulse_train(self, now: Frame, pulses: Pulses, seed: Lanes) -> EchoTrain:
        """All that comes back of some pulses, on the device."""
        return self._together(self._lit(partial(now.placements, pulses.times), pulses.number, seed), seed)

    def of_rays(self, pulse: Array) -> OfRays:
        """The pulse of each ray, where pulses have several, by their number."""
        shapes = [self.footprint] if self.field is None else [self.footprint, self.field]
        return {one.rays: transfer.repeat_lanes(pulse, one.rays)[0] for one in shapes if one.rays > 1}

    def _lit(
        self, places: Places, pulse: Array, seed: Lanes, *, survey: bool = False, of_rays: OfRays = NO_RAYS
    ) -> Lit:
        """The optical stages: beams, hits, echoes."""
        # The background may be gathered by rays of its own: the receiver can see more than the laser lights.
        background = None
        if self.field is not None:
            background = self._background(places, pulse, seed, self.field, of_rays)
        rays, paths = self._traced(places, pulse, seed, self.footprint, survey=survey, of_rays=of_rays)
        light = echoes.with_all_background([echoes.receive(rays, one, self.sensor, self.ambient) for one in paths])
        if background is not None:
            of_ray = background if self.rays == 1 else transfer.repeat_lanes(background, self.rays)[0]
            light[0] = replace(light[0], background_power_w=of_ray)
        return Lit(pulse, rays, paths, light, paths[0].goes_on)

    def _traced(
        self,
        places: Places,
        pulse: Array,
        seed: Lanes,
        shape: Footprint,
        *,
        survey: bool = False,
        of_rays: OfRays = NO_RAYS,
    ) -> tuple[Beams, Sequence[Hits]]:
        """What the rays of a footprint meet, lane = pulse lane * its rays + ray."""
        of_ray, ray = pulse, None
        if shape.rays > 1:
            of_ray, ray = transfer.repeat_lanes(pulse, shape.rays)
            of_ray = of_rays.get(shape.rays, of_ray)
        place, movers = places(shape.rays)
        # `fire` gives the axis of each beam. The rays of a pulse share it, jitter included, and are spread around it.
        axes = beams.fire(self.sensor, pulse=of_ray, origin_m=place.origin_m, rotation=place.rotation, seed=seed)
        rays = axes if ray is None else spread(axes, shape, ray=ray, rotation=place.rotation)
        aimed = None
        # Only the laser's own rays can come back from a mirror; rays that gather background carry no pulse.
        if self.world.speculars is not None and shape is self.footprint:
            aimed = aim(axes, shape, profile=self.sensor.laser.profile, rotation=place.rotation)
        firing = Firing(
            seed=seed,
            ray=0 if ray is None else ray,
            aim=aimed,
            housing_m=self.sensor.housing_m,
            velocity_m_s=None if place.velocity_m_s is None else place.velocity_at(rays.origin_m),
            vectors=self.vectors and shape is self.footprint,
        )
        paths = trace(
            self.world, rays, sun=self.sun, moving=movers, interactions=self.interactions, survey=survey, firing=firing
        )
        return rays, [_in_sensor(hits, place) for hits in paths]

    def _background(self, places: Places, pulse: Array, seed: Lanes, shape: Footprint, of_rays: OfRays) -> Any:
        """Of each pulse, gathered over the receiver's field of view."""
        rays, paths = self._traced(places, pulse, seed, shape, of_rays=of_rays)
        power = background_power_w(rays, paths, self.sensor, self.ambient, count=shape.rays)
        # A kernel of its own, or these rays would be traced again wherever the power is used.
        transfer.start([power])
        return power

    def _together(self, lit: Lit, seed: Lanes) -> EchoTrain:
        """All that comes back of each pulse, with the light of the air."""
        # Lanes of rays are traced in a kernel of their own, before they come together in their pulses.
        transfer.start(
            [
                *(array for one in lit.light for array in of_light(one)),
                *(one for hits in lit.paths for one in needed_of(hits)),
                *([] if lit.goes_on is None else [lit.goes_on]),
            ]
        )
        air = None
        if self.air is not None:
            air = LitAir(light=self.air, sensor=self.sensor, ambient=self.ambient, seed=seed, pulse=lit.pulse)
        return together(lit.light, lit.rays, rays=self.rays, skirt=self.footprint.skirt, air=air)


def _in_sensor(hits: Hits, place: Placement) -> Hits:
    """The hits, with their vectors in the sensor's axes: where it is when the pulse leaves, as points are measured."""
    if hits.normal is None or hits.velocity_m_s is None:
        return hits
    return replace(hits, normal=place.vector_within(hits.normal), velocity_m_s=place.vector_within(hits.velocity_m_s))


class Chain:
    """`Stages.chain` for the pulses of frames, started; written down for the device but once where that may be.

    repeats  tests set it to False, for frames to compare with
    """

    repeats = True

    def __init__(self, stages: Stages) -> None:
        self._stages = stages
        self._replays: dict[tuple[bool, ...], Replay] = {}

    def __call__(self, now: Frame, pulses: Pulses, seed: Lanes, *, survey: bool = False) -> Chunk:
        """Some pulses of a frame."""
        pulse = pulses.number
        if self.repeats:
            # A recording takes arrays only, so the paths of what moves go in as their parts.
            moving = (
                ()
                if now.paths is None
                else (now.paths.table, now.paths.rate_hz, now.paths.last, now.paths.boxes_m, pulses.times())
            )
            place = now.origin.origin_m, now.origin.rotation
            # Dr.Jit launches a kernel for as many lanes as its inputs have. Of several rays to a pulse these would be
            # the pulses' own: a recording would keep the number of rays that it was made with. So the rays are counted
            # before it, and an input of their kernel has an element for each.
            of_rays = dict(self._stages.of_rays(pulse))
            transfer.start([*of_rays.values()])
            repeated: Chunk = self._replay(now, survey)(pulse, seed, place, moving, of_rays)
            return repeated
        part = self._stages.chain(partial(now.placements, pulses.times), pulse, seed, survey=survey)
        transfer.start(part.arrays())
        return part

    @property
    def recordings(self) -> list[int]:
        """How often the stages were written down, each way that they are needed."""
        return [one.recordings for one in self._replays.values()]

    def _replay(self, now: Frame, survey: bool) -> Replay:
        """The stages, written down for a sensor that moves or not among bodies that do or do not."""
        # What chooses code is part of the key: each of these kinds is recorded for itself.
        moves, count = now.moves, 0 if now.paths is None else now.paths.count
        key = survey, moves, count > 0
        if key not in self._replays:
            stages = self._stages

            def chain(
                pulse: Array,
                seed: Lanes,
                place: tuple[Vector, tuple[Lanes, ...]],
                moving: tuple[Any, ...],
                of_rays: OfRays,
            ) -> Chunk:
                paths, times = None, None
                if moving:
                    table, rate_hz, last, boxes, times = moving
                    paths = Paths(table=table, rate_hz=rate_hz, last=last, count=count, boxes_m=boxes)
                origin_m, rotation = place
                origin = Placement(origin_m=origin_m, rotation=rotation)

                def places(rays: int) -> tuple[Placement, Moving | None]:
                    own = times if times is None or rays == 1 else transfer.repeat_lanes(times, rays)[0]
                    return placements(origin, paths, own, moves=moves)

                return stages.chain(places, pulse, seed, survey=survey, of_rays=of_rays)

            held = (stages.sensor, stages.ambient, stages.footprint, stages.field, stages.air, stages.sun, stages.world)
            self._replays[key] = Replay(chain, Chunk.arrays, captured=held, rays=stages.rays)
        return self._replays[key]


def ambient_of(scene: Scene, sensor: Sensor) -> Ambient:
    """Light and air of a scene in a sensor's band."""
    sun = sunlight.sun_irradiance_w_m2(
        irradiance_at_100_klux_w_m2=sensor.optics.sun_irradiance_w_m2, illuminance_klux=scene.sun.illuminance_klux
    )
    return Ambient(
        sun_irradiance_w_m2=sun,
        sky_irradiance_w_m2=sunlight.sky_irradiance_w_m2(
            sun_irradiance_w_m2=sun, diffuse_share=scene.sky.diffuse_share
        ),
        transmittance=scene.air.transmittance,
        extinction_per_m=scene.air.extinction_at_per_m(sensor.laser.wavelength_m),
        sun_direction=numbers_of(scene.sun.direction),
        lamps_w_m2=scene.lamps_w_m2 or None,
        interferers=scene.interferers,
    )
