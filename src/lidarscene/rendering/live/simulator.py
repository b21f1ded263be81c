"""LiveSimulator: bodies and the ego vehicle are where the caller says, from frame to frame.

The world is compiled once, with every body that may ever be there. A body that can be placed is traced in its own
frame, as all that moves: where it stands is numbers on the device, and no ray passes the box of one that is away. So
nothing is compiled or built again, and a frame is that of a scene file with the same poses.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TypedDict, Unpack

import numpy as np

from ...cloud.point_cloud import PointCloud
from ...errors import InputError
from ...maths.pose import Pose
from ...maths.trajectory import Course, Motion, Riding
from ...scene.clearance import Clearance
from ...scene.scene import Body, Scene
from ...scene.scene_file import load_scene
from ...sensor.model import Sensor
from ..frame import TOLERANCE_S, frame_edges
from ..options import FrameKeywords, FrameOptions, Keywords, Placed, TraceKeywords, TraceOptions, placed
from ..simulator import Simulator
from .bodies import known, live_scene
from .tracks import Track

ROTATION_ERROR = 1e-5
"""Largest error of a rotation's entries: those of a rotation in single precision, multiplied a few times."""


class MotionKeywords(TypedDict, total=False):
    """How a body goes on from a pose. Without any of these it stands there.

    velocity_m_s    (x, y, z) in the world
    yaw_rate_deg_s  about its own z axis, positive to the left
    time_s          when it is at the pose, by the clock of the scene's motions; 0 if it is not given
    """

    velocity_m_s: tuple[float, float, float]
    yaw_rate_deg_s: float
    time_s: float


class LiveSimulator(Simulator):
    """A `Simulator` of a world that is changed between frames; nothing is compiled again.

    `render` and `stream` give the frame that they are asked for, `advance` those that are over by the caller's clock.
    """

    def __init__(
        self,
        scene: str | os.PathLike[str] | Scene,
        sensor: str | os.PathLike[str] | Sensor | None = None,
        trace: TraceOptions | None = None,
        *,
        movable: Iterable[str] = (),
        spares: Mapping[str, int] | None = None,
        pose: Placed | None = None,
        **options: Unpack[TraceKeywords],
    ) -> None:
        """Compile the scene.

        movable  names of bodies that can be placed, besides those that have a motion in the scene
        spares   by name of a body, how many copies of it can be added; it can be placed, too
        others   as of `Simulator`. The sensor rides on the ego vehicle, which stands at the world's origin if the
                 scene has none
        Raises InputError for a name that is no body of the scene.
        """
        built, self._pools = live_scene(load_scene(scene), movable, spares or {})
        super().__init__(built, sensor, trace, pose=pose, **options)
        self._number = {body.name: number for number, body in enumerate(built.bodies)}
        there = [replace(body, away=False) for body in built.bodies]
        self._everywhere = Clearance.of_scene(replace(built, bodies=tuple(there)))
        self._tracks: dict[str | None, Track] = {}  # None is the ego vehicle
        self._now_s, self._rendered = -math.inf, 0

    def place(self, name: str, pose: Placed, **motion: Unpack[MotionKeywords]) -> None:
        """From the next frame on the body stands at this pose in the world, or goes on from it.

        Raises InputError for a name that is none, and for a body that cannot be placed or is away.
        """
        self._require(name)
        self._tracks.pop(name, None)
        self._change({name: _course(f"'{name}'", pose, **motion)})

    def move_ego(self, pose: Placed, **motion: Unpack[MotionKeywords]) -> None:
        """From the next frame on the ego vehicle stands at this pose, with the sensor and all that is fixed to it."""
        self._tracks.pop(None, None)
        self._change({None: _course("ego", pose, **motion)})

    def add(self, name: str, pose: Placed, **motion: Unpack[MotionKeywords]) -> str:
        """Add a spare copy of a body, as `place` has it, and return the copy's name.

        Raises InputError where no spare is left.
        """
        if name not in self._pools:
            known_ones = ", ".join(f"'{one}'" for one in self._pools) or "none"
            raise InputError(f"body '{name}': has no spares; bodies with spares: {known_ones}")
        free = next((one for one in self._pools[name] if self._body(one).away), None)
        if free is None:
            count = len(self._pools[name]) - 1
            raise InputError(
                f"body '{name}': no spare is left, all {count} are there; spares={{'{name}': {count + 1}}} has one more"
            )
        self._change({free: _course(f"'{name}'", pose, **motion)}, away={free: False})
        return free

    def remove(self, name: str) -> None:
        """From the next frame on the body is not there. `add` brings it back if it has spares, or is one."""
        self._require(name)
        self._tracks.pop(name, None)
        self._change({}, away={name: True})

    def advance(
        self,
        to_s: float,
        poses: Mapping[str, Placed] | None = None,
        ego: Placed | None = None,
        frame: FrameOptions | None = None,
        **options: Unpack[FrameKeywords],
    ) -> list[PointCloud]:
        """The caller's clock went on to this time, and bodies are at these poses now. Returns the frames that are over.

        Between two poses a body turns and slides evenly; one that is given no more stays where it was. The first frame
        begins at ``begin_s`` and has the ``number`` of the options, later ones follow.

        poses    in the world, by name of the body
        ego      of the ego vehicle
        options  fields of `FrameOptions`, in place of those of ``frame``; they should be the same every time
        Raises InputError for a time that is not later than the last one, and as `place`.
        """
        keywords = Keywords(options)
        asked = keywords.take(FrameOptions, frame)
        keywords.end()
        if not self._now_s < to_s < math.inf:
            raise InputError(f"advance: must be to a time later than {self._now_s:g} s, got {to_s:g} s")
        given: dict[str | None, Pose] = {}
        for name, pose in (poses or {}).items():
            self._require(name)
            given[name] = _checked(f"'{name}'", pose)
        if ego is not None:
            given[None] = _checked("ego", ego)
        self._now_s = float(to_s)
        for key, pose in given.items():
            self._tracks.setdefault(key, Track()).append(self._now_s, pose)
        clouds: list[PointCloud] = []
        while self._edges_s(asked)[1] <= self._now_s + TOLERANCE_S:
            if not clouds:
                self._change({key: track.motion(key or "ego") for key, track in self._tracks.items()})
            clouds.append(self.render(replace(asked, number=asked.number + self._rendered)))
            self._rendered += 1
        for track in self._tracks.values():
            track.forget(self._edges_s(asked)[0])
        return clouds

    def _edges_s(self, asked: FrameOptions) -> tuple[float, float]:
        """When the next frame of `advance` begins and ends."""
        first_s, last_s = frame_edges(self.sensor.scanner, asked.number + self._rendered)
        return asked.begin_s + first_s, asked.begin_s + last_s

    def _body(self, name: str) -> Body:
        return self.scene.bodies[self._number[name]]

    def _require(self, name: str) -> None:
        """Raise InputError unless a body of this name is there, and can be placed."""
        bodies = {body.name: body for body in self.scene.bodies}
        able = {one: body for one, body in bodies.items() if body.motion is not None and not body.away}
        if name in able:
            return
        if name not in bodies:
            why = "not in the scene"
        elif bodies[name].away:
            why = "is away, add brings it back"
        else:
            why = f"cannot be placed, movable=['{name}'] lets it"
        known(able, name, why, "bodies that can be placed")

    def _change(self, motions: Mapping[str | None, Motion], *, away: Mapping[str, bool] | None = None) -> None:
        """Give bodies, and the ego vehicle (None), these motions; say which are there."""
        bodies, before = list(self.scene.bodies), self.scene.ego
        ego = motions.get(None, before)
        for number, body in enumerate(bodies):
            # What is fixed to the ego vehicle goes with it.
            if isinstance(body.motion, Riding) and body.motion.carrier is before and ego is not None:
                bodies[number] = replace(body, motion=replace(body.motion, carrier=ego))
        for name, motion in motions.items():
            if name is not None:
                bodies[self._number[name]] = replace(self._body(name), motion=motion)
        for name, gone in (away or {}).items():
            bodies[self._number[name]] = replace(bodies[self._number[name]], away=gone)
        self.scene = replace(self.scene, bodies=tuple(bodies), ego=ego)
        self.world = self.world.with_bodies(bodies)
        around = self._everywhere
        now = [bodies[self._number[body.name]] for body in around.bodies]
        there = np.array([not body.away for body in now], bool)
        self.clearance = Clearance(
            bodies=tuple(body for body in now if not body.away),
            boxes=around.boxes[there],
            around=around.around[there],
            blocks=around.blocks,
        )


def _course(
    who: str,
    pose: Placed,
    *,
    velocity_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0),
    yaw_rate_deg_s: float = 0.0,
    time_s: float = 0.0,
) -> Course:
    """The motion from a pose on."""
    x, y, z = velocity_m_s
    if not all(math.isfinite(number) for number in (x, y, z, yaw_rate_deg_s, time_s)):
        raise InputError(
            f"{who}: velocity, yaw rate and time must be finite, got {velocity_m_s}, {yaw_rate_deg_s}, {time_s}"
        )
    return Course(
        start=_checked(who, pose),
        velocity_m_s=(float(x), float(y), float(z)),
        yaw_rate_rad_s=math.radians(yaw_rate_deg_s),
        since_s=float(time_s),
    )


def _checked(who: str, pose: Placed) -> Pose:
    """A pose that is one. Raises InputError for numbers that are not finite, or a matrix that is no rotation."""
    found = placed(pose)
    turn = found.rotation
    square = np.isfinite(turn).all() and np.abs(turn @ turn.T - np.eye(3)).max() < ROTATION_ERROR
    if not (np.isfinite(found.position_m).all() and square and np.linalg.det(turn) > 0.0):
        raise InputError(
            f"{who}: its pose must be finite numbers and a rotation, got {found.position_m.tolist()} and "
            f"{turn.tolist()}"
        )
    return found
