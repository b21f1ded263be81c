"""Write point clouds for the Rerun viewer: a file of a whole drive (`.rrd`), or live to a viewer that runs.

All is on one timeline, `scene_time`: the scene's clock as a date. In the frame `world` are the vehicle (`vehicle`, a
transform for each frame), its way so far (`vehicle_path`) and boxes (`boxes`). Each sensor is fixed to the vehicle
(`lidar`, or its label). It has its points in its own frame, coloured by class where that is known, with all columns
beside, and its range images. IMUs are six curves.
"""

from __future__ import annotations

import errno
import os
import shutil
import socket
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ..errors import LidarSceneError
from ..files.atomic import atomic_output
from ..files.optional import import_optional
from ..maths.arrays import Numbers
from ..maths.pose import Pose
from ..maths.rotations import quaternion
from ..sensor.imu import ImuSamples
from .clock import default_epoch_ns, stamp_ns
from .cloud_columns import Cloud, sensor_positions_m
from .cloud_description import description, is_new_place, library_errors

TIMELINE, WORLD, VEHICLE, LIDAR = "scene_time", "world", "world/vehicle", "lidar"

HOST, PORT = "127.0.0.1", 9876
"""Where a viewer listens that was started by `rerun`."""

PATIENCE_S = 1.0
"""Choice: time limit for a viewer of this machine to take a connection."""

LONGEST_FLUSH_S = 120.0
"""Choice: time limit for the viewer to take what was sent."""

PROBE_BYTES = 1 << 16
"""Bytes that the disk must have room for before a log is begun, and besides its points before each frame."""


class LabelledBox(Protocol):
    """Box of a body in the world: `labels.boxes.Box`."""

    @property
    def name(self) -> str:
        """Name of the body."""

    @property
    def class_name(self) -> str:
        """Class of the body."""

    @property
    def size_m(self) -> Numbers:
        """(3,) length, width, height."""

    @property
    def pose(self) -> Pose:
        """Pose of the centre."""


@contextmanager
def rerun_frames(path: str | os.PathLike[str], *, epoch_ns: int | None = None) -> Iterator[RerunLog]:
    """Write a file of the clouds that are appended in the block.

    Args:
        epoch_ns: from 1970 to the scene's second 0; None: `formats.clock.default_epoch_ns` of the first cloud
    """
    rerun = import_optional("rerun", extra="rerun")
    with atomic_output(path) as temporary:
        # Rerun's own thread may wait for ever where it has no room: `RerunLog` asks for it before each frame.
        temporary.write_bytes(bytes(PROBE_BYTES))
        with library_errors(path):
            # The same name has the same recording, so that a viewer replaces what it shows of it.
            stream = rerun.RecordingStream("lidarscene", recording_id=uuid.uuid5(uuid.NAMESPACE_URL, Path(path).name))
            stream.save(temporary)
        log = RerunLog(path, stream, epoch_ns, folder=temporary.parent)
        yield log
        log.flush()
        stream.disconnect()


@contextmanager
def rerun_live(*, epoch_ns: int | None = None) -> Iterator[RerunLog]:
    """Send the clouds that are appended in the block to the viewer of this machine."""
    require_viewer()
    stream = import_optional("rerun", extra="rerun").RecordingStream("lidarscene")
    address = f"rerun+http://{HOST}:{PORT}/proxy"
    with library_errors(address):
        stream.connect_grpc(address)
    log = RerunLog(address, stream, epoch_ns)
    yield log
    log.flush()
    stream.disconnect()


def require_viewer() -> None:
    """Raise LidarSceneError, in one line, if Rerun is missing or no viewer runs."""
    import_optional("rerun", extra="rerun")
    try:
        socket.create_connection((HOST, PORT), timeout=PATIENCE_S).close()
    except OSError as error:
        raise LidarSceneError(
            f"no Rerun viewer listens at {HOST}:{PORT} ({error.strerror or error}); start one with the command: rerun"
        ) from None


class RerunLog:
    """Open log: a function that appends clouds."""

    def __init__(
        self, path: str | os.PathLike[str], stream: Any, epoch_ns: int | None, *, folder: Path | None = None
    ) -> None:
        """Begin a log of a stream; ``folder`` is that of its file, if it has one."""
        self._rerun = import_optional("rerun", extra="rerun")
        self._path, self._stream, self._epoch_ns, self._folder = path, stream, epoch_ns, folder
        self._mountings: dict[str, Pose] = {}
        self._colours: dict[str, int] = {}
        self._way_m: list[list[float]] = []
        self._stamps: set[int] = set()
        with library_errors(path):
            stream.log(WORLD, self._rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def __call__(
        self,
        cloud: Cloud,
        label: str = "",
        *,
        boxes: Sequence[LabelledBox] = (),
        images: Mapping[str, Numbers] | None = None,
    ) -> None:
        """Append a frame of the sensor with this label; "" without a rig, and for merged clouds.

        Args:
            boxes: boxes of bodies in the world
            images: images by ring and azimuth by name; "range" is in metres
        """
        with library_errors(self._path):
            self._set_time(cloud.frame_start_s)
            self._append_points(cloud, label)
            if boxes:
                self._append_boxes(boxes)
            for name, image in (images or {}).items():
                self._append_image(f"images/{label or LIDAR}/{name}", name, image)
        self.flush()

    def flush(self) -> None:
        """Wait until everything is written or sent.

        Raises:
            OutputError: if a result cannot be written
        """
        with library_errors(self._path):
            self._stream.flush(timeout_sec=LONGEST_FLUSH_S)

    def append_imu(self, samples: ImuSamples, *, label: str, mounting: Pose) -> None:
        """Append samples of the IMU with this label; ``mounting`` is its pose on the vehicle."""
        entity = f"imu/{label or 'vehicle'}"
        with library_errors(self._path):
            self._append_mounting(f"{VEHICLE}/{'_'.join(filter(None, (label, 'imu')))}", mounting)
            curves = {"angular_velocity_rad_s": samples.angular_velocity_rad_s}
            curves["specific_force_m_s2"] = samples.specific_force_m_s2
            for row, time_s in enumerate(samples.time_s.tolist()):
                self._set_time(time_s)
                for name, values in curves.items():
                    self._stream.log(f"{entity}/{name}", self._rerun.Scalars(values[row]))

    def _set_time(self, time_s: float) -> None:
        if self._epoch_ns is None:
            self._epoch_ns = default_epoch_ns(time_s)
        self._stream.set_time(TIMELINE, timestamp=np.datetime64(stamp_ns(time_s, self._epoch_ns), "ns"))

    def _append_points(self, cloud: Cloud, label: str) -> None:
        """Append the points in the frame of their sensor, or of the world if there are several."""
        rerun, name = self._rerun, label or LIDAR
        entity = f"{VEHICLE}/{name}"
        self._stream.log(f"about/{name}", rerun.TextDocument(description(cloud)), static=True)
        if len(sensor_positions_m(cloud.metadata)) > 1:
            entity, place = f"{WORLD}/{name}", cloud.frame_to_world
            if place is not None:
                self._stream.log(entity, self._transform(place))
        else:
            cloud = cloud.in_sensor_frame()
            if cloud.vehicle_to_world is not None:
                self._append_mounting(entity, cloud.sensors_to_vehicle[0])
            elif cloud.sensor_to_world is not None:  # of a recording, which knows no vehicle
                self._stream.log(entity, self._transform(cloud.sensor_to_world))
        if cloud.vehicle_to_world is not None:
            self._append_vehicle(cloud.vehicle_to_world, cloud.frame_start_s)
        points = rerun.Points3D(cloud.xyz_m.astype(np.float32), colors=self._point_colours(cloud))
        columns = {column.name: cloud.column(column.name) for column in cloud.columns if column.name not in "xyz"}
        beside = [rerun.AnyValues(**columns)] if len(cloud) else []  # none may be empty
        size = PROBE_BYTES + cloud.xyz_m.nbytes + sum(column.nbytes for column in columns.values())
        if self._folder is not None and shutil.disk_usage(self._folder).free < size:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._stream.log(f"{entity}/points", points, *beside)

    def _append_vehicle(self, pose: Pose, start_s: float) -> None:
        """Append the vehicle's pose and its way, once for sensors whose frames begin together."""
        stamp = stamp_ns(start_s, self._epoch_ns or 0)
        if stamp in self._stamps:
            return
        self._stamps.add(stamp)
        self._stream.log(VEHICLE, self._transform(pose))
        self._way_m.append(pose.position_m.tolist())
        self._stream.log(f"{WORLD}/vehicle_path", self._rerun.LineStrips3D([self._way_m]))

    def _append_mounting(self, entity: str, mounting: Pose) -> None:
        """Append the place of a sensor or an IMU on the vehicle, once.

        Raises:
            InputError: for an entity that has another place already
        """
        if is_new_place(self._mountings, entity, mounting, where=f"{os.fspath(self._path)}: {entity}"):
            self._stream.log(entity, self._transform(mounting), static=True)

    def _append_boxes(self, boxes: Sequence[LabelledBox]) -> None:
        rerun = self._rerun
        turns = [quaternion(box.pose.rotation) for box in boxes]
        archetype = rerun.Boxes3D(
            half_sizes=[0.5 * box.size_m for box in boxes],
            centers=[box.pose.position_m for box in boxes],
            quaternions=[rerun.Quaternion(xyzw=(x, y, z, w)) for w, x, y, z in turns],
            colors=[self._class_colour(box.class_name) for box in boxes],
            labels=[box.name for box in boxes],
        )
        values = rerun.AnyValues(class_name=[box.class_name for box in boxes])
        self._stream.log(f"{WORLD}/boxes", archetype, values)

    def _append_image(self, entity: str, name: str, image: Numbers) -> None:
        rerun = self._rerun
        if name == "range":
            self._stream.log(entity, rerun.DepthImage(image.astype(np.float32), meter=1.0))
        else:
            self._stream.log(entity, rerun.Tensor(image, dim_names=("ring", "azimuth")))

    def _transform(self, pose: Pose) -> Any:
        return self._rerun.Transform3D(translation=pose.position_m, mat3x3=pose.rotation)

    def _point_colours(self, cloud: Cloud) -> Numbers:
        """(n, 3) uint8: the class's colour, or a grey by the intensity."""
        if cloud.has_truth and cloud.class_names:
            table = np.array([*(self._class_colour(name) for name in cloud.class_names), NO_CLASS], np.uint8)
            return np.asarray(table[np.asarray(cloud.class_id)])
        # Intensities span decades: their ranks show all of them.
        ranks = np.argsort(np.argsort(cloud.intensity, kind="stable")) * (200.0 / max(len(cloud) - 1, 1))
        return np.repeat((55.0 + ranks).astype(np.uint8)[:, None], 3, axis=1)

    def _class_colour(self, name: str) -> tuple[int, int, int]:
        """Colour of a class: as far from those before as the golden angle takes it."""
        number = self._colours.setdefault(name, len(self._colours))
        hue = (0.12 + 0.618034 * number) % 1.0
        # Red, green and blue by how far the hue is from each of them, on a circle of 1.
        distances = [abs((hue - place + 0.5) % 1.0 - 0.5) for place in (0.0, 1.0 / 3.0, 2.0 / 3.0)]
        red, green, blue = (round(255 * (0.25 + 0.75 * min(max(2.0 - 6.0 * d, 0.0), 1.0))) for d in distances)
        return red, green, blue


NO_CLASS = (90, 90, 90)
