"""Collect: what the stages left on the device in, the columns of the kept points out, as numpy.

Only kept points leave the device (docs/architecture.md, decision 2): they are counted, gathered there by a
second small kernel, and what follows from the pulse number alone is computed for them only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...detection.returns import Detection, Outcome, Status
from ...light.beams import reported
from ...light.hits import Hits
from ...maths.arrays import Lanes, Numbers, inverse, is_drjit, xp
from ...sensor.model import Sensor
from ..device import transfer
from ..device.backend import mitsuba
from ..world.build import World

ABSENT: dict[str, Any] = {
    "radial_velocity_m_s": np.float32(0.0),
    "interactions": np.uint8(0),
    "ghost": np.uint8(0),
    "pulse_width_s": np.float32(0.0),
}
"""Columns that only some worlds or sensors have, and what they hold in the others."""


def lanes_where(flag: Any) -> Any:
    """(k,) lanes at which a flag is set, or None if none is."""
    import drjit as dr

    lanes = dr.compress(flag)
    return None if dr.width(lanes) == 0 else lanes


def more_than_one(lanes: Any) -> tuple[Any, Any]:
    """The lanes, a single one twice, and then which of the two to leave out, or None: Dr.Jit takes an array of one for
    a number, and would compile all stages again for it. The second counts, so that what it says is written last.
    """
    import drjit as dr

    mi = mitsuba()
    if dr.width(lanes) > 1:
        return lanes, None
    return dr.gather(mi.UInt32, lanes, dr.zeros(mi.UInt32, 2)), dr.arange(mi.UInt32, 2) == 0


def gathered(values: Any, lanes: Any) -> Any:
    """Entries of these lanes, computed."""
    import drjit as dr

    found = dr.gather(type(values), values, lanes)
    dr.eval(found)
    return found


def any_of_pulse(flag: Any, rays: int) -> Any:
    """Whether it is set for any of the rays of each pulse."""
    ops = xp(flag)
    found = ops.column(flag, 0, rays)
    for ray in range(1, rays):
        found = found | ops.column(flag, ray, rays)
    return found


def kept_lanes(detection: Detection, lane_of: Any = None) -> tuple[Any, Any] | None:
    """(k,) lane and stop number of every reported return, by pulse and then by stop, or None if k is 0.

    lane_of  (n,) lane of each pulse where lanes are not by pulse
    """
    import drjit as dr

    mi = mitsuba()
    stops = len(detection.stops)
    reported = [stop.reported for stop in detection.stops]
    if lane_of is not None:
        reported = [dr.gather(mi.Bool, one, lane_of) for one in reported]
    index = dr.compress(_interleaved(reported))
    if dr.width(index) == 0:
        return None
    place, stop = (index, mi.UInt32(0)) if stops == 1 else (index // stops, index % stops)
    return (place if lane_of is None else dr.gather(mi.UInt32, lane_of, place)), stop


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Ends:
    """The surfaces that some returns come from.

    paths      Hits by each way of the light, lane = pulse lane * rays + ray
    index      (k,) lane in them
    path       (k,) which of them, or None: there is only one
    known      (k,) whether there is such a surface
    """

    paths: Sequence[Hits]
    index: Any
    path: Any
    known: Any

    @classmethod
    def of(cls, paths: Sequence[Hits], rays: int, lane: Any, source: Any) -> _Ends:
        """Of pulse lanes and the numbers of sub-echoes (None: there is one to a pulse)."""
        import drjit as dr

        mi = mitsuba()
        if source is None:
            return cls(paths=paths, index=lane, path=None, known=dr.full(mi.Mask, True, dr.width(lane)))
        known = (source >= 0) & (source < rays * len(paths))
        number = mi.UInt32(dr.select(known, source, 0))
        path = number // rays
        return cls(paths=paths, index=lane * rays + number - path * rays, path=path, known=known)

    def get(self, name: str) -> Any:
        """An attribute of the hits; zero where there is no surface."""
        import drjit as dr

        values = None
        for number, hits in enumerate(self.paths):
            here = self.known if len(self.paths) == 1 else self.known & (self.path == number)
            array = getattr(hits, name)
            part = dr.gather(type(array), array, self.index, here)
            values = part if values is None else dr.select(here, part, values)
        return values

    @property
    def face(self) -> Any:
        """Faces, -1 where there is none."""
        import drjit as dr

        return dr.select(self.known, self.get("face"), -1)


def columns(
    *,
    world: World,
    sensor: Sensor,
    pulse: Any,
    paths: Sequence[Hits],
    rays: int,
    detection: Detection,
    air_classes: Any,
    lanes: tuple[Any, Any],
    turn: tuple[Lanes, ...],
    shift: tuple[Lanes, Lanes, Lanes],
) -> dict[str, Any]:
    """Columns of the kept points by attribute of PointCloud, on the device, not yet computed, xyz_m a Point3f; none of
    `ABSENT` where nothing moves, where nothing lets through or mirrors, or where widths are not measured.

    sensor       with its numbers on the device
    pulse        (n,) pulse numbers of the chunk's lanes
    paths, rays  what the rays of each pulse met, lane = pulse lane * rays + ray
    air_classes  class of light of the air, and of each sub-echo of the air, or None in clear air
    lanes        from `kept_lanes`
    turn         nine numbers, row by row, and shift three: sensor frame to the frame of the points
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

    def own(name: str) -> Any:
        """Of the return, or of the pulse where one echo stands for it."""
        return of_lane(getattr(detection, name)) if detection.source is None else of_stop(name)

    of_pulse, range_m = of_lane(pulse), of_stop("range_m")
    source = None if detection.source is None else of_stop("source")
    ends = _Ends.of(paths, rays, lane, source)
    face, status = ends.face, of_stop("status")
    azimuth, elevation = sensor.scanner.angles(of_pulse)
    beams = reported(sensor, pulse=of_pulse, origin_m=shift, rotation=turn)
    body = _where_known(world.face_body, face)
    class_id = _where_known(world.body_class, body)
    true_range = ends.get("range_m") if source is None else of_stop("true_range_m")
    has_range = face >= 0
    if air_classes is not None and source is not None:
        of_air = status == int(Status.WEATHER)
        number = dr.select(source < 0, 0, source - rays * len(paths) + 1)
        class_id = dr.select(of_air, dr.gather(mi.Int32, air_classes, mi.UInt32(number), of_air), class_id)
        has_range |= of_air
    given = {
        column: ends.get(name)
        for column, name in (("radial_velocity_m_s",) * 2, ("interactions",) * 2, ("ghost", "mirrored"))
        if is_drjit(getattr(paths[0], name))
    }
    if "ghost" in given:
        given["interactions"] = mi.UInt8(given["interactions"])
        given["ghost"] = mi.UInt8(dr.select(given["ghost"], mi.UInt32(1), 0))
    if sensor.measures_width:
        given["pulse_width_s"] = of_stop("width_s")
    return given | {
        "xyz_m": mi.Point3f(*(s + d * range_m for s, d in zip(beams.origin_m, beams.direction, strict=True))),
        "range_m": range_m,
        "intensity": of_stop("intensity"),
        "snr": own("snr"),
        "detection_probability": own("detection_probability"),
        "ambient": of_lane(detection.ambient),
        "time_s": of_pulse,  # single precision would lose nanoseconds: the caller makes it a time
        "channel": sensor.scanner.channel(of_pulse),
        "azimuth_rad": azimuth,
        "elevation_rad": elevation,
        "return_number": mi.UInt8(stop + 1) + dr.zeros(mi.UInt8, dr.width(lane)),
        "status": mi.UInt8(status),
        "true_range_m": dr.select(has_range, true_range, dr.inf),
        "incidence_angle_rad": dr.acos(ends.get("cos_incidence")),
        "reflectivity": ends.get("reflectivity"),
        "sun_angle_rad": dr.acos(dr.clip(ends.get("cos_sun"), -1.0, 1.0)),
        "in_shadow": mi.UInt8(dr.select((face >= 0) & ~ends.get("lit"), mi.UInt32(1), 0)),
        "body": body,
        "class_id": class_id,
        "material": _where_known(world.face_material, face),
    }


def one_by_one(columns: dict[str, Any]) -> dict[str, Any]:
    """`columns` with x, y, z of each point after each other."""
    import drjit as dr

    return columns | {"xyz_m": dr.ravel(columns["xyz_m"])}


def by_pulse(parts: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Several `columns` as one, by pulse, `one_by_one`; returns of one pulse are all of one part, and in order."""
    import drjit as dr

    mi = mitsuba()
    pulses = [columns["time_s"] for columns in parts]
    dr.eval(*pulses)
    places = [transfer.unsigned_numbers(place) for place in _merged([one.numpy() for one in pulses])]
    count = sum(dr.width(place) for place in places)
    known = {name: values for columns in reversed(parts) for name, values in columns.items()}
    joined = {
        name: dr.empty(mi.Float, 3 * count) if name == "xyz_m" else dr.empty(type(values), count)
        for name, values in known.items()
    }
    # Part by part: what is written into one array twice is written by two kernels.
    for columns, place in zip(parts, places, strict=True):
        for name, room in joined.items():
            if name == "xyz_m":
                for axis, values in enumerate(columns[name]):
                    dr.scatter(room, values, 3 * place + axis)
            else:
                values = columns[name] if name in columns else type(room)(ABSENT[name].item())
                dr.scatter(room, values, place)
    return joined


def _merged(pulses: Sequence[Numbers]) -> list[Numbers]:
    """Where each element of several lists goes in all of them together, sorted; what is equal keeps its order."""
    order = np.argsort(np.concatenate(pulses), kind="stable")
    return np.split(inverse(order), np.cumsum([len(one) for one in pulses])[:-1])


def surfaces(
    *, world: World, pulse: Any, paths: Sequence[Hits], rays: int, detection: Detection
) -> dict[str, Any] | None:
    """Every pulse of a chunk that met a surface, kept or not, on the device, not yet computed; None if none did.

    pulse, outcome (an `Outcome`), snr and detection_probability, and the truth by attribute of PointCloud: of a pulse
    of several sub-echoes that of the strongest.
    """
    import drjit as dr

    lane = dr.compress(detection.outcome != int(Outcome.NO_SURFACE))
    if dr.width(lane) == 0:
        return None

    def of_lane(values: Any) -> Any:
        return dr.gather(type(values), values, lane)

    source = None if detection.source is None else of_lane(detection.source)
    ends = _Ends.of(paths, rays, lane, source)
    body = _where_known(world.face_body, ends.face)
    return {
        "pulse": of_lane(pulse),
        "outcome": of_lane(detection.outcome),
        "snr": of_lane(detection.snr),
        "detection_probability": of_lane(detection.detection_probability),
        "true_range_m": ends.get("range_m"),
        "incidence_angle_rad": dr.acos(ends.get("cos_incidence")),
        "reflectivity": ends.get("reflectivity"),
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
