"""Motion of a run: what its IMUs measure and where its sensors stood, from the first frame to the last.

The noise of an IMU is one process over all frames, so samples are made once for the run and handed out in parts.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import OptionError
from ..formats.motion_files import write_imu, write_poses
from ..formats.ros import TRANSFORM_HZ
from ..maths.arrays import Numbers
from ..maths.pose import Pose
from ..maths.trajectory import Course, Motion, Riding, pose_at
from ..rendering.frame import check_frame
from ..rendering.render_options import FrameOptions
from ..rendering.simulator import Simulator
from ..scene.scene import Scene
from ..sensor.imu import Imu, ImuSamples
from ..sensor.rig_file import Rig


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImuTrack:
    """Samples of one IMU.

    Attributes:
        label: label of its sensor; "" without a rig, and of the vehicle's own
        on_vehicle: pose of the IMU on the vehicle
    """

    label: str
    samples: ImuSamples
    on_vehicle: Pose


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RunMotion:
    """Motion of all sensors of a run.

    Attributes:
        starts_s: label of each sensor -> (frames,) starts of its frames by the scene's clock
        tracks: samples of its IMUs
    """

    scene: Scene
    simulators: Mapping[str, Simulator]
    starts_s: Mapping[str, Numbers]
    tracks: Sequence[ImuTrack]

    @classmethod
    def of_run(
        cls,
        scene: Scene,
        simulators: Mapping[str, Simulator],
        frame: FrameOptions,
        frames: int,
        *,
        rig: Rig | None = None,
        with_imus: bool = True,
    ) -> RunMotion:
        """Sample all IMUs from the start of the first of these frames to the end of the last."""
        numbers = range(frame.number, frame.number + frames)
        starts_s, ends_s = {}, []
        for label, simulator in simulators.items():
            edges = [
                check_frame(scene, simulator.sensor.scanner, number=number, begin_s=frame.begin_s) for number in numbers
            ]
            starts_s[label] = np.array([frame.begin_s + first_s for first_s, _ in edges])
            ends_s.append(float(starts_s[label][-1] + simulator.sensor.scanner.frame_s))
        begin_s = min(float(times[0]) for times in starts_s.values())
        tracks = []
        for label, imu, mounting in _imus(simulators, rig, frame) if with_imus else ():
            # Each IMU has noise of its own, the same whatever other sensors there are.
            rng = np.random.default_rng([frame.seed, zlib.crc32(label.encode())])
            times_s = imu.times_s(begin_s, max(ends_s))
            samples = imu.measure(Riding(carrier=scene.ego or Course(), pose=mounting), times_s, rng)
            tracks.append(ImuTrack(label=label, samples=samples, on_vehicle=mounting @ imu.pose))
        return cls(scene=scene, simulators=simulators, starts_s=starts_s, tracks=tracks)

    def parts(self, labels: Sequence[str], index: int) -> Iterator[tuple[ImuTrack, ImuSamples]]:
        """Yield the IMUs of these sensors, and their samples until the next frame; the vehicle's with the first.

        Args:
            index: of the frame within the run
        """
        first = next(iter(self.simulators))
        for track in self.tracks:
            is_vehicle = track.label not in self.simulators
            if track.label in labels or (is_vehicle and first in labels):
                starts_s = self.starts_s[first if is_vehicle else track.label]
                start_s = -np.inf if index == 0 else starts_s[index]
                end_s = starts_s[index + 1] if index + 1 < len(starts_s) else np.inf
                yield track, track.samples.between(float(start_s), float(end_s))

    def vehicle_poses(self, label: str, index: int) -> tuple[list[float], list[Pose]]:
        """Times by the scene's clock and poses of the vehicle from the start of a sensor's frame to that of the next.

        They are `formats.ros.TRANSFORM_HZ` a second, those of the last frame to where the last sensor's ends; none
        where the vehicle never moves, and for the sensors of a rig after its first.

        Args:
            index: of the frame within the run
        """
        ego, starts_s = self.scene.ego, self.starts_s[label]
        if label != next(iter(self.simulators)):
            return [], []
        if index + 1 < len(starts_s):
            end_s = float(starts_s[index + 1])
        else:
            end_s = max(
                float(self.starts_s[name][-1]) + simulator.sensor.scanner.frame_s
                for name, simulator in self.simulators.items()
            )
        return poses_between(ego, float(starts_s[index]), end_s)

    def write_imu(self, path: Path, label: str, epoch_ns: int) -> None:
        """Write the samples of the IMU with this label."""
        track = next(track for track in self.tracks if track.label == label)
        write_imu(path, track.samples, epoch_ns=epoch_ns)

    def write_poses(self, path: Path, label: str, epoch_ns: int) -> None:
        """Write the sensor's pose in the world at the start of each frame; "" of a rig: the vehicle's."""
        single = label in self.simulators
        times_s = self.starts_s[label if single else next(iter(self.simulators))]
        motion: Motion = self.simulators[label].motion if single else self.scene.ego or Course()
        poses = [pose_at(motion, time_s) for time_s in times_s.tolist()]
        write_poses(path, times_s.tolist(), poses, epoch_ns=epoch_ns)


def poses_between(ego: Motion | None, start_s: float, end_s: float) -> tuple[list[float], list[Pose]]:
    """Times from a start to an end [s], `TRANSFORM_HZ` a second, and poses of a vehicle; none without one.

    The end is one of them: a reader of `/tf` finds no pose later than the last.
    """
    times_s = [] if ego is None else [*np.arange(start_s, end_s - 1e-9, 1.0 / TRANSFORM_HZ).tolist(), end_s]
    return times_s, [pose_at(ego, time_s) for time_s in times_s if ego is not None]


def imu_labels(sensors: Mapping[str, bool], rig: Rig | None) -> list[str]:
    """Labels of the IMUs of a run: the vehicle's "" first.

    Args:
        sensors: label of each sensor -> whether it has an IMU

    Raises:
        OptionError: where there is none, for a run that is to write one
    """
    labels = [""] if rig is not None and rig.imu is not None else []
    labels += [label for label, has_imu in sensors.items() if has_imu]
    if not labels:
        owner = "rig or one of its sensors" if rig is not None else "sensor"
        raise OptionError("{imu}: the {0} must have an [imu], as {overrides} imu.model=bmi088 gives it", owner)
    return labels


def _imus(simulators: Mapping[str, Simulator], rig: Rig | None, frame: FrameOptions) -> Iterator[tuple[str, Imu, Pose]]:
    """Yield label, IMU, and pose on the vehicle of what it is fixed to."""
    if rig is not None and rig.imu is not None:
        yield "", rig.imu, frame.pose or Pose()
    for label, simulator in simulators.items():
        if simulator.sensor.imu is not None:
            yield label, simulator.sensor.imu, simulator.pose @ simulator.sensor.mounting
