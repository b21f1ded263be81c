"""FrameFiles: simulators of one frame in, all of its files out.

A frame may be larger than the memory. So everything that can be written chunk by chunk is written while the frame is
traced, and one pass over the points serves all files.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from ..cloud.pixels import Camera
from ..cloud.point_cloud import PointCloud
from ..cloud.rays import PulseRays
from ..cloud.rig_clouds import Merging
from ..cloud.thinning import Thinned
from ..files.atomic import name_path_in_errors
from ..formats.packets.firings import FiringsBuilder
from ..kernel.rays.camera_distances import distances_m
from ..labels.files import labels_stream
from ..labels.point_rows import DeviceRows, PointRows
from ..maths.arrays import Numbers
from ..maths.trajectory import Course, pose_at
from ..rendering.frame_summary import Summary
from ..rendering.render_options import FrameOptions, Observers
from ..rendering.simulator import Simulator
from ..scene.scene import Scene, View
from ..sensor.imu import ImuSamples
from .closing import Closing
from .light import AmbientImage, write_waveforms
from .plan import Plan
from .range_image import range_image_stream
from .streams import (
    Append,
    Capture,
    cloud_stream,
    dataset_stream,
    missed_stream,
    rerun_stream,
    row_reader,
    trace_stream,
    waveform_pulses,
)

Change = Callable[[int, PointCloud], PointCloud]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameFiles:
    """One frame of one sensor, or of several whose clouds are merged.

    Attributes:
        simulators: label of the sensor -> its simulator
        files: key of `Plan.files` -> path to write
        placed: whether the sensor has another pose than the scene's
        capture: open file of the sensor's packets, which replace the cloud; None: a cloud is written
        bags: file that holds several frames -> function that appends a cloud to it
        live: function that appends a cloud to a viewer, or None
        epoch_ns: from 1970 to the scene's second 0, for packets
        imu: samples of the sensor's IMU until the next frame, for packets, or None
        frames: number of frames of the run from this one on
        ahead: called once the device has done its part of the frame: time to begin the next one
        closing: writes and completes the files while the next frame is traced; None: they are complete when the frame
            is
    """

    plan: Plan
    scene: Scene
    simulators: Mapping[str, Simulator]
    frame: FrameOptions
    files: Mapping[str, Path]
    placed: bool
    summary: Summary
    capture: Capture | None = None
    bags: Mapping[Path, Append] = field(default_factory=dict)
    live: Append | None = None
    epoch_ns: int = 0
    imu: ImuSamples | None = None
    frames: int = 1
    ahead: Callable[[], None] | None = None
    closing: Closing | None = None

    def write(self, progress: Callable[[int, int], object] | None) -> None:
        """Trace the frame into its files; ``progress`` is called with (done, pulses) of each sensor."""
        picture = Thinned() if "picture" in self.files else None
        ambient = AmbientImage() if "ambient" in self.files else None
        packets = self._packets()
        rays: list[PulseRays] | None = [] if "keep_rays" in self.files else None
        kept: list[Callable[[], None]] = []
        with ExitStack() as opened:
            takers = opened.enter_context(self._takers(picture, packets))
            if self.closing is not None and picture is None:
                takers = [_keeper(kept, take) for take in takers]
            for number, (simulator, take) in enumerate(zip(self._simulators, takers, strict=True), start=1):
                later = self._simulators[number:]
                ahead = partial(later[0].begin, self.frame, self.frames) if later else self.ahead
                with self._missed(simulator) as missed:
                    observers = Observers(
                        progress=progress,
                        missed=missed,
                        ambient=self._ambient(ambient, packets),
                        pulses=None if rays is None else rays.append,
                        summary=self.summary,
                    )
                    simulator.stream(take, self.frame, observers, ahead=ahead, read=self._reader(simulator))
            since = time.perf_counter()
            if self.closing is not None:
                opened.callback(lambda: [take() for take in kept])
                self.closing(opened)
        if self.capture is not None and packets is not None:
            self.capture.take(packets.firings())
        if ambient is not None:
            ambient.save(self.files["ambient"], simulator.sensor)
        if rays is not None:
            PulseRays.concatenate(rays).save(self.files["keep_rays"])
        if "waveforms" in self.files:
            chosen = waveform_pulses(self.plan.outputs, simulator.sensor)
            write_waveforms(self.files["waveforms"], simulator.waveforms(chosen, frame=self.frame))
        since = self.summary.add_time("write", since)
        if picture is not None:
            self._draw(picture)
            self.summary.add_time("picture", since)

    def _reader(self, simulator: Simulator) -> DeviceRows | None:
        """Reader of the rows of points for files that need no more of them; None: clouds are read."""
        if self.live is not None or not self.files.keys().isdisjoint(("range_image", "picture")):
            return None
        outputs = self.plan.outputs
        return row_reader(simulator, self.frame, outputs.dataset, deskew=outputs.is_deskewed, own_car=outputs.own_car)

    def _packets(self) -> FiringsBuilder | None:
        """Builder of the firings that packets are made of; None without packets."""
        if self.capture is None:
            return None
        return FiringsBuilder(self._simulators[0].sensor, self.frame.number, epoch_ns=self.epoch_ns, imu=self.imu)

    def _ambient(
        self, image: AmbientImage | None, packets: FiringsBuilder | None
    ) -> Callable[[Numbers, Numbers], None] | None:
        """One observer that hands the background to every output that needs it; None without any."""
        sinks: list[Callable[[Numbers, Numbers], None]] = [] if image is None else [image]
        if packets is not None and self.capture is not None and self.capture.needs_ambient:
            sinks.append(packets.ambient)

        def observe(pulse: Numbers, counts: Numbers) -> None:
            for sink in sinks:
                sink(pulse, counts)

        return observe if sinks else None

    @property
    def _simulators(self) -> Sequence[Simulator]:
        return list(self.simulators.values())

    def _missed(self, simulator: Simulator) -> AbstractContextManager[Callable[..., None] | None]:
        if "missed" not in self.files:
            return nullcontext()
        return _naming_file(self.files["missed"], missed_stream(self.files["missed"], simulator.sensor))

    @contextmanager
    def _takers(self, picture: Thinned | None, packets: FiringsBuilder | None) -> Iterator[Sequence[Append]]:
        """Functions that take the points of each simulator; their files are complete when the block ends."""
        with ExitStack() as opened:
            # Points take two routes: as they were seen, and without the sensor's motion. One without files is dropped.
            raw, deskewed = (
                [opened.enter_context(_naming_file(path, stream)) for path, stream in streams]
                for streams in (self._streams("output"), self._streams("deskewed"))
            )
            if picture is not None:
                raw.append(picture.append)
            if packets is not None:
                raw.append(packets.add)
            routes = [route for route in ((self._as_seen(), raw), (self._deskewed(), deskewed)) if route[1]]
            if self.plan.outputs.merge:
                routes = [(self._merged(change), appended) for change, appended in routes]

            def taker(number: int) -> Append:
                def take(cloud: PointCloud | PointRows) -> None:
                    for change, appended in routes:
                        piece = cloud if isinstance(cloud, PointRows) else change(number, cloud)
                        for append in appended:
                            append(piece)

                return take

            yield [taker(number) for number in range(len(self.simulators))]

    def _streams(self, key: str) -> Iterator[tuple[Path, AbstractContextManager[Append]]]:
        """Iterate over the files of raw or of deskewed clouds, and the streams that write them."""
        outputs = self.plan.outputs
        if outputs.dataset is not None:
            if key == ("deskewed" if outputs.is_deskewed else "output"):
                label = next(iter(self.simulators))
                in_turn = (lambda: None) if self.closing is None else self.closing.in_turn()
                stream = dataset_stream(outputs, label, self.frame.number, self.scene, in_turn=in_turn)
                yield self.files["output"], stream
        elif key in self.files and self.capture is None:
            points = sum(simulator.sensor.scanner.pulses * simulator.sensor.tdc.stops for simulator in self._simulators)
            path = self.files[key]
            if self.plan.format.boxes and path in self.bags:
                yield path, rerun_stream(outputs, path.parent, self.scene, self.bags[path])
            elif self.plan.has_truth:
                yield path, trace_stream(self.plan, path, self.scene, self.bags[path])
            else:
                yield path, cloud_stream(self.plan, path, points, bag=self.bags.get(path))
            if outputs.labels is not None and not self.plan.has_truth:
                path = self.files[f"{key}_labels"]
                cloud, all_around = self.files[key], outputs.all_around
                yield path, labels_stream(cloud, self.scene, format=outputs.labels, all_around=all_around)
        if key == "output" and self.live is not None:
            yield Path("--rrd"), rerun_stream(outputs, Path(tempfile.gettempdir()), self.scene, self.live)
        if key == "output" and "range_image" in self.files:
            yield self.files["range_image"], range_image_stream(self.files["range_image"])

    def _as_seen(self) -> Change:
        if self.plan.outputs.own_car:
            return lambda _, cloud: cloud
        return lambda _, cloud: cloud.without_bodies(self.scene.own_bodies)

    def _deskewed(self) -> Change:
        as_seen = self._as_seen()
        return lambda number, cloud: self._simulators[number].without_motion(as_seen(number, cloud), self.frame)

    def _merged(self, change: Change) -> Change:
        """Change of pieces that applies ``change`` and then makes them pieces of one merged cloud."""
        # Names and metadata are known before anything is traced, so that pieces can be merged one by one.
        empty_clouds = [simulator.empty(self.frame) for simulator in self._simulators]
        merging = Merging([change(number, cloud) for number, cloud in enumerate(empty_clouds)], list(self.simulators))
        return lambda number, cloud: merging.piece(number, change(number, cloud))

    def _draw(self, picture: Thinned) -> None:
        from ..figures.pictures import frame_picture

        view = self._view(picture.cloud().frame_start_s)
        # Colours distinguish several sensors: their intensities may be amperes and cells.
        colour_by = "sensor_index" if self.plan.outputs.merge else "intensity"
        frame_picture(picture, self.files["picture"], colour_by=colour_by, view=view, surfaces=self._surfaces)

    def _surfaces(self, camera: Camera, size: tuple[int, int]) -> Numbers:
        """Depth of the surfaces that a camera sees as the frame begins [m], (height, width)."""
        simulator = self._simulators[0]
        to_world = simulator.to_world(self.frame)
        directions, ahead = camera.rays(*size)
        distance_m = distances_m(
            simulator.world,
            to_world.apply(camera.eye_m),
            to_world.rotation.astype(np.float32) @ directions,
            time_s=simulator.start_s(self.frame),
        )
        return (distance_m * ahead).reshape(size[::-1])

    def _view(self, start_s: float) -> View | None:
        """View of the scene in the coordinates of the points; None where it does not apply to them."""
        # The file gives it relative to the vehicle, which stands at the world's origin unless it moves. It applies to
        # the scene's own sensor pose, or to any sensor on a vehicle that moves.
        coordinates, scene = self.frame.coordinates, self.scene
        if coordinates == "sensor" or (scene.ego is None and self.placed):
            return None
        if scene.camera is None or coordinates != "world":
            return scene.camera
        vehicle = pose_at(scene.ego or Course(), start_s)
        eye_m, target_m = vehicle.apply(np.array([scene.camera.eye_m, scene.camera.target_m])).tolist()
        return View(eye_m=tuple(eye_m), target_m=tuple(target_m), fov_deg=scene.camera.fov_deg)


def _keeper(kept: list[Callable[[], None]], take: Append) -> Append:
    """Return a function that keeps points until they are taken."""
    return lambda points: kept.append(partial(take, points))


@contextmanager
def _naming_file(path: Path, stream: AbstractContextManager[Callable[..., None]]) -> Iterator[Callable[..., None]]:
    """Wrap a stream so that errors raised while appending name its file."""
    with stream as take:
        yield name_path_in_errors(path, take)
