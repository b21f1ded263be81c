"""Simulator: a Scene, a Sensor and a Pose in, a PointCloud out, chunk by chunk through the `stages`.

The world and the compiled kernels are kept for all frames; what differs from frame to frame goes in as numbers on the
device. The cloud's metadata say how it was made: scene and sensor by name, seed, number and poses.
"""

from __future__ import annotations

import itertools
import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any, ClassVar, Literal, NoReturn, Unpack, cast, overload

import numpy as np

from ..cloud.builder import CloudBuilder
from ..cloud.deskew import MOTION_KEPT, Deskewing, deskewed
from ..cloud.device_cloud import DeviceCloud
from ..cloud.point_cloud import PointCloud
from ..cloud.rays import PulseRays
from ..detection.sampled_waveforms import Waveforms, check_pulses, sample_waveforms
from ..errors import InputError
from ..files.arguments import checks_arguments
from ..formats.cloud_columns import RING_ROWS, SENSOR_TO_VEHICLE, SENSOR_TO_WORLD, numbers_text, pose_text
from ..kernel.device import backend, blocks, transfer
from ..kernel.device.gate import exclusive
from ..kernel.device.types import DeviceArray
from ..kernel.rays import kept_lanes
from ..kernel.rays import point_columns as collect
from ..kernel.rays.device_columns import DeviceColumns, join, start_columns
from ..kernel.world.mitsuba_world import World, build_world
from ..light.beams import reported_beams
from ..light.echoes import EchoTrain
from ..maths.arrays import Array, Mask, Numbers
from ..maths.attributes import HintedAttributes, refuse_to_set
from ..maths.pose import Pose
from ..maths.random import Seed
from ..maths.trajectory import Motion, pose_at
from ..scene.clearance import Clearance
from ..scene.scene import Scene
from ..scene.scene_file import SceneChoice, load_scene
from ..sensor.pose_file import Placed, to_pose
from ..sensor.rig_file import MOST_SENSORS
from ..sensor.sensor_file import load_sensor
from ..sensor.sensor_model import Sensor
from .chunk import Chunk, Placing, is_far, join_columns, without_lanes
from .extremes import check_detections, points_error
from .frame import Frame, check_frame, sensor_motion
from .frame_summary import Summary as Summary
from .launch import Launch, rows_of
from .pieces import pieces_of, world_of_piece
from .render_options import (
    FrameKeywords,
    FrameOptions,
    Keywords,
    Observers,
    StreamKeywords,
    TraceKeywords,
    TraceOptions,
)
from .stages import Chain, Stages, TracedPaths
from .tiles import LANES, PACKET, Numbering

READ_COLUMNS = "status", collect.NAN_COLUMN, collect.PULSE_COLUMN
"""Columns that are read in NumPy also where the others stay on the device."""

SEED_OF_RIG = 2**32 // MOST_SENSORS
"""Choice: the seeds of a rig's sensors differ by multiples of this, so that runs with smaller seeds share none."""


@dataclass(frozen=True, slots=True)
class _Piece:
    """Result of one chunk of pulses, in NumPy.

    Attributes:
        first: number of the chunk's first pulse
        pulse: number of the pulse of each point; none unless an observer asks for pulses
        range_m: its range, likewise
        status: `Status` of each of its points
        taken: what was read of the columns of its points; None without points
        outcome: (n,) `Outcome` of each pulse
    """

    first: int
    pulse: Numbers
    range_m: Numbers
    status: Numbers
    taken: Any
    outcome: Numbers


@checks_arguments
class Simulator(HintedAttributes):
    """A world and a sensor, ready for any number of frames; nothing is compiled twice.

    Coordinates are single precision around the place where the sensor stood when the world was built; a
    later `render` from 100 m off that place is still good to 0.01 mm, one from 10 km to 1 mm.
    """

    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {
        "simulate": "simulator.render(seed=1) renders a frame",
        **dict.fromkeys(
            ("step", "next", "run", "render_frames", "frames"),
            "simulator.render(number=N) renders frame N, render_frames(scene, sensor, frames=10) ten",
        ),
        **dict.fromkeys(("cloud", "plot", "seed", "reset"), "simulator.render(seed=1) is a cloud"),
        "fps": "1 / simulator.sensor.scanner.frame_s",
        **dict.fromkeys(
            ("set_pose", "move", "add", "remove"), "LiveSimulator(scene, sensor) has bodies and an ego that move"
        ),
    }
    CHANGED_BY: ClassVar[str] = (
        "Simulator(scene, sensor) is made for one scene and sensor; simulator.render(pose=...) is from another place"
    )
    _takes_turns = True
    """Whether bodies that hide may share a place among the movers (`build_world`)."""

    @exclusive
    def __init__(
        self,
        scene: SceneChoice,
        sensor: str | os.PathLike[str] | Sensor | None = None,
        trace: TraceOptions | None = None,
        *,
        world: World | None = None,
        pose: Placed | None = None,
        rig_number: int = 0,
        **options: Unpack[TraceKeywords],
    ) -> None:
        """Compile the scene around the sensor's place (or take a compiled ``world``).

        Args:
            scene: a name, a file or a `Scene`, as for `load_scene`
            sensor: a catalogue name, a file or a `Sensor`; the scene's own if None
            pose: where the sensor stands, its mounting not included: in the world, or on the scene's ego vehicle; the
                scene's own if None. `render` takes another per frame.
            rig_number: place among the sensors of a rig, from 0: each has noise of its own
            options: fields of `TraceOptions`, in place of those of ``trace``

        Raises:
            InputError: for an unknown option
        """
        keywords = Keywords(options)
        self.trace = trace = keywords.take(TraceOptions, trace)
        keywords.end()
        self.scene = scene = load_scene(scene)
        self.sensor = sensor = load_sensor(scene.sensor_name if sensor is None else sensor)
        self.pose = scene.sensor_pose if pose is None else to_pose(pose)
        self.rig_number = rig_number
        self.clearance = Clearance.of_scene(scene)
        (self._piece,) = pieces_of(scene, [0.0])
        self.world = world or self._build_world()
        # The rays of one pulse are neighbours already.
        whole = 1 if sensor.optics.stray is None else sensor.scanner.line_pulses or 1
        self.numbering = Numbering(sensor.scanner, tiled=trace.rays < PACKET, whole=whole)
        if trace.interactions and not self.world.see_through:
            raise ValueError("world: must let beams go on (see_through) for interactions > 0, got one that does not")
        self._prepare_stages()
        rings = sensor.rings_by_channel
        self._rings = None if rings is None else transfer.whole_numbers(rings)
        air, self._air_classes = self._stages.air, None
        self.class_names = tuple(dict.fromkeys((*self.world.class_names, *(air.names if air is not None else ()))))
        if air is not None:
            sources = (air.strongest, *air.sources)
            self._air_classes = transfer.whole_numbers([self.class_names.index(name) for name in sources])

    def _build_world(self) -> World:
        """Compile the scene around the sensor's place, or the piece of it in which the vehicle is."""
        keys: dict[str, Any] = {
            "wavelength_m": self.sensor.laser.wavelength_m,
            "see_through": self.trace.interactions > 0,
        }
        if self._piece is not None:
            return world_of_piece(self.scene, self._piece, self.clearance, **keys)
        centre_m = pose_at(self.motion).position_m
        return build_world(self.scene, centre_m=centre_m, takes_turns=self._takes_turns, **keys)

    def _forget_launches(self) -> None:
        self._traced: Launch | None = None
        self._begun: Launch | None = None
        self._deskewings: dict[Frame, Deskewing] = {}

    def _prepare_stages(self) -> None:
        self._forget_launches()
        self._stages = Stages.from_scene(self.scene, self.sensor, self.world, self.trace)
        self._chain = Chain(self._stages)

    @exclusive
    def share_paths(self, traced: TracedPaths) -> None:
        """Read the paths of the next frame from ``traced``, or trace them into it: see there for what may differ.

        For sensors that are rendered once each: the stages are not recorded for later frames.
        """
        traced.rewind()
        self._forget_launches()
        self._stages = replace(self._stages, traced=traced)
        self._chain = Chain(self._stages)

    def __setattr__(self, word: str, value: object) -> None:
        """Set an attribute, but none of what the stages are compiled for: the others would not follow."""
        if word in vars(self) and not word.startswith("_"):
            refuse_to_set(self, word, value)
        super().__setattr__(word, value)

    def __repr__(self) -> str:
        return f"Simulator({self.sensor!r} in {self.scene!r})"

    def __reduce__(self) -> NoReturn:
        raise InputError(
            f"{type(self).__name__}: cannot be pickled or copied, its kernels are of this process; send scene and "
            "sensor, of which each process makes its own"
        )

    def _seed(self, options: FrameOptions) -> int:
        """Seed of the sensor's own noise; alone with this one its cloud is that of the rig."""
        return options.seed ^ SEED_OF_RIG * self.rig_number

    @property
    def motion(self) -> Motion:
        """Motion of the sensor in the world, which `deskewed` corrects for."""
        return sensor_motion(self.scene, self.sensor, self.pose)

    def check_frames(self, numbers: Sequence[int], *, begin_s: float = 0.0) -> None:
        """Raise InputError unless every motion lasts for these frames, and there are numbers for their pulses.

        The same for a sensor that is on or in a surface as the first or the last of these frames begins.
        """
        for number in (*numbers[:1], *numbers[-1:]):
            scanner_s, _ = check_frame(self.scene, self.sensor.scanner, number=number, begin_s=begin_s)
            start_s = begin_s + scanner_s
            self._check_clearance(pose_at(self.motion, start_s), start_s)

    def without_motion(self, cloud: PointCloud, frame: FrameOptions) -> PointCloud:
        """Deskew the cloud of a frame, or a piece of it (`deskewed`)."""
        _, length_s = check_frame(self.scene, self.sensor.scanner, number=frame.number, begin_s=frame.begin_s)
        return deskewed(cloud, self.motion, length_s=length_s)

    @exclusive
    def deskewing(self, frame: FrameOptions) -> Deskewing:
        """Way of the points of a frame to where they are in `without_motion`."""
        own = self._started_frame(frame) or self._frame(frame)
        if own not in self._deskewings:
            launches = (launch for launch in (self._traced, self._begun) if launch is not None and launch.has(own))
            # For all that are traced together: one motion at one time costs as much as at ten.
            frames = next(([each for _, each in launch.frames] for launch in launches), [own])
            deskewings = Deskewing.of_frames(
                self.motion,
                [each.goal(frame.coordinates) for each in frames],
                starts_s=[each.start_s for each in frames],
                lengths_s=[each.length_s for each in frames],
            )
            self._deskewings = dict(zip(frames, deskewings, strict=True))
        return self._deskewings[own]

    @exclusive
    def begin(self, frame: FrameOptions, frames: int = 1) -> None:
        """Start the first chunk of the frame that is rendered next, so that the device has it when its turn comes.

        The frame is the same without. Does nothing where the frame has a mistake, which is raised when it is rendered,
        or where the vehicle is in another piece of the scene then.

        Args:
            frames: number of the frames that are rendered from this one on, one after the other: several small ones are
                traced together
        """
        end = frame.number + frames
        if self._traced is not None and self._traced.frame_of(frame) is not None:
            number = self._traced.frames[-1][0].number + 1
            if number >= end:
                return
            frame = replace(frame, number=number)
        if self._begun is None or self._begun.frame_of(frame) is None:
            with blocks.resting():
                self._begun = self._started_together(frame, end - frame.number)

    @overload
    def render(
        self,
        frame: FrameOptions | None = None,
        observers: Observers | None = None,
        *,
        ahead: Callable[[], None] | None = None,
        keep_rays: bool = False,
        on_device: Literal[False] = False,
        **options: Unpack[StreamKeywords],
    ) -> PointCloud: ...

    @overload
    def render(
        self,
        frame: FrameOptions | None = None,
        observers: Observers | None = None,
        *,
        ahead: Callable[[], None] | None = None,
        keep_rays: bool = False,
        on_device: Literal[True],
        **options: Unpack[StreamKeywords],
    ) -> DeviceCloud: ...

    @exclusive
    def render(
        self,
        frame: Annotated[FrameOptions | None, "a FrameOptions (frame N is number=N) or None"] = None,
        observers: Observers | None = None,
        *,
        ahead: Callable[[], None] | None = None,
        keep_rays: bool = False,
        on_device: bool = False,
        **options: Unpack[StreamKeywords],
    ) -> PointCloud | DeviceCloud:
        """Render one frame as a point cloud.

        Args:
            keep_rays: keep the ray of every pulse too, in `PointCloud.rays`: 60 bytes a pulse
            ahead: called once the device has done its part of the frame: time to `begin` another one
            on_device: leave the columns on the device, for libraries that compute there: a `DeviceCloud`
            options: fields of `FrameOptions` and `Observers`, in place of those of ``frame`` and ``observers``

        Raises:
            InputError: for an unknown option, or a motion that ends too early
        """
        if on_device and keep_rays:
            raise InputError("render: keep_rays must be False where on_device is True, got True: rays are NumPy's")
        frame_options, observers = _resolve_options(frame, observers, options)
        current_frame, summary = (
            self._traced_frame(frame_options),
            Summary() if observers.summary is None else observers.summary,
        )
        pulses = self.sensor.scanner.pulses
        is_cut = pulses > self._chunk_pulses(frame_options)
        # Chunks are joined on the device where that is asked for, and on a card: its memory is a hundred times as fast.
        parts: list[DeviceColumns] | None = [] if on_device or (is_cut and backend.is_cuda()) else None
        builder = CloudBuilder(
            capacity=pulses * self.sensor.tdc.stops,
            vectors=self.trace.vectors,
            memory=transfer.pooled_memory if parts is None and is_cut else None,
        )
        description = self._description(current_frame, frame_options)
        rays: list[PulseRays] = []
        pulses_observer = observers.pulses if not keep_rays else _both(rays.append, observers.pulses)
        taking = replace(observers, summary=summary, pulses=pulses_observer)
        take, read = (builder.append, _in_numpy) if parts is None else (parts.append, _on_device)
        self._hand_out(current_frame, take, "assemble", frame_options, taking, ahead, read)
        since = time.perf_counter()
        if parts is None:
            cloud = PointCloud(**builder.fields(**description), checked=True)
        else:
            gathered = DeviceCloud(columns=join(parts), vectors=self.trace.vectors, **description)
            if on_device:
                return gathered
            cloud = gathered.numpy()
        if keep_rays:
            object.__setattr__(cloud, "_rays", PulseRays.concatenate(rays))
        summary.add_time("assemble", since)
        return cloud

    @exclusive
    def stream(
        self,
        sink: Callable[[Any], None],
        frame: FrameOptions | None = None,
        observers: Observers | None = None,
        *,
        ahead: Callable[[], None] | None = None,
        read: Callable[[DeviceCloud], Any] | None = None,
        **options: Unpack[StreamKeywords],
    ) -> None:
        """Render one frame chunk by chunk: the memory that it takes does not grow with its pulses.

        Args:
            sink: called with clouds, at least one, which joined are that of `render`; its time counts as the stage
                "write". `formats.registry.Format.stream` gives such a sink
            read: makes what ``sink`` is called with, of points that are on the device, before the device goes on; a
                frame without points remains a cloud

        The other arguments are those of `render`.
        """
        frame_options, observers = _resolve_options(frame, observers, options)
        current_frame = self._traced_frame(frame_options)
        description, empty = self._description(current_frame, frame_options), True

        def take(piece: Any) -> None:
            nonlocal empty
            empty = False
            sink(piece)

        def read_columns(columns: DeviceColumns) -> Any:
            if not columns.count:
                return None
            if read is None:
                return PointCloud(**description | columns.in_numpy(), checked=True)
            return read(DeviceCloud(columns=columns, vectors=self.trace.vectors, **description))

        self._hand_out(current_frame, take, "write", frame_options, observers, ahead, read_columns)
        if empty:
            sink(PointCloud(**CloudBuilder(vectors=self.trace.vectors).fields(**description)))

    @exclusive
    def empty(self, frame: FrameOptions | None = None, **options: Unpack[FrameKeywords]) -> PointCloud:
        """Cloud of `render` without its points: names and metadata, available before anything is traced."""
        frame_options, _ = _resolve_options(frame, None, options)
        current_frame = self._started_frame(frame_options) or self._frame(frame_options)
        description = self._description(current_frame, frame_options)
        return PointCloud(**CloudBuilder(vectors=self.trace.vectors).fields(**description))

    @exclusive
    def start_s(self, frame: FrameOptions) -> float:
        """Time at which a frame begins, by the clock of the scene's motions [s].

        Raises:
            InputError: where a motion does not last as long as the frame, or the frame's number is too high
        """
        scanner_s, _ = check_frame(self.scene, self.sensor.scanner, number=frame.number, begin_s=frame.begin_s)
        return frame.begin_s + scanner_s

    @exclusive
    def to_world(self, frame: FrameOptions) -> Pose:
        """Pose in the world, as the frame begins, of the coordinates of its points."""
        current_frame = self._started_frame(frame) or self._frame(frame)
        return current_frame.place @ current_frame.goal(frame.coordinates).inverse()

    def _hand_out(
        self,
        frame: Frame,
        take: Callable[[Any], None],
        stage: str,
        options: FrameOptions,
        observers: Observers,
        ahead: Callable[[], None] | None,
        read: Callable[[DeviceColumns], Any],
    ) -> None:
        """Hand the columns of each piece of a frame to ``take``, and the rest to the observers.

        Args:
            take: called with what is read of the columns of each chunk
            read: reads them, before the device starts something else; None: there is nothing to take
            stage: name under which the summary counts the time of this
        """
        finished, summary = 0, Summary() if observers.summary is None else observers.summary
        for piece in self._pieces(frame, options, observers, summary, ahead, read):
            since = time.perf_counter()
            finished += len(piece.outcome)
            summary.count(piece.outcome, piece.status)
            if piece.taken is not None:
                take(piece.taken)
            if observers.missed is not None:
                missed = np.flatnonzero(piece.outcome)
                observers.missed(frame.pulses_in_run(missed + piece.first), piece.outcome[missed].astype(np.uint8))
            if observers.pulses is not None:
                observers.pulses(self._rays(frame, piece, options.coordinates))
            if observers.progress is not None:
                observers.progress(finished, self.sensor.scanner.pulses)
            summary.add_time(stage, since)

    def _rays(self, frame: Frame, piece: _Piece, coordinates: str) -> PulseRays:
        """Rays of all pulses of a piece, in the coordinates of its points."""
        pulse, goal = piece.first + np.arange(len(piece.outcome)), frame.goal(coordinates)
        range_m = np.full(len(pulse), np.inf, np.float32)
        np.minimum.at(range_m, piece.pulse.astype(np.int64) - piece.first, piece.range_m)
        in_run = frame.pulses_in_run(pulse)
        beams = reported_beams(
            self.sensor, pulse=in_run, origin_m=tuple(goal.position_m), rotation=tuple(goal.rotation.ravel())
        )
        channel = np.asarray(self.sensor.scanner.channel(in_run))
        return PulseRays(
            pulse=in_run,
            origin_m=np.stack([np.broadcast_to(np.float64(axis), pulse.shape) for axis in beams.origin_m], axis=-1),
            direction=np.stack(beams.direction, axis=-1).astype(np.float32),
            time_s=self.sensor.scanner.time_s(in_run) - frame.scanner_s,
            channel=channel,
            ring=self.sensor.rings(channel),
            outcome=piece.outcome.astype(np.uint8),
            range_m=range_m,
        )

    def _pieces(
        self,
        frame: Frame,
        options: FrameOptions,
        observers: Observers,
        summary: Summary,
        ahead: Callable[[], None] | None,
        read: Callable[[DeviceColumns], Any],
    ) -> Iterator[_Piece]:
        """Iterate over the results of the chunks; outcomes are in the order of pulses if an observer needs them so.

        The device starts the next chunk before this one is handed out: it computes while NumPy copies.
        """
        begin, end = frame.first_pulse, frame.first_pulse + self.sensor.scanner.pulses
        needs_order = observers.missed is not None or observers.pulses is not None
        launch, first = self._launch_with(frame), begin
        for following in [*range(begin + self._chunk_pulses(options), end, self._chunk_pulses(options)), None]:
            if launch is None:
                since = time.perf_counter()
                launch = self._started([(options, frame)], first)
                summary.add_time("record", since)
            if not launch.parts:
                self._finish(launch, summary)
            since = time.perf_counter()
            check_detections(self.scene, self.sensor, partial(launch.values, frame, ordered=False))
            outcome = launch.values(frame, "outcome", ordered=needs_order)
            numbers = range(first, first + len(outcome))
            columns = self._points(launch, frame, numbers)
            if observers.ambient is not None:
                observers.ambient(
                    frame.pulses_in_run(np.arange(numbers.start, numbers.stop)),
                    launch.values(frame, "ambient").astype(np.uint64),
                )
            if observers.points is not None:
                of_points = frame.pulses_in_run(columns.numpy(collect.PULSE_COLUMN))
                observers.points(of_points, self._surfaces(launch, frame, numbers))
            # All that NumPy reads of this chunk: later it would wait for the next one, too.
            status = columns.numpy("status")
            pulse = range_m = np.zeros(0)
            if observers.pulses is not None:
                pulse, range_m = columns.numpy(collect.PULSE_COLUMN), columns.numpy("range_m")
            taken = read(columns)
            summary.add_time("collect", since)
            piece_first, launch = first, None
            if following is not None:
                since = time.perf_counter()
                launch, first = self._started([(options, frame)], following), following
                summary.add_time("record", since)
            elif ahead is not None:
                ahead()
            yield _Piece(piece_first, pulse, range_m, status, taken, outcome)

    def _launch_with(self, frame: Frame) -> Launch | None:
        """Launch that begins with the pulses of a frame, or has them among others; forget those that it comes after."""
        launches, self._begun = (self._traced, self._begun), None
        launch = next((launch for launch in launches if launch is not None and launch.has(frame)), None)
        if launch is not None and launch is launches[0]:
            self._begun = launches[1]
        # Kept until its last frame is handed out.
        self._traced = launch if launch is not None and launch.frames[-1][1] is not frame else None
        return launch

    def _finish(self, launch: Launch, summary: Summary) -> None:
        """Wait for a launch, trace once more what goes on, and collect the points of all its frames."""
        run, frames = launch.run, [frame for _, frame in launch.frames]
        options, _ = launch.frames[0]
        since = time.perf_counter()
        transfer.wait()
        with blocks.resting():
            launch.parts = self._trace_continuing(run, launch.part, run.seed_words(self._seed(options)), len(frames))
            since = summary.add_time("trace", since)
            pulses = self.sensor.scanner.pulses
            placing = Placing.of_frames(
                frames, options.coordinates, pulses, clock=self.numbering.clock, rings=self._rings
            )
            launch.columns = self._columns(run, launch.parts, placing)
        summary.add_time("collect", since)

    def _points(self, launch: Launch, frame: Frame, numbers: range) -> DeviceColumns:
        """Points of the pulses of these numbers.

        Raises:
            InputError: for points with NaN or infinities
        """
        columns = launch.columns
        assert columns is not None
        if len(launch.frames) > 1:
            rows = rows_of(columns.numpy(collect.PULSE_COLUMN), numbers)
            columns = columns.part(rows.start, rows.stop)
        if columns.numpy(collect.NAN_COLUMN).any():
            raise points_error(self.scene, self.sensor, columns.in_numpy())
        return columns

    def _chunk_pulses(self, options: FrameOptions) -> int:
        """Number of pulses of a chunk."""
        # The option counts rays, since they take the memory; a chunk counts pulses.
        chunk = max(1, blocks.lanes_per_chunk(options.chunk) // self._rays_of_pulse)
        # Whole bands of tiles, or whole packets: so the same rays are traced together whatever the option says. Where a
        # ray meets the edge of two triangles, which of them it meets depends on the rays beside it.
        step = self.numbering.step
        return max(step, chunk - chunk % step)

    @property
    def _rays_of_pulse(self) -> int:
        return max(self.trace.rays, self.trace.background_rays or 1)

    def _started_together(self, options: FrameOptions, frames: int) -> Launch | None:
        """Start the first of the frames that follow each other, with as many of the others as are worth it.

        None where the first has a mistake, or the vehicle is in another piece of the scene then.
        """
        chunk, launch = self._chunk_pulses(options), blocks.lanes_per_launch() // self._rays_of_pulse
        limit, best = (max(pulses // self.sensor.scanner.pulses, 1) for pulses in (chunk, min(chunk, launch)))
        # Launches are alike: a few frames more cost less than a launch for the last of them.
        most = math.ceil(frames / max(round(frames / best), math.ceil(frames / limit), 1))
        numbers = range(options.number, options.number + (most if self.numbering.goes_together else 1))
        following, starts_s = [replace(options, number=number) for number in numbers], list[float]()
        with suppress(InputError):  # raised when that frame is rendered
            for own in following:
                starts_s.append(self.start_s(own))
        pieces = pieces_of(self.scene, starts_s)
        here = list(itertools.takewhile(lambda pair: pair[1] == self._piece, zip(following, pieces, strict=False)))
        if not here:
            return None
        following = [own for own, _ in here]
        together = list[tuple[FrameOptions, Frame]]()
        with suppress(InputError):
            for own, frame in zip(following, self._frames(following), strict=True):
                self._check_clearance(frame.place, frame.start_s, standing=frame.standing())
                first = together[0][1] if together else frame
                if not frame.goes_with(first):
                    break
                if is_far(frame.goal(options.coordinates)) != is_far(first.goal(options.coordinates)):
                    break
                together.append((own, frame))
        return self._started(together, together[0][1].first_pulse) if together else None

    def _started(self, frames: Sequence[tuple[FrameOptions, Frame]], first: int) -> Launch:
        """Start several frames, or the chunk of one that begins at pulse ``first``."""
        options, frame = frames[0]
        count = min(self._chunk_pulses(options), frame.first_pulse + len(frames) * self.sensor.scanner.pulses - first)
        pulses = self.numbering.pulses(frame, first, count)
        run = frame.on_device(*(later for _, later in frames[1:]))
        blocks.share_frame(count * self.trace.rays)
        part = self._chain(run, pulses, run.seed_words(self._seed(options)), survey=self._stages.surveys)
        return Launch(frames, run, replace(part, order=pulses.order))

    def _trace_continuing(self, frame: Frame, part: Chunk, seed: Seed, frames: int) -> list[Chunk]:
        """Trace the pulses of a chunk whose light goes on, past panes or to other channels, once more and in full.

        Args:
            frames: number of the frames in the chunk

        Returns:
            the chunk without them, and them; the chunk alone without any
        """
        if part.goes_on is None:
            return [part]
        parts = [part]
        alone = part.goes_on if part.leaks is None else part.goes_on & ~part.leaks
        if (lanes := kept_lanes.lanes_where(alone)) is not None:
            if frames > 1:
                lanes = kept_lanes.in_packets(lanes, self.numbering.frame_lanes, LANES)
            lines, known = self._stages.crosstalk is None, self._stages.known_hits(part.paths[0])
            parts.append(self._traced_again(frame, part, (lanes, alone), seed, lines=lines, known=known))
        if part.leaks is None:
            return parts
        # Channels that see each other's light are traced together: all pulses of the lines concerned.
        whole = self.numbering.whole
        leaking = np.concatenate([traced.pulse.numpy()[traced.leaks.numpy()] for traced in parts]) // whole
        if not len(leaking):
            return parts
        numbers = part.pulse.numpy()
        again = np.flatnonzero(np.isin(numbers // whole, leaking))
        lanes = transfer.unsigned_numbers(again[np.argsort(numbers[again])])
        parts = [without_lanes(traced, np.isin(traced.pulse.numpy() // whole, leaking)) for traced in parts]
        in_lines = parts[0].goes_on
        # The pulses of panes in these lines are traced a third time, which replaces the second. Rays at an edge of two
        # faces meet, among others than in the survey, either; all of a line ask again.
        for number, traced in enumerate(parts[1:], start=1):
            assert traced.retraced is not None
            outside = traced.retraced.mask & ~in_lines
            transfer.start([outside])  # as `without_lanes` does
            parts[number] = replace(traced, retraced=replace(traced.retraced, mask=outside))
        return [*parts, self._traced_again(frame, part, (lanes, in_lines), seed, lines=True)]

    def _traced_again(
        self,
        frame: Frame,
        part: Chunk,
        chosen: tuple[DeviceArray, Mask],
        seed: Seed,
        *,
        lines: bool,
        known: tuple[Array, ...] = (),
    ) -> Chunk:
        """Trace the chosen lanes of a chunk, and the mask (n,) of them, in full.

        Args:
            lines: as in `Stages.chain`
            known: `Stages.known_hits` of the chunk
        """
        lanes, mask = chosen
        several = kept_lanes.more_than_one(lanes)
        retraced = kept_lanes.Retraced.from_lanes(several, mask)
        pulse, met = retraced.pulses(part.pulse, known)
        blocks.share_out(len(pulse) * self.trace.rays)
        traced = self._chain(frame, self.numbering.chosen(frame, pulse), seed, lines=lines, met=met)
        transfer.wait()
        blocks.rest()
        return replace(traced, retraced=retraced, twice=several is not lanes)

    @exclusive
    def waveforms(
        self,
        pulses: Sequence[int],
        times_s: Numbers | None = None,
        frame: FrameOptions | None = None,
        **options: Unpack[FrameKeywords],
    ) -> Waveforms:
        """Power on the detector and its signal against time, without noise, of chosen pulses of a frame.

        Args:
            pulses: numbers within the frame, 0 for its first pulse; the result has them in rising order
            times_s: (times,) after the pulse left; if None the converter's window in sixteenths of the pulse's width
            frame: as for `render`; coordinates and chunk change nothing here
            options: as for `render`; coordinates and chunk change nothing here

        Raises:
            InputError: for a number that no pulse has
        """
        frame_options, _ = _resolve_options(frame, None, options)
        current_frame = self._traced_frame(frame_options).on_device()
        chosen = check_pulses(pulses, self.sensor)
        seed_words = current_frame.seed_words(self._seed(frame_options))

        def train_of(first: int, count: int) -> EchoTrain:
            return self._train(current_frame, first, count, seed_words)

        pulse = chosen + current_frame.first_pulse
        return sample_waveforms(
            train_of,
            pulse,
            self.sensor,
            times_s,
            pulse_in_run=current_frame.pulses_in_run(pulse),
            seed=(self._seed(frame_options), current_frame.rollover),
        )

    @exclusive
    def light(self, frame: FrameOptions | None = None, **options: Unpack[FrameKeywords]) -> EchoTrain:
        """All that comes back of each pulse of a frame, before any detector; NumPy arrays.

        It depends on poses, surfaces and light, and is proportional to the laser's power: traced once, it serves any
        receiver.

        Args:
            frame: as for `render`; coordinates and chunk change nothing here
            options: as for `render`; coordinates and chunk change nothing here
        """
        frame_options, _ = _resolve_options(frame, None, options)
        current_frame = self._traced_frame(frame_options).on_device()
        seed_words = current_frame.seed_words(self._seed(frame_options))
        return self._train(current_frame, current_frame.first_pulse, self.sensor.scanner.pulses, seed_words)

    def _train(self, frame: Frame, first: int, count: int, seed: Seed) -> EchoTrain:
        """All that comes back of ``count`` pulses from ``first`` on, in firing order; NumPy arrays."""
        # Channels that see each other's light are traced together, and those that were not asked for are left out.
        whole = self.numbering.whole
        before = first % whole
        traced = -(-(before + count) // whole) * whole
        blocks.share_frame(traced * self.trace.rays)
        pulses = self.numbering.chosen(frame, transfer.counter(first - before, traced))
        train = cast(EchoTrain, transfer.fetch(self._stages.pulse_train(frame, pulses, seed)))
        return train if traced == count else train.part(before, count, of=traced)

    def _columns(self, frame: Frame, parts: Sequence[Chunk], placing: Placing) -> DeviceColumns:
        """Kept points of a chunk, sorted by pulse and then by return."""
        surveyed = parts[0]
        blocks.share_out(len(surveyed.pulse))
        lane_of = None if surveyed.order is None else surveyed.order.device_lane
        again = [(part.retraced, part) for part in parts[1:] if part.retraced is not None]
        lane, stop, count = kept_lanes.reported_lanes(
            surveyed.detection, lane_of, again=[(retraced, part.detection) for retraced, part in again]
        )
        # First of all, since it waits for the device.
        replaced = [(part, retraced.among(lane, stop, stops=len(part.detection.stops))) for retraced, part in again]
        on_device = partial(self._on_device, frame, placing)
        # Columns of all returns as the survey has them. Those of pulses that were traced again are replaced. A single
        # point is there twice (`kept_lanes.more_than_one`): the count leaves the copy out.
        later = ((on_device(part, returns[1]), returns[0]) for part, returns in replaced if returns is not None)
        first = on_device(surveyed, (lane, stop))
        blocks.share_out(count)
        columns = start_columns(first, count, later)
        # Of a card only what NumPy needs in any case; on a CPU nothing is copied.
        return columns.fetch(READ_COLUMNS if backend.is_cuda() else None)

    def _on_device(self, frame: Frame, placing: Placing, part: Chunk, lanes: tuple[Any, Any]) -> dict[str, Any]:
        """`collect.point_columns` of these lanes and stops of one part, on the device."""
        return collect.point_columns(
            world=self.world,
            sensor=self._stages.at_phase(frame.phase).sensor,
            staged=part.staged(self.trace.rays),
            air_classes=self._air_classes,
            lanes=lanes,
            placing=placing.of_pulses,
        )

    def _surfaces(self, launch: Launch, frame: Frame, numbers: range) -> dict[str, Numbers]:
        """`collect.surface_columns` of the pulses of these numbers in NumPy; empty without any surface."""
        if launch.surfaces is None:
            launch.surfaces = join_columns([self._surfaces_of_part(part) for part in launch.parts])
        if not launch.surfaces or (rows := rows_of(launch.surfaces["pulse"], numbers)).start == rows.stop:
            return {}
        surfaces = {name: values[rows] for name, values in launch.surfaces.items()}
        if frame.bodies is not None:
            surfaces["body"] = frame.bodies[surfaces["body"]]
        return surfaces | {"pulse": frame.pulses_in_run(surfaces["pulse"])}

    def _surfaces_of_part(self, part: Chunk) -> dict[str, Numbers]:
        surfaces = collect.surface_columns(world=self.world, staged=part.staged(self.trace.rays), twice=part.twice)
        if surfaces is None:
            return {}
        columns, count = surfaces
        return {name: values[:count] for name, values in transfer.fetch_columns(columns).items()}

    def _frame(self, options: FrameOptions) -> Frame:
        (frame,) = self._frames([options])
        self._check_clearance(frame.place, frame.start_s, standing=frame.standing())
        return frame

    def _frames(self, options: Sequence[FrameOptions]) -> list[Frame]:
        """Frames of these options, which differ in number only; no clearance is checked."""
        return Frame.from_options(self.scene, self.sensor, self.world, options, pose=options[0].pose or self.pose)

    def _started_frame(self, options: FrameOptions) -> Frame | None:
        """Frame of these options that the device has already; None without one."""
        frames = (launch.frame_of(options) for launch in (self._traced, self._begun) if launch is not None)
        return next((frame for frame in frames if frame is not None), None)

    def _traced_frame(self, options: FrameOptions) -> Frame:
        """Frame of these options, in the piece of the scene that is compiled then."""
        if (started := self._started_frame(options)) is not None:
            return started
        (piece,) = pieces_of(self.scene, [self.start_s(options)])
        if piece != self._piece:
            self._piece = piece
            vars(self)["world"] = self._build_world()
            self._prepare_stages()
        return self._frame(options)

    def _check_clearance(self, place: Pose, start_s: float, **standing: Any) -> None:
        """Raise InputError for a sensor on or in a surface; ``standing`` as for `Clearance.check`."""
        radius_m, sensor = float(self.sensor.housing_m), self.sensor.name
        self.clearance.check(place.position_m, radius_m=radius_m, time_s=start_s, sensor=sensor, **standing)

    def _description(self, frame: Frame, options: FrameOptions) -> dict[str, Any]:
        """Names and metadata of the frame's cloud."""
        return {
            "sensor_names": (self.sensor.name,),
            "body_names": self.world.body_names,
            "class_names": self.class_names,
            "material_names": self.world.material_names,
            "metadata": _metadata(self.scene, self.sensor, frame, replace(options, seed=self._seed(options))),
        }


def _in_numpy(columns: DeviceColumns) -> dict[str, Numbers] | None:
    """Columns of points in NumPy; None without points."""
    return columns.in_numpy() if columns.count else None


def _on_device(columns: DeviceColumns) -> DeviceColumns:
    """Columns as they are."""
    return columns


def _both(
    first: Callable[[PulseRays], object], second: Callable[[PulseRays], object] | None
) -> Callable[[PulseRays], object]:
    """Observer that calls two others."""
    return first if second is None else lambda rays: (first(rays), second(rays))


def _resolve_options(
    frame: FrameOptions | None, observers: Observers | None, options: Mapping[str, object]
) -> tuple[FrameOptions, Observers]:
    """Frame options and observers of a call, with its keywords put in."""
    keywords = Keywords(options)
    resolved = keywords.take(FrameOptions, frame), keywords.take(Observers, observers)
    keywords.end()
    return resolved


def _metadata(scene: Scene, sensor: Sensor, frame: Frame, options: FrameOptions) -> dict[str, str]:
    """Metadata of a frame's cloud: how it was made. The key `frame` holds the coordinates of its points."""
    from .._version import __version__

    metadata = {
        "software": "lidarscene",
        "version": __version__,
        "scene": scene.name,
        "sensor": sensor.name,
        "seed": str(options.seed),
        "intensity_unit": _intensity_unit(sensor),
        "frame": options.coordinates,
        "frame_number": str(frame.number),
        "frame_start_s": repr(frame.start_s),
        SENSOR_TO_WORLD: pose_text(frame.place),
        SENSOR_TO_VEHICLE: pose_text(frame.goal("vehicle")),
    }
    if sensor.driver:
        metadata["driver"] = sensor.driver
    if sensor.ring_rows is not None:
        metadata[RING_ROWS] = " ".join(map(str, sensor.ring_rows.tolist()))
    if frame.moves:
        metadata["ego_motion"] = MOTION_KEPT
    if options.coordinates != "sensor":
        goal = frame.goal(options.coordinates)
        metadata["sensor_position_m"] = numbers_text(goal.position_m)
        metadata["sensor_rotation"] = numbers_text(goal.rotation)
    return metadata


def _intensity_unit(sensor: Sensor) -> str:
    """Unit of the column `intensity`."""
    if sensor.intensity is not None:
        return {"range_corrected": "W", "reflectivity": "of 255"}[sensor.intensity.kind]
    return sensor.detector.unit
