"""Options: how rays are traced, which frame is rendered, and who is told what happens. Each is declared here, once.

The library, the command line, `batch` and `view` build the same objects, and an object checks itself when it is made:
a wrong value is one line, whoever gave it. A call takes the objects, or their fields as loose keywords, or both:
``render(scene, sensor, seed=1, rays=3)``. `Keywords` sorts these.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeAlias, TypedDict, TypeVar, cast

from ..errors import InputError, OptionError
from ..light.limits import INTERACTIONS, MOST_INTERACTIONS

# Options load no NumPy: the command line names them, and still answers --help at once.
if TYPE_CHECKING:
    from ..maths.arrays import Numbers
    from ..maths.pose import Pose
    from .summary import Summary

Placed: TypeAlias = "Pose | Sequence[float]"
"""Where a sensor stands: a `Pose`, or x, y, z in metres, with or without yaw, pitch, roll in degrees."""

COORDINATES = ("world", "vehicle", "sensor")

DEFAULT_CHUNK = 2**20
"""Rays traced at a time: some 100 MB of arrays; smaller chunks spend more of their time in Python."""


class Whole(NamedTuple):
    """The whole numbers from ``low`` to ``high``, both included."""

    low: int
    high: int

    def __str__(self) -> str:
        return f"a whole number from {self.low} to {self.high}"

    def check(self, option: str, value: object) -> None:
        """Raise OptionError for a value that is none of them."""
        whole = isinstance(value, Integral) and not isinstance(value, bool)
        if not whole or not self.low <= int(cast(int, value)) <= self.high:
            raise OptionError(f"{{{option}}}: must be {self}, got {{0!r}}", value)


RAYS = Whole(1, 1024)
MEETINGS = Whole(0, MOST_INTERACTIONS)
SEEDS = Whole(0, 2**32 - 1)
NUMBERS = Whole(0, 2**31 - 1)
CHUNKS = Whole(1, 2**31 - 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceOptions:
    """How the rays of a pulse are traced: what chooses the kernels.

    rays             of each pulse, over the footprint of its beam; a single one is its axis
    interactions     panes, mirrors and gaps that a beam may meet; with 0 it ends at the first, without an echo
    background_rays  of each pulse, over the receiver's field of view, for its background; None: what its rays see
    vectors          whether points have the normals and velocities of their surfaces
    Raises InputError for a value that is none.
    """

    KEYWORD: ClassVar[str] = "trace"

    rays: int = 1
    interactions: int = INTERACTIONS
    background_rays: int | None = None
    vectors: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.vectors, bool):
            raise OptionError("{vectors}: must be True or False, got {0!r}", self.vectors)
        RAYS.check("rays", self.rays)
        MEETINGS.check("interactions", self.interactions)
        if self.background_rays is not None:
            RAYS.check("background_rays", self.background_rays)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameOptions:
    """Which frame, a sweep of the sensor in time, and in which coordinates its points are.

    seed         32 bits; the same seed gives the same cloud whatever the chunk
    number       of the frame: later ones have later pulses, at later times, with noise of their own
    begin_s      when frame 0 begins, by the clock of the scene's motions
    pose         where the sensor stands, its mounting not included: in the world, or on the scene's ego vehicle;
                 None: the simulator's, or else the scene's own. A `Pose`, or (x, y, z) in metres, with or without
                 (..., yaw, pitch, roll) in degrees
    coordinates  of the points: "world", "vehicle" or "sensor". A sensor that moves does not know it: all points are
                 placed from where it stood at the frame's start (see `deskewed`)
    chunk        rays traced at a time: bounds the memory, changes nothing else
    Raises InputError for a value that is none.
    """

    KEYWORD: ClassVar[str] = "frame"

    seed: int = 0
    number: int = 0
    begin_s: float = 0.0
    pose: Pose | None = None
    coordinates: str = "world"
    chunk: int = DEFAULT_CHUNK

    def __post_init__(self) -> None:
        SEEDS.check("seed", self.seed)
        NUMBERS.check("number", self.number)
        CHUNKS.check("chunk", self.chunk)
        begin_s: object = self.begin_s
        if not isinstance(begin_s, Real) or not math.isfinite(self.begin_s):
            raise OptionError("{begin_s}: must be a finite number of seconds, got {0!r}", begin_s)
        if self.pose is not None:
            object.__setattr__(self, "pose", placed(self.pose))
        if self.coordinates not in COORDINATES:
            known = " or ".join(map(repr, COORDINATES))
            raise OptionError("{coordinates}: must be {0}, got {1!r}", known, self.coordinates)


def placed(pose: object) -> Pose:
    """A `Pose`, also from three to six numbers. Raises OptionError."""
    from ..maths.pose import Pose

    if isinstance(pose, Pose):
        return pose
    numbers = list(pose) if isinstance(pose, Iterable) and not isinstance(pose, str) else []
    if not 3 <= len(numbers) <= 6 or not all(isinstance(n, Real) and math.isfinite(n) for n in numbers):
        raise OptionError(
            "{pose}: must be a Pose, or x, y, z in metres with or without yaw, pitch, roll in degrees, got {0}",
            " ".join(repr(pose).split()),
        )
    x, y, z, yaw, pitch, roll = [float(n) for n in numbers] + [0.0] * (6 - len(numbers))
    return Pose.from_degrees(position_m=(x, y, z), yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observers:
    """Who is told while a frame is rendered, chunk by chunk.

    progress  told (done, pulses): how many pulses are done, of how many
    missed    told (pulse, outcome) of every pulse without an echo point
    ambient   told (pulse, counts) of every pulse: the background, `detection.ambient.counts`
    points    told (pulse, surfaces): the pulse of each point of the cloud, and `surface_columns` (in
              `kernel.rays.point_columns`) of every pulse that met one: what rates of detection need
    summary   filled: pulses by outcome, points, seconds by stage
    Raises InputError for an observer that cannot be called.
    """

    KEYWORD: ClassVar[str] = "observers"

    progress: Callable[[int, int], object] | None = None
    missed: Callable[[Numbers, Numbers], object] | None = None
    ambient: Callable[[Numbers, Numbers], object] | None = None
    points: Callable[[Numbers, Mapping[str, Numbers]], object] | None = None
    summary: Summary | None = None

    def __post_init__(self) -> None:
        for name in ("progress", "missed", "ambient", "points"):
            observer = getattr(self, name)
            if observer is not None and not callable(observer):
                raise OptionError(f"{{{name}}}: must be a function, got {{0!r}}", observer)


class TraceKeywords(TypedDict, total=False):
    """The fields of `TraceOptions` as keywords; a test holds them to be the same."""

    rays: int
    interactions: int
    background_rays: int | None
    vectors: bool


class FrameKeywords(TypedDict, total=False):
    """The fields of `FrameOptions` as keywords."""

    seed: int
    number: int
    begin_s: float
    pose: Placed | None
    coordinates: str
    chunk: int


class ObserverKeywords(TypedDict, total=False):
    """The fields of `Observers` as keywords."""

    progress: Callable[[int, int], object] | None
    missed: Callable[[Numbers, Numbers], object] | None
    ambient: Callable[[Numbers, Numbers], object] | None
    points: Callable[[Numbers, Mapping[str, Numbers]], object] | None
    summary: Summary | None


class StreamKeywords(FrameKeywords, ObserverKeywords):
    """What a frame that is rendered takes."""


class RenderKeywords(TraceKeywords, StreamKeywords, total=False):
    """All options of a frame, one by one or as the objects that have them."""

    trace: TraceOptions
    frame: FrameOptions
    observers: Observers


Options = TypeVar("Options", TraceOptions, FrameOptions, Observers)


class Keywords:
    """The loose keywords of a call, taken out as options of one kind after the other."""

    def __init__(self, keywords: Mapping[str, object]) -> None:
        self._left = dict(keywords)
        self._known: list[str] = []

    def take(self, kind: type[Options], given: Options | None = None) -> Options:
        """The options of this kind: those given, or the default, with the keywords that are fields of theirs.

        They may also come whole, as the keyword of their kind. Raises InputError for what is not of this kind.
        """
        whole = self._left.pop(kind.KEYWORD, None) if given is None else given
        if whole is not None and not isinstance(whole, kind):
            more = "; the coordinate system is coordinates=" if kind is FrameOptions else ""
            raise InputError(f"{kind.KEYWORD}: must be {kind.__name__}, got {whole!r}{more}")
        names = [field.name for field in dataclasses.fields(kind)]
        self._known += names
        changes: dict[str, Any] = {name: self._left.pop(name) for name in names if name in self._left}
        return dataclasses.replace(whole or kind(), **changes)

    def end(self) -> None:
        """Raise InputError for a keyword that no options had as a field."""
        if self._left:
            raise InputError(f"unknown option '{next(iter(self._left))}'; known here: {', '.join(self._known)}")
