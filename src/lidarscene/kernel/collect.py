"""Collect: what the stages left on the device in, the columns of the kept points out, as numpy.

Only kept points leave the device (docs/architecture.md, decision 2): they are counted, gathered there by a
second small kernel, and what follows from the pulse number alone is computed for them only.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..arrays import Array, is_drjit
from ..beams import reported
from ..hits import Hits
from ..returns import Detection
from ..sensor import Sensor
from .backend import mitsuba
from .world import World


ABSENT = {"radial_velocity_m_s": np.float32(0.0), "interactions": np.uint8(0), "ghost": np.uint8(0)}
"""Columns that only some worlds have, and what they hold in the others."""


def kept_lanes(detection: Detection) -> tuple[Any, Any] | None:
    """(k,) lane and stop number of every reported return, by pulse and then by stop, or None if k is 0."""
    import drjit as dr

    mi = mitsuba()
    stops = len(detection.stops)
    index = dr.compress(_interleaved([stop.reported for stop in detection.stops]))
    if dr.width(index) == 0:
        return None
    if stops == 1:
        return index, mi.UInt32(0)
    return index // stops, index % stops


def columns(
    *,
    world: World,
    sensor: Sensor,
    pulse: Any,
    hits: Hits,
    detection: Detection,
    lanes: tuple[Any, Any],
    turn: tuple[Array, ...],
    shift: tuple[Array, Array, Array],
) -> dict[str, Any]:
    """Columns of the kept points by attribute of PointCloud, on the device, not yet computed; none of
    `ABSENT` where nothing moves, or where nothing lets through or mirrors.

    sensor  with its numbers on the device
    pulse   (n,) pulse numbers of the chunk's lanes
    lanes   from `kept_lanes`
    turn    nine numbers, row by row, and shift three: sensor frame to the frame of the points
    """
    import drjit as dr

    mi = mitsuba()
    lane, stop = lanes
    stops = len(detection.stops)

    def of_lane(values: Any) -> Any:
        return dr.gather(type(values), values, lane)

    def of_stop(name: str) -> Any:
        values = _interleaved([getattr(one, name) for one in detection.stops])
        return dr.gather(type(values), values, lane * stops + stop)

    of_pulse = of_lane(pulse)
    range_m, face = of_stop("range_m"), of_lane(hits.face)
    azimuth, elevation = sensor.scanner.angles(of_pulse)
    rays = reported(sensor, pulse=of_pulse, origin_m=shift, rotation=turn)
    body = _where_known(world.face_body, face)
    counted = {
        "radial_velocity_m_s": hits.radial_velocity_m_s,
        "interactions": hits.interactions,
        "ghost": hits.mirrored,
    }
    given = {name: of_lane(values) for name, values in counted.items() if is_drjit(values)}
    if "interactions" in given:
        given["interactions"] = mi.UInt8(given["interactions"])
        given["ghost"] = mi.UInt8(dr.select(given["ghost"], mi.UInt32(1), 0))
    return given | {
        "xyz_m": dr.ravel(
            mi.Point3f(*(s + d * range_m for s, d in zip(rays.origin_m, rays.direction, strict=True)))
        ),
        "range_m": range_m,
        "intensity": of_stop("amplitude"),
        "snr": of_lane(detection.snr),
        "detection_probability": of_lane(detection.detection_probability),
        "time_s": of_pulse,  # single precision would lose nanoseconds: the caller makes it a time
        "channel": sensor.scanner.channel(of_pulse),
        "azimuth_rad": azimuth,
        "elevation_rad": elevation,
        "return_number": mi.UInt8(stop + 1) + dr.zeros(mi.UInt8, dr.width(lane)),
        "status": mi.UInt8(of_stop("status")),
        "true_range_m": dr.select(face >= 0, of_lane(hits.range_m), dr.inf),
        "incidence_angle_rad": dr.acos(of_lane(hits.cos_incidence)),
        "reflectivity": of_lane(hits.reflectivity),
        "sun_angle_rad": dr.acos(dr.clip(of_lane(hits.cos_sun), -1.0, 1.0)),
        "in_shadow": mi.UInt8(dr.select((face >= 0) & ~of_lane(hits.lit), mi.UInt32(1), 0)),
        "body": body,
        "class_id": _where_known(world.body_class, body),
        "material": _where_known(world.face_material, face),
    }


def surfaces(*, world: World, pulse: Any, hits: Hits, detection: Detection) -> dict[str, Any] | None:
    """Every pulse of a chunk that met a surface, kept or not, on the device, not yet computed; None if none did.

    pulse, outcome (an `Outcome`), snr and detection_probability, and the truth by attribute of PointCloud.
    """
    import drjit as dr

    lane = dr.compress(hits.found)
    if dr.width(lane) == 0:
        return None

    def of_lane(values: Any) -> Any:
        return dr.gather(type(values), values, lane)

    body = _where_known(world.face_body, of_lane(hits.face))
    return {
        "pulse": of_lane(pulse),
        "outcome": of_lane(detection.outcome),
        "snr": of_lane(detection.snr),
        "detection_probability": of_lane(detection.detection_probability),
        "true_range_m": of_lane(hits.range_m),
        "incidence_angle_rad": dr.acos(of_lane(hits.cos_incidence)),
        "reflectivity": of_lane(hits.reflectivity),
        "body": body,
        "class_id": _where_known(world.body_class, body),
    }


def _where_known(table: Any, index: Any) -> Any:
    """Entries of a table of whole numbers, -1 where the index is."""
    import drjit as dr

    mi = mitsuba()
    return dr.select(index >= 0, dr.gather(mi.Int32, table, mi.UInt32(index), index >= 0), -1)


def _interleaved(arrays: list[Any]) -> Any:
    """Arrays of n lanes each as one of n times their number: lane by lane, array after array within it."""
    import drjit as dr

    mi = mitsuba()
    if len(arrays) == 1:
        return arrays[0]
    count, lanes = len(arrays), max(dr.width(one) for one in arrays)
    place = dr.arange(mi.UInt32, lanes) * count
    together = dr.zeros(type(arrays[0]), lanes * count)
    for number, one in enumerate(arrays):
        dr.scatter(together, one, place + number)
    return together
