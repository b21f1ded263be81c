"""Sources of the page: clouds, a recording or a live scene, as blobs of a stage and its frames."""

from __future__ import annotations

import dataclasses
import functools
import json
import re
import shlex
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from .. import catalog
from ..cloud.deskew import MOTION_KEPT, deskewed
from ..cloud.pixels import camera_for
from ..cloud.point_cloud import PointCloud
from ..errors import InputError
from ..kernel.device import transfer
from ..kernel.rays.camera_distances import distances_m
from ..kernel.rays.point_columns import LARGEST_FLOAT32_M
from ..kernel.rays.retraced_light import LIGHT_COLUMNS, retraced_light
from ..kernel.world.mitsuba_world import World
from ..light.echoes import Ambient, Echoes
from ..maths.arrays import Numbers
from ..maths.pose import Pose
from ..maths.rotations import yaw_pitch_roll_rad
from ..maths.trajectory import Riding, pose_at
from ..recordings.as_cloud import cloud_of
from ..recordings.recording import Recording
from ..rendering.frame import Frame
from ..rendering.render_options import FrameOptions, TraceOptions
from ..rendering.simulator import Simulator, Summary
from ..rendering.stages import ambient_of
from ..rendering.surroundings import warn_of_light
from ..scene.scene import Scene
from ..sensor.sensor_file import load_sensor
from ..sensor.sensor_model import Sensor
from ..studies.budget import Budget, budget_of, pulses_of
from .blob import pack_blob
from .controls import DETECTOR, Equipment, Settings
from .live_conditions import KEYS, command, conditions, controls
from .point_fields import frame_blob
from .solid import solid_of

SENSOR = "sensor"
"""Key of the choice of a sensor."""

IN_ROOM = 0.9
"""Choice: share of the way to the first surface at which the camera stops."""

WAVELENGTH_M = 905e-9
"""Choice: wavelength of the grey of a scene's surfaces, where no sensor is known."""

NO_SCENE = "no deskewed layer: it needs the motion of the vehicle; name the scene of the cloud, too"
OTHER_SCENE = "no deskewed layer: the vehicle of this scene stands still"
SEVERAL = "no deskewed layer: the cloud joins several sensors; render it deskewed"
RECORDED = "no deskewed layer: the recording does not contain the motion of its vehicle"


class Source(Protocol):
    """Content of a page.

    Attributes:
        title: title in one line
        frames: names of the frames
    """

    title: str
    frames: tuple[str, ...]

    def stage(self, number: int | None = None) -> bytes:
        """Blob of what stays the same in all frames: camera, meshes, names of the frames.

        Args:
            number: number of the frame of a live scene that moves; None: the first one shown
        """

    def frame(self, number: int) -> bytes:
        """Blob of a frame."""

    def render(self, settings: Settings) -> bytes:
        """Blob of the frame rendered with these settings.

        Raises:
            InputError: for a source that cannot render
        """


def pair_deskewed(paths: Sequence[Path]) -> dict[Path, Path | None]:
    """Cloud file -> file of the same frame deskewed, which `render --deskew` calls NAME.deskewed.ply; None without."""
    deskewed_of: dict[Path, Path] = {}
    for path in paths:
        for mark in (".deskewed.", "-deskewed."):
            raw = path.with_name(".".join(path.name.rsplit(mark, 1)))
            if raw != path and raw in paths:
                deskewed_of[raw] = path
    return {path: deskewed_of.get(path) for path in paths if path not in deskewed_of.values()}


class Clouds:
    """Cloud files as frames, with the surfaces of a scene if one is given; a frame and itself deskewed are one.

    A point's link budget needs the scene and the sensor: `sensor`, or the one that the cloud names if the catalogue has
    it.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        *,
        scene: Scene | None = None,
        sensor: str | None = None,
        overrides: Sequence[str] = (),
    ) -> None:
        """Read the first file.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        pairs = pair_deskewed(paths)
        self.paths, self.scene, self.overrides = tuple(pairs), scene, tuple(overrides)
        self._deskewed_paths = tuple(pairs.values())
        names = [path.name for path in self.paths]
        is_unique = len(set(names)) == len(names)  # of a rig each sensor's folder has the same names
        self.frames = tuple(names if is_unique else (f"{path.parent.name}/{path.name}" for path in self.paths))
        self.sensor = load_sensor(sensor, overrides=overrides) if sensor is not None else None
        self._first = self._load(0)
        self._origin = _origin_of(self._first.sensor_position_m)
        self.title = _title(self._first.metadata, self.paths[0].name)

    def stage(self, number: int | None = None) -> bytes:
        """Pack the scene's meshes, if any, and a camera for the first cloud."""
        sensor = self._sensor_of(self._first)
        wavelength = sensor.laser.wavelength_m if sensor else WAVELENGTH_M
        page_header = {"title": self.title, "frames": self.frames, "live": False}
        return stage_blob(
            page_header,
            scene=self.scene,
            wavelength_m=wavelength,
            origin=self._origin,
            camera=_camera(self._first, self.scene, time_s=self._first.frame_start_s),
            time_s=self._first.frame_start_s,
        )

    def frame(self, number: int) -> bytes:
        """Read a file, and compute its points' budgets if scene, sensor and truth are known."""
        cloud = self._load(number) if number else self._first
        sensor = self._sensor_of(cloud)
        still, no_layer_reason = self._deskewed_positions_m(number, cloud)
        budget: Budget | None = None
        page_header: dict[str, Any] = {"layers": no_layer_reason}
        if sensor is not None and self.scene is not None and cloud.has_truth:
            budget = budget_of(cloud, sensor, ambient_of(self.scene, sensor))
            page_header["approximate"] = _not_lambertian(self.scene, cloud)
        return frame_blob(
            cloud,
            name=self.frames[number],
            origin_m=self._origin,
            budget=budget,
            extra_header=page_header,
            still_m=still,
        )

    def _deskewed_positions_m(self, number: int, cloud: PointCloud) -> tuple[Numbers | None, str]:
        """(n, 3) deskewed positions, of the file beside the frame's or by the scene, or None with the reason."""
        path = self._deskewed_paths[number]
        if path is not None:
            beside = self._load_path(path)
            same_frame = beside.metadata.get("frame") == cloud.metadata.get("frame")
            if same_frame and np.array_equal(beside.time_s, cloud.time_s):
                return beside.xyz_m, ""
        return deskewed_positions_m(cloud, self.scene)

    def render(self, settings: Settings) -> bytes:
        """Raise InputError: clouds cannot be rendered."""
        raise InputError("clouds are shown as they are; only a scene can be rendered anew")

    def _read(self, path: Path) -> PointCloud:
        """Read a cloud file."""
        return PointCloud.load(path)

    def _load(self, number: int) -> PointCloud:
        """Read the cloud of a frame."""
        return self._load_path(self.paths[number])

    def _load_path(self, path: Path) -> PointCloud:
        """Read a cloud; with a scene, move it to world coordinates by the pose of the scene's sensor or vehicle."""
        cloud = self._read(path)
        frame = cloud.metadata.get("frame", "sensor")
        if self.scene is None or frame == "world":
            return cloud
        start_s = float(cloud.metadata.get("frame_start_s", "0"))
        if frame == "sensor":
            sensor = self._sensor_of(cloud)
            riding = self.scene.sensor_pose @ (sensor.mounting if sensor else Pose())
        else:
            riding = Pose()
        place = (pose_at(self.scene.ego, start_s) if self.scene.ego else Pose()) @ riding
        return cloud.transform(place)

    def _sensor_of(self, cloud: PointCloud) -> Sensor | None:
        name = cloud.metadata.get("sensor", "")
        if self.sensor is None and name in catalog.names("sensors"):
            self.sensor = load_sensor(name, overrides=self.overrides)
        return self.sensor


class RecordingFrames:
    """Frames of a recording, or one of them."""

    def __init__(self, recording: Recording, *, frame: int | None = None) -> None:
        """Read the first frame.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        self.recording = recording
        self.numbers = range(len(recording)) if frame is None else (frame,)
        self.frames = tuple(f"frame {number}" for number in self.numbers)
        self._first = cloud_of(recording[self.numbers[0]])
        self.title = _title({}, recording.path.name)

    def stage(self, number: int | None = None) -> bytes:
        """Pack the names of the frames, and a camera for the first."""
        page_header = {"title": self.title, "frames": self.frames, "live": False}
        return stage_blob(
            page_header, scene=None, wavelength_m=WAVELENGTH_M, origin=np.zeros(3), camera=_camera(self._first, None)
        )

    def frame(self, number: int) -> bytes:
        """Read a frame, in the sensor's coordinates."""
        cloud = cloud_of(self.recording[self.numbers[number]]) if number else self._first
        page_header = {"layers": RECORDED}
        return frame_blob(cloud, name=self.frames[number], origin_m=np.zeros(3), budget=None, extra_header=page_header)

    def render(self, settings: Settings) -> bytes:
        """Raise InputError: recordings cannot be rendered."""
        raise InputError("recordings are shown as they are; only a scene can be rendered anew")


class Live:
    """Scene that is rendered anew for every setting; worlds are compiled once for each wavelength."""

    frames: tuple[str, ...] = ("",)

    def __init__(
        self,
        scene: Scene,
        *,
        sensor: str | None = None,
        overrides: Sequence[str] = (),
        frame: FrameOptions | None = None,
        scene_argument: str = "",
    ) -> None:
        """Compile the scene and render it once.

        Args:
            scene_argument: scene as named on the command line

        Raises:
            InputError: if a file, a key or a value cannot be understood
            BackendError: if Mitsuba has no back end that works on this machine
        """
        self.scene, self.options, self.scene_argument = scene, frame or FrameOptions(), scene_argument or scene.name
        sensor_name = sensor or scene.sensor_name
        if not sensor_name.endswith(".toml"):
            sensor_name = catalog.sensor_path(sensor_name).stem
        self.overrides = tuple(overrides)
        # Overrides hold for the scene's own sensor only: another may lack the keys that they change.
        self._equipment = {sensor_name: Equipment(scene, sensor_name, overrides)}
        self.sensors = tuple(dict.fromkeys([sensor_name, *catalog.names("sensors")]))
        self._worlds: dict[float, World] = {}
        simulator = self._simulator(self.scene, self.equipment.sensor, TraceOptions())
        warn_of_light(scene)
        self._first = simulator.render(self.options)
        self._place = pose_at(simulator.motion, simulator.start_s(self.options))
        self._origin = _origin_of(self._place.position_m)
        self._start_s = simulator.start_s(self.options)
        self.title = _title(self._first.metadata, scene.name)

    @property
    def equipment(self) -> Equipment:
        """Equipment with the sensor of the command line or the scene."""
        return next(iter(self._equipment.values()))

    def _choose_equipment(self, settings: Settings) -> Equipment:
        """Equipment with the sensor chosen on the page.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        name = settings.get(SENSOR, self.sensors[0])
        if not isinstance(name, str) or name not in self.sensors:
            raise InputError(f"{SENSOR}: must be one of {', '.join(self.sensors)}, got {name}")
        if name not in self._equipment:
            self._equipment[name] = Equipment(self.scene, name)
        return self._equipment[name]

    def _simulator(self, scene: Scene, sensor: Sensor, trace: TraceOptions) -> Simulator:
        wavelength_m = sensor.laser.wavelength_m
        simulator = Simulator(scene, sensor, trace, world=self._worlds.get(wavelength_m), pose=self.options.pose)
        self._worlds[wavelength_m] = simulator.world
        return simulator

    def stage(self, number: int | None = None) -> bytes:
        """Pack the scene's meshes, its camera, and the choices of sensor and detector."""
        frame = self._frame_options(number)
        start_s = self._simulator(self.scene, self.equipment.sensor, TraceOptions()).start_s(frame)
        page_header = {
            "title": self.title,
            "frames": self.frames,
            "live": True,
            "choices": {SENSOR: list(self.sensors), DETECTOR: list(self.equipment.detectors)},
            "ahead": self._place.rotation[:, 0].tolist(),
            "moves": self._moves,
        }
        return stage_blob(
            page_header,
            scene=self.scene,
            wavelength_m=self.equipment.sensor.laser.wavelength_m,
            origin=self._origin,
            camera=self._camera(start_s),
            time_s=start_s,
        )

    def _frame_options(self, number: int | None) -> FrameOptions:
        return self.options if number is None else dataclasses.replace(self.options, number=number)

    @property
    def _moves(self) -> bool:
        """True if the vehicle or a body moves, so that frames differ."""
        return self.scene.ego is not None or any(body.motion is not None for body in self.scene.bodies)

    def _camera(self, start_s: float) -> dict[str, Any]:
        """Camera of the scene, which rides on its vehicle; without one, a camera that suits the first cloud."""
        camera_scene = None if self.options.pose else self.scene
        camera = _camera(self._first, camera_scene, time_s=start_s)
        if camera_scene is not None and camera_scene.camera is not None:
            return camera
        # A ceiling or wall may lie between the sensor and a camera above and behind it: stop in front of it.
        sensor_m, eye_m = self._place.position_m, np.array(camera["eye"])
        offset_m = eye_m - sensor_m
        length_m = float(np.linalg.norm(offset_m))
        world = next(iter(self._worlds.values()))
        free_m = float(distances_m(world, sensor_m, (offset_m / max(length_m, 1e-9))[:, None], time_s=self._start_s)[0])
        if free_m < length_m:
            camera["eye"] = (sensor_m + offset_m * (IN_ROOM * free_m / length_m)).tolist()
        return camera

    def frame(self, number: int) -> bytes:
        """Render with the values of the files."""
        return self.render({})

    def render(self, settings: Settings) -> bytes:
        """Render one frame with these settings."""
        equipment = self._choose_equipment(settings)
        equipment_settings = {key: value for key, value in settings.items() if key not in (*KEYS, SENSOR)}
        lit_scene, sensor = equipment.with_settings(equipment_settings)
        chosen = conditions(lit_scene, self.options, settings)
        summary, since = Summary(), time.perf_counter()
        simulator = self._simulator(chosen.scene, sensor, chosen.trace)
        cloud = simulator.render(chosen.frame, summary=summary)
        seconds = time.perf_counter() - since
        page_header: dict[str, Any] = {
            "controls": [
                dataclasses.asdict(slider)
                for slider in (*equipment.controls(equipment_settings), *controls(self.scene, self.options))
            ],
            "choices": {SENSOR: list(self.sensors), DETECTOR: list(equipment.detectors)},
            "title": _title(cloud.metadata, self.scene.name),  # the sensor may be another than at first
            "beams": summary.beams,
            "seconds": seconds,
            "sun": chosen.scene.sun.direction.tolist(),
            "command": self._command(equipment, settings),
            "budget": chosen.budget,
        }
        budget = None
        if chosen.budget:
            ambient = ambient_of(chosen.scene, sensor)
            light = self._light(simulator, cloud, ambient, chosen.frame)
            budget = budget_of(cloud, sensor, ambient, light=light)
        still = None
        if cloud.metadata.get("ego_motion"):
            still = deskewed(cloud, simulator.motion, length_s=sensor.scanner.frame_s)
        return frame_blob(
            cloud,
            name="",
            origin_m=self._origin,
            budget=budget,
            extra_header=page_header,
            still_m=None if still is None else still.xyz_m,
        )

    def _command(self, equipment: Equipment, settings: Settings) -> str:
        """Command line that renders the same."""
        overrides = self.overrides if equipment is self.equipment else ()
        donor_name = equipment.donor_name(settings)
        words = command(self.scene_argument, equipment.name, overrides, settings, donor_name=donor_name)
        if self.options.pose is not None:
            place = self.options.pose
            yaw, pitch, roll = np.degrees(yaw_pitch_roll_rad(place.rotation))
            numbers = [*place.position_m, yaw, -pitch, roll]  # on the command line, positive pitch looks up
            words.append(f"--pose={','.join(f'{value:.6g}' for value in numbers)}")
        return shlex.join(words)

    def _light(self, simulator: Simulator, cloud: PointCloud, ambient: Ambient, frame: FrameOptions) -> Echoes:
        """Light on the detector for the pulse of each point, traced once more."""
        scene, sensor, world = simulator.scene, simulator.sensor, simulator.world
        (frame_then,) = Frame.from_options(scene, sensor, world, [frame], pose=frame.pose or simulator.pose)
        timed_frame = frame_then.on_device()
        pulses = range(timed_frame.first_pulse, timed_frame.first_pulse + sensor.scanner.pulses)
        chosen = simulator.numbering.chosen(timed_frame, transfer.counter(pulses.start, len(pulses)))
        light = retraced_light(
            world,
            dataclasses.replace(sensor, scanner=sensor.scanner.at_phase(timed_frame.phase)),
            ambient,
            sun=scene.sun.direction,
            placements=timed_frame.placements(chosen.departures),
            pulses=pulses,
            seed=timed_frame.seed_words(frame.seed),
        )
        pulse = pulses_of(cloud, sensor.scanner) - frame.number * sensor.scanner.pulses
        return Echoes(**{name: getattr(light, name)[pulse] for name in LIGHT_COLUMNS})


def deskewed_positions_m(cloud: PointCloud, scene: Scene | None) -> tuple[Numbers | None, str]:
    """(n, 3) deskewed positions in the world, or None with the reason for the page.

    With a scene the cloud is in world coordinates. Its file holds the time of each point and the sensor's pose at the
    frame's start, but not its motion: that is the scene's.
    """
    if cloud.metadata.get("ego_motion") != MOTION_KEPT:
        return None, ""
    if scene is None:
        return None, NO_SCENE
    if scene.ego is None:
        return None, OTHER_SCENE
    if len(cloud.sensor_names) > 1:
        return None, SEVERAL
    # The sensor stays where it is on its vehicle, which may be another place than the scene's own (--pose).
    on_vehicle = pose_at(scene.ego, cloud.frame_start_s).inverse() @ cloud.sensor_place
    return deskewed(cloud, Riding(carrier=scene.ego, pose=on_vehicle)).xyz_m, ""


def stage_blob(
    extra_header: dict[str, Any],
    *,
    scene: Scene | None,
    wavelength_m: float,
    origin: Numbers,
    camera: dict[str, Any],
    time_s: float = 0.0,
) -> bytes:
    """Pack camera and meshes, relative to the origin, with the bodies at their poses at a time."""
    moved = {key: (np.array(camera[key]) - origin).tolist() for key in ("eye", "target")}
    header = extra_header | {"camera": camera | moved, "origin": origin.tolist()}
    if scene is None:
        return pack_blob(header, {})
    solid = solid_of(scene, wavelength_m, time_s=time_s)
    header |= {"opaque": 3 * solid.opaque, "sun": scene.sun.direction.tolist()}
    vertices = (solid.vertices_m - origin).astype(np.float32)
    return pack_blob(
        header, {"vertices": vertices.ravel(), "colours": solid.colours.ravel(), "faces": solid.faces.ravel()}
    )


def _not_lambertian(scene: Scene, cloud: PointCloud) -> list[int]:
    """Indices of the materials for which a budget from truth columns is not exact."""
    kinds = [getattr(scene.materials.get(name), "bsdf", "") for name in cloud.material_names]
    return [index for index, kind in enumerate(kinds) if kind != "diffuse"]


def _camera(cloud: PointCloud, scene: Scene | None, *, time_s: float = 0.0) -> dict[str, Any]:
    """Eye, target and horizontal angle of view: the scene's own camera, or one that suits the cloud.

    A scene's camera moves with its vehicle.
    """
    if scene is not None and scene.camera is not None:
        view = scene.camera
        vehicle = pose_at(scene.ego, time_s) if scene.ego else Pose()
        eye, target = vehicle.apply(np.array([view.eye_m, view.target_m])).tolist()
        return {"eye": eye, "target": target, "fov_deg": view.fov_deg}
    camera = camera_for(cloud)
    look = camera.axes[2]
    ahead = (cloud.xyz_m[cloud.status == 0] - camera.eye_m) @ look
    ahead = ahead[ahead > 0.0]
    reach = float(np.median(ahead).clip(2.0, 60.0)) if len(ahead) else 20.0
    return {"eye": camera.eye_m.tolist(), "target": (camera.eye_m + reach * look).tolist(), "fov_deg": camera.fov_deg}


def _origin_of(position_m: Numbers) -> Numbers:
    """Origin that is subtracted from all coordinates, so that the page's single precision resolves them."""
    return np.zeros(3) if np.abs(position_m).max() < LARGEST_FLOAT32_M else np.rint(position_m)


def _title(metadata: Any, otherwise: str) -> str:
    names = [Path(metadata.get(key, "")).name for key in ("scene", "sensor")]
    return " · ".join(filter(None, names)) or otherwise


def blob_of(source: Source, request: str) -> Callable[[], bytes] | None:
    """Job that makes what a page asks for, "stage", "stage?frame=3" or "frame-3"; None for anything else."""
    name, _, query = request.partition("?")
    if name == "stage":
        frame_query = re.fullmatch("frame=([0-9]{1,9})", query)
        return functools.partial(source.stage, int(frame_query[1]) if frame_query else None)
    frame = re.fullmatch("frame-([0-9]{1,9})", name)
    return functools.partial(source.frame, int(frame[1])) if frame and int(frame[1]) < len(source.frames) else None


def settings_from(body: bytes) -> Settings:
    """Parse the settings that the page sends.

    Raises:
        InputError: unless they are a JSON object
    """
    try:
        settings = json.loads(body)
    except (ValueError, RecursionError):
        settings = None
    if not isinstance(settings, dict):
        raise InputError("settings: must be a JSON object")
    return settings
