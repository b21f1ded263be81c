"""Simulator: a Scene, a Sensor and a Pose in, a PointCloud out, chunk by chunk through the `stages`.

What costs time once (the world, the compiled kernels) is kept here for all frames; what differs from frame to frame
goes in as numbers on the device.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Unpack, cast

import numpy as np

from ..cloud.builder import CloudBuilder
from ..cloud.point_cloud import PointCloud
from ..detection.sampled_waveforms import Waveforms, check_pulses, sampled_pulses
from ..kernel.device import blocks, transfer
from ..kernel.rays import kept
from ..kernel.rays import point_columns as collect
from ..kernel.world.mitsuba_world import World, build_world
from ..light.echoes import EchoTrain
from ..maths.arrays import Lanes, Numbers
from ..maths.pose import Pose
from ..maths.trajectory import Motion, pose_at
from ..scene.clearance import Clearance
from ..scene.scene import Scene
from ..scene.scene_file import load_scene
from ..sensor.catalogue import load_sensor
from ..sensor.model import Sensor
from .chunk import Chunk, Placing, all_of, of_every_pulse
from .extremes import check_detections, of_points
from .frame import Frame, check_frame, motion_of
from .metadata import metadata_of
from .options import (
    FrameKeywords,
    FrameOptions,
    Keywords,
    Observers,
    Placed,
    StreamKeywords,
    TraceKeywords,
    TraceOptions,
    placed,
)
from .stages import Chain, Stages
from .summary import Summary as Summary
from .tiles import PACKET, Numbering, Pulses


@dataclass(frozen=True, slots=True)
class _Piece:
    """What a chunk of pulses became.

    first    number of its first pulse
    columns  of its points by name; None without any
    outcome  (n,) `Outcome` of each pulse
    """

    first: int
    columns: dict[str, Any] | None
    outcome: Numbers


class Simulator:
    """A world and a sensor, ready for any number of frames; nothing is compiled twice.

    Coordinates are single precision around the place where the sensor stood when the world was built; a
    later `render` from 100 m off that place is still good to 0.01 mm, one from 10 km to 1 mm.
    """

    def __init__(
        self,
        scene: str | os.PathLike[str] | Scene,
        sensor: str | os.PathLike[str] | Sensor | None = None,
        trace: TraceOptions | None = None,
        *,
        world: World | None = None,
        pose: Placed | None = None,
        **options: Unpack[TraceKeywords],
    ) -> None:
        """Compile the scene around the sensor's place (or take a compiled ``world``).

        scene    a name, a file or a `Scene`, as for `load_scene`
        sensor   a catalogue name, a file or a `Sensor`; the scene's own if None
        pose     where the sensor stands, its mounting not included: in the world, or on the scene's ego vehicle; the
                 scene's own if None. `render` takes another per frame.
        options  fields of `TraceOptions`, in place of those of ``trace``
        Raises InputError for an option that is none.
        """
        keywords = Keywords(options)
        self.trace = trace = keywords.take(TraceOptions, trace)
        keywords.end()
        self.scene = scene = load_scene(scene)
        self.sensor = sensor = load_sensor(scene.sensor_name if sensor is None else sensor)
        self.pose = scene.sensor_pose if pose is None else placed(pose)
        self.clearance = Clearance.of_scene(scene)
        self.world = world or build_world(
            scene,
            wavelength_m=sensor.laser.wavelength_m,
            centre_m=pose_at(self.motion).position_m,
            see_through=trace.interactions > 0,
        )
        # The rays of one pulse are neighbours already.
        self.numbering = Numbering(sensor.scanner, tiled=trace.rays < PACKET)
        if trace.interactions and not self.world.see_through:
            raise ValueError("world: must let beams go on (see_through) for interactions > 0, got one that does not")
        self._stages = Stages.of(scene, sensor, self.world, trace)
        self._chain = Chain(self._stages)
        self.class_names = self.world.class_names
        self._air_classes = None
        if (air := self._stages.air) is not None:
            self.class_names = tuple(dict.fromkeys((*self.class_names, *air.names)))
            sources = (air.strongest, *air.sources)
            self._air_classes = transfer.whole_numbers([self.class_names.index(name) for name in sources])

    def __repr__(self) -> str:
        return f"Simulator({self.sensor!r} in {self.scene!r})"

    @property
    def motion(self) -> Motion:
        """The sensor's own in the world: what `deskewed` takes off."""
        return motion_of(self.scene, self.sensor, self.pose)

    def check_frames(self, numbers: Sequence[int], *, begin_s: float = 0.0) -> None:
        """Raises InputError unless every motion lasts for these frames, and there are numbers for their pulses.

        Nor may the sensor be on or in a surface as the first or the last of them begins.
        """
        for number in (numbers[0], numbers[-1]):
            scanner_s, _ = check_frame(self.scene, self.sensor.scanner, number=number, begin_s=begin_s)
            start_s = begin_s + scanner_s
            self._check_clearance(pose_at(self.motion, start_s), start_s)

    def render(
        self, frame: FrameOptions | None = None, observers: Observers | None = None, **options: Unpack[StreamKeywords]
    ) -> PointCloud:
        """One frame as a point cloud.

        options  fields of `FrameOptions` and `Observers`, in place of those of ``frame`` and ``observers``
        Raises InputError for an option that is none, or a motion that ends too early.
        """
        asked, told = _asked(frame, observers, options)
        now, summary = self._frame(asked), Summary() if told.summary is None else told.summary
        most = self.sensor.scanner.pulses * self.sensor.tdc.stops
        builder = CloudBuilder(capacity=most, vectors=self.trace.vectors)
        self._hand_out(now, builder.append, "assemble", asked, replace(told, summary=summary))
        since = time.perf_counter()
        cloud = PointCloud(**builder.fields(**self._description(now, asked)), checked=True)
        summary.spent("assemble", since)
        return cloud

    def stream(
        self,
        sink: Callable[[PointCloud], None],
        frame: FrameOptions | None = None,
        observers: Observers | None = None,
        **options: Unpack[StreamKeywords],
    ) -> None:
        """One frame, chunk by chunk: the memory that it takes does not grow with its pulses.

        sink    called with clouds, at least one, which together are that of `render`; the time that it takes is
                that of the stage "write". What `formats.registry.Format.stream` gives is such a sink
        others  as those of `render`
        """
        asked, told = _asked(frame, observers, options)
        now = self._frame(asked)
        description, empty = self._description(now, asked), True

        def take(columns: Mapping[str, Any]) -> None:
            nonlocal empty
            empty = False
            sink(PointCloud(**columns, **description, checked=True))

        self._hand_out(now, take, "write", asked, told)
        if empty:
            sink(PointCloud(**CloudBuilder(vectors=self.trace.vectors).fields(**description)))

    def empty(self, frame: FrameOptions | None = None, **options: Unpack[FrameKeywords]) -> PointCloud:
        """The cloud of `render` without its points: names and metadata, known before anything is traced."""
        asked, _ = _asked(frame, None, options)
        description = self._description(self._frame(asked), asked)
        return PointCloud(**CloudBuilder(vectors=self.trace.vectors).fields(**description))

    def start_s(self, frame: FrameOptions) -> float:
        """When a frame begins, by the clock of the scene's motions."""
        return self._frame(frame).start_s

    def to_world(self, frame: FrameOptions) -> Pose:
        """Where the coordinates of a frame's points stand in the world as it begins."""
        now = self._frame(frame)
        return now.place @ now.goal(frame.coordinates).inverse()

    def _hand_out(
        self, now: Frame, take: Callable[[Mapping[str, Any]], None], stage: str, asked: FrameOptions, told: Observers
    ) -> None:
        """A frame's columns to ``take``, all else to who asked for it; ``stage`` is what taking is called."""
        done, summary = 0, Summary() if told.summary is None else told.summary
        for piece in self._pieces(now, asked, told, summary):
            since = time.perf_counter()
            done += len(piece.outcome)
            summary.count(piece.outcome, None if piece.columns is None else piece.columns["status"])
            if piece.columns is not None:
                take(piece.columns)
            if told.missed is not None:
                lost = np.flatnonzero(piece.outcome)
                told.missed((lost + piece.first).astype(np.uint32), piece.outcome[lost].astype(np.uint8))
            if told.progress is not None:
                told.progress(done, self.sensor.scanner.pulses)
            summary.spent(stage, since)

    def _pieces(self, now: Frame, asked: FrameOptions, told: Observers, summary: Summary) -> Iterator[_Piece]:
        """What each chunk became, in order; outcomes are by pulse if someone is told of those that are missed.

        The device is given the next chunk before this one is handed out: it works while numpy copies.
        """
        begin, end = now.first_pulse, now.first_pulse + self.sensor.scanner.pulses
        # The option counts rays, since they take the memory; a chunk counts pulses.
        chunk = max(1, asked.chunk // max(self.trace.rays, self.trace.background_rays or 1))
        # Whole bands of tiles, or whole packets: so the same rays are traced together whatever the option says. Where a
        # ray meets the edge of two triangles, which of them it meets depends on the rays beside it.
        step = self.numbering.step
        chunk = max(step, chunk - chunk % step)
        seed_word = transfer.seed_word(asked.seed)
        placing = Placing.of(now.goal(asked.coordinates))

        def started(first: int) -> Chunk:
            since = time.perf_counter()
            count = min(chunk, end - first)
            blocks.share_out(count * self.trace.rays)
            pulses = self.numbering.pulses(now, first, count)
            part = self._chain(now, pulses, seed_word, survey=self.trace.interactions > 0)
            summary.spent("record", since)
            return replace(part, order=pulses.order)

        part, first = started(begin), begin
        for following in [*range(begin + chunk, end, chunk), None]:
            since = time.perf_counter()
            transfer.wait()
            parts = [part, *self._gone_on(now, part, seed_word)]
            check_detections(self.scene, self.sensor, [one.detection for one in parts])
            since = summary.spent("trace", since)
            pulse, columns = self._columns(now, parts, placing)
            outcome = of_every_pulse(parts, first, "outcome", ordered=told.missed is not None)
            if told.ambient is not None:
                every = np.arange(first, first + len(outcome), dtype=np.uint32)
                told.ambient(every, of_every_pulse(parts, first, "ambient").astype(np.uint64))
            if told.points is not None:
                told.points(pulse, all_of([self._surfaces(one) for one in parts]))
            summary.spent("collect", since)
            # The next chunk is started before this one is handed out: the device works while a file is written.
            done = first
            if following is not None:
                part, first = started(following), following
            yield _Piece(done, columns, outcome)

    def _gone_on(self, now: Frame, part: Chunk, seed: Lanes) -> list[Chunk]:
        """The pulses of a chunk that meet panes or mirrors, once more and in full."""
        lanes = None if part.goes_on is None else kept.lanes_where(part.goes_on)
        if lanes is None:
            return []
        several = kept.more_than_one(lanes)
        pulse = kept.gather_lanes(part.pulse, several)
        whole = self._chain(now, Pulses(pulse, lambda: now.times(pulse.numpy())), seed)
        transfer.wait()
        return [replace(whole, twice=several is not lanes)]

    def waveforms(
        self,
        pulses: Sequence[int],
        times_s: Numbers | None = None,
        frame: FrameOptions | None = None,
        **options: Unpack[FrameKeywords],
    ) -> Waveforms:
        """Power on the detector and its signal against time, without noise, of chosen pulses of a frame.

        pulses   their numbers within the frame, 0 for its first; in rising order in what is returned
        times_s  (times,) after the pulse left; if None the converter's window in sixteenths of the pulse's width
        frame, options  as for `render`; coordinates and chunk change nothing here
        Raises InputError for a pulse that is none.
        """
        asked, _ = _asked(frame, None, options)
        now = self._frame(asked)
        chosen = check_pulses(pulses, self.sensor)
        seed_word = transfer.seed_word(asked.seed)

        def train_of(first: int, count: int) -> EchoTrain:
            return self._train(now, now.first_pulse + first, count, seed_word)

        return sampled_pulses(train_of, chosen, self.sensor, times_s, first_pulse=now.first_pulse, seed=asked.seed)

    def light(self, frame: FrameOptions | None = None, **options: Unpack[FrameKeywords]) -> EchoTrain:
        """All that comes back of each pulse of a frame, before any detector; NumPy arrays.

        It depends on places, surfaces and light, and goes with the laser's power: traced once, it serves any receiver.

        frame, options  as for `render`; coordinates and chunk change nothing here
        """
        asked, _ = _asked(frame, None, options)
        now = self._frame(asked)
        seed_word = transfer.seed_word(asked.seed)
        return self._train(now, now.first_pulse, self.sensor.scanner.pulses, seed_word)

    def _train(self, now: Frame, first: int, count: int, seed: Lanes) -> EchoTrain:
        """Of pulses in firing order; NumPy arrays."""
        numbers = np.arange(first, first + count, dtype=np.uint32)
        pulses = Pulses(transfer.counter(first, count), lambda: now.times(numbers))
        return cast(EchoTrain, transfer.fetch(self._stages.pulse_train(now, pulses, seed)))

    def _columns(self, now: Frame, parts: Sequence[Chunk], placing: Placing) -> tuple[Numbers, dict[str, Any] | None]:
        """The kept points of a chunk, by pulse and then by return: pulse numbers, columns of a PointCloud or None.

        Raises InputError for points with NaN.
        """
        found = [self._on_device(part, placing) for part in parts]
        # Without any point the columns of one part are computed all the same, for the kernels of later frames.
        filled = [one for one in found if one[1]] or found[:1]
        # Whether any pulse went on must not decide: the first chunk where it is otherwise would compile kernels.
        alone = parts[0].goes_on is None
        columns = transfer.fetch_columns(
            collect.with_flat_positions(filled[0][0]) if alone else collect.merge_by_pulse(filled)
        )
        columns["xyz_m"] = columns["xyz_m"].reshape(-1, 3)
        # A single point is there twice (`kept.more_than_one`): the count leaves the copy out.
        count = sum(number for _, number in filled)
        if not count:
            return np.zeros(0, np.uint32), None
        columns = {name: values[:count] for name, values in columns.items()}
        if columns.pop(collect.BROKEN).any():
            raise of_points(self.scene, self.sensor, columns)
        if placing.added_m is not None:
            columns["xyz_m"] = columns["xyz_m"] + placing.added_m
        # The device hands on pulse numbers; times need float64, which only NumPy has here.
        pulse = columns["time_s"]
        columns["time_s"] = now.time_s(pulse)
        columns["sensor_index"] = np.broadcast_to(np.uint8(0), len(pulse))
        for name, nothing in collect.ABSENT.items():
            columns.setdefault(name, np.broadcast_to(nothing, len(pulse)))
        return pulse, columns

    def _on_device(self, part: Chunk, placing: Placing) -> tuple[dict[str, Any], int]:
        """`collect.point_columns` of some pulses, and the number of their points."""
        lane_of = None if part.order is None else part.order.device_lane
        lane, stop, count = kept.kept_lanes(part.detection, lane_of, twice=part.twice)
        columns = collect.point_columns(
            world=self.world,
            sensor=self._stages.sensor,
            staged=part.staged(self.trace.rays),
            air_classes=self._air_classes,
            lanes=(lane, stop),
            turn=placing.turn,
            shift=placing.shift,
        )
        return columns, count

    def _surfaces(self, part: Chunk) -> dict[str, Numbers]:
        """`collect.surface_columns` of a chunk; empty without any."""
        found = collect.surface_columns(world=self.world, staged=part.staged(self.trace.rays), twice=part.twice)
        if found is None:
            return {}
        columns, count = found
        return {name: values[:count] for name, values in transfer.fetch_columns(columns).items()}

    def _frame(self, asked: FrameOptions) -> Frame:
        now = Frame.of(self.scene, self.sensor, self.world, replace(asked, pose=asked.pose or self.pose))
        self._check_clearance(now.place, now.start_s)
        return now

    def _check_clearance(self, place: Pose, start_s: float) -> None:
        """Raises InputError for a sensor on or in a surface."""
        self.clearance.check(
            place.position_m, radius_m=float(self.sensor.housing_m), time_s=start_s, sensor=self.sensor.name
        )

    def _description(self, now: Frame, asked: FrameOptions) -> dict[str, Any]:
        """Names and metadata of the frame's cloud."""
        return {
            "sensor_names": (self.sensor.name,),
            "body_names": self.world.body_names,
            "class_names": self.class_names,
            "material_names": self.world.material_names,
            "metadata": metadata_of(self.scene, self.sensor, now, asked),
        }


def _asked(
    frame: FrameOptions | None, observers: Observers | None, options: Mapping[str, object]
) -> tuple[FrameOptions, Observers]:
    """The frame that a call asks for, and who is told of it."""
    keywords = Keywords(options)
    found = keywords.take(FrameOptions, frame), keywords.take(Observers, observers)
    keywords.end()
    return found
