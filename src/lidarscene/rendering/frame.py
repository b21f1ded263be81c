"""Frame: the pulses of one frame, their times, and the poses of the sensor and of moving bodies at these times.

All that depends on time is decided here, before the device starts: the stages get arrays of poses and times, never a
motion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..cloud.deskew import SHORTEST_S
from ..errors import InputError
from ..kernel.device import transfer
from ..kernel.rays.kept_lanes import NO_PULSE
from ..kernel.world.mitsuba_world import World, fixed_placement, motions_on_device, mover_boxes
from ..maths.arrays import Array, Numbers, xp
from ..maths.motion_table import MotionTable, MovingBodies, Placement, Travel
from ..maths.pose import Pose
from ..maths.random import ROLLOVERS, Seed
from ..maths.trajectory import CLOCK_ROUNDING_S, Course, Motion, Riding, motion_in_frame, poses_over
from ..scan import Scanner
from ..scan.clock import PulseClock
from ..scene.scene import Body, Scene
from ..sensor.sensor_model import Sensor
from .render_options import NUMBERS, FrameOptions

PULSE_NUMBERS = NO_PULSE
"""Pulse numbers on the device are below this: as many whole frames as fit, then they begin again at 0 (a rollover)."""

TOLERANCE_S = CLOCK_ROUNDING_S
"""A trajectory that ends this much early still lasts to the end of a frame: 30 um at 30 m/s."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """One frame of a scanner, as the device needs it.

    Attributes:
        number: number of the frame
        rollover: how often the pulse numbers have begun again before it
        first_pulse: number of its first pulse since then
        scanner_s: time at which the first pulse leaves, by the scanner's clock
        start_s: the same time by the scene's clock, in which motions are given
        length_s: from its first pulse to its last
        place: pose of the sensor in the world at the start
        vehicle: pose of the ego vehicle in the world at the start
        paths: sampled poses of the sensor (0) and of the world's movers (1, ...); None: nothing moves
        moves: whether the sensor moves
        movers: bodies in the places of the world's movers
        bodies: `World.bodies_in_frame`
    """

    number: int
    rollover: int
    first_pulse: int
    scanner_s: float
    start_s: float
    length_s: float
    place: Pose
    vehicle: Pose
    paths: MotionTable | None
    moves: bool
    movers: Sequence[Body]
    bodies: Numbers | None
    _scanner: Scanner
    _centre_m: Numbers

    @classmethod
    def from_options(
        cls, scene: Scene, sensor: Sensor, world: World, options: Sequence[FrameOptions], *, pose: Pose
    ) -> list[Frame]:
        """Build the frames that ``options`` choose, with the sensor at a pose.

        Raises:
            InputError: where a motion does not last as long as a frame, or a frame's number is too high
        """
        riding, frames, travels = sensor_motion(scene, sensor, pose), [], []
        edges = [check_frame(scene, sensor.scanner, number=own.number, begin_s=own.begin_s) for own in options]
        starts_s = [own.begin_s + scanner_s for own, (scanner_s, _) in zip(options, edges, strict=True)]
        vehicles = poses_over(scene.ego or Course(), np.array(starts_s))
        for own, (scanner_s, length_s), start_s, vehicle in zip(options, edges, starts_s, vehicles, strict=True):
            rollover, since = divmod(own.number, _frames_numbered(sensor.scanner))
            movers = [mover.in_frame(start_s) for mover in world.movers]
            travels.append(
                Travel(
                    motions=[riding, *(_motion_of(mover.body, start_s) for mover in movers)],
                    start_s=start_s,
                    length_s=length_s,
                    centre_m=world.centre_m,
                    carried_m=mover_boxes(movers, start_s),
                    walks=[mover.walk_in_frame(start_s) for mover in movers],
                )
            )
            frames.append(
                cls(
                    number=own.number,
                    rollover=rollover,
                    first_pulse=since * sensor.scanner.pulses,
                    scanner_s=scanner_s,
                    start_s=start_s,
                    length_s=length_s,
                    place=vehicle @ riding.pose,
                    vehicle=vehicle,
                    paths=None,
                    moves=scene.ego is not None,
                    movers=[mover.body for mover in movers],
                    bodies=world.bodies_in_frame(start_s),
                    _scanner=sensor.scanner,
                    _centre_m=world.centre_m,
                )
            )
        if scene.ego is None and not world.movers:
            return frames
        # Poses at the times of all pulses would be large. So each path is sampled once a frame, and the device
        # interpolates between the samples (`maths.motion_table`).
        tables = MotionTable.of_frames(travels)
        return [replace(frame, paths=paths) for frame, paths in zip(frames, tables, strict=True)]

    def standing(self) -> dict[Motion, tuple[Numbers, Numbers]]:
        """Places and rotations of the bodies that move and that the frame shows, as it begins, by their motions."""
        if self.paths is None:
            return {}
        places_m, rotations = self.paths.at_start()
        rows = zip(self.movers, places_m[1:] + self._centre_m, rotations[1:], strict=True)
        shown = ((body.motion, *place) for body, *place in rows if body.is_present(self.start_s))
        return {motion: (place_m, rotation) for motion, place_m, rotation in shown if motion}

    def goes_with(self, other: Frame) -> bool:
        """Whether its pulses and those of another frame can be traced together."""
        if self.rollover != other.rollover:
            return False
        return self.paths is None or (other.paths is not None and self.paths.goes_with(other.paths))

    def on_device(self, *later: Frame) -> Frame:
        """Return the frame with its paths on the device, and those of the frames that follow it behind them."""
        if self.paths is None:
            return self
        paths = [frame.paths for frame in (self, *later) if frame.paths is not None]
        return replace(self, paths=motions_on_device(MotionTable.joined(paths)))

    @property
    def origin(self) -> Placement:
        """``place`` in traced coordinates, on the device; holds for all pulses unless the sensor moves."""
        return fixed_placement(self.place, self._centre_m)

    @property
    def phase(self) -> tuple[Any, ...]:
        """`Scanner.phase` of pulse 0 since the rollover, on the device."""
        return tuple(map(transfer.opaque, self._scanner.phase(self._earlier_pulses)))

    def seed_words(self, seed: int) -> Seed:
        """Key of the frame's random numbers, on the device."""
        return transfer.seed_word(seed), transfer.opaque_uint32(self.rollover)

    def pulses_in_run(self, pulse: Numbers) -> Numbers:
        """Numbers of pulses of the frame counted from frame 0, (n,) int64, from those since the rollover."""
        return np.add(pulse, self._earlier_pulses, dtype=np.int64)

    @property
    def _earlier_pulses(self) -> int:
        """Pulses from frame 0 to the rollover."""
        return self.number * self._scanner.pulses - self.first_pulse

    @property
    def before(self) -> float:
        """`PulseClock.before` of pulse 0 since the rollover."""
        return self._scanner.clock.before(self._earlier_pulses)

    def departures(self, pulse: Array, clock: PulseClock) -> tuple[Any, Any]:
        """Times [s] since the first pulse of their frame at which these pulses leave, (n,) on the device.

        Args:
            pulse: (n,) numbers on the device; `NO_PULSE` leaves with the first pulse
            clock: the scanner's, on the device

        Returns:
            the times, and the number of the frame, counted from this one
        """
        # Counted from the first frame's start: the same bits in every frame, so that they can be kept. Single precision
        # is enough for times within a frame: 0.1 s to 7 ns, in which nothing goes anywhere.
        ops = xp(pulse)
        since = ops.where(pulse >= NO_PULSE, 0, ops.int32(pulse) - transfer.opaque(self.first_pulse))
        number, place = ops.divmod(since, transfer.opaque(self._scanner.pulses))
        start_s = clock.time_s(transfer.whole_numbers([0]))
        return ops.float32(clock.time_s(place) - start_s), number

    def placements(
        self, departures: Callable[[], tuple[Any, Any]], rays: int = 1
    ) -> tuple[Placement, MovingBodies | None]:
        """`placements` of the sensor and of the movers, for pulses of ``rays`` rays each.

        Args:
            departures: gives `departures` of the pulses; called only where something moves
        """
        leaving = None if self.paths is None else departures()
        return placements(self.origin, self.paths, leaving, rays, moves=self.moves)

    def goal(self, coordinates: str) -> Pose:
        """Pose of the sensor at the start in the coordinates of the points: "world", "vehicle" or "sensor"."""
        if coordinates == "sensor":
            return Pose()
        return self.place if coordinates == "world" else self.vehicle.inverse() @ self.place


_REST = Course()


def _motion_of(body: Body, start_s: float) -> Motion:
    """Return the motion of a body in a frame; at rest for one that the frame does not show: a ride takes time."""
    return motion_in_frame(body.motion, start_s) if body.motion and body.is_present(start_s) else _REST


def placements(
    origin: Placement, paths: MotionTable | None, departures: tuple[Any, Any] | None, rays: int, *, moves: bool
) -> tuple[Placement, MovingBodies | None]:
    """Placements of the sensor and of the movers, for pulses of ``rays`` rays each.

    Args:
        origin: placement of the sensor unless it ``moves``
        departures: `Frame.departures` of the pulses

    Returns:
        the latter None where nothing but the sensor moves
    """
    if paths is None or departures is None:
        return origin, None
    time_s, number = departures if rays == 1 else (transfer.repeat_lanes(values, rays)[0] for values in departures)
    paths = paths.of_frame(number)
    movers = None if paths.boxes is None else MovingBodies(motions=paths, time_s=time_s)
    return paths.placement(time_s, 0) if moves else origin, movers


def sensor_motion(scene: Scene, sensor: Sensor, sensor_pose: Pose) -> Riding:
    """Motion of the sensor: it rides on the ego vehicle at ``sensor_pose``, and its mounting is applied there."""
    return Riding(carrier=scene.ego or Course(), pose=sensor_pose @ sensor.mounting)


def check_frame(scene: Scene, scanner: Scanner, *, number: int, begin_s: float) -> tuple[float, float]:
    """Compute the time of a frame's first pulse by the scanner's clock, and from it to the last pulse [s].

    Raises:
        InputError: where a motion does not last as long as the frame, or the frame's number is too high
    """
    scanner_s, end_s = frame_edges(scanner, number)
    _check_spans(scene, begin_s + scanner_s, begin_s + end_s)
    return scanner_s, max(end_s - scanner_s, SHORTEST_S)


def frame_edges(scanner: Scanner, number: int) -> tuple[float, float]:
    """Times of a frame's first and last pulse by the scanner's clock [s].

    Raises:
        InputError: for a number too high
    """
    highest = min(NUMBERS.high, ROLLOVERS * _frames_numbered(scanner) - 1)
    if not 0 <= number <= highest:
        raise InputError(f"frame number: must be from 0 to {highest}, got {number}")
    # The last pulse leaves before the frame ends: a motion needs to last only that long.
    edges = number * scanner.pulses + np.array([0, scanner.pulses - 1], dtype=np.int64)
    first_s, last_s = (float(t) for t in scanner.time_s(edges))
    return first_s, last_s


def _frames_numbered(scanner: Scanner) -> int:
    """Frames from one rollover to the next."""
    return PULSE_NUMBERS // scanner.pulses


def _check_spans(scene: Scene, start_s: float, end_s: float) -> None:
    moving = [body for body in scene.bodies if body.motion is not None]
    motions = [("ego", scene.ego), *((f"body '{body.name}'", body.motion) for body in moving)]
    for name, motion in motions:
        if motion is None:
            continue
        # Rounding of clocks that began in 1970 is no mistake of the scene.
        first, last = motion.span_s
        if start_s < first - TOLERANCE_S or end_s > last + TOLERANCE_S:
            covered, needed = (f"{_seconds(a)} to {_seconds(b)} s" for a, b in ((first, last), (start_s, end_s)))
            raise InputError(
                f"scene '{scene.name}': motion of {name}: must have poses for the frame, {needed}, got {covered}"
            )


def _seconds(time_s: float) -> str:
    """Text of a time to a microsecond: its clock may have begun in 1970."""
    return f"{round(time_s, 6):.16g}"
