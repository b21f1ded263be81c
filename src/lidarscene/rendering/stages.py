"""Stages: the chain on the device, from pulse numbers to what the electronics report, as in ARCHITECTURE.md."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from ..detection import receiver
from ..kernel.device import transfer
from ..kernel.device.replay import Replay
from ..kernel.rays import kept_lanes
from ..kernel.rays.trace import Firing, trace
from ..kernel.world.mitsuba_world import World
from ..light import beams, echoes
from ..light.air_light import AirLight, air_light
from ..light.beams import Beams
from ..light.echoes import Ambient, Echoes, EchoTrain
from ..light.field_background import background_power_w, field_of_view
from ..light.fluctuations import FluctuationLaw, fluctuate
from ..light.footprint import Footprint, aim, footprint, polarisation, spread, sweep
from ..light.hits import Hits, relative_row_slope
from ..light.pulse_train import LitAir, join_echoes
from ..light.stray_light import ChannelLight, Crosstalk, add_stray_light, channel_light, reaches_others
from ..maths.arrays import Array, Lanes, flatten, is_drjit
from ..maths.box_tree import BoxTree
from ..maths.motion_table import MotionTable, MovingBodies, Placement
from ..maths.random import Seed
from ..maths.vectors import Vector
from ..physics.optics import sunlight
from ..scene.scene import Scene
from ..sensor.sensor_model import Sensor
from .chunk import Chunk, OpticalChunk, drop_continuing, light_arrays, plain_numbers, truth_arrays
from .frame import Frame, placements
from .render_options import TraceOptions
from .tiles import DevicePulses

Places = Callable[[int], tuple[Placement, MovingBodies | None]]
"""Function of the rays of a pulse: placement of the sensor and of moving bodies (None: nothing moves) for each ray."""

RayPulses = Mapping[int, Any]
"""Rays of a pulse -> (n rays,) pulse number of each ray, computed before."""

NO_RAYS: RayPulses = {}


class TracedPaths:
    """Paths of all rays of a frame: traced once, and read again for sensors with the same rays in the same scene.

    Sensors may differ in power, lens, detector and electronics, and the sun in its strength. A frame reads the paths in
    the order in which it would trace them, so light that goes on to other channels, which depends on it, must not be
    part of the frame.
    """

    def __init__(self) -> None:
        self._paths: list[Sequence[Hits]] = []
        self._read = 0

    def rewind(self) -> None:
        """Begin with the first path of the frame again."""
        self._read = 0

    def following(self, traced: Callable[[], Sequence[Hits]]) -> Sequence[Hits]:
        """Next paths of the frame; ``traced`` gives them the first time."""
        if self._read == len(self._paths):
            paths = traced()
            # Computed before anything uses them, also the first time: every frame has the same kernels after them.
            transfer.start([array for hits in paths for array in flatten(hits) if is_drjit(array)])
            self._paths.append(paths)
        self._read += 1
        return self._paths[self._read - 1]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stages:
    """World, sensor and light of the stages; numbers are on the device, so that other values compile nothing.

    Attributes:
        rays: rays of each pulse
        interactions: panes and mirrors that a beam may meet
        vectors: whether normals and velocities of surfaces are computed
        footprint: footprint of the laser's rays
        field: receiver's field of view, whose rays gather the background; None: the laser's rays do
        air: light of fog, rain and snow, or None
        crosstalk: channels that see each other's light, or None
        fluctuation: law by which echoes scatter, or None
        sun: unit vector towards the sun
        traced: paths of the frame, for rays that were traced before; None: each frame traces its own
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
    crosstalk: Crosstalk | None
    fluctuation: FluctuationLaw | None
    sun: Any
    traced: TracedPaths | None = None

    @classmethod
    def from_scene(cls, scene: Scene, sensor: Sensor, world: World, options: TraceOptions) -> Stages:
        """Build for a scene, a sensor and the scene's compiled world."""
        ambient = ambient_of(scene, sensor)
        air = air_light(scene.air.weather, sensor, extinction_per_m=float(ambient.extinction_per_m))
        field = None if options.background_rays is None else field_of_view(sensor, options.background_rays)
        return cls(
            world=world,
            rays=options.rays,
            interactions=options.interactions,
            vectors=options.vectors,
            sensor=transfer.opaque(sensor),
            ambient=transfer.opaque(ambient),
            footprint=transfer.opaque(footprint(sensor.laser, options.rays, sensor.optics.halo, sensor.sweep_rad)),
            field=transfer.opaque(field),
            air=transfer.opaque(air),
            crosstalk=transfer.opaque(Crosstalk.from_sensor(sensor)),
            fluctuation=transfer.opaque(FluctuationLaw.of(sensor, scene.air)),
            sun=transfer.opaque(plain_numbers(scene.sun.direction)),
        )

    @property
    def leans(self) -> bool:
        """True if the noise of a range depends on how its surface leans along the row."""
        return self.sensor.histogram is not None and self.sensor.histogram.column_range_sigmas is not None

    @property
    def surveys(self) -> bool:
        """True if some pulses may be traced twice: first all of them, then those whose light goes on."""
        return self.interactions > 0 or self.crosstalk is not None

    def at_phase(self, phase: tuple[Lanes, ...]) -> Stages:
        """The stages with the scanner `at_phase`: that of a `Frame`."""
        scanner = self.sensor.scanner.at_phase(phase)
        return replace(self, sensor=replace(self.sensor, scanner=scanner))

    def chain(
        self,
        places: Places,
        pulse: Array,
        seed: Seed,
        *,
        survey: bool,
        lines: bool = True,
        ray_pulses: RayPulses | None = None,
        met: tuple[Array, ...] = (),
    ) -> Chunk:
        """Beams, hits, echoes, returns of some pulses, on the device.

        Args:
            survey: leave out the pulses that meet panes or mirrors and mark them in ``goes_on``
            lines: the pulses are whole scan lines in order, of which channels see each other's light; False, and in a
                survey: pulses whose light other channels notice are left out, and marked in ``leaks``
            ray_pulses: `ray_pulses` of these pulses, if computed before
            met: `known_hits` of these pulses
        """
        lines = lines and not survey and self.crosstalk is not None
        sensor, known = self.sensor, ray_pulses or {}
        lit = self._optical_stages(places, pulse, seed, survey=survey, lines=lines, ray_pulses=known, met=met)
        number = kept_lanes.existing(pulse)
        # One echo at most, and a converter that keeps the first: detection has a closed form, and no search for peaks.
        lone = self.rays == len(lit.paths) == 1 and self.air is None and not lines
        if lone and receiver.is_plain(sensor):
            detection = receiver.detect(lit.light[0], sensor, seed=seed, pulse=number)
            return drop_continuing(pulse, lit.paths, detection, lit.goes_on, lit.leaks)
        whole, light = self._combine(lit, seed), None
        if lines and self.crosstalk is not None:
            light = self._channel_light(whole, self.crosstalk)
            whole = add_stray_light(whole, light, self.crosstalk, pulse=number)
        detection = receiver.detect(whole, sensor, seed=seed, pulse=number, channels=light, crosstalk=self.crosstalk)
        goes_on, leaks = (
            None if rays is None else kept_lanes.any_of_pulse(rays, self.rays) for rays in (lit.goes_on, lit.leaks)
        )
        return drop_continuing(pulse, lit.paths, detection, goes_on, leaks)

    def pulse_train(self, frame: Frame, pulses: DevicePulses, seed: Seed) -> EchoTrain:
        """All that comes back of some pulses, on the device.

        If channels see each other's light, the pulses are whole scan lines in order.
        """
        stages = self.at_phase(frame.phase)
        lit = stages._optical_stages(partial(frame.placements, pulses.departures), pulses.number, seed)
        train = stages._combine(lit, seed)
        if self.crosstalk is None:
            return train
        light = self._channel_light(train, self.crosstalk)
        return add_stray_light(train, light, self.crosstalk, pulse=pulses.number)

    def known_hits(self, surveyed: Hits) -> tuple[Array, ...]:
        """What a survey tells of the rays' first hits, panes left out (`Firing.met`); () if it cannot tell."""
        world, several = self.world, self.rays > 1
        if several or surveyed.goes_on is None or world.movers or world.face_normal is None:
            return ()
        return surveyed.range_m, surveyed.face

    def ray_pulses(self, pulse: Array) -> RayPulses:
        """Pulse number of each ray, for every footprint with several rays to a pulse."""
        shapes = [self.footprint] if self.field is None else [self.footprint, self.field]
        return {shape.rays: transfer.repeat_lanes(pulse, shape.rays)[0] for shape in shapes if shape.rays > 1}

    def _optical_stages(
        self,
        places: Places,
        pulse: Array,
        seed: Seed,
        *,
        survey: bool = False,
        lines: bool = True,
        ray_pulses: RayPulses = NO_RAYS,
        met: tuple[Array, ...] = (),
    ) -> OpticalChunk:
        """Run the optical stages: beams, hits, echoes."""
        # The background may have rays of its own: the receiver can see more than the laser lights.
        background = None
        if self.field is not None:
            background = self._background(places, pulse, seed, self.field, ray_pulses)
        rays, paths = self._trace_rays(
            places, pulse, seed, self.footprint, survey=survey, ray_pulses=ray_pulses, met=met
        )
        light = echoes.gather_background([self._receive(rays, hits, seed) for hits in paths])
        if background is not None:
            ray_background = background if self.rays == 1 else transfer.repeat_lanes(background, self.rays)[0]
            light[0] = replace(light[0], background_power_w=ray_background)
        leaks = None if self.crosstalk is None or lines else reaches_others(light, self.crosstalk)
        return OpticalChunk(pulse, rays, paths, light, paths[0].goes_on, leaks)

    def _receive(self, rays: Beams, hits: Hits, seed: Seed) -> Echoes:
        """Echoes of the laser's rays along one path, as they fluctuate."""
        received = echoes.receive(rays, hits, self.sensor, self.ambient, lone=self.rays == 1)
        law = self.fluctuation
        if law is None:
            return received
        variance = law.variance(range_m=hits.range_m, cos_incidence=hits.cos_incidence, aperture_m2=rays.aperture_m2)
        return fluctuate(received, variance, seed=seed, pulse=rays.pulse)

    def _trace_rays(
        self,
        places: Places,
        pulse: Array,
        seed: Seed,
        shape: Footprint,
        *,
        survey: bool = False,
        ray_pulses: RayPulses = NO_RAYS,
        met: tuple[Array, ...] = (),
    ) -> tuple[Beams, Sequence[Hits]]:
        """Trace the rays of a footprint: beams and hits, lane = pulse lane * rays + ray."""
        ray_pulse, ray = pulse, None
        if shape.rays > 1:
            ray_pulse, ray = transfer.repeat_lanes(pulse, shape.rays)
            ray_pulse = ray_pulses.get(shape.rays, ray_pulse)
        # Between frames that are traced together there may be lanes without a pulse (`Numbering.lane_order`), and
        # between those of what is traced once more (`kept_lanes.in_packets`).
        active, ray_pulse = ray_pulse < kept_lanes.NO_PULSE, kept_lanes.existing(ray_pulse)
        place, movers = places(shape.rays)
        # `fire` gives the axis of each beam. The rays of a pulse share it, jitter included, and are spread around it.
        axes = beams.fire(self.sensor, pulse=ray_pulse, origin_m=place.origin_m, rotation=place.rotation, seed=seed)
        rays = axes
        if ray is not None:
            axes = sweep(axes, shape, ray=ray, rotation=place.rotation)
            rays = spread(axes, shape, ray=ray, rotation=place.rotation)
        aimed = None
        # Only the laser's own rays can come back from a mirror; rays that gather background carry no pulse.
        if self.world.speculars is not None and shape is self.footprint:
            aimed = aim(axes, shape, profile=self.sensor.laser.profile, rotation=place.rotation)
        swing = None
        if self.world.speculars is not None:
            swing = polarisation(axes, self.sensor.laser, rotation=place.rotation)
        firing = Firing(
            seed=seed,
            ray=0 if ray is None else ray,
            active=active,
            aim=aimed,
            housing_m=self.sensor.housing_m,
            velocity_m_s=None if place.velocity_m_s is None else place.velocity_at(rays.origin_m),
            vectors=(self.vectors or self.leans) and shape is self.footprint,
            polarisation=swing,
            met=met,
        )
        trace_all = partial(
            trace,
            self.world,
            rays,
            sun=self.sun,
            moving=movers,
            interactions=self.interactions,
            survey=survey and self.interactions > 0,
            firing=firing,
        )
        paths = trace_all() if self.traced is None else self.traced.following(trace_all)
        return rays, [self._in_sensor(hits, place, rays) for hits in paths]

    def _in_sensor(self, hits: Hits, place: Placement, rays: Beams) -> Hits:
        """Rotate normals and velocities of hits into the sensor's axes at the time when the pulse leaves."""
        if hits.normal is None:
            return hits
        normal, row_slope = place.vector_within(hits.normal), None
        if self.leans:
            row_slope = relative_row_slope(normal, place.vector_within(hits.direction or rays.direction))
        if not self.vectors:
            return replace(hits, normal=None, velocity_m_s=None, row_slope=row_slope)
        velocity_m_s = None if hits.velocity_m_s is None else place.vector_within(hits.velocity_m_s)
        return replace(hits, normal=normal, velocity_m_s=velocity_m_s, row_slope=row_slope)

    def _background(self, places: Places, pulse: Array, seed: Seed, shape: Footprint, ray_pulses: RayPulses) -> Any:
        """Background power of each pulse [W], (n,), gathered over the receiver's field of view."""
        rays, paths = self._trace_rays(places, pulse, seed, shape, ray_pulses=ray_pulses)
        power = background_power_w(rays, paths, self.sensor, self.ambient, count=shape.rays)
        # A kernel of its own, or these rays would be traced again wherever the power is used.
        transfer.start([power])
        return power

    def _combine(self, lit: OpticalChunk, seed: Seed) -> EchoTrain:
        """Join the echoes of all rays and paths, and the light of the air, by pulse."""
        # Lanes of rays are traced in a kernel of their own, before they come together in their pulses.
        transfer.start(
            [
                *(array for path_light in lit.light for array in light_arrays(path_light)),
                *(array for hits in lit.paths for array in truth_arrays(hits)),
                *(mask for mask in (lit.goes_on, lit.leaks) if mask is not None),
            ]
        )
        air = None
        if self.air is not None:
            air = LitAir(light=self.air, sensor=self.sensor, ambient=self.ambient, seed=seed, pulse=lit.pulse)
        return join_echoes(lit.light, lit.rays, rays=self.rays, skirt=self.footprint.skirt, air=air)

    def _channel_light(self, train: EchoTrain, crosstalk: Crosstalk) -> ChannelLight:
        """Light of the channels of whole scan lines, computed, so that other lanes can read it."""
        light = channel_light(train, crosstalk)
        transfer.start([light.range_m, light.power_w])
        return light


class Chain:
    """`Stages.chain` as a callable that starts the kernels; traced by Dr.Jit once and replayed for later chunks.

    Attributes:
        repeats: tests set it to False, for frames without replay to compare with
    """

    repeats = True

    def __init__(self, stages: Stages) -> None:
        self._stages = stages
        self._replays: dict[tuple[bool, ...], Replay] = {}

    def __call__(
        self,
        frame: Frame,
        pulses: DevicePulses,
        seed: Seed,
        *,
        survey: bool = False,
        lines: bool = True,
        met: tuple[Array, ...] = (),
    ) -> Chunk:
        """Start the stages for some pulses of a frame; ``survey``, ``lines`` and ``met`` as in `Stages.chain`."""
        pulse, lines = pulses.number, lines and not survey
        if self.repeats and self._stages.traced is None:
            # A recording takes arrays only, so `MotionTable` goes in as its parts and is built again inside.
            moving: tuple[Any, ...] = ()
            if (paths := frame.paths) is not None:
                tree = () if (boxes := paths.boxes) is None else (boxes.nodes, boxes.low, boxes.high, boxes.size)
                moving = paths.table, paths.rate_hz, paths.last, paths.count, tree, pulses.departures()
            origin = frame.origin
            place = origin.origin_m, origin.rotation
            # Dr.Jit launches a kernel for as many lanes as its inputs have. Of several rays to a pulse these would be
            # the pulses' own: a recording would keep the number of rays that it was made with. So the rays are counted
            # before it, and an input of their kernel has an element for each.
            ray_pulses = dict(self._stages.ray_pulses(pulse))
            transfer.start([*ray_pulses.values()])
            arguments = pulse, seed, frame.phase, place, moving, ray_pulses, met
            repeated: Chunk = self._replay(frame, survey, lines)(*arguments)
            return repeated
        stages = self._stages.at_phase(frame.phase)
        places = partial(frame.placements, pulses.departures)
        part = stages.chain(places, pulse, seed, survey=survey, lines=lines, met=met)
        transfer.start(part.arrays())
        return part

    @property
    def recordings(self) -> list[int]:
        """Number of recordings of each variant of the stages (tests expect one of each)."""
        return [replay.recordings for replay in self._replays.values()]

    def _replay(self, frame: Frame, survey: bool, lines: bool) -> Replay:
        """Replay of the stages for this variant: survey, whole lines or neither, at rest or moving."""
        # All that chooses code is part of the key: each variant has its own recording.
        moves = frame.moves
        key = survey, lines, moves, frame.paths is not None
        if key not in self._replays:
            stages = self._stages

            def chain(
                pulse: Array,
                seed: Seed,
                phase: tuple[Lanes, ...],
                place: tuple[Vector, tuple[Lanes, ...]],
                moving: tuple[Any, ...],
                ray_pulses: RayPulses,
                met: tuple[Array, ...],
            ) -> Chunk:
                paths, departures = None, None
                if moving:
                    table, rate_hz, last, count, tree, departures = moving
                    boxes = BoxTree(nodes=tree[0], low=tree[1], high=tree[2], size=tree[3]) if tree else None
                    paths = MotionTable(table=table, rate_hz=rate_hz, last=last, count=count, boxes=boxes)
                origin_m, rotation = place
                origin = Placement(origin_m=origin_m, rotation=rotation)

                def places(rays: int) -> tuple[Placement, MovingBodies | None]:
                    return placements(origin, paths, departures, rays, moves=moves)

                return stages.at_phase(phase).chain(
                    places, pulse, seed, survey=survey, lines=lines, ray_pulses=ray_pulses, met=met
                )

            light = stages.ambient, stages.footprint, stages.field, stages.air, stages.crosstalk, stages.fluctuation
            held = (stages.sensor, *light, stages.sun, stages.world)
            self._replays[key] = Replay(chain, Chunk.arrays, captured=held, rays=stages.rays)
        return self._replays[key]


def ambient_of(scene: Scene, sensor: Sensor) -> Ambient:
    """Ambient light and air of a scene in the sensor's band."""
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
        sun_direction=plain_numbers(scene.sun.direction),
        lamps_w_m2=scene.lamps_w_m2 or None,
        interferers=scene.interferers,
    )
