"""LiveSimulator: the caller places, adds and removes bodies and moves the ego vehicle between frames.

The world is compiled once, with every body that may ever be there. A body that can be placed is traced in its own
coordinates, like all that moves: its pose is numbers on the device, and no ray enters the box of a body that is away.
So nothing is compiled or built again, and a frame equals that of a scene file with the same poses.
"""

from __future__ import annotations

import math
import os
import re
from bisect import bisect_right
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from numbers import Real
from typing import ClassVar, TypedDict, Unpack

import numpy as np

from ..cloud.point_cloud import PointCloud
from ..errors import InputError, OptionWarning, one_line, warn
from ..files.arguments import checks_arguments
from ..kernel.device.gate import exclusive
from ..maths.pose import Pose
from ..maths.trajectory import ALWAYS, LARGEST_STEP_RAD, Course, HeldAtEnds, Motion, Riding, Spline
from ..scene.clearance import Clearance
from ..scene.scene import Body, Scene
from ..scene.scene_file import SceneChoice, load_scene
from ..sensor.pose_file import Placed, finite_numbers, to_pose
from ..sensor.sensor_model import Sensor
from .frame import TOLERANCE_S, frame_edges
from .render_options import NUMBERS, FrameKeywords, FrameOptions, Keywords, TraceKeywords, TraceOptions
from .simulator import Simulator

ROTATION_ERROR = 1e-5
"""Accuracy bought: largest error of a rotation's entries: those of a rotation in single precision, multiplied a few
times."""

_SHOWN = 8
"""Most names listed in an error."""


class MotionKeywords(TypedDict, total=False):
    """Motion of a body from a pose on. Without any of these it stands there.

    Attributes:
        velocity_m_s: (x, y, z) in the world
        yaw_rate_deg_s: about its own z axis, positive to the left
        time_s: time of the pose, by the clock of the scene's motions; 0 by default
    """

    velocity_m_s: tuple[float, float, float]
    yaw_rate_deg_s: float
    time_s: float


class LiveSimulator(Simulator):
    """A `Simulator` of a world that is changed between frames; nothing is compiled again.

    `render` and `stream` give the frame of their options, `advance` the frames that are over by the caller's clock.
    """

    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(
            ("step", "next", "run", "tick", "frames"), "live.advance(to_s=0.1) gives the frames until then"
        ),
        **dict.fromkeys(("move", "set_pose", "teleport"), 'live.place("car", pose)'),
        **dict.fromkeys(("ego", "set_ego", "set_ego_pose"), "live.move_ego(pose)"),
        **dict.fromkeys(("spawn", "create"), 'live.add("car", pose)'),
    }
    CHANGED_BY: ClassVar[str] = 'live.place("car", pose) and live.move_ego(pose) change what stands where'
    _takes_turns = False

    @checks_arguments
    def __init__(
        self,
        scene: SceneChoice,
        sensor: str | os.PathLike[str] | Sensor | None = None,
        trace: TraceOptions | None = None,
        *,
        movable: Iterable[str] = (),
        spares: Mapping[str, int] | None = None,
        pose: Placed | None = None,
        **options: Unpack[TraceKeywords],
    ) -> None:
        """Compile the scene.

        Args:
            movable: names of bodies that can be placed, besides those that have a motion in the scene
            spares: name of a body -> number of copies of it that can be added; the body itself can be placed, too

        Raises:
            InputError: for a name that no body of the scene has

        The other arguments are as for `Simulator`. The sensor rides on the ego vehicle, which stands at the world's
        origin if the scene has none.
        """
        built, self._pools = live_scene(load_scene(scene), movable, spares or {})
        super().__init__(built, sensor, trace, pose=pose, **options)
        self._number = {body.name: number for number, body in enumerate(built.bodies)}
        present = [replace(body, away=False) for body in built.bodies]
        self._everywhere = Clearance.of_scene(replace(built, bodies=tuple(present)))
        self._tracks: dict[str | None, PoseHistory] = {}  # None is the ego vehicle
        self._now_s, self._rendered = -math.inf, 0

    @exclusive
    def place(self, name: str, pose: Placed, **motion: Unpack[MotionKeywords]) -> None:
        """Place a body at this pose in the world from the next frame on, at rest or with a ``motion`` from there.

        Raises:
            InputError: for an unknown name, and for a body that cannot be placed or is away
        """
        self._require(name)
        course = _course(f"'{name}'", pose, motion)
        self._tracks.pop(name, None)
        self._change({name: course}, since_s=motion.get("time_s", 0.0))

    @exclusive
    def move_ego(self, pose: Placed, **motion: Unpack[MotionKeywords]) -> None:
        """Place the ego vehicle, with the sensor and all that is fixed to it, at this pose from the next frame on."""
        course = _course("ego", pose, motion)
        self._tracks.pop(None, None)
        self._change({None: course}, since_s=motion.get("time_s", 0.0))

    @exclusive
    def add(self, name: str, pose: Placed, **motion: Unpack[MotionKeywords]) -> str:
        """Add a spare copy of a body at a pose, as `place` does, or bring a body back; return its name.

        Raises:
            InputError: where no spare is left
        """
        _check_name(name)
        is_away = name in self._number and self._body(name).away
        if name not in self._pools and not is_away:
            originals = ", ".join(f"'{original}'" for original in self._pools) or "none"
            raise InputError(f"body '{name}': has no spares; bodies with spares: {originals}")
        free = name if is_away else next((copy for copy in self._pools[name] if self._body(copy).away), None)
        if free is None:
            count = len(self._pools[name]) - 1
            raise InputError(
                f"body '{name}': no spare is left, all {count} are there; spares={{'{name}': {count + 1}}} has one more"
            )
        self._change({free: _course(f"'{name}'", pose, motion)}, absence={free: False})
        return free

    @exclusive
    def remove(self, name: str) -> None:
        """Remove a body from the next frame on; `add` brings it back."""
        self._require(name)
        self._tracks.pop(name, None)
        self._change({}, absence={name: True})

    @exclusive
    def advance(
        self,
        to_s: float,
        poses: Mapping[str, Placed] | None = None,
        ego: Placed | None = None,
        frame: FrameOptions | None = None,
        **options: Unpack[FrameKeywords],
    ) -> list[PointCloud]:
        """Advance the caller's clock to this time, at which bodies have these poses, and render the frames now over.

        Between two poses a body moves with a constant twist; without a new pose it stays where it was. The first frame
        begins at ``begin_s`` and has the ``number`` of the options, later ones follow. A frame that cannot be rendered,
        since a body drives through the sensor, say, is left out with an `OptionWarning`; the next ones go on.

        Args:
            poses: name of a body -> its pose in the world
            ego: pose of the ego vehicle
            options: fields of `FrameOptions`, in place of those of ``frame``; they should be the same every time

        Raises:
            InputError: for a time that is not later than the last one, and as `place`; nothing has changed then
        """
        keywords = Keywords(options)
        frame_options = keywords.take(FrameOptions, frame)
        keywords.end()
        if not _is_finite(to_s) or not self._now_s < to_s:
            time_text = f"{to_s:g} s" if _is_finite(to_s) else one_line(to_s)
            raise InputError(f"advance: must be to a time later than {self._now_s:g} s, got {time_text}")
        if poses is not None and not isinstance(poses, Mapping):
            raise InputError(f"poses: must be a dict of names and poses, got {type(poses).__name__}")
        new_poses: dict[str | None, Pose] = {}
        for name, pose in (poses or {}).items():
            self._require(name)
            new_poses[name] = _checked_pose(f"'{name}'", pose)
        if ego is not None:
            new_poses[None] = _checked_pose("ego", ego)
        # A mistake raises before anything changes, so that the next call finds the world as it was.
        numbers, next_start_s = self._frames_over(frame_options, float(to_s))
        for key, pose in new_poses.items():
            self._tracks.get(key, PoseHistory()).check_turn(pose, key or "ego")
        self._now_s = float(to_s)
        for key, pose in new_poses.items():
            self._tracks.setdefault(key, PoseHistory()).append(self._now_s, pose)
        clouds: list[PointCloud] = []
        if numbers:
            self._change({key: track.motion() for key, track in self._tracks.items()}, since_s=next_start_s)
        for number in numbers:
            self._rendered += 1
            ahead, left = None, numbers.stop - number - 1
            if left:
                ahead = partial(self.begin, replace(frame_options, number=number + 1), left)
            try:
                clouds.append(self.render(replace(frame_options, number=number), ahead=ahead))
            except InputError as error:
                warn(OptionWarning("advance: frame {0} is left out: {1}", number, error))
        for track in self._tracks.values():
            track.forget(min(next_start_s, self._now_s))
        return clouds

    def _frames_over(self, options: FrameOptions, now_s: float) -> tuple[range, float]:
        """Numbers of the frames of `advance` that are over, and the start of the next one [s].

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        first = options.number + self._rendered
        # Not one by one from the first: a caller's clock may be off by years.
        passed = min((now_s - options.begin_s) / self.sensor.scanner.frame_s, NUMBERS.high + 1)
        number = max(first, int(passed) - 1)
        while True:
            start_s, end_s = frame_edges(self.sensor.scanner, number)
            if options.begin_s + end_s > now_s + TOLERANCE_S:
                return range(first, number), options.begin_s + start_s
            number += 1

    def _body(self, name: str) -> Body:
        return self.scene.bodies[self._number[name]]

    def _require(self, name: str) -> None:
        """Raise InputError unless a body of this name is present and can be placed."""
        _check_name(name)
        bodies = {body.name: body for body in self.scene.bodies}
        placeable = {key: body for key, body in bodies.items() if body.motion is not None and not body.away}
        if name in placeable:
            return
        if name not in bodies:
            why = "not in the scene"
        elif bodies[name].away:
            why = "is away, add brings it back"
        else:
            why = f"cannot be placed, movable=['{name}'] lets it"
        require_body(placeable, name, why, "bodies that can be placed")

    def _change(
        self, motions: Mapping[str | None, Motion], *, since_s: float = 0.0, absence: Mapping[str, bool] | None = None
    ) -> None:
        """Change the world: motions of bodies and of the ego vehicle (None), and whether bodies are away.

        Who walks goes on with the stride of the motion before, from the first of its poses or from ``since_s`` on.
        """
        bodies, before = list(self.scene.bodies), self.scene.ego
        ego = motions.get(None, before)
        # What is fixed to the ego vehicle goes with it.
        changed: dict[str | None, Motion] = {
            body.name: replace(body.motion, carrier=ego)
            for body in bodies
            if isinstance(body.motion, Riding) and body.motion.carrier is before and ego is not None
        }
        changed.update(motions)
        for name, motion in changed.items():
            if name is not None:
                body, gait = self._body(name), self._body(name).gait
                if gait is not None and body.motion is not None:
                    poses = motion.carrier if isinstance(motion, Riding) else motion
                    start_s = poses.motion.span_s[0] if isinstance(poses, HeldAtEnds) else since_s
                    gait = gait.continued(body.motion, motion, start_s)
                present_s = ALWAYS if name in motions else body.present_s
                bodies[self._number[name]] = replace(body, motion=motion, present_s=present_s, gait=gait)
        for name, absent in (absence or {}).items():
            bodies[self._number[name]] = replace(bodies[self._number[name]], away=absent)
        self._forget_launches()
        around = self._everywhere
        box_bodies = [bodies[self._number[body.name]] for body in around.bodies]
        present = np.array([not body.away for body in box_bodies], bool)
        clearance = Clearance(
            bodies=tuple(body for body in box_bodies if not body.away),
            boxes=around.boxes[present],
            around=around.around[present],
            blocks=around.blocks,
        )
        scene = replace(self.scene, bodies=tuple(bodies), ego=ego)
        vars(self).update(scene=scene, world=self.world.with_bodies(bodies), clearance=clearance)


@dataclass(slots=True)
class PoseHistory:
    """Last poses of a body, at rising times [s].

    Attributes:
        moved: whether it has ever moved
    """

    times_s: list[float] = field(default_factory=list)
    poses: list[Pose] = field(default_factory=list)
    moved: bool = False

    def check_turn(self, pose: Pose, name: str) -> None:
        """Raise InputError for a turn from the last pose to this one that is too large for a motion."""
        if not self.poses:
            return
        cosine = 0.5 * (float((self.poses[-1].rotation * pose.rotation).sum()) - 1.0)
        turn_rad = math.acos(min(max(cosine, -1.0), 1.0))
        if turn_rad > LARGEST_STEP_RAD:
            raise InputError(
                f"'{name}': the turn between two poses must be <= {math.degrees(LARGEST_STEP_RAD):.0f} degrees, got "
                f"{math.degrees(turn_rad):.1f}"
            )

    def append(self, time_s: float, pose: Pose) -> None:
        """Add the latest pose."""
        last = self.poses[-1] if self.poses else pose
        self.moved |= bool((last.position_m != pose.position_m).any() or (last.rotation != pose.rotation).any())
        self.times_s.append(time_s)
        self.poses.append(pose)

    def forget(self, before_s: float) -> None:
        """Drop the poses that no frame after this time needs; what rests since an earlier pose has it then, too."""
        first = max(bisect_right(self.times_s, before_s) - 1, 0)
        del self.times_s[:first], self.poses[:first]
        if len(self.times_s) == 1:
            self.times_s[0] = max(self.times_s[0], before_s)

    def motion(self) -> Motion:
        """Motion through the poses: a constant twist from each to the next, at rest before and after.

        One that never moved is at rest; one that waits is not, for labels.
        """
        if not self.moved:
            return Course(start=self.poses[0])
        # Of a single pose left, a motion from it to itself.
        times_s, poses = [*self.times_s, self.times_s[-1] + 1.0], (*self.poses, self.poses[-1])
        return HeldAtEnds(motion=Spline(time_s=np.array(times_s), poses=poses, smooth=False))


def live_scene(
    scene: Scene, movable: Iterable[str], spares: Mapping[str, int]
) -> tuple[Scene, dict[str, tuple[str, ...]]]:
    """Add an ego vehicle, placeable bodies and spare ones that are away to a scene; also name -> names of its copies.

    A placeable body has a motion: one at rest where the scene gives it none. Spare bodies come last, so that the others
    keep their numbers.

    Raises:
        InputError: for an unknown body, or a number of spares that is no whole number >= 0
    """
    if isinstance(movable, str):
        raise InputError(f"movable: must be several names, got '{movable}'")
    bodies = {body.name: body for body in scene.bodies}
    for name in (*movable, *spares):
        if (body := require_body(bodies, name)).motion is None:
            bodies[name] = replace(body, motion=Course(start=body.pose))
    pools: dict[str, tuple[str, ...]] = {}
    for name, count in spares.items():
        if not isinstance(count, int | np.integer) or isinstance(count, bool) or count < 0:
            raise InputError(f"spares: '{name}': must be a whole number >= 0, got {one_line(count)}")
        pools[name] = (name, *spare_names(name, int(count), bodies))
        for spare in pools[name][1:]:
            # The same parts: copies share the compiled meshes.
            bodies[spare] = replace(bodies[name], name=spare, away=True)
    return replace(scene, bodies=tuple(bodies.values()), ego=scene.ego or Course(), reach_m=math.inf), pools


def spare_names(name: str, count: int, existing: Iterable[str]) -> list[str]:
    """Find names for copies of a body "car" or "car.0" that no other body has: "car.1", "car.2", ..."""
    names: list[str] = []
    number, existing, base = 1, set(existing), re.sub(r"\.\d+$", "", name)
    while len(names) < count:
        if (candidate := f"{base}.{number}") not in existing:
            names.append(candidate)
        number += 1
    return names


def _check_name(name: object) -> None:
    """Raise InputError for what is no name: some values cannot even be looked up."""
    if not isinstance(name, str):
        raise InputError(f"body: must be a name, got {one_line(name)}")


def require_body(
    bodies: Mapping[str, Body], name: str, why: str = "not in the scene", listed: str = "its bodies"
) -> Body:
    """Look up a body by name.

    Raises:
        InputError: with ``why``, and the names there are, where it is missing
    """
    if name in bodies:
        return bodies[name]
    names = [f"'{key}'" for key in bodies]
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    raise InputError(f"body '{name}': {why}; {listed}: {(', '.join(names[:_SHOWN]) or 'none') + more}")


def _course(subject: str, pose: Placed, motion: MotionKeywords) -> Course:
    """Motion from a pose on.

    Raises:
        InputError: for a keyword or number that is none of `MotionKeywords`
    """
    for keyword in motion:
        if keyword not in MotionKeywords.__annotations__:
            keywords = ", ".join(MotionKeywords.__annotations__)
            raise InputError(f"{subject}: unknown keyword '{keyword}'; a motion has {keywords}")
    velocity_m_s = motion.get("velocity_m_s", (0.0, 0.0, 0.0))
    velocity = finite_numbers(velocity_m_s)
    if len(velocity) != 3:
        raise InputError(f"{subject}: velocity_m_s must be three finite numbers, got {one_line(velocity_m_s)}")
    yaw_rate_deg_s, time_s = motion.get("yaw_rate_deg_s", 0.0), motion.get("time_s", 0.0)
    for keyword, number in (("yaw_rate_deg_s", yaw_rate_deg_s), ("time_s", time_s)):
        if not _is_finite(number):
            raise InputError(f"{subject}: {keyword} must be a finite number, got {one_line(number)}")
    x, y, z = velocity
    return Course(
        start=_checked_pose(subject, pose),
        velocity_m_s=(x, y, z),
        yaw_rate_rad_s=math.radians(yaw_rate_deg_s),
        since_s=float(time_s),
    )


def _is_finite(number: object) -> bool:
    try:
        return isinstance(number, Real) and math.isfinite(number)
    except OverflowError:  # of a whole number beyond those of float
        return False


def _checked_pose(subject: str, pose: Placed) -> Pose:
    """Convert to a `Pose`.

    Raises:
        InputError: for numbers that are not finite, or a matrix that is no rotation
    """
    checked = to_pose(pose)
    turn = checked.rotation
    square = np.isfinite(turn).all() and np.abs(turn @ turn.T - np.eye(3)).max() < ROTATION_ERROR
    if not (np.isfinite(checked.position_m).all() and square and np.linalg.det(turn) > 0.0):
        raise InputError(
            f"{subject}: its pose must be finite numbers and a rotation, got {checked.position_m.tolist()} and "
            f"{turn.tolist()}"
        )
    return checked
