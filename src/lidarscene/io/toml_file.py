"""TOML files in, checked pydantic models out; every mistake is one line that names the file and the key."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from ..errors import InputError


class FileModel(BaseModel):
    """Base of all file models: unknown keys are errors, values are not coerced from strings, NaN is refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False, allow_inf_nan=False)


Model = TypeVar("Model", bound=BaseModel)


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file. Raises InputError if it is missing, unreadable or not TOML."""
    try:
        with path.open("rb") as file:
            return tomllib.load(file)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder, a TOML file was expected") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not valid TOML: {error}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def validated(model: type[Model], tables: dict[str, Any], where: str) -> Model:
    """``tables`` as a model. Raises InputError with the first mistake and how many more there are."""
    try:
        return model.model_validate(tables)
    except ValidationError as error:
        first = error.errors()[0]
        more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
        raise InputError(f"{where}: {_told(first, model)}{more}") from None


def _told(error: Any, model: type[BaseModel]) -> str:
    """One pydantic error as "key: what is wrong, what came"."""
    # A discriminated union puts its tag between the keys: detector.apd.gain is written detector.gain.
    location = [part for part in error["loc"] if not (isinstance(part, str) and part in _TAGS)]
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location).lstrip(".")
    if error["type"] == "extra_forbidden":
        known = ", ".join(_keys_at(model, location[:-1]))
        return f"unknown key '{key}'" + (f"; known here: {known}" if known else "")
    if error["type"] == "missing":
        return f"key '{key}' is missing"
    message = error["msg"].removeprefix("Value error, ").replace("Input should", "should")
    came = error.get("input")
    shown = "" if isinstance(came, dict) or not key else f", {came!r} came"
    return f"{key}: {message}{shown}" if key else message


_TAGS = frozenset({"apd", "sipm", "raster"})


def _keys_at(model: type[BaseModel], location: list[Any]) -> list[str]:
    """Keys a model knows at a place, as far as the types tell."""
    fields: Any = model
    for part in location:
        if isinstance(part, int):
            continue
        annotation = fields.model_fields[part].annotation if part in fields.model_fields else None
        nested = _model_in(annotation)
        if nested is None:
            return []
        fields = nested
    return [info.alias or name for name, info in fields.model_fields.items()]


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """The only model inside a type such as ``tuple[Body, ...]`` or ``Sun | None``; None if not just one."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    inner = [_model_in(argument) for argument in getattr(annotation, "__args__", ())]
    found = [one for one in inner if one is not None]
    return found[0] if len(found) == 1 else None


def with_overrides(tables: dict[str, Any], assignments: Iterable[str]) -> dict[str, Any]:
    """A copy of the tables with ``a.b=value`` assignments made; values are TOML, or else plain strings."""
    result = _deep_copy(tables)
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        path = [part.strip() for part in key.split(".")]
        if not equals or not all(path):
            raise InputError(f"--set {assignment}: KEY=VALUE was expected, such as detector.gain=60")
        table = result
        for part in path[:-1]:
            inner = table.setdefault(part, {})
            if not isinstance(inner, dict):
                raise InputError(f"--set {assignment}: '{part}' is a value, not a table")
            table = inner
        table[path[-1]] = _toml_value(text)
    return result


def _toml_value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text.strip()


def _deep_copy(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _deep_copy(inner) for key, inner in value.items()}
    return list(value) if isinstance(value, list) else value
