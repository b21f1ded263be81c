"""Surroundings: one line on a scene and on the sensor's place in it, and warnings of likely mistakes.

A sensor under the road, a mesh in millimetres or a sun of 500 klux renders without complaint, into a cloud that is
empty or wrong. Bounding boxes and two rays reveal most of these mistakes before anything is traced. Each gives a
one-line warning with its remedy; none is refused, since the scene may be intended.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from ..errors import OptionWarning, warn
from ..maths.arrays import Numbers
from ..maths.pose import Pose
from ..maths.trajectory import pose_at
from ..physics.constants import SUN_KLUX
from ..physics.optics import radiometry
from ..scene.clearance import Clearance, Surrounding
from ..scene.ride import Ride
from ..scene.scene import Ball, Scene
from ..scene.shared_faces import shared_faces
from ..scene.sizes import metres_text, size_text
from ..sensor.sensor_model import Sensor
from .frame import frame_edges
from .render_options import FrameOptions
from .simulator import Simulator

LARGEST_BODY_M = 200.0
"""Choice: extent in all three directions beyond which a body is a mistake of its unit: terrain is flatter, a tower
thinner."""

SMALLEST_BODY_M = 0.01
"""Choice: extent in all three directions below which a body is one too: a lidar would not see it from a metre."""

CLEAREST_M = 300e3
"""Source: Rayleigh scattering; no air is clearer: molecules alone scatter 0.013 of green light in a km, and 3.912 over
that is the visibility."""

WAY_STEP_S = 0.1
"""Choice: seconds between times at which the ground below the ego vehicle is looked for."""

ENDLESS_S = 120.0
"""Choice: time for which the way of an ego vehicle is followed where nobody says how many frames there will be,
seconds."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surroundings:
    """A scene around one sensor, as a frame begins.

    Attributes:
        scene: name of the scene
        extent_m: (3,) edges of the box around all bodies; None without any
        bodies: number of bodies
        triangles: number of triangles of all bodies
        base: whether there is a Mitsuba scene too, whose shapes are not examined
        around: nearest surfaces around the sensor
        doubts: warnings of likely mistakes
        walk: line on the walk that the sensor's correction may leave; None: none
    """

    scene: str
    extent_m: Numbers | None
    bodies: int
    triangles: int
    base: bool
    around: Surrounding
    doubts: tuple[OptionWarning, ...]
    walk: str | None = None

    @classmethod
    def inspect(cls, scene: Scene, sensor: Sensor, place_m: Numbers, *, time_s: float, clearance: Clearance) -> Self:
        """Examine the surroundings of a sensor at a place in the world, at a time of the scene's motions.

        Args:
            place_m: (3,) position of the sensor
            clearance: `Clearance` of the scene
        """
        around = clearance.around_place(place_m, time_s=time_s)
        corners = clearance.corners(time_s=time_s)
        return cls(
            scene=scene.name,
            extent_m=np.ptp(corners, axis=0) if len(corners) else None,
            bodies=len(scene.bodies),
            triangles=sum(
                0 if isinstance(part, Ball) else len(part.faces) for body in scene.bodies for part in body.parts
            ),
            base=scene.base is not None,
            around=around,
            doubts=(
                *_light_doubts(scene),
                *_size_doubts(clearance),
                *_place_doubts(sensor, around, place_m, alone=scene.base is None),
                *_face_doubts(scene, place_m),
            ),
            walk=None if sensor.histogram is None else sensor.histogram.residual_walk,
        )

    def line(self) -> str:
        """One line of text."""
        parts = [] if self.extent_m is None else [f"{size_text(self.extent_m)} m"]
        parts += [f"{self.bodies:,} {'body' if self.bodies == 1 else 'bodies'}", f"{self.triangles:,} triangles"]
        if self.base:
            parts.append("and those of its Mitsuba scene")
        near, below = self.around.nearest, self.around.below
        where = [f"{metres_text(below.distance_m)} m above '{below.body}'"] if below.body else []
        if near.body and near.distance_m < 0.99 * below.distance_m:
            where.append(f"{metres_text(near.distance_m)} m off '{near.body}'")
        where += ["the nearest surface"] if near.body else []
        sensor = f"; sensor {', '.join(where)}" if where else ""
        return f"{self.scene}: {', '.join(parts)}{sensor}"

    def as_dict(self) -> dict[str, object]:
        """Entries for JSON; None where there is no body."""
        near, below = self.around.nearest, self.around.below
        return {
            "name": self.scene,
            "extent_m": None if self.extent_m is None else [round(float(x), 3) for x in self.extent_m],
            "bodies": self.bodies,
            "triangles": self.triangles,
            "height_m": round(below.distance_m, 4) if below.body else None,
            "above": below.body or None,
            "nearest_m": round(near.distance_m, 4) if near.body else None,
            "nearest": near.body or None,
        }


def simulator_surroundings(simulator: Simulator, frame: FrameOptions, frames: int | None = 1) -> Surroundings:
    """Surroundings of a simulator's sensor in its scene as the first frame begins, with doubts about its way until the
    last one ends and about its rays.

    Args:
        frames: number of frames; None: without end
    """
    scene, scanner, clearance = simulator.scene, simulator.sensor.scanner, simulator.clearance
    begin_s = frame.begin_s + frame_edges(scanner, frame.number)[0]
    length_s = ENDLESS_S if frames is None else frames * scanner.frame_s
    surroundings = Surroundings.inspect(
        scene, simulator.sensor, pose_at(simulator.motion, begin_s).position_m, time_s=begin_s, clearance=clearance
    )
    way = _way_doubts(scene, clearance, begin_s, begin_s + length_s)
    beam = _beam_doubts(simulator.sensor, simulator.trace.rays)
    return replace(surroundings, doubts=(*surroundings.doubts, *way, *beam))


def warn_of_surroundings(sensors: Sequence[Surroundings]) -> None:
    """Issue each doubt of these sensors once, as a warning."""
    for doubt in {str(doubt): doubt for surroundings in sensors for doubt in surroundings.doubts}.values():
        warn(doubt)


def warn_of_light(scene: Scene) -> None:
    """Issue the doubts about sun and air alone, for scenes whose sensors are not known yet."""
    for doubt in _light_doubts(scene):
        warn(doubt)


def warn_of_scene(scene: Scene) -> None:
    """Issue the doubts about a scene alone: light, sizes, all faces that bodies share, and the way of its ego vehicle,
    from time 0 or its first pose on.
    """
    begin_s = 0.0 if scene.ego is None else max(0.0, scene.ego.span_s[0])
    vehicle = Pose() if scene.ego is None else pose_at(scene.ego, begin_s)
    clearance = Clearance.of_scene(scene)
    for doubt in (
        *_light_doubts(scene),
        *_size_doubts(clearance),
        *_way_doubts(scene, clearance, begin_s, begin_s + ENDLESS_S),
        *_face_doubts(scene, (vehicle @ scene.sensor_pose).position_m, each=True),
    ):
        warn(doubt)


def _way_doubts(scene: Scene, clearance: Clearance, begin_s: float, end_s: float) -> Iterator[OptionWarning]:
    """Warn of an ego vehicle that leaves the ground: from there on frames are of the sky."""
    if scene.ego is None or scene.base is not None:
        return
    # Springs move it up and down: to follow them would take seconds.
    way = scene.ego.path if isinstance(scene.ego, Ride) else scene.ego
    first_s, last_s = way.span_s
    begin_s, end_s = max(begin_s, first_s), min(end_s, last_s)
    time_s = np.linspace(begin_s, end_s, max(math.ceil((end_s - begin_s) / WAY_STEP_S), 1) + 1)
    grounded = clearance.over_ground(way.at(time_s).position_m)
    if grounded[0] and not grounded.all():
        yield OptionWarning(
            "the ego vehicle leaves the ground {0:.1f} s after {1:.16g} s: from there on nothing is below it; a wider "
            "ground or another way ([ego]) keeps it in the scene",
            time_s[np.argmin(grounded)] - begin_s,
            round(begin_s, 3),
        )


def _beam_doubts(sensor: Sensor, rays: int) -> Iterator[OptionWarning]:
    """Warn of several rays for a beam without width: no mistake, but they change nothing."""
    if rays > 1 and not (sensor.laser.has_width or sensor.optics.halo or sensor.sweep_rad):
        yield OptionWarning(
            "{rays} {0} changes nothing: laser.divergence_mrad of '{1}' is 0; a width is given by {overrides} "
            "laser.divergence_mrad=3",
            rays,
            sensor.name,
        )


def _face_doubts(scene: Scene, sensor_m: Numbers, *, each: bool = False) -> Iterator[OptionWarning]:
    """Warn of the first two bodies that share faces, or of ``each`` two."""
    shared = shared_faces(scene, sensor_m)
    for pair in shared if each else shared[:1]:
        yield OptionWarning(
            "'{0}' and '{1}'{2} share faces at ({3}), where rounding decides which of them a point names: keep them "
            "1 mm apart",
            *pair.names,
            "" if each or len(shared) == 1 else f" (1 of {len(shared)} pairs, which lidarscene check lists)",
            ", ".join(f"{x:g}" for x in np.round(pair.place_m, 3) + 0.0),
        )


def sun_doubts(klux: float) -> Iterator[OptionWarning]:
    """Warn of a sun that no sky has."""
    if klux > SUN_KLUX:
        yield OptionWarning(
            "sun.illuminance_klux is {0:g}, and no sun has more than {1:g}: if these are lux, set "
            "sun.illuminance_klux={2:g}",
            klux,
            SUN_KLUX,
            klux / 1e3,
        )


def _light_doubts(scene: Scene) -> Iterator[OptionWarning]:
    """Warn of a sun that no sky has, and of air that is too clear."""
    klux, sun = scene.sun.illuminance_klux, scene.sun
    yield from sun_doubts(klux)
    # A sky as bright as the sun is meant to light the scene alone, as a twin's.
    if klux > 0.0 and sun.elevation_rad < 0.0 and scene.sky.diffuse_share < 1.0:
        yield OptionWarning(
            "sun.elevation_deg is {0:.4g}, so that its {1:g} klux come from below the horizon: give an elevation above "
            "0, or sun.illuminance_klux=0 for night",
            math.degrees(sun.elevation_rad),
            klux,
        )
    if scene.air.visibility_m is not None and scene.air.visibility_m > CLEAREST_M:
        km = scene.air.visibility_m / 1e3
        yield OptionWarning(
            "air.visibility_km is {0:g}, and the clearest air has 300: if these are metres, set "
            "air.visibility_km={1:g}",
            km,
            km / 1e3,
        )


def _size_doubts(clearance: Clearance) -> Iterator[OptionWarning]:
    """Warn of bodies a thousand times too large or too small."""
    sizes = np.ptp(clearance.boxes, axis=1)
    for wrong, unit, scale in (
        (sizes.min(axis=1, initial=np.inf) > LARGEST_BODY_M, "the millimetre", 0.001),
        (sizes.max(axis=1, initial=0.0) < SMALLEST_BODY_M, "the kilometre", 1000.0),
    ):
        for number in np.flatnonzero(wrong)[:1]:
            name, more = clearance.bodies[number].name, int(wrong.sum()) - 1
            yield OptionWarning(
                "body '{0}'{1} is {2} m: if the unit of its mesh is {3}, multiply its scale by {4:g} "
                "({scene_overrides} bodies.{5}.scale=...)",
                name,
                f" (and {more} more)" if more else "",
                size_text(sizes[number]),
                unit,
                scale,
                name.partition(".")[0],
            )


def _place_doubts(sensor: Sensor, around: Surrounding, place_m: Numbers, *, alone: bool) -> Iterator[OptionWarning]:
    """Warn of a sensor inside, below or far from all bodies; the last two only if ``alone``: no Mitsuba scene."""
    location = f"sensor '{sensor.name}' at ({', '.join(f'{x:g}' for x in np.round(place_m, 3) + 0.0)})"
    if around.within is not None:
        yield OptionWarning(
            "{0} is inside '{1}', which is closed all around it: unless that is a room, give {pose} or position_m "
            "outside",
            location,
            around.within,
        )
    if not alone or not around.nearest.body:
        return
    if around.above.body and not around.below.body:
        yield OptionWarning(
            "{0} is {1} m below '{2}', with nothing under it: if that is the ground, raise the sensor by {pose} or "
            "position_m to z above {3:.4g}",
            location,
            metres_text(around.above.distance_m),
            around.above.body,
            place_m[2] + around.above.distance_m,
        )
    reach_m = float(radiometry.range_from_time_of_flight_m(time_of_flight_s=sensor.tdc.window_s))
    if around.nearest.distance_m > reach_m:
        yield OptionWarning(
            "{0} is {1} m off the nearest surface, '{2}', and listens for {3} m: check the unit of position_m, "
            "and of the meshes (bodies.*.scale)",
            location,
            metres_text(around.nearest.distance_m),
            around.nearest.body,
            metres_text(reach_m),
        )
