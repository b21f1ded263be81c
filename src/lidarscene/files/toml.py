"""Read TOML files as checked pydantic models; every mistake is one line that names the file and the key.

Sensor, scene and job files are written by hand, so they have mistakes. pydantic finds them, but its messages
name Python types and its own models. Here its first error becomes a line in the words of the file, such as
`car.toml: bodies[3 "car"].scale: must be > 0, got -2`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError

from ..errors import InputError, did_you_mean, question
from ..maths.units import keys_like
from .inputs import LARGEST_TEXT, require_file
from .overrides import change_error, get_entry, key_path, number_list_entries, short_text


class FileModel(BaseModel):
    """Base of all file models: unknown keys are errors, no value is turned into another type, NaN is refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True)


Model = TypeVar("Model", bound=BaseModel)

OUT_OF_BOUNDS = "out_of_bounds"
"""Type of the error of `files.table_model.Number`."""

# Condition on a value, by pydantic's error type; pydantic's own texts name Python types.
_MUST_BE = {
    "bool_type": "true or false",
    "dict_type": "a table",
    "finite_number": "a finite number",
    "float_type": "a number",
    "greater_than": "> {gt:g}",
    "greater_than_equal": ">= {ge:g}",
    "int_type": "a whole number",
    "less_than": "< {lt:g}",
    "less_than_equal": "<= {le:g}",
    "literal_error": "{expected}",
    "model_attributes_type": "a table",
    "model_type": "a table",
    OUT_OF_BOUNDS: "{must}",
    "string_too_short": "text that is not empty",
    "string_type": "text",
    "string_unicode": "UTF-8 text",
    "too_long": "a list of at most {max_length}",
    "too_short": "a list of at least {min_length}",
    "tuple_type": "a list",
    "union_tag_invalid": "one of {expected_tags}",
}


def read_toml(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file.

    Raises:
        InputError: if it is missing, unreadable or not TOML
    """
    require_file(path, "a TOML file", largest=LARGEST_TEXT)
    try:
        # Windows editors write a byte-order mark first, which is not valid TOML.
        text = path.read_bytes().decode("utf-8-sig")
        tables = tomllib.loads(text)
        _require_shallow(tables)
        return tables
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise InputError(f"{path}: not UTF-8 text (at line {line})") from None
    except tomllib.TOMLDecodeError as error:
        hint = "; this looks like JSON" if text.lstrip().startswith("{") else ""
        raise InputError(f"{path}: not valid TOML: {error}{hint}") from None
    except RecursionError:
        raise InputError(f"{path}: not valid TOML: nested too deeply") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None


DEEPEST = 50
"""Largest depth of nested tables and lists; the deepest file model has six."""


def _require_shallow(value: Any) -> None:
    """Raise RecursionError for deep nesting here, before a recursive function does so halfway."""
    level = [value]
    for _ in range(DEEPEST):
        level = [
            inner
            for container in level
            if isinstance(container, (dict, list))
            for inner in (container.values() if isinstance(container, dict) else container)
        ]
        if not level:
            return
    raise RecursionError


def validate(
    model: type[Model],
    tables: Mapping[str, Any],
    where: str,
    *,
    overrides: Iterable[str] = (),
    always: Sequence[str] = (),
    option: str = "overrides",
) -> Model:
    """Return ``tables`` as a model.

    Args:
        where: the name of the file, for messages
        overrides: assignments that `with_overrides` has made: the message names those at the key of the mistake
        always: further ones, which the message names whatever the key
        option: Python's name of the argument that has them

    Raises:
        InputError: with the first mistake and the number of further ones
    """
    try:
        return model.model_validate(_with_tuples(tables))
    except ValidationError as error:
        first = error.errors()[0]
        further = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
        mistake_path = [str(part) for part in _keys_in_file(first["loc"], tables, missing=first["type"] == "missing")]
        named = [*always]
        for assignment in overrides:
            path = number_list_entries(key_path(assignment), tables)
            shared = min(len(path), len(mistake_path))
            named += [assignment] if path[:shared] == mistake_path[:shared] else []
        text, hint = _error_text(first, model, tables), ""
        if not named and first["type"] in ("missing", "extra_forbidden") and len(mistake_path) == 1:
            hint = _other_kind_hint(model, tables)
        elif named and (owner := _owner_of("".join(mistake_path[:1]), model)):
            text = f"unknown key '{mistake_path[0]}'"
            hint = f"; it belongs to the {owner}, which render changes by {{{TABLES[owner][0]}}}"
        raise change_error(named, text + further, where=where, option=option, hint=hint) from None


TELLTALE = {"laser": "sensor", "scanner": "sensor", "bodies": "scene", "scenes": "job", "sensors": "rig"}
"""Tables and lists that only one kind of file has at its top."""


def _other_kind_hint(model: type[BaseModel], tables: Mapping[str, Any]) -> str:
    """Hint that the file looks like one of another kind; "" without."""
    kinds = [kind for key, kind in TELLTALE.items() if key in tables and key not in model.model_fields]
    return f"; this looks like a {kinds[0]} file" if kinds else ""


TABLES = {
    "scene": ("scene_overrides", (
        "extends", "without", "base", "base_materials", "sun", "sky", "air", "weather", "interference", "reach_m",
        "ground", "street", "ego", "sensor", "picture", "materials", "bodies",
    )),
    "sensor": ("overrides", (
        "laser", "optics", "scanner", "detector", "tdc", "receiver", "histogram", "sampler", "mounting", "imu", "wear",
        "power", "intensity", "driver", "published", "sources", "uncertainty",
    )),
}  # fmt: skip
"""Option of a render that changes a scene or a sensor, and the top keys that its file has and the other's lacks."""


def _owner_of(table: str, model: type[BaseModel]) -> str:
    """Key of `TABLES` of a top key that this model lacks; "" of any other."""
    owners = [owner for owner, (_, names) in TABLES.items() if table in names]
    return owners[0] if owners and table not in model.model_fields else ""


def list_mistakes(model: type[Model], tables: Mapping[str, Any]) -> list[str]:
    """List all mistakes of these tables, one line each; the first is that of `validate`."""
    try:
        model.model_validate(_with_tuples(tables))
    except ValidationError as error:
        return list(dict.fromkeys(_error_text(mistake, model, tables) for mistake in error.errors()))
    return []


def _with_tuples(value: Any) -> Any:
    """Turn lists into tuples: strict models take nothing else."""
    if isinstance(value, dict):
        return {key: _with_tuples(inner) for key, inner in value.items()}
    return tuple(_with_tuples(inner) for inner in value) if isinstance(value, list) else value


def _error_text(error: Any, model: type[BaseModel], tables: Mapping[str, Any]) -> str:
    """Return a pydantic error as "key: must be X, got Y"."""
    kind, context = error["type"], error.get("ctx", {})
    location = _keys_in_file(error["loc"], tables, missing=kind == "missing")
    if kind.startswith("union_tag_"):
        location.append(context["discriminator"].strip("'"))
    key = _dotted_key(location, tables)
    if kind == "extra_forbidden":
        known_keys = _known_keys(model, location[:-1], tables)
        if fitting := question(_keys_that_fit(model, location, known_keys, tables)):
            return f"unknown key '{key}'; {fitting}"
        similar = did_you_mean(location[-1], known_keys)
        hint = f"{similar} all known here" if similar else "known here"
        return f"unknown key '{key}'" + (f"; {hint}: {', '.join(known_keys)}" if known_keys else "")
    if kind == "missing" and isinstance(location[-1], int):
        return f"{_dotted_key(location[:-1], tables)}: must be a longer list, got {short_text(error['input'])}"
    if kind in ("missing", "union_tag_not_found"):
        return f"key '{key}' is missing"
    if kind == "value_error":
        message = str(error["msg"]).removeprefix("Value error, ")
        return f"{key}: {message}" if key else message
    valid = _MUST_BE[kind].format(**context) if kind in _MUST_BE else f"valid ({error['msg']})"
    suggestion_of_number = context.get("suggestion", "")
    meant = question(_keys_that_fit(model, location, (), tables)) if valid == "a table" and len(location) == 1 else ""
    given = f"{short_text(context.get('tag', error['input']))}{suggestion_of_number}"
    return f"{key}: must be {valid}, got {given}" + (f"; {meant}" if meant else "")


def _keys_in_file(location: Iterable[Any], tables: Any, *, missing: bool) -> list[Any]:
    """Return a pydantic location without what is not in the file: the tags of the models that pydantic tried."""
    keys: list[Any] = []
    parts = list(location)
    for number, part in enumerate(parts):
        is_last = number == len(parts) - 1
        if (isinstance(tables, Mapping) and part in tables) or (
            isinstance(tables, (list, tuple)) and isinstance(part, int) and part < len(tables)
        ):
            tables = tables[part]
        elif not (missing and is_last):
            continue
        keys.append(part)
    return keys


def _dotted_key(location: Iterable[Any], tables: Any) -> str:
    """Return a location as ``bodies[3].scale``, or ``bodies[3 "car"].scale`` if the table has a name."""
    text = ""
    for part in location:
        tables = get_entry(tables, part)
        if isinstance(part, int):
            name = tables.get("name") if isinstance(tables, Mapping) else None
            text += f"[{part} {short_text(name)}]" if isinstance(name, str) else f"[{part}]"
        else:
            text += f".{part}" if text else str(part)
    return text


def _known_keys(model: type[BaseModel], location: Iterable[Any], tables: Any) -> list[str]:
    """Return the keys of the model at a location; [] if types and the file's ``type`` leave several models."""
    of_any_name = False
    for part in location:
        tables = get_entry(tables, part)
        if isinstance(part, int) or of_any_name:
            of_any_name = False
            continue
        annotation = model.model_fields[part].annotation if part in model.model_fields else None
        inner, of_any_name = model_of(annotation, tables), get_origin(annotation) in (dict, Mapping)
        if inner is None:
            return []
        model = inner
    return [info.alias or name for name, info in model.model_fields.items()]


def _keys_that_fit(
    model: type[BaseModel], location: list[Any], known_keys: Iterable[str], tables: Mapping[str, Any]
) -> list[str]:
    """Keys that an unknown key may stand for, by its last part: those of its own table, or else of all tables."""
    table = _dotted_key(location[:-1], tables)
    prefix = "" if any(isinstance(part, int) for part in location) else f"{table}." if table else ""
    if near := keys_like(str(location[-1]), [f"{prefix}{key}" for key in known_keys]):
        return near
    table_name, value = str(location[0]), get_entry(tables, location[0])
    if len(location) > 2 or _owner_of(table_name, model):
        return []
    typed = str(location[-1])
    if len(location) == 1 and isinstance(value, Mapping):
        # The key of a table of an unknown name, unless that is a known one with a slip.
        if len(value) != 1 or did_you_mean(table_name, model.model_fields):
            return []
        typed = str(next(iter(value)))
    dotted_keys = [
        f"{name}.{inner}"
        for name, inner_table in tables.items()
        if isinstance(inner_table, Mapping) and name in model.model_fields
        for inner in _known_keys(model, [name], tables)
    ]
    return keys_like(typed, dotted_keys)


def keys_of_tables(model: type[BaseModel]) -> list[str]:
    """Dotted keys of a file's tables, of each model that a table may have."""
    return list(
        dict.fromkeys(
            f"{info.alias or table}.{inner_info.alias or inner}"
            for table, info in model.model_fields.items()
            for inner_model in _models_in(info.annotation)
            for inner, inner_info in inner_model.model_fields.items()
        )
    )


def model_of(annotation: Any, table: Any) -> type[BaseModel] | None:
    """Return the one model inside a type; of several, that of the table's ``type``. None if that leaves several."""
    models = _models_in(annotation)
    if len(models) > 1:
        models = [model for model in models if get_entry(table, "type") in _types_of(model)]
    return models[0] if len(models) == 1 else None


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    """Return all models inside a type such as ``tuple[Body, ...]`` or ``Apd | Sipm``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in getattr(annotation, "__args__", ()) for model in _models_in(argument)]


def _types_of(model: type[BaseModel]) -> tuple[Any, ...]:
    """Values that ``type`` may have in a model: the arguments of its Literal."""
    field = model.model_fields.get("type")
    return tuple(getattr(field.annotation, "__args__", ())) if field else ()
