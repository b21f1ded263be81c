"""Check arguments by their annotations: what a caller gives must be of the type that the signature says.

`checks_arguments` checks the calls of a public function, or of the public methods of a class, before they do anything;
`rendering.option_fields` checks the fields of options. Words for the values may stand in the annotation:
``Annotated[Pose | Sequence[float], "a Pose, or x, y, z in metres"]``. With `CHECKED_INSIDE` in it the call checks.
"""

from __future__ import annotations

import builtins
import functools
import inspect
import itertools
import os
import sys
import types
import typing
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence, Sized
from numbers import Integral, Real
from typing import Annotated, Any, Literal, TypeVar

from ..errors import InputError, OptionError, did_you_mean, meant_by_a_part, one_line

Checked = TypeVar("Checked", bound=Callable[..., Any])

CHECKED_INSIDE = object()
"""Note in an annotation: more is taken than it says, or the call says best what is wrong."""

FOREIGN_KEYWORDS: Mapping[str, Mapping[str, str]] = {
    "pose": {
        **dict.fromkeys(
            ("yaw", "yaw_deg", "pitch", "roll", "heading", "rotation", "orientation"),
            "angles go in pose=(x, y, z, yaw, pitch, roll)",
        ),
        **dict.fromkeys(("position", "sensor_pose", "origin", "location", "height", "at"), "a place is pose=(x, y, z)"),
    },
    "rays": dict.fromkeys(("seed", "number", "begin_s"), "a frame has it: simulator.render(seed=1)"),
    "seed": dict.fromkeys(("rng", "random_state", "random_seed"), "the seed is seed=N"),
    "begin_s": dict.fromkeys(("time", "t", "start"), "a frame begins at begin_s=1.0"),
    "overrides": dict.fromkeys(
        ("set", "settings", "params", "parameters", "config"),
        'values of the sensor file go in overrides={"laser.peak_power_w": 50}',
    ),
    "scene_overrides": dict.fromkeys(
        ("scene_set", "scene_settings", "night", "day", "dark"),
        'values of the scene file go in scene_overrides={"sun.illuminance_klux": 1}',
    ),
    "number": {
        **dict.fromkeys(
            ("frames", "n_frames", "num_frames", "duration"),
            "several frames are render_frames(scene, sensor, frames=N)",
        ),
        **dict.fromkeys(
            ("noise", "noisy", "ideal"),
            "noise follows from the sensor and the light; cloud.true_range has the range without",
        ),
        **dict.fromkeys(("picture", "image", "plot"), "a picture is written by cloud.plot().save('a.png')"),
        **dict.fromkeys(("output", "path", "file", "save", "out"), "a cloud is written by cloud.save(path)"),
        "overrides": 'other values are those of sensor.replace({"laser.peak_power_w": 50})',
        "scene_overrides": 'other values are those of scene.replace({"sun.illuminance_klux": 1})',
        "deskew": "the sensor's own motion is taken out by cloud.deskew(Simulator(scene, sensor).motion)",
        "rig": "record(scene, Rig(file), outputs=...) renders a rig of several sensors",
    },
    "illuminance_klux": dict.fromkeys(
        ("sun", "sunlight", "light", "lux", "klux"), "the sun's light is illuminance_klux=100"
    ),
    "probability": dict.fromkeys(("pd", "p_d", "p"), "the detection probability is probability=0.9"),
    "distance": {"range": "the distance of SNR and P_d is distance=100"},
    "points": {"values": "an axis is start=, stop= and points="},
    "colour_by": {
        **dict.fromkeys(("c", "by", "column", "cmap", "field"), "a column gives the colours: colour_by='range'"),
        **dict.fromkeys(("save", "path", "file", "filename", "output"), "a picture is written by plot().save('a.png')"),
    },
    "position": {
        "scale": "a mesh is scaled before, such as mesh.apply_scale(2) of trimesh",
        **dict.fromkeys(
            ("velocity", "speed", "motion", "trajectory"),
            "a scene file has motions, [bodies.motion]; LiveSimulator(scene, sensor, movable=[name]) moves bodies",
        ),
        **dict.fromkeys(("color", "colour"), "material=Material(reflectivity=0.2) is grey"),
        **dict.fromkeys(("label", "category", "class_"), "points have class_name="),
        **dict.fromkeys(("x", "y", "z"), "a place is position=(x, y, z)"),
    },
    "ascii": {"binary": "files are binary unless ascii=True"},
    "material": dict.fromkeys(("reflectivity", "albedo", "reflectance"), "material=Material(reflectivity=0.2)"),
    "class_": dict.fromkeys(
        ("x", "y", "z", "range", "range_m", "intensity", "ring", "snr", "time"),
        "columns are compared: cloud[(cloud.range > 5) & (cloud.range < 50)]",
    ),
    "job": dict.fromkeys(
        ("scenes", "sensors", "seeds", "frames", "n"),
        "a job file lists them; examples are lidarscene.batch('job', 'out')",
    ),
    "as_seen": dict.fromkeys(
        ("class_", "class_name", "name", "label"), 'boxes have names: [b for b in boxes if b.class_name == "car"]'
    ),
    "PointCloud.to_torch": dict.fromkeys(("device", "dtype"), "a tensor is moved by tensor.to(...)"),
    "": dict.fromkeys(
        ("device", "gpu", "cuda", "cpu", "backend", "variant", "use_gpu"),
        "a GPU is used where there is one; the environment variable LIDARSCENE_VARIANT=llvm_ad_mono chooses the CPU",
    ),
}
"""Keywords that people try, with what does it, of calls with this option or of this name; with "" of all calls."""

_MOST_ELEMENTS = 1000
"""Elements of a sequence that are looked at, each: of what is longer, only whether it is a sequence."""


def checks_arguments(call: Checked) -> Checked:
    """Check the arguments of a function, or of all public methods of a class, by their annotations (a decorator).

    A wrong type, and an unknown keyword where there are no others to take it, is an InputError that names the argument.
    """
    if isinstance(call, type):
        for name, method in list(vars(call).items()):
            made = isinstance(method, classmethod | staticmethod)
            function = method.__func__ if made else method
            own_init = name == "__init__" and "__dataclass_fields__" not in vars(call)
            if inspect.isfunction(function) and (own_init or not name.startswith("_")):
                checked = checks_arguments(function)
                setattr(call, name, type(method)(checked) if made else checked)
        return call
    signature = inspect.signature(call)
    kinds = [parameter.kind for parameter in signature.parameters.values()]
    takes_all, takes_list = inspect.Parameter.VAR_KEYWORD in kinds, inspect.Parameter.VAR_POSITIONAL in kinds
    positional = [name for name, kind in zip(signature.parameters, kinds, strict=True) if kind in _POSITIONAL]
    required = [
        name
        for name, parameter in signature.parameters.items()
        if parameter.default is parameter.empty and parameter.kind not in _OPEN and name != "self"
    ]
    nameless = {name for name, each in signature.parameters.items() if each.kind is each.POSITIONAL_ONLY}
    own = positional[:1] == ["self"]

    @functools.wraps(call)
    def checked_call(*arguments: Any, **keywords: Any) -> Any:
        if not takes_all:
            for word in keywords.keys() - signature.parameters.keys():
                names = [name for name in signature.parameters if name != "self"]
                meant = ""
                if "overrides" in names and not did_you_mean(word, names):
                    meant = 'values of the file go in overrides={"TABLE.KEY": value}'
                raise unknown_option(word, names, meant=meant, call=call.__qualname__)
        if len(arguments) > len(positional) and not takes_list:
            others = [name for name in _keywords_of(call, signature) if name not in positional]
            raise _too_many(call.__name__, arguments[own:], positional[own:], others, _hints_of(call))
        # `inspect.Signature.bind` takes longer than all else here.
        named = {name: value for name, value in keywords.items() if name not in nameless}
        bound = dict(zip(positional, arguments, strict=False)) | named
        if len(bound) < len(named) + min(len(arguments), len(positional)) or not bound.keys() >= {*required}:
            _require_once(call, signature, required, positional[: len(arguments)], keywords)
            bound = {}  # the call itself says what else is wrong
        hints = _hints_of(call)
        for name, value in bound.items():
            if name in hints:
                require_type(name, value, hints[name])
        return call(*arguments, **keywords)

    return typing.cast(Checked, checked_call)


def unknown_option(word: str, options: Collection[str], *, meant: str = "", call: str = "") -> InputError:
    """Error for a keyword that is none of a call's options.

    Args:
        meant: what it means, unless `FOREIGN_KEYWORDS` has it or it is a slip of an option
        call: name of the call
    """
    foreign: dict[str, str] = {}
    for key, words in FOREIGN_KEYWORDS.items():
        if key in ("", call, *options):
            foreign = {**words, **foreign}
    slip = did_you_mean(word, options, cutoff=0.8)
    text = foreign.get(word) or ("" if slip else meant or meant_by_a_part(word, foreign))
    meant = f"{text};" if text else slip or did_you_mean(word, options)
    return InputError(
        f"unknown option '{word}'; {meant}{' ' if meant else ''}known here: {', '.join(options) or 'none'}"
    )


def _require_once(
    call: Callable[..., Any],
    signature: inspect.Signature,
    required: Sequence[str],
    placed: Sequence[str],
    keywords: Collection[str],
) -> None:
    """Raise OptionError for an argument that is missing, or given twice.

    Args:
        required: names of those without a default
        placed: names of the arguments that were given without their names
    """
    owner, _, function = call.__qualname__.rpartition(".")
    called = f"{owner if function == '__init__' else function}()"
    for name in placed:
        if name in keywords and signature.parameters[name].kind is inspect.Parameter.POSITIONAL_OR_KEYWORD:
            order = ", ".join(word for word in placed if word != "self")
            raise OptionError("{0}: {1} is given twice; arguments without a name are {2}", called, name, order)
    for name in required:
        if name not in placed and name not in keywords:
            unknown = did_you_mean(name, set(keywords) - signature.parameters.keys()).partition(" mean ")[2]
            hint = f", got {unknown[:-1]}" if unknown else ""
            raise OptionError("{0}: must have {1}; {2} is missing{3}", called, ", ".join(required), name, hint)


def _keywords_of(call: Callable[..., Any], signature: inspect.Signature) -> Iterable[str]:
    """Names of the arguments of a call, with those of its keywords."""
    for name, parameter in signature.parameters.items():
        if parameter.kind is not parameter.VAR_KEYWORD:
            yield name
        elif typing.get_origin(hint := type_hints(call).get(name)) is typing.Unpack:
            yield from type_hints(typing.get_args(hint)[0])


def _too_many(
    call: str, given: Sequence[object], names: Sequence[str], others: Sequence[str], hints: Mapping[str, Any]
) -> OptionError:
    """Error for a call with more arguments than names that go without them; several choices go in a list."""
    words = f"{call}(): must have at most {len(names)} without a name ({', '.join(names)}), got {len(given)}"
    rest = [*given[len(names) - 1 :]]
    if names and _takes_list(hints[names[-1]]) and is_of_type(rest, hints[names[-1]]):
        return OptionError("{0}; several go in one list: {1}={2}", words, names[-1], one_line(rest))
    return OptionError("{0}{1}", words, f"; the others go by name: {'=, '.join(others)}=" if others else "")


def _takes_list(hint: Any) -> bool:
    """Whether a list is one of the types of an argument."""
    return typing.get_origin(hint) in _SEQUENCES or (
        typing.get_origin(hint) in (Annotated, typing.Union, types.UnionType)
        and any(map(_takes_list, typing.get_args(hint)))
    )


def _takes_file(hint: Any) -> bool:
    """Whether a path is one of the types of an argument."""
    return any((typing.get_origin(option) or option) is os.PathLike for option in typing.get_args(hint))


_POSITIONAL = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
_OPEN = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


def require_type(name: str, value: object, hint: Any) -> None:
    """Raise OptionError, with the argument's name, unless a value is of an annotated type; no file has the name ""."""
    if isinstance(value, str) and not value and _takes_file(hint):
        raise OptionError(f"{{{name}}}: must be {{0}}, got an empty text", _words(hint))
    if not is_of_type(value, hint):
        content = f" {one_line(value)}" if isinstance(value, str | bytes | Sequence | Mapping) else ""
        raise OptionError(f"{{{name}}}: must be {{0}}, got {{1}}{{2}}", _words(hint), type(value).__name__, content)


@functools.cache
def _hints_of(call: Callable[..., Any]) -> dict[str, Any]:
    """Types of the parameters that have one name each."""
    named = {
        name
        for name, parameter in inspect.signature(call).parameters.items()
        if parameter.kind not in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)
    }
    return {name: hint for name, hint in type_hints(call).items() if name in named}


@functools.cache
def type_hints(of: Any) -> dict[str, Any]:
    """Annotations of a function or a class. A name that is imported for type checkers alone stands for any type."""
    classes = of.__mro__ if isinstance(of, type) else (of,)
    known = set(vars(builtins)).union(*(vars(sys.modules[owner.__module__]) for owner in classes))
    return typing.get_type_hints(of, localns=_Names(known), include_extras=True)


class _Names(dict[str, Any]):
    """Local names of annotations: `Any` for each that is not known."""

    def __init__(self, known: set[str]) -> None:
        super().__init__()
        self._known = known

    def __missing__(self, name: str) -> Any:
        if name in self._known:
            raise KeyError(name)
        return Any


def is_of_type(value: object, hint: Any) -> bool:
    """Whether a value is of a type; arrays and lists are sequences, and numbers are of any library."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        return CHECKED_INSIDE in inner or is_of_type(value, inner[0])
    if origin in (typing.Union, types.UnionType):
        return any(is_of_type(value, option) for option in inner)
    if origin is Literal:
        return isinstance(value, str | int) and value in inner
    if hint is Any or isinstance(hint, TypeVar):
        return True
    if hint is None or hint is type(None):
        return value is None
    if hint in (int, float):
        return isinstance(value, Integral if hint is int else Real) and not isinstance(value, bool)
    if hint is bool:
        return isinstance(value, bool) or type(value).__name__ in ("bool", "bool_")
    kind = origin or hint
    if kind is Callable:
        return callable(value)
    if kind in _SEQUENCES:
        return _is_sequence(value, kind, inner)
    # Anything may become an array of NumPy: the call looks at its shape.
    if not isinstance(kind, type) or kind.__module__ == "numpy":
        return True
    if getattr(kind, "_is_protocol", False):
        return all(hasattr(value, member) for member in vars(kind) if not member.startswith("_"))
    if issubclass(kind, Mapping):
        entries = value.items() if inner and isinstance(value, Mapping) else ()
        return isinstance(value, Mapping) and all(
            is_of_type(k, inner[0]) and is_of_type(v, inner[1]) for k, v in entries
        )
    return isinstance(value, kind)


_SEQUENCES = (tuple, list, Sequence, Collection, Iterable)


def _is_sequence(value: object, kind: Any, inner: tuple[Any, ...]) -> bool:
    """Whether a value has elements of a type: a list, a tuple or an array; a set or an iterator where ``kind`` does."""
    if isinstance(value, set | frozenset) and kind not in (Collection, Iterable):
        return False
    if isinstance(value, str | bytes | Mapping) or getattr(value, "ndim", 1) == 0 or not isinstance(value, Iterable):
        return False
    if not isinstance(value, Sized):
        return kind is Iterable
    if kind is tuple and inner and inner[-1] is not Ellipsis:
        return len(value) == len(inner) and all(map(is_of_type, value, inner))
    return not inner or all(is_of_type(element, inner[0]) for element in itertools.islice(value, _MOST_ELEMENTS))


def _words(hint: Any) -> str:
    """Words for the values of a type: "a name, a file or a Sensor"."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        return next((note for note in inner[1:] if isinstance(note, str)), _words(inner[0]))
    if origin in (typing.Union, types.UnionType):
        *first, last = dict.fromkeys(_words(option) for option in inner)
        text = f"{', '.join(first)} or {last}" if first else last
        return {"a text or a file": "the name of a file"}.get(text, text.replace("a text, a file", "a name, a file"))
    if origin is Literal:
        return " or ".join(map(repr, inner))
    kind = origin or hint
    if kind in _SEQUENCES:
        return f"a list, each {_words(inner[0])}" if inner else "a list"
    if kind in _WORDS:
        return _WORDS[kind]
    if not isinstance(kind, type):
        return str(kind)
    if issubclass(kind, os.PathLike):
        return "a file"
    if issubclass(kind, Mapping):
        return "a dict"
    return f"{'an' if kind.__name__[0] in 'AEIOU' else 'a'} {kind.__name__}"


_WORDS: dict[Any, str] = {
    str: "a text", int: "a whole number", float: "a number", bool: "True or False", Callable: "a function",
    type(None): "None", None: "None",
}  # fmt: skip
