"""Motions through the poses that the caller has given so far, as his clock went on."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field

import numpy as np

from ...errors import InputError
from ...maths.pose import Pose
from ...maths.trajectory import Course, Held, Motion, Spline


@dataclass(slots=True)
class Track:
    """The last poses of a body, at rising times [s]."""

    times_s: list[float] = field(default_factory=list)
    poses: list[Pose] = field(default_factory=list)

    def append(self, time_s: float, pose: Pose) -> None:
        """It is here now."""
        self.times_s.append(time_s)
        self.poses.append(pose)

    def forget(self, before_s: float) -> None:
        """Drop the poses that no frame after this time needs."""
        first = max(bisect_right(self.times_s, before_s) - 1, 0)
        del self.times_s[:first], self.poses[:first]

    def motion(self, name: str) -> Motion:
        """From each pose straight to the next, as a body that turns with a constant twist; at rest before and after.

        A pose that is given once more is a body at rest. Raises InputError where it turns too far.
        """
        first = self.poses[0]
        if all(
            np.array_equal(one.position_m, first.position_m) and np.array_equal(one.rotation, first.rotation)
            for one in self.poses
        ):
            return Course(start=first)
        try:
            return Held(motion=Spline(time_s=np.array(self.times_s), poses=tuple(self.poses), smooth=False))
        except ValueError as error:
            raise InputError(f"'{name}': {error}") from None
