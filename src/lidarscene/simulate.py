"""The chain: a World, a Sensor and a Pose in, a PointCloud out. Reads as the picture in docs/architecture.md."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from . import beams, echoes, returns
from .cloud import CloudBuilder, PointCloud
from .detectors import Apd
from .echoes import Ambient, Echoes
from .geometry import Pose
from .hits import Hits
from .kernel import device
from .kernel.trace import trace
from .kernel.world import World, build_world
from .physics import sunlight
from .returns import Detection, Outcome
from .scene import Scene
from .sensor import Sensor

Matrix = np.ndarray[Any, Any]

DEFAULT_CHUNK = 2**20
"""Pulses traced at a time: some 100 MB of arrays; smaller chunks spend more of their time in Python."""

FRAMES = ("world", "sensor")


@dataclass(slots=True)
class Summary:
    """What happened in a frame: pulses by outcome, points, and seconds by stage."""

    beams: int = 0
    outcomes: Matrix = field(default_factory=lambda: np.zeros(len(Outcome), dtype=np.int64))
    points: int = 0
    false_alarms: int = 0
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def hits(self) -> int:
        """Pulses that met a surface."""
        return self.beams - int(self.outcomes[Outcome.NO_SURFACE])

    def spent(self, stage: str, since: float) -> float:
        """Add the time since ``since`` to a stage; returns now."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - since
        return now


@dataclass(frozen=True, slots=True, eq=False)
class _Chunk:
    """What leaves the device for some pulses."""

    first: int
    offset_m: tuple[Any, Any, Any]
    hits: Hits
    light: Echoes
    detection: Detection

    def arrays(self) -> list[Any]:
        """Everything that numpy will read."""
        hits, detection = self.hits, self.detection
        kept = [hits.range_m, hits.cos_incidence, hits.reflectivity, hits.cos_sun, hits.lit, hits.face]
        kept += [detection.snr, detection.detection_probability, detection.outcome, *self.offset_m]
        for stop in detection.stops:
            kept += [stop.reported, stop.status, stop.range_m, stop.amplitude]
        return kept


class Simulator:
    """A world and a sensor, ready for any number of frames; nothing is compiled twice.

    sensor   in SI units; its scanner gives the pulses of a frame
    ambient  light and air of the scene in the sensor's band
    """

    def __init__(
        self, scene: Scene, sensor: Sensor, *, world: World | None = None, pose: Pose | None = None
    ) -> None:
        """Compile the scene around the sensor's place (or take a compiled ``world``).

        pose  where the sensor stands in the world; the scene's own if None. `render` takes another per frame.
        """
        self.scene, self.sensor = scene, sensor
        self.pose = (pose or scene.sensor_pose) @ sensor.mounting
        self.world = world or build_world(
            scene, wavelength_m=sensor.laser.wavelength_m, centre_m=self.pose.position_m
        )
        self._device_sensor = device.opaque(sensor)
        self._device_ambient = device.opaque(ambient_of(scene, sensor))
        self._device_sun = device.opaque(tuple(float(x) for x in scene.sun.direction))

    def render(
        self,
        *,
        seed: int = 0,
        pose: Pose | None = None,
        chunk: int = DEFAULT_CHUNK,
        frame: str = "world",
        progress: Callable[[int], None] | None = None,
        missed: Callable[[Matrix, Matrix], None] | None = None,
        summary: Summary | None = None,
    ) -> PointCloud:
        """One frame as a point cloud.

        seed      32 bits; the same seed gives the same cloud whatever the chunk
        pose      of the sensor (its mounting not included) in the world; the scene's own if None
        chunk     pulses at a time, bounds the memory
        frame     "world" or "sensor": in which frame the points are
        progress  called with the number of pulses done so far
        missed    called with (pulse, outcome) of every pulse that has no echo point, chunk by chunk
        summary   filled if given
        """
        place = self.pose if pose is None else pose @ self.sensor.mounting
        summary = Summary() if summary is None else summary
        builder = CloudBuilder()
        for part in self._chunks(place, seed=seed, chunk=chunk, summary=summary):
            since = time.perf_counter()
            builder.append(self._columns(part, place, frame, summary))
            outcome = part.detection.outcome.numpy()
            summary.beams += len(outcome)
            summary.outcomes += np.bincount(outcome, minlength=len(Outcome))
            if missed is not None:
                lost = np.flatnonzero(outcome)
                missed((lost + part.first).astype(np.uint32), outcome[lost].astype(np.uint8))
            if progress is not None:
                progress(summary.beams)
            summary.spent("collect", since)
        since = time.perf_counter()
        cloud = builder.build(
            body_names=self.world.body_names,
            class_names=self.world.class_names,
            material_names=self.world.material_names,
            metadata=self._metadata(place, seed, frame),
        )
        summary.points = len(cloud)
        summary.false_alarms = int(np.count_nonzero(cloud.status))
        summary.spent("assemble", since)
        return cloud

    def _chunks(self, place: Pose, *, seed: int, chunk: int, summary: Summary) -> Iterator[_Chunk]:
        """Chunks in order. The next one is written down (Python) while the device works on this one."""
        total = self.sensor.scanner.pulses
        seed_word = device.opaque_uint32(seed)
        origin = device.opaque(tuple(float(x) for x in place.position_m - self.world.centre_m))
        rotation = device.opaque(tuple(float(x) for x in place.rotation.ravel()))
        pending: _Chunk | None = None
        for first in range(0, total, chunk):
            since = time.perf_counter()
            count = min(chunk, total - first)
            pulse = device.counter(first, count)
            part = self._chain(first, pulse, seed_word, origin, rotation)
            since = summary.spent("record", since)
            device.wait()
            summary.spent("trace", since)
            device.start(part.arrays())
            if pending is not None:
                yield pending
            pending = part
        since = time.perf_counter()
        device.wait()
        summary.spent("trace", since)
        if pending is not None:
            yield pending

    def _chain(self, first: int, pulse: Any, seed: Any, origin: Any, rotation: Any) -> _Chunk:
        """Beams, hits, echoes, returns of these pulses, on the device."""
        rays = beams.fire(self._device_sensor, pulse=pulse, origin_m=origin, rotation=rotation)
        hits = trace(self.world, rays, sun=self._device_sun)
        light = echoes.receive(rays, hits, self._device_sensor, self._device_ambient)
        detection = returns.detect(light, self._device_sensor, seed=seed, pulse=pulse)
        x, y, z = rays.direction
        return _Chunk(first, (x, y, z), hits, light, detection)

    def _columns(self, part: _Chunk, place: Pose, frame: str, summary: Summary) -> dict[str, Any]:
        """The kept points of a chunk, as columns of a PointCloud, by pulse and then by return."""
        stops = part.detection.stops
        reported = np.stack([stop.reported.numpy() for stop in stops], axis=1)
        lane, stop = np.nonzero(reported)
        lane = lane.astype(np.int64)

        def of_stop(name: str) -> Matrix:
            values = [getattr(one, name).numpy() for one in stops]
            return values[0][lane] if len(values) == 1 else np.stack(values, axis=1)[lane, stop]

        hits, world = part.hits, self.world
        range_m = of_stop("range_m")
        face = hits.face.numpy()[lane]
        known = face >= 0
        safe = np.maximum(face, 0)
        body = np.where(known, world.face_body[safe], -1)
        pulse = lane + part.first
        azimuth, elevation = self.sensor.scanner.angles(pulse.astype(np.uint32))
        return {
            "xyz_m": self._points(part, lane, range_m, place, frame),
            "range_m": range_m,
            "intensity": of_stop("amplitude"),
            "snr": part.detection.snr.numpy()[lane],
            "detection_probability": part.detection.detection_probability.numpy()[lane],
            "time_s": beams.firing_time_s(self.sensor, pulse),
            "channel": self.sensor.scanner.channel(pulse.astype(np.uint32)),
            "azimuth_rad": azimuth,
            "elevation_rad": elevation,
            "return_number": (stop + 1).astype(np.uint8),
            "status": of_stop("status").astype(np.uint8),
            "true_range_m": np.where(known, hits.range_m.numpy()[lane], np.float32(np.inf)),
            "incidence_angle_rad": np.arccos(hits.cos_incidence.numpy()[lane]),
            "reflectivity": hits.reflectivity.numpy()[lane],
            "sun_angle_rad": np.arccos(np.clip(hits.cos_sun.numpy()[lane], -1.0, 1.0)),
            "in_shadow": (known & ~hits.lit.numpy()[lane]).astype(np.uint8),
            "body": body,
            "class_id": np.where(known, world.body_class[np.maximum(body, 0)], -1),
            "material": np.where(known, world.face_material[safe], -1),
        }

    def _points(self, part: _Chunk, lane: Matrix, range_m: Matrix, place: Pose, frame: str) -> Matrix:
        """(n, 3) positions; float32 as long as that is good to 0.1 mm, else float64."""
        offset = np.stack([axis.numpy()[lane] * range_m for axis in part.offset_m], axis=1)
        if frame == "sensor":
            return np.asarray(offset @ place.rotation.astype(np.float32))
        if np.abs(place.position_m).max() < 1000.0:
            return np.asarray(offset + place.position_m.astype(np.float32))
        return np.asarray(offset + place.position_m)

    def _metadata(self, place: Pose, seed: int, frame: str) -> dict[str, str]:
        from . import __version__

        metadata = {
            "software": "lidarscene",
            "version": __version__,
            "scene": self.scene.name,
            "sensor": self.sensor.name,
            "seed": str(seed),
            "intensity_unit": "A" if isinstance(self.sensor.detector, Apd) else "cells",
            "frame": frame,
        }
        if frame == "world":
            metadata["sensor_position_m"] = " ".join(repr(float(x)) for x in place.position_m)
        return metadata


def ambient_of(scene: Scene, sensor: Sensor) -> Ambient:
    """Light and air of a scene in a sensor's band."""
    sun = sunlight.sun_irradiance_w_m2(
        irradiance_at_100_klux_w_m2=sensor.optics.sun_irradiance_w_m2,
        illuminance_klux=scene.sun.illuminance_klux,
    )
    return Ambient(
        sun_irradiance_w_m2=sun,
        sky_irradiance_w_m2=sunlight.sky_irradiance_w_m2(
            sun_irradiance_w_m2=sun, diffuse_share=scene.sky.diffuse_share
        ),
        transmittance=scene.air.transmittance,
        extinction_per_m=scene.air.extinction_at_per_m(sensor.laser.wavelength_m),
    )
