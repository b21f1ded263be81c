"""A scene as the simulation sees it: bodies with their surfaces, sun, sky and air. Plain data, metres, radians.

`lidarscene.scene.file` makes one from a TOML file, `Scene` is as easily made in Python.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..materials.material import Material
from ..maths.arrays import Numbers, frozen
from ..maths.pose import Pose, direction_from_angles
from ..maths.trajectory import Motion, pose_at
from ..physics.optics import air
from .weather import Weather


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Part:
    """A triangle mesh of one material, in its body's frame.

    vertices_m  (v, 3) float64
    faces       (f, 3) uint32, indices into the vertices
    """

    vertices_m: Numbers
    faces: Numbers
    material: str
    name: str = ""

    def __post_init__(self) -> None:
        """Check shapes and freeze the arrays."""
        object.__setattr__(self, "vertices_m", frozen(self.vertices_m, np.float64, (None, 3)))
        object.__setattr__(self, "faces", frozen(self.faces, np.uint32, (None, 3)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Ball:
    """An exact sphere of one material, centred on its body's origin."""

    radius_m: float
    material: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Body:
    """Something with a name, a class and a shape, standing somewhere. Instances are bodies that share parts.

    motion  where it is at each time, in the world, or None: it stands at ``pose``. With a motion ``pose`` is where
            it is at time 0, or at the end of the motion's span that is nearest to it.
    """

    name: str
    class_name: str
    parts: tuple[Part | Ball, ...]
    pose: Pose = field(default_factory=Pose)
    motion: Motion | None = None

    def __post_init__(self) -> None:
        """Take the pose from the motion."""
        if self.motion is not None:
            object.__setattr__(self, "pose", pose_at(self.motion))


@dataclass(frozen=True, slots=True, kw_only=True)
class Sun:
    """Direction towards the sun (azimuth counter-clockwise from x seen from above), and illuminance on a
    surface that faces it.
    """

    azimuth_rad: float = 0.0
    elevation_rad: float = math.radians(45.0)
    illuminance_klux: float = 100.0

    @property
    def direction(self) -> Numbers:
        """(3,) unit vector towards the sun, world frame."""
        return np.array(direction_from_angles(azimuth_rad=self.azimuth_rad, elevation_rad=self.elevation_rad))


@dataclass(frozen=True, slots=True, kw_only=True)
class Sky:
    """Uniform sky; ``diffuse_share`` is its irradiance over the sun's at normal incidence, in band."""

    diffuse_share: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Air:
    """One-way transmittance: fixed, times extinction over the range (given or from visibility, and weather)."""

    transmittance: float = 1.0
    extinction_per_m: float = 0.0
    visibility_m: float = math.inf
    model: str = "kim"
    weather: Weather = field(default_factory=Weather)

    def extinction_at_per_m(self, wavelength_m: float) -> float:
        """Extinction coefficient at a laser wavelength, weather included."""
        extinction_per_m = self.extinction_per_m + self.weather.extinction_at_per_m(wavelength_m)
        if math.isinf(self.visibility_m):
            return extinction_per_m
        return extinction_per_m + air.extinction_from_visibility_per_m(
            visibility_m=self.visibility_m, wavelength_m=wavelength_m, model=self.model
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Interferer:
    """Another lidar, whose pulses reach the receiver at random times, whichever way it looks.

    rate_hz          mean rate of the pulses that do
    irradiance_w_m2  median of their peaks, in the sensor's band, at the receiver's aperture
    spread_db        standard deviation of ten times the decimal logarithm of the peak
    """

    rate_hz: float
    irradiance_w_m2: float
    spread_db: float = 6.0


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """Where pictures of the scene are taken from: a pinhole at ``eye_m``, ``fov_deg`` across, world frame."""

    eye_m: tuple[float, float, float]
    target_m: tuple[float, float, float]
    fov_deg: float = 60.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """All that light can meet.

    bodies          in the order of the file; a point's `body` is an index into `body_names`
    materials       by name, every one that a part names
    lamps_w_m2      irradiance of all surfaces by lamps, in the sensor's band
    interferers     other lidars
    sensor_name     catalogue name or file of the sensor to use unless another is given
    sensor_pose     where the sensor stands: on the ego vehicle, or in the world without one
    ego             how the vehicle moves that carries the sensor, or None: it stands at the world's origin
    view            where pictures are taken from; chosen by what is near the sensor if None
    base            a Mitsuba XML scene whose shapes are added, or None
    base_materials  BSDF id in that file to material name; BSDFs not listed are used as they are
    """

    name: str = "scene"
    bodies: tuple[Body, ...] = ()
    materials: Mapping[str, Material] = field(default_factory=dict)
    sun: Sun = field(default_factory=Sun)
    sky: Sky = field(default_factory=Sky)
    air: Air = field(default_factory=Air)
    lamps_w_m2: float = 0.0
    interferers: tuple[Interferer, ...] = ()
    sensor_name: str = "table1-apd"
    sensor_pose: Pose = field(default_factory=Pose)
    ego: Motion | None = None
    view: View | None = None
    base: Path | None = None
    base_materials: Mapping[str, str] = field(default_factory=dict)
