"""Simulator: a Scene, a Sensor and a Pose in, a PointCloud out, chunk by chunk through the `stages`."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np

from ..cloud.builder import CloudBuilder
from ..cloud.points import PointCloud
from ..detection.sampled_waveforms import Waveforms, check_pulses, sampled_pulses
from ..errors import InputError
from ..kernel.device import transfer
from ..kernel.rays import columns as collect
from ..kernel.rays.trace import INTERACTIONS, MOST_INTERACTIONS
from ..kernel.world.build import World, build_world
from ..light.echoes import EchoTrain
from ..maths.arrays import Numbers
from ..maths.pose import Pose
from ..maths.trajectory import Motion, pose_at
from ..scene.model import Scene
from ..sensor.model import Sensor
from .chunk import Chunk, Order, Placing, all_of, left_out, numbered, of_every_pulse
from .frame import COORDINATES, Frame, check_frame, motion_of
from .metadata import metadata_of
from .stages import Chain, Stages
from .summary import Summary as Summary
from .tiles import PACKET, Tiling

DEFAULT_CHUNK = 2**20
"""Pulses traced at a time: some 100 MB of arrays; smaller chunks spend more of their time in Python."""

Observer = Callable[[Numbers, Mapping[str, Numbers]], None]
"""Told, chunk by chunk, the pulse number of each point of the cloud, and `collect.surfaces` of all pulses."""


class Simulator:
    """A world and a sensor, ready for any number of frames; nothing is compiled twice.

    Coordinates are single precision around the place where the sensor stood when the world was built; a
    later `render` from 100 m off that place is still good to 0.01 mm, one from 10 km to 1 mm.
    """

    def __init__(
        self,
        scene: Scene,
        sensor: Sensor,
        *,
        world: World | None = None,
        pose: Pose | None = None,
        rays: int = 1,
        interactions: int = INTERACTIONS,
        background_rays: int | None = None,
    ) -> None:
        """Compile the scene around the sensor's place (or take a compiled ``world``).

        rays  of each pulse, over the laser's footprint; a single one is its axis. Raises InputError for less.
        background_rays  of each pulse, over the receiver's field of view, for its background; None: what its rays see
        pose  where the sensor stands, its mounting not included: in the world, or on the scene's ego vehicle; the
              scene's own if None. `render` takes another per frame.
        interactions  panes, mirrors and gaps that a beam may meet; at 0 it ends at the first, without an echo
        """
        if not 0 <= interactions <= MOST_INTERACTIONS:
            raise InputError(f"interactions: 0 to {MOST_INTERACTIONS} was expected, {interactions} came")
        if rays < 1:
            raise InputError(f"rays: at least 1 was expected, {rays} came")
        if background_rays is not None and background_rays < 1:
            raise InputError(f"background_rays: at least 1 was expected, {background_rays} came")
        self.scene, self.sensor = scene, sensor
        self.rays, self.interactions, self.background_rays = rays, interactions, background_rays
        self.pose = pose or scene.sensor_pose
        self.world = world or build_world(
            scene,
            wavelength_m=sensor.laser.wavelength_m,
            centre_m=pose_at(self.motion).position_m,
            see_through=interactions > 0,
        )
        # The rays of one pulse are neighbours already.
        self._tiling = Tiling.of(sensor.scanner) if rays < PACKET else None
        self._orders: dict[int, Order] = {}
        if interactions and not self.world.see_through:
            raise ValueError("world: one that beams go on in was expected, one for interactions=0 came")
        self._stages = Stages.of(
            scene, sensor, self.world, rays=rays, interactions=interactions, background_rays=background_rays
        )
        self._chain = Chain(self._stages)
        self.class_names = self.world.class_names
        self._air_classes = None
        if (air := self._stages.air) is not None:
            self.class_names = tuple(dict.fromkeys((*self.class_names, *air.names)))
            sources = (air.strongest, *air.sources)
            self._air_classes = transfer.whole_numbers([self.class_names.index(name) for name in sources])

    @property
    def motion(self) -> Motion:
        """The sensor's own in the world: what `deskewed` takes off."""
        return motion_of(self.scene, self.sensor, self.pose)

    def check_frames(self, frames: int, *, begin_s: float = 0.0) -> None:
        """Raises InputError unless every motion lasts for so many frames, and there are numbers for their pulses."""
        for number in (0, frames - 1):
            check_frame(self.scene, self.sensor.scanner, number=number, begin_s=begin_s)

    def render(
        self,
        *,
        seed: int = 0,
        number: int = 0,
        begin_s: float = 0.0,
        pose: Pose | None = None,
        chunk: int = DEFAULT_CHUNK,
        frame: str = "world",
        progress: Callable[[int], None] | None = None,
        missed: Callable[[Numbers, Numbers], None] | None = None,
        ambient: Callable[[Numbers, Numbers], None] | None = None,
        observer: Observer | None = None,
        summary: Summary | None = None,
    ) -> PointCloud:
        """One frame as a point cloud.

        seed      32 bits; the same seed gives the same cloud whatever the chunk
        number    of the frame: later ones have later pulses, at later times, with noise of their own
        begin_s   when frame 0 begins, by the clock of the scene's motions
        pose      of the sensor (its mounting not included) in the world or on the ego vehicle; as when it was
                  made if None
        chunk     rays at a time, bounds the memory
        frame     "world", "vehicle" or "sensor": in which frame the points are. A sensor that moves does not know
                  it: all points are placed from where it stood at the frame's start (see `deskewed`)
        progress  called with the number of pulses done so far
        missed    called with (pulse, outcome) of every pulse that has no echo point, chunk by chunk
        ambient   called with (pulse, counts) of every pulse, chunk by chunk: the background, `detection.ambient.counts`
        observer  told of every pulse that met a surface: what rates of detection need
        summary   filled if given
        Raises InputError for a seed, number, chunk or frame that is none, or a motion that ends too early.
        """
        _check_call(seed=seed, chunk=chunk, frame=frame)
        now = self._frame(number, begin_s, pose)
        summary = Summary() if summary is None else summary
        builder = CloudBuilder(capacity=self.sensor.scanner.pulses * self.sensor.tdc.stops)
        self._hand_out(
            now, builder.append, "assemble", seed=seed, chunk=chunk, frame=frame, progress=progress,
            missed=missed, ambient=ambient, observer=observer, summary=summary,
        )  # fmt: skip
        since = time.perf_counter()
        cloud = PointCloud(**builder.fields(**self._description(now, seed, frame)))
        summary.spent("assemble", since)
        return cloud

    def stream(
        self,
        sink: Callable[[PointCloud], None],
        *,
        seed: int = 0,
        number: int = 0,
        begin_s: float = 0.0,
        pose: Pose | None = None,
        chunk: int = DEFAULT_CHUNK,
        frame: str = "world",
        progress: Callable[[int], None] | None = None,
        missed: Callable[[Numbers, Numbers], None] | None = None,
        ambient: Callable[[Numbers, Numbers], None] | None = None,
        summary: Summary | None = None,
    ) -> None:
        """One frame, chunk by chunk: the memory that it takes does not grow with its pulses.

        sink    called with clouds, at least one, which together are that of `render`; the time that it takes is
                that of the stage "write". What `formats.registry.Format.stream` gives is such a sink
        others  as those of `render`
        """
        _check_call(seed=seed, chunk=chunk, frame=frame)
        now = self._frame(number, begin_s, pose)
        description, empty = self._description(now, seed, frame), True

        def take(columns: Mapping[str, Any]) -> None:
            nonlocal empty
            empty = False
            sink(PointCloud(**columns, **description))

        self._hand_out(
            now, take, "write", seed=seed, chunk=chunk, frame=frame, progress=progress,
            missed=missed, ambient=ambient, observer=None, summary=Summary() if summary is None else summary,
        )  # fmt: skip
        if empty:
            sink(PointCloud(**CloudBuilder().fields(**description)))

    def empty(
        self,
        *,
        seed: int = 0,
        number: int = 0,
        begin_s: float = 0.0,
        pose: Pose | None = None,
        frame: str = "world",
    ) -> PointCloud:
        """The cloud of `render` without its points: names and metadata, known before anything is traced."""
        _check_call(seed=seed, chunk=1, frame=frame)
        return PointCloud(
            **CloudBuilder().fields(**self._description(self._frame(number, begin_s, pose), seed, frame))
        )

    def _hand_out(
        self,
        now: Frame,
        take: Callable[[Mapping[str, Any]], None],
        stage: str,
        *,
        seed: int,
        chunk: int,
        frame: str,
        progress: Callable[[int], None] | None,
        missed: Callable[[Numbers, Numbers], None] | None,
        ambient: Callable[[Numbers, Numbers], None] | None,
        observer: Observer | None,
        summary: Summary,
    ) -> None:
        """A frame's columns to ``take``, all else to who asked for it; ``stage`` is what taking is called."""
        done = 0
        for first, columns, outcome in self._chunks(
            now, seed=seed, chunk=chunk, goal=now.goal(frame), summary=summary, ambient=ambient,
            observer=observer, ordered=missed is not None,
        ):  # fmt: skip
            since = time.perf_counter()
            done += len(outcome)
            summary.count(outcome, None if columns is None else columns["status"])
            if columns is not None:
                take(columns)
            if missed is not None:
                lost = np.flatnonzero(outcome)
                missed((lost + first).astype(np.uint32), outcome[lost].astype(np.uint8))
            if progress is not None:
                progress(done)
            summary.spent(stage, since)

    def _chunks(
        self,
        now: Frame,
        *,
        seed: int,
        chunk: int,
        goal: Pose,
        summary: Summary,
        ambient: Callable[[Numbers, Numbers], None] | None,
        observer: Observer | None,
        ordered: bool,
    ) -> Iterator[tuple[int, dict[str, Any] | None, Numbers]]:
        """First pulse, columns of the kept points (None without any) and outcomes of each chunk, in order; outcomes
        by pulse if they have to be ``ordered``.

        The device is given the next chunk before this one is handed out: it works while numpy copies.
        """
        begin, end = now.first_pulse, now.first_pulse + self.sensor.scanner.pulses
        chunk = max(1, chunk // max(self.rays, self.background_rays or 1))
        if self._tiling is not None and chunk > self._tiling.band:
            chunk -= chunk % self._tiling.band
        seed_word = transfer.opaque_uint32(seed)
        placing = Placing.of(goal)

        def started(first: int) -> Chunk:
            since = time.perf_counter()
            count = min(chunk, end - first)
            order = self.order_of(count)
            if order is None:
                pulse, numbers = transfer.counter(first, count), numbered(first, count)
            else:
                pulse, numbers = order.on_device(first), functools.partial(order.pulse_from, first)
            part = self._chain(now, pulse, numbers, seed_word, survey=self.interactions > 0)
            summary.spent("record", since)
            return replace(part, order=order)

        part, first = started(begin), begin
        for following in [*range(begin + chunk, end, chunk), None]:
            since = time.perf_counter()
            transfer.wait()
            parts = [part, *self._gone_on(now, part, seed_word)]
            since = summary.spent("trace", since)
            pulse, columns = self._columns(now, parts, placing)
            outcome = of_every_pulse(parts, first, "outcome", ordered=ordered)
            if ambient is not None:
                every = np.arange(first, first + len(outcome), dtype=np.uint32)
                ambient(every, of_every_pulse(parts, first, "ambient").astype(np.uint64))
            if observer is not None:
                observer(pulse, all_of([self._surfaces(one) for one in parts]))
            summary.spent("collect", since)
            done = first
            if following is not None:
                part, first = started(following), following
            yield done, columns, outcome

    def order_of(self, count: int) -> Order | None:
        """Of a chunk of so many pulses; frames have chunks of two sizes, and the last two are kept."""
        if self._tiling is None:
            return None
        known = self._orders.get(count)
        if known is None:
            known = Order.of(self._tiling.order(count))
            self._orders = dict([*self._orders.items()][-1:]) | {count: known}
        return known

    def _gone_on(self, now: Frame, part: Chunk, seed: Any) -> list[Chunk]:
        """The pulses of a chunk that meet panes or mirrors, once more and in full."""
        lanes = None if part.goes_on is None else collect.lanes_where(part.goes_on)
        if lanes is None:
            return []
        lanes, twice = collect.more_than_one(lanes)
        pulse = collect.gathered(part.pulse, lanes)
        whole = self._chain(now, pulse, pulse.numpy, seed)
        if twice is not None:
            whole = left_out(whole.pulse, whole.paths, whole.detection, twice)
            transfer.start(whole.arrays())
        transfer.wait()
        return [whole]

    def waveforms(
        self,
        pulses: Sequence[int],
        times_s: Numbers | None = None,
        *,
        seed: int = 0,
        number: int = 0,
        begin_s: float = 0.0,
        pose: Pose | None = None,
    ) -> Waveforms:
        """Power on the detector and its signal against time, without noise, of chosen pulses of a frame.

        pulses   their numbers within the frame, 0 for its first; in rising order in what is returned
        times_s  (times,) after the pulse left; if None the converter's window in sixteenths of the pulse's width
        seed, number, begin_s, pose  of the frame, as for `render`
        Raises InputError for a pulse that is none.
        """
        _check_call(seed=seed, chunk=1, frame="sensor")
        now = self._frame(number, begin_s, pose)
        chosen = check_pulses(pulses, self.sensor)
        seed_word = transfer.opaque_uint32(seed)

        def train_of(first: int, count: int) -> EchoTrain:
            begin = now.first_pulse + first
            pulse, numbers = transfer.counter(begin, count), numbered(begin, count)
            return cast(EchoTrain, transfer.fetched(self._stages.pulse_train(now, pulse, numbers, seed_word)))

        return sampled_pulses(train_of, chosen, self.sensor, times_s, first_pulse=now.first_pulse)

    def _columns(
        self, now: Frame, parts: Sequence[Chunk], placing: Placing
    ) -> tuple[Numbers, dict[str, Any] | None]:
        """The kept points of a chunk, by pulse and then by return: pulse numbers, columns of a PointCloud or None."""
        found = [self._on_device(part, placing) for part in parts]
        kept = [one for one in found if one is not None]
        if not kept:
            return np.zeros(0, np.uint32), None
        ordered = found[0] is not None and len(kept) == 1
        columns = transfer.columns(collect.one_by_one(kept[0]) if ordered else collect.by_pulse(kept))
        columns["xyz_m"] = columns["xyz_m"].reshape(-1, 3)
        if placing.added_m is not None:
            columns["xyz_m"] = columns["xyz_m"] + placing.added_m
        pulse = columns["time_s"]
        columns["time_s"] = now.time_s(pulse)
        columns["sensor_index"] = np.broadcast_to(np.uint8(0), len(pulse))
        for name, nothing in collect.ABSENT.items():
            columns.setdefault(name, np.broadcast_to(nothing, len(pulse)))
        return pulse, columns

    def _on_device(self, part: Chunk, placing: Placing) -> dict[str, Any] | None:
        """`collect.columns` of some pulses; None without any points."""
        lanes = collect.kept_lanes(part.detection, None if part.order is None else part.order.device_lane)
        if lanes is None:
            return None
        return collect.columns(
            world=self.world, sensor=self._stages.sensor, pulse=part.pulse, paths=part.paths, rays=self.rays,
            detection=part.detection, air_classes=self._air_classes, lanes=lanes,
            turn=placing.turn, shift=placing.shift,
        )  # fmt: skip

    def _surfaces(self, part: Chunk) -> dict[str, Numbers]:
        """`collect.surfaces` of a chunk; empty without any."""
        on_device = collect.surfaces(
            world=self.world, pulse=part.pulse, paths=part.paths, rays=self.rays, detection=part.detection
        )
        return {} if on_device is None else transfer.columns(on_device)

    def _frame(self, number: int, begin_s: float, pose: Pose | None) -> Frame:
        return Frame.of(
            self.scene, self.sensor, self.world, number=number, begin_s=begin_s, sensor_pose=pose or self.pose
        )

    def _description(self, now: Frame, seed: int, frame: str) -> dict[str, Any]:
        """Names and metadata of the frame's cloud."""
        return {
            "sensor_names": (self.sensor.name,),
            "body_names": self.world.body_names,
            "class_names": self.class_names,
            "material_names": self.world.material_names,
            "metadata": metadata_of(self.scene, self.sensor, now, seed=seed, frame=frame),
        }


def _check_call(*, seed: int, chunk: int, frame: str) -> None:
    if not 0 <= seed < 2**32:
        raise InputError(f"seed: a whole number from 0 to {2**32 - 1} was expected, {seed} came")
    if chunk < 1:
        raise InputError(f"chunk: at least 1 was expected, {chunk} came")
    if frame not in COORDINATES:
        raise InputError(f"frame: {' or '.join(map(repr, COORDINATES))} was expected, {frame!r} came")
