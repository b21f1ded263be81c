"""Every key of a file is set somewhere that a user can see: in a catalogue entry, a scene, an example, or on a page."""

import inspect
import re
import tomllib
from collections.abc import Iterator
from typing import Any, get_args

import pytest
from helpers.documentation import PAGES, Block, blocks, code_spans
from helpers.models import FILES, MODELS

from lidarscene import catalog
from lidarscene.files.table_model import Table
from lidarscene.files.toml import FileModel, list_mistakes
from lidarscene.scene.scene_file import SceneFile
from lidarscene.sensor.imu import ImuModelFile
from lidarscene.sensor.sensor_file import SensorFile

Key = tuple[str, str]
"""Model that declares a key, and the key."""

DOTTED = re.compile(r"""(?<![\w.\[])(?:scene\.|sensor\.)?([a-z]\w*(?:\.[a-z]\w*)+)(?:["']\s*:|["']?\s*=|\s+--from)""")
"""A key set by its dotted name: `--set tdc.keep=last`, `{"detector.gain": 60}`, `--over tdc.jitter_ps --from 5`."""

INLINE = re.compile(r"""--(?:scene-)?set "([^"]*=[{][^"]*)\"""")
"""A table that is set on the command line: `--set "intensity={kind='range_corrected'}"`."""


def fields_of(model: type[FileModel]) -> dict[str, str]:
    """Field of each key."""
    return {info.alias or field: field for field, info in model.model_fields.items()}


def declared(model: type[FileModel], key: str) -> Key:
    """The key, of the class that has it first: tables with a common base share its keys."""
    owner, name = model, fields_of(model)[key]
    if issubclass(model, Table):  # declared on the class that the table describes
        owner, name = next(((model.target, field) for field, (k, _) in model.keys.items() if k == name), (model, name))
    bases = [base for base in owner.__mro__ if name in inspect.get_annotations(base)] or [model]
    return bases[-1].__name__, key


def tables_in(annotation: Any) -> list[type[FileModel]]:
    """File models in an annotation, however deep."""
    if isinstance(annotation, type) and issubclass(annotation, FileModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in tables_in(argument)]


def keys_in(tables: dict[str, Any], model: type[FileModel]) -> Iterator[Key]:
    """Keys that a file of this model sets, or a piece of one."""
    for key, value in tables.items():
        if key in (fields := fields_of(model)):
            yield declared(model, key)
            inner = tables_in(model.model_fields[fields[key]].annotation)
            for table in tables_of(value):
                for inner_model in inner:
                    if all(name in fields_of(inner_model) for name in table) and has_kind(inner_model, table):
                        yield from keys_in(table, inner_model)


def tables_of(value: Any) -> Iterator[dict[str, Any]]:
    """The tables in a value: itself, those of a list, and those by name."""
    if isinstance(value, list):
        for entry in value:
            yield from tables_of(entry)
    elif isinstance(value, dict):
        yield value
        yield from (entry for entry in value.values() if isinstance(entry, dict))


def has_kind(model: type[FileModel], table: dict[str, Any]) -> bool:
    """Whether a table may be of this model, by its `type` or `kind`, if it has one."""
    return all(
        table[tag] in get_args(model.model_fields[tag].annotation)
        for tag in ("type", "kind")
        if tag in table and tag in model.model_fields
    )


def nested(dotted: str) -> dict[str, Any]:
    """Tables in which one key is set: {"a": {"b": None}} of "a.b"."""
    first, _, rest = dotted.partition(".")
    return {first: nested(rest) if rest else None}


def parsed(text: str) -> dict[str, Any]:
    """The tables of a text, none if it is not TOML but another language."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return {}


def texts() -> Iterator[str]:
    """What ships and can be seen: the catalogue's files, and the blocks and commands of pages."""
    for kind in catalog.KINDS:
        for file in catalog.files(kind).values():
            if file.suffix == ".toml":
                yield file.read_text(encoding="utf-8")
    for page in PAGES:
        yield from (block.code for block in blocks(page))
        yield from (span for span in code_spans(page) if span.startswith(("lidarscene ", "--")))


def keys_shown() -> set[Key]:
    shown: set[Key] = set()
    for text in texts():
        pieces = [nested(name) for name in DOTTED.findall(text)]
        pieces += map(parsed, (text, *INLINE.findall(text)))
        for piece in pieces:
            for model in (*FILES, ImuModelFile):
                shown |= set(keys_in(piece, model))
    return shown


def test_every_key_is_set_where_a_user_sees_it() -> None:
    """Rationale: a key without an example has a check, a row, a formula and a test, and nobody knows what it is for."""
    shown = keys_shown()
    keys = {declared(model, key) for model in MODELS.values() for key in fields_of(model)}
    assert sorted(keys - shown) == []


ELSEWHERE = re.compile("missing|must have|both or none")
"""Words of mistakes that other pieces of the file mend."""


def misfits(block: Block, model: type[FileModel]) -> list[str]:
    """What a file of this model would have wrong with this block, but for keys that other pieces of it have."""
    return [mistake for mistake in list_mistakes(model, parsed(block.code)) if not ELSEWHERE.search(mistake)]


@pytest.mark.parametrize("block", [b for page in PAGES for b in blocks(page, "toml") if parsed(b.code)], ids=str)
def test_pieces_of_files_on_pages_fit(block: Block) -> None:
    """Those that no command reads, too."""
    assert min((misfits(block, model) for model in FILES), key=len) == []


def test_keys_are_found_in_files_pieces_and_settings() -> None:
    assert ("Laser", "wavelength_nm") in set(keys_in({"laser": {"wavelength_nm": 905}}, SensorFile))
    assert DOTTED.findall("--set roof:tdc.keep=last --scene-set sun.azimuth_deg=3") == ["tdc.keep", "sun.azimuth_deg"]
    assert ("Sun", "azimuth_deg") in set(keys_in(nested("sun.azimuth_deg"), SceneFile))
    assert list(keys_in({"scanner": {"type": "flash", "frame_hz": 3}}, SensorFile)) == [("SensorFile", "scanner")]
