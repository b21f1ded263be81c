"""Compute the columns of the kept points from the results of the stages on the device.

Most pulses of a frame may report nothing, and a point has 28 columns. So the reported returns are counted first, and a
second small kernel gathers them and computes positions, angles and identities for these lanes only. What follows from
the pulse's number alone is not carried through the first kernel. Nothing else leaves the device
(ARCHITECTURE.md).

Symbols: n pulse lanes, k kept points; lane of a ray = pulse lane * rays + ray.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

from ...detection.outcomes import Outcome, Status
from ...detection.report import Detection
from ...formats.cloud_columns import OF_VECTORS
from ...light.beams import reported_beams
from ...light.hits import Hits
from ...maths.arrays import Array, Lanes, is_drjit
from ...sensor.sensor_model import Sensor
from ..device.backend import mitsuba
from ..world.mitsuba_world import World
from .kept_lanes import more_than_one

LARGEST_FLOAT32_M = 1000.0
"""Accuracy bought: coordinates beyond this are double precision: float32 steps reach 0.1 mm there."""

NAN_COLUMN = "broken"
"""A column beside those of a cloud: 1 if any number of the point is NaN or infinite, else 0."""

NOT_A_NUMBER = 255
"""Outcome code of a pulse whose signal is NaN or infinite; without it the pulse would count as missed."""

PULSE_COLUMN = "since rollover"
"""A column beside those of a cloud: number of the pulse since the rollover."""


def with_nan_outcomes(detection: Detection) -> Detection:
    """Return the detection with outcomes of one byte each, `NOT_A_NUMBER` among them."""
    import drjit as dr

    # NumPy, on one core, would take a twentieth of a frame to look for it in whole columns.
    is_finite = dr.isfinite(detection.snr) & dr.isfinite(detection.detection_probability)
    outcome = mitsuba().UInt8(dr.select(is_finite, detection.outcome, NOT_A_NUMBER))
    return replace(detection, outcome=cast(Array, outcome))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Staged:
    """Results of the stages for some pulses, on the device.

    Attributes:
        pulse: (n,) pulse number of each lane
        paths: Hits of each path of the beams, lane = pulse lane * rays + ray
        rays: number of rays to a pulse
    """

    pulse: Any
    paths: Sequence[Hits]
    rays: int
    detection: Detection


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PulsePlaces:
    """What turns numbers of the sensor and of the tables into those of the points of (k,) pulses.

    Attributes:
        turn: rotation from the sensor's coordinates to those of the points, nine numbers, row by row
        shift: translation likewise [m]
        added_m: translation that is added in double precision; None near the origin, where float32 is good to 0.1 mm
        time_s: time since the start of the frame, in double precision: single precision would lose nanoseconds
        bodies: table of the number of the body that a frame shows by that of the body in the world's tables, frame by
            frame; None: each is itself
        first_body: place in that table at which the frame of the pulse begins
        rings: ring of each channel; None: rings are channels
    """

    turn: tuple[Lanes, ...]
    shift: tuple[Lanes, Lanes, Lanes]
    added_m: tuple[Lanes, ...] | None
    time_s: Array
    bodies: Array | None
    first_body: Lanes
    rings: Array | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Ends:
    """The surfaces from which some returns come.

    Attributes:
        paths: Hits of each path of the beams, lane = pulse lane * rays + ray
        index: (k,) lane in these Hits
        path: (k,) number of the path, or None if there is one path only
        on_surface: (k,) whether the return comes from a surface at all
    """

    paths: Sequence[Hits]
    index: Any
    path: Any
    on_surface: Any

    @classmethod
    def at_lanes(cls, staged: Staged, lane: Array, source: Array | None) -> _Ends:
        """Find the surfaces of these pulse lanes.

        Args:
            source: (k,) number of the sub-echo; None if each pulse has one. Those of surfaces come first, path by path
                (path * rays + ray), then those of the air; -1 is none
        """
        import drjit as dr

        mi, paths, rays = mitsuba(), staged.paths, staged.rays
        if source is None:
            return cls(paths=paths, index=lane, path=None, on_surface=dr.full(mi.Mask, True, dr.width(lane)))
        on_surface = (source >= 0) & (source < rays * len(paths))
        number = mi.UInt32(dr.select(on_surface, source, 0))
        path = number // rays
        return cls(paths=paths, index=lane * rays + number - path * rays, path=path, on_surface=on_surface)

    def get(self, name: str, axis: int | None = None) -> Any:
        """Return (k,) values of an attribute of the hits, or of one axis of it; zero where there is no surface."""
        import drjit as dr

        # Each path has arrays of its own: gather from each the lanes that end on it.
        values = None
        for number, hits in enumerate(self.paths):
            on_path = self.on_surface if len(self.paths) == 1 else self.on_surface & (self.path == number)
            array = getattr(hits, name) if axis is None else getattr(hits, name)[axis]
            part = dr.gather(type(array), array, self.index, on_path)
            values = part if values is None else dr.select(on_path, part, values)
        return values

    @property
    def face(self) -> Any:
        """(k,) face numbers, -1 where there is no surface."""
        import drjit as dr

        return dr.select(self.on_surface, self.get("face"), -1)


def point_columns(
    *,
    world: World,
    sensor: Sensor,
    staged: Staged,
    air_classes: Array | None,
    lanes: tuple[Array, Array],
    placing: Callable[[Array], PulsePlaces],
) -> dict[str, Any]:
    """Return (k,) columns of the kept points by attribute of PointCloud, on the device and not yet computed.

    xyz_m is a vector, and `NAN_COLUMN` and `PULSE_COLUMN` are among them. Columns of `device_columns.DEFAULT_VALUES`
    are left out if nothing moves, if no surface lets through or mirrors, or if the sensor measures no widths.

    Args:
        sensor: its numbers opaque
        air_classes: class of the light of the air, and of each sub-echo of the air; None in clear air
        lanes: lanes and stop numbers, from `kept_lanes.reported_lanes`
        placing: gives `PulsePlaces` of (k,) pulses
    """
    import drjit as dr

    mi = mitsuba()
    lane, stop = lanes
    paths, rays, detection = staged.paths, staged.rays, staged.detection

    def of_lane(values: Lanes) -> Any:
        return dr.gather(type(values), values, lane)

    def of_stop(name: str) -> Any:
        # Gathered from each stop's own array: to join the arrays first would be a kernel for each of a dozen columns.
        values: Any = of_lane(getattr(detection.stops[0], name))
        for number, returns in enumerate(detection.stops[1:], start=1):
            array, is_stop = getattr(returns, name), stop == number
            values = dr.select(is_stop, dr.gather(type(array), array, lane, is_stop), values)
        return values

    def of_return(name: str) -> Any:
        """Values of the return; with one echo to a pulse they are the pulse's."""
        return of_lane(getattr(detection, name)) if detection.source is None else of_stop(name)

    of_pulse, range_m = of_lane(staged.pulse), of_stop("range_m")
    places = placing(of_pulse)
    source = None if detection.source is None else of_stop("source")
    ends = _Ends.at_lanes(staged, lane, source)
    face, status, channel = ends.face, of_stop("status"), cast(Array, sensor.scanner.channel(of_pulse))
    # Computed from the pulse's number again, by the functions that fired it: cheaper than to keep what all pulses had.
    azimuth, elevation = sensor.scanner.angles(of_pulse)
    beams = reported_beams(sensor, pulse=of_pulse, origin_m=places.shift, rotation=places.turn)
    body = _look_up(world.face_body, face)
    class_id = _look_up(world.body_class, body)
    true_range = ends.get("range_m") if source is None else of_stop("true_range_m")
    has_range = face >= 0
    if sensor.optics.stray is not None:
        has_range |= status == int(Status.STRAY)
    if air_classes is not None and source is not None:
        of_air = status == int(Status.WEATHER)
        number = dr.select(source < 0, 0, source - rays * len(paths) + 1)
        class_id = dr.select(of_air, dr.gather(mi.Int32, air_classes, mi.UInt32(number), of_air), class_id)
        has_range |= of_air
    optional = {
        column: ends.get(name)
        for column, name in (("radial_velocity_m_s",) * 2, ("interactions",) * 2, ("ghost", "mirrored"))
        if is_drjit(getattr(paths[0], name))
    }
    if "ghost" in optional:
        optional["interactions"] = mi.UInt8(optional["interactions"])
        optional["ghost"] = mi.UInt8(dr.select(optional["ghost"], mi.UInt32(1), 0))
    if paths[0].normal is not None:
        optional |= _vector_columns(ends, places.turn)
    if sensor.wear is not None:
        loss = sensor.wear.loss(sensor.scanner.direction(of_pulse), sensor.scanner.channel(of_pulse))
        optional["wear"] = loss + dr.zeros(mi.Float, dr.width(lane))
    if sensor.measures_width:
        optional["pulse_width_s"] = of_stop("width_s")
    if sensor.histogram is not None:
        # A filter weighs the counts; what the sensor sends is a whole number.
        optional["signal"] = dr.round(of_stop("amplitude"))
    xyz_m = mi.Point3f(*(s + d * range_m for s, d in zip(beams.origin_m, beams.direction, strict=True)))
    result = optional | {
        "xyz_m": xyz_m if places.added_m is None else mi.Point3d(xyz_m) + mi.Point3d(*places.added_m),
        "range_m": range_m,
        "intensity": of_stop("intensity"),
        "snr": of_return("snr"),
        "detection_probability": of_return("detection_probability"),
        "ambient": of_lane(detection.ambient),
        "time_s": places.time_s,
        PULSE_COLUMN: of_pulse,
        "channel": channel,
        "ring": channel if places.rings is None else _look_up(places.rings, channel),
        "azimuth_rad": azimuth,
        "elevation_rad": elevation,
        "return_number": mi.UInt8(stop + 1) + dr.zeros(mi.UInt8, dr.width(lane)),
        "status": mi.UInt8(status),
        "true_range_m": dr.select(has_range, true_range, dr.inf),
        "incidence_angle_rad": dr.acos(ends.get("cos_incidence")),
        "reflectivity": ends.get("reflectivity"),
        "sun_angle_rad": dr.acos(dr.clip(ends.get("cos_sun"), -1.0, 1.0)),
        "in_shadow": mi.UInt8(dr.select((face >= 0) & ~ends.get("lit"), mi.UInt32(1), 0)),
        "body": body if places.bodies is None else _look_up(places.bodies, body, places.first_body),
        "class_id": class_id,
        "material": _look_up(world.face_material, face),
    }
    # Looked for here, where the numbers are at hand: NumPy would fetch all of them once more.
    # A true range is infinite where there is no surface.
    floats = [values for name, values in result.items() if isinstance(values, mi.Float) and name != "true_range_m"]
    is_finite = functools.reduce(operator.and_, map(dr.isfinite, [*xyz_m, *floats]))
    is_broken = ~is_finite | dr.isnan(result["true_range_m"])
    return result | {NAN_COLUMN: mi.UInt8(dr.select(is_broken, mi.UInt32(1), 0))}


def _vector_columns(ends: _Ends, turn: tuple[Lanes, ...]) -> dict[str, Any]:
    """Return the columns of normals and velocities, in the axes of the points.

    Args:
        turn: rotation from the sensor's axes, row by row
    """
    import drjit as dr

    vector_columns: dict[str, Any] = {}
    names = iter(OF_VECTORS)
    for name in ("normal", "velocity_m_s"):
        if getattr(ends.paths[0], name) is None:  # nothing moves
            x = y = z = dr.zeros(mitsuba().Float, dr.width(ends.index))
        else:
            x, y, z = (ends.get(name, axis) for axis in range(3))
        for row in range(0, 9, 3):
            vector_columns[next(names)] = turn[row] * x + turn[row + 1] * y + turn[row + 2] * z
    return vector_columns


def surface_columns(*, world: World, staged: Staged, twice: bool) -> tuple[dict[str, Any], int] | None:
    """Return columns of every pulse that met a surface, kept or not, on the device and not yet computed, and how many.

    The columns are pulse, outcome (an `Outcome`), snr, detection_probability, and the truth by attribute of PointCloud.
    For a pulse of several sub-echoes they are those of the strongest.

    Returns:
        None if no pulse met a surface. A single one is there twice, as in `kept_lanes.reported_lanes`.
    """
    import drjit as dr

    detection = staged.detection
    lane = dr.compress(detection.outcome != int(Outcome.NO_SURFACE))
    count = dr.width(lane) // (2 if twice else 1)
    if count == 0:
        return None
    lane = more_than_one(lane)

    def of_lane(values: Lanes) -> Any:
        return dr.gather(type(values), values, lane)

    source = None if detection.source is None else of_lane(detection.source)
    ends = _Ends.at_lanes(staged, lane, source)
    body = _look_up(world.face_body, ends.face)
    columns = {
        "pulse": of_lane(staged.pulse),
        "outcome": of_lane(detection.outcome),
        "snr": of_lane(detection.snr),
        "detection_probability": of_lane(detection.detection_probability),
        "true_range_m": ends.get("range_m"),
        "incidence_angle_rad": dr.acos(ends.get("cos_incidence")),
        "reflectivity": ends.get("reflectivity"),
        "body": body,
        "class_id": _look_up(world.body_class, body),
    }
    return columns, count


def _look_up(table: Array, index: Array, first: Lanes = 0) -> Any:
    """Look up (k,) entries of an Int32 table from place ``first`` on; the result is -1 where the index is -1."""
    import drjit as dr

    mi = mitsuba()
    return dr.select(index >= 0, dr.gather(mi.Int32, table, mi.UInt32(index + first), index >= 0), -1)
