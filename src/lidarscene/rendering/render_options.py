"""Options: how rays are traced, which frame is rendered, and who observes it. Each is declared here, once.

The library, the command line, `batch` and `view` build the same objects from the same fields (`option_fields`), and an
object checks itself when it is made: a wrong value gives the same one-line error everywhere. A call takes the objects,
or their fields as keywords, or both:
``render(scene, sensor, seed=1, rays=3)``. `Keywords` sorts these.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, TypedDict, TypeVar

from ..errors import InputError, one_line
from ..files.arguments import unknown_option
from ..light.limits import INTERACTIONS, MOST_INTERACTIONS
from ..maths.units import keys_like
from .option_fields import Finite, Function, OneOf, Whole, check_options, list_options, option

# Options load no NumPy: the command line names them, and still answers --help at once.
if TYPE_CHECKING:
    from pydantic import BaseModel

    from ..cloud.rays import PulseRays
    from ..maths.arrays import Numbers
    from ..maths.pose import Pose
    from ..sensor.pose_file import Placed
    from .frame_summary import Summary

RAYS = Whole(1, 1024)
MEETINGS = Whole(0, MOST_INTERACTIONS)
SEEDS = Whole(0, 2**32 - 1)
NUMBERS = Whole(0, 2**31 - 1)
CHUNKS = Whole(1, 2**31 - 1)
FUNCTION = Function()
COORDINATES = OneOf(("world", "vehicle", "sensor"), "'world' or 'vehicle' or 'sensor'")


@list_options
@dataclass(frozen=True, slots=True, kw_only=True)
class TraceOptions:
    """Options of tracing: all that chooses the compiled kernels.

    Raises:
        InputError: for a value out of bounds
    """

    KEYWORD: ClassVar[str] = "trace"

    rays: int = option(
        1, RAYS, help="rays per pulse, spread over the footprint of the beam (default {default}: its axis)", metavar="N"
    )
    interactions: int = option(
        INTERACTIONS,
        MEETINGS,
        help="number of panes, mirrors and gaps that a beam may pass; with 0 it ends at the first, without an "
        "echo (default {default})",
        metavar="N",
    )
    background_rays: int | None = option(
        None,
        RAYS,
        help="rays per pulse for the background, spread over the receiver's field of view (default: the rays of "
        "the pulse)",
        metavar="K",
    )
    vectors: bool = option(False, help="add the normals of surfaces and their velocities relative to the ground")

    def __post_init__(self) -> None:
        check_options(self)


@list_options
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameOptions:
    """Choice of one frame (one sweep of the sensor in time) and of the coordinates of its points.

    A pose is a `Pose`, or (x, y, z) in metres, with or without (..., yaw, pitch, roll) in degrees; the sensor's
    mounting is not included. None: the simulator's, or else the scene's own. Motion of the sensor within a frame is not
    corrected: all points are placed from where it stood at the frame's start (see `deskewed`).

    Raises:
        InputError: for a value out of bounds
    """

    KEYWORD: ClassVar[str] = "frame"

    seed: int = option(
        0,
        SEEDS,
        help="seed of the noise; the same seed gives the same cloud, for any chunk (default {default})",
        metavar="N",
    )
    number: int = option(
        0, NUMBERS, help="number of the frame; later frames have later pulses, at later times, with different noise"
    )
    begin_s: float = option(
        0.0,
        Finite("seconds"),
        help="start of frame 0 in seconds, on the scene's clock (default {default:g})",
        metavar="S",
        flags=("--begin",),
    )
    pose: Pose | None = option(
        None,
        help="pose of the sensor, in the world or on the scene's ego vehicle, in metres and degrees; positive "
        "pitch looks up (default: the scene's pose)",
        metavar="X,Y,Z[,YAW,PITCH,ROLL]",
    )
    coordinates: str = option(
        "world",
        COORDINATES,
        help="coordinate system of the points: world, vehicle or sensor (default {default})",
        flags=("--coordinates", "--frame"),
    )
    chunk: int | None = option(
        None, CHUNKS, help="rays per batch; limits memory, not the result (default: 2^20, on a GPU 2^21)", metavar="N"
    )

    def __post_init__(self) -> None:
        check_options(self)
        if self.pose is not None:
            from ..sensor.pose_file import to_pose

            object.__setattr__(self, "pose", to_pose(self.pose))

    def differs_in_number(self, other: FrameOptions) -> bool:
        """Whether the options are those of another frame of the same run, or of the same frame."""
        names = [field.name for field in dataclasses.fields(self) if field.name != "number"]
        return all(getattr(self, name) == getattr(other, name) for name in names)


@list_options
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observers:
    """Functions called while a frame is rendered, once for each chunk, and a summary that is filled.

    Raises:
        InputError: for an observer that cannot be called
    """

    KEYWORD: ClassVar[str] = "observers"

    progress: Callable[[int, int], object] | None = option(
        None, FUNCTION, help="called with (done, pulses): the number of pulses done so far, and of all pulses"
    )
    missed: Callable[[Numbers, Numbers], object] | None = option(
        None, FUNCTION, help="called with (pulse, outcome): arrays of all pulses without an echo point"
    )
    ambient: Callable[[Numbers, Numbers], object] | None = option(
        None,
        FUNCTION,
        help="called with (pulse, counts): arrays of all pulses and of their background counts, "
        "`detection.ambient.counts`",
    )
    pulses: Callable[[PulseRays], object] | None = option(
        None, FUNCTION, help="called with the rays of all pulses, a `cloud.rays.PulseRays`"
    )
    points: Callable[[Numbers, Mapping[str, Numbers]], object] | None = option(
        None,
        FUNCTION,
        help="called with (pulse, surfaces): the pulse of each point of the cloud, and `surface_columns` (in "
        "`kernel.rays.point_columns`) of every pulse that hit a surface, for detection rates",
    )
    summary: Summary | None = option(None, help="filled with pulses by outcome, points, seconds by stage")

    def __post_init__(self) -> None:
        check_options(self)


class TraceKeywords(TypedDict, total=False):
    """Keywords for the fields of `TraceOptions`; a test compares the two."""

    rays: int
    interactions: int
    background_rays: int | None
    vectors: bool


class FrameKeywords(TypedDict, total=False):
    """Keywords for the fields of `FrameOptions`."""

    seed: int
    number: int
    begin_s: float
    pose: Placed | None
    coordinates: str
    chunk: int | None


class ObserverKeywords(TypedDict, total=False):
    """Keywords for the fields of `Observers`."""

    progress: Callable[[int, int], object] | None
    missed: Callable[[Numbers, Numbers], object] | None
    ambient: Callable[[Numbers, Numbers], object] | None
    pulses: Callable[[PulseRays], object] | None
    points: Callable[[Numbers, Mapping[str, Numbers]], object] | None
    summary: Summary | None


class StreamKeywords(FrameKeywords, ObserverKeywords):
    """Keywords of `Simulator.render` and `Simulator.stream`."""


class RenderKeywords(TraceKeywords, StreamKeywords, total=False):
    """Keywords of `render`: all options of a frame, one by one or as the objects that hold them."""

    trace: TraceOptions
    frame: FrameOptions
    observers: Observers


class FramesKeywords(RenderKeywords, total=False):
    """Keywords of `render_frames`."""

    keep_rays: bool


Options = TypeVar("Options", TraceOptions, FrameOptions, Observers)


class Keywords:
    """Split the **keywords of a call into TraceOptions, FrameOptions and Observers."""

    def __init__(self, keywords: Mapping[str, object]) -> None:
        self._remaining = dict(keywords)
        self._field_names: list[str] = []

    def take(self, kind: type[Options], options: Options | None = None) -> Options:
        """Take the options of one kind: ``options`` or the default, with fields replaced by keywords of their names.

        The keyword `KEYWORD` of the kind may give the whole object instead.

        Raises:
            InputError: for an object of another kind
        """
        whole = self._remaining.pop(kind.KEYWORD, None) if options is None else options
        if whole is not None and not isinstance(whole, kind):
            more = "; frame N is number=N, the coordinate system is coordinates=" if kind is FrameOptions else ""
            raise InputError(f"{kind.KEYWORD}: must be {kind.__name__}, got {one_line(whole)}{more}")
        names = [field.name for field in dataclasses.fields(kind)]
        self._field_names += names
        changes: dict[str, Any] = {name: self._remaining.pop(name) for name in names if name in self._remaining}
        if whole is None:
            return kind(**changes)
        return dataclasses.replace(whole, **changes) if changes else whole

    def end(self, *parameters: str) -> None:
        """Raise InputError for a keyword that was a field of none of the kinds taken.

        Args:
            parameters: names of the other parameters of the call, which may have been meant
        """
        if self._remaining:
            word, value = next(iter(self._remaining.items()))
            options = [*self._field_names, *parameters]
            raise unknown_option(word, options, meant=key_to_change(word, options, value))


MAIN_KEYS = {
    **dict.fromkeys(("sun", "light", "illuminance"), "sun.illuminance_klux"),
    **dict.fromkeys(("weather", "fog"), "weather.fog_visibility_km"),
    "range": "",
}
"""Words that people try, and the key of a scene file that they mean most; "" if they mean none, whatever is like it."""


def key_to_change(word: str, options: Collection[str], value: object = None) -> str:
    """Keyword, or else method, by which a key or a table like a word is changed; "" if there is none.

    Args:
        options: keywords of the call
        value: given with the word: a mapping is a table
    """
    from ..scene.tables import SceneFile
    from ..sensor.sensor_file import SensorFile

    models: dict[str, type[BaseModel]] = {"sensor": SensorFile, "scene": SceneFile}
    tables = [owner for owner, model in models.items() if isinstance(value, Mapping) and word in model.model_fields]
    owner, key = (tables[0], word) if tables else key_like(word, **models)
    keyword = {"sensor": "overrides", "scene": "scene_overrides"}.get(owner, "")
    change = f'{{"{key}": ...}}'
    by = f"{keyword}={change}" if keyword in options else f"{owner}.replace({change})"
    return f"values of the file are changed by {by}" if key else ""


def key_like(word: str, **models: type[BaseModel]) -> tuple[str, str]:
    """Keyword and key of a file that are like a word; both "" if there is none.

    Args:
        models: keyword and model of its file
    """
    from ..files.toml import keys_of_tables

    for keyword, model in models.items():
        keys = [key for key in keys_of_tables(model) if not key.startswith("published.")]
        if MAIN_KEYS.get(word) in keys:
            return keyword, MAIN_KEYS[word]
        if word not in MAIN_KEYS and (fitting := keys_like(word, keys)):
            return keyword, fitting[0]
    return "", ""
