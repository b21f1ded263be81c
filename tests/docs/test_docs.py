"""The documentation tells the truth: links, names, keys, tables, commands and examples against the code.

`PYTHONPATH=src:tests python tests/docs/test_docs.py` writes the tables and the examples' outputs anew.
"""

import ast
import contextlib
import importlib
import io
import pkgutil
import re
import tomllib
from pathlib import Path
from typing import Any, get_args

import pytest
from helpers.documentation import (
    ARCHITECTURE,
    PAGES,
    README,
    ROOT,
    THEORY,
    Block,
    blocks,
    code_spans,
    make_workplace,
    prose,
    says,
    table,
    text_of,
)
from helpers.models import MODELS
from helpers.run_seed import chosen
from pydantic_core import PydanticUndefined

import lidarscene
from lidarscene import catalog, load_sensor
from lidarscene.cli import main
from lidarscene.files.toml import FileModel
from lidarscene.formats.cloud_columns import COLUMNS
from lidarscene.formats.registry import ALL, BAGS, FORMATS
from lidarscene.materials.material_file import catalogue_material
from lidarscene.studies.design.study_file import QUANTITIES, TRACED, UNITS

pytestmark = pytest.mark.fixed_streams

CONVENTIONS = ROOT / "docs" / "conventions.md"
MATERIALS = catalog.names("materials")
KEYS = tuple(
    ROOT / "docs" / f"{name}.md" for name in ("scene_files", "sensor_files", "scanners", "materials", "job_files")
)


# --- links ------------------------------------------------------------------------------------------


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


BESIDE = (ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("notebooks/*.ipynb")))


@pytest.mark.parametrize("page", [*PAGES, *BESIDE], ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for link in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if re.match(r"[a-z]+:", link):
            continue
        file, _, anchor = link.partition("#")
        target = page.parent / file if file else page
        assert target.exists(), link
        if anchor:
            assert anchor in anchors(target), link


def test_readme_is_short_and_its_picture_small() -> None:
    assert len(text_of(README).splitlines()) <= 200
    assert (ROOT / "docs" / "images" / "car.png").stat().st_size < 400_000
    assert (ROOT / "docs" / "images" / "drive.png").stat().st_size < 300_000


def test_the_version_is_that_of_the_package() -> None:
    version = lidarscene.__version__
    assert f"\nversion: {version}\n" in text_of(ROOT / "CITATION.cff")
    assert f"\n## {version}" in text_of(ROOT / "CHANGELOG.md")


def test_every_page_is_in_the_navigation() -> None:
    navigation = text_of(ROOT / "mkdocs.yml")
    pages = (ROOT / "docs").glob("*.md")
    assert [page.name for page in pages if f": {page.name}\n" not in navigation] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_comments_and_folded_parts_are_read_as_such(page: Path) -> None:
    """A list mark that begins a line ends the comment around it; text beside `<details>` folds nothing."""
    comments = re.findall(r"<!--.*?-->", text_of(page), re.DOTALL)
    marked = [line for text in comments for line in re.findall(r"\n\s*(?:[-+*]|\d+[.)])\s.*", text)]
    assert marked == []
    assert re.findall(r"<details[^>]*>[^\S\n]*\S.*", text_of(page)) == []


# --- examples ---------------------------------------------------------------------------------------


def output_of_code(code: str) -> str:
    """What a piece of code prints."""
    with contextlib.redirect_stdout(io.StringIO()) as out:
        exec(compile(code, "<documentation>", "exec"), {"__name__": "documentation"})
    return out.getvalue()


@pytest.mark.parametrize("block", chosen(10, [b for page in PAGES for b in blocks(page, "python")]), ids=str)
def test_python_blocks_run(
    block: Block, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    """And print what the page says they print."""
    if re.search("render|Simulator", block.code):
        request.getfixturevalue("mi")
    make_workplace(tmp_path, block.page, monkeypatch)
    output = output_of_code(block.code)
    if block.output is not None:
        assert output == block.output


def test_readme_summary(
    mi: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The lines of the excerpt, beams exactly. The others to 2e-4 and one more: processors differ in last bits, and
    numpy and the device too are allowed that (`tests/chain/test_repeatability.py`).
    """

    def lines(text: str) -> list[tuple[str, list[int]]]:
        rows = [line for line in text.splitlines() if not line.startswith(("seconds", "beams/", "wrote"))]
        numbers = [[int(n.replace(",", "")) for n in re.findall(r"\d[\d,]*", row)] for row in rows]
        return [(re.sub(r"[\d,\s]+", " ", row), n) for row, n in zip(rows, numbers, strict=True)]

    make_workplace(tmp_path, README, monkeypatch)
    assert main.main(["render", "car", "-o", "out/car.ply"]) == 0
    excerpt = next(re.finditer(r"```text\n(scene .*?)```", text_of(README), re.DOTALL))[1]
    printed, documented = lines(capsys.readouterr().out), lines(excerpt)
    assert [words for words, _ in printed] == [words for words, _ in documented]
    assert printed[0] == documented[0]
    for (words, printed_numbers), (_, documented_numbers) in zip(printed, documented, strict=True):
        assert printed_numbers == pytest.approx(documented_numbers, rel=2e-4, abs=1), words


# --- names ------------------------------------------------------------------------------------------

MODULES = {module.name for module in pkgutil.iter_modules(lidarscene.__path__)}
DOTTED = re.compile(r"[a-z_]\w*(\.\w+)+")


def dotted_names(page: Path) -> list[str]:
    """Code spans that are names below lidarscene: `physics.electronics.tdc.crossing_level`, not `scene.toml`."""
    spans = [span for span in code_spans(page) if DOTTED.fullmatch(span)]
    files = (".py", ".toml", ".xml", ".ply")
    return [span for span in spans if span.split(".")[0] in MODULES and not span.endswith(files)]


def resolve_name(name: str) -> object:
    """The module, class, function or attribute of this name below lidarscene."""
    parts = name.split(".")
    resolved_object: Any = lidarscene
    for depth, part in enumerate(parts):
        try:
            resolved_object = importlib.import_module(".".join(["lidarscene", *parts[: depth + 1]]))
        except ModuleNotFoundError:
            resolved_object = getattr(resolved_object, part)
    return resolved_object


def test_a_code_span_may_be_wrapped(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("`one`, `lidarscene render car\n  --rays 4` and `lost\n\n`three`\n", encoding="utf-8")
    assert code_spans(page) == ["one", "lidarscene render car --rays 4", "three"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_names_exist(page: Path) -> None:
    for name in dotted_names(page):
        resolve_name(name)


def test_theory_names_the_formulas() -> None:
    """Every module of formulas has its place on a page; docs/api_physics.md has its functions."""
    dotted = [f"{name}." for page in PAGES for name in dotted_names(page)]
    package = ROOT / "src" / "lidarscene"
    files = [path.relative_to(package).with_suffix("") for path in (package / "physics").rglob("[a-z]*.py")]
    modules = {".".join(file.parts) for file in files} - {"physics.constants", "physics.photon_counting.draws"}
    assert [m for m in sorted(modules) if not any(name.startswith(f"{m}.") for name in dotted)] == []


def test_equations_are_numbered_in_order() -> None:
    """Numbers rise on each page, and no two equations have the same number."""
    others = [ROOT / "docs" / name for name in ("photon_counting.md", "sipm.md", "fit.md")]
    pages = [[int(n) for n in re.findall(r"\\tag\{T(\d+)\}", text_of(page))] for page in (*THEORY, *others)]
    assert all(page == sorted(page) for page in pages)
    numbers = [n for page in pages for n in page]
    assert len(numbers) == len(set(numbers))
    cited = {int(n) for page in PAGES for n in re.findall(r"\(T(\d+)\)", text_of(page))}
    assert cited <= set(numbers)


def test_named_tests_exist() -> None:
    for page in PAGES:
        for file, function in re.findall(r"`(tests/(?:\w+/)+\w+\.py)(?:::(\w+))?`", text_of(page)):
            assert (ROOT / file).is_file(), file
            assert not function or f"def {function}(" in text_of(ROOT / file), f"{file}::{function}"


@pytest.mark.parametrize("file", ["Makefile", "CONTRIBUTING.md", "tools/environments.py"])
def test_paths_of_tests_exist(file: str) -> None:
    """Those that `make test-gpu` and tools/environments.py run, too: pytest sees one that is gone only there."""
    paths = re.findall(r"\btests/[\w/]+(?:\.py)?", text_of(ROOT / file))
    assert paths
    assert [path for path in paths if not (ROOT / path).exists()] == []


def test_tiers_are_those_of_the_test() -> None:
    source = ast.parse(text_of(ROOT / "tests" / "chain" / "test_imports.py"))
    (tiers,) = [
        ast.literal_eval(node.value)
        for node in source.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "TIERS"
    ]
    excerpt = re.search(r"<!-- tiers -->\n```text\n(.*?)```", text_of(ARCHITECTURE), re.DOTALL)
    assert excerpt
    assert [tuple(line.split()) for line in excerpt[1].splitlines()] == list(tiers)


def test_the_tree_names_every_module() -> None:
    tree = next(b for b in re.findall(r"```text\n(.*?)```", text_of(ARCHITECTURE), re.DOTALL) if "src/" in b)
    files = {path.name for path in (ROOT / "src" / "lidarscene").glob("*.py")} - {"__main__.py"}
    folders = {f"{path.parent.name}/" for path in (ROOT / "src" / "lidarscene").glob("*/__init__.py")}
    assert files | folders <= set(tree.split())


# --- tables -----------------------------------------------------------------------------------------


def columns_table() -> str:
    rows = ["| name | dtype | unit | meaning | |", "|---|---|---|---|---|"]
    for c in COLUMNS:
        dtype = "float32 or float64" if c.attribute == "xyz_m" else c.dtype
        rows.append(f"| `{c.name}` | {dtype} | {c.unit} | {c.meaning} | {c.group if c.truth else ''} |")
    return "\n".join(rows)


def formats_table() -> str:
    """Formats that keep the same share a row."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for name, format_of_file in (FORMATS | BAGS).items():
        abilities = ("yes" if able else "no" for able in (format_of_file.stream, format_of_file.read))
        cells_of_format = (format_of_file.columns, format_of_file.positions, format_of_file.beside, *abilities)
        groups.setdefault(cells_of_format, []).append(name)
    rows = ["| `--format` | suffix | needs | columns | positions | also in the file | in pieces | read again |"]
    rows += ["|---|---|---|---|---|---|---|---|"]
    for cells_of_format, names in groups.items():
        suffixes = dict.fromkeys(ALL[name].suffix for name in names)
        cells = [", ".join(f"`{word}`" for word in words) for words in (names, suffixes)]
        extras = {name: ALL[name].extra for name in names}
        if len({*extras.values()}) == 1:
            needs = f"`{extras[names[0]]}`" if extras[names[0]] else "-"
        else:
            needs = ", ".join(f"`{name}`: `{extra}`" for name, extra in extras.items() if extra)
        rows.append(f"| {' | '.join((*cells, needs, *cells_of_format))} |")
    return "\n".join(rows)


def quantities_table() -> str:
    """Quantities of design studies."""
    rows = ["| quantity | unit | what it is |", "|---|---|---|"]
    for name, meaning in QUANTITIES.items():
        traced = "; traced" if name in TRACED else ""
        rows.append(f"| `{name}` | {UNITS.get(name, '-')} | {meaning}{traced} |")
    return "\n".join(rows)


def materials_table() -> str:
    """Materials of the catalogue, with a star at reflectivities that are estimates."""
    rows = ["| Material | What it is | BSDF | 905 nm | 1550 nm |", "|---|---|---|---|---|"]
    for name in MATERIALS:
        data = tomllib.loads(text_of(catalog.path_of("materials", name)))
        material = catalogue_material(name)
        sources = {entry["wavelength_nm"]: entry["source"] for entry in data["reflectivity"]}
        cells = [
            f"{material.at(nm * 1e-9)['reflectivity']:.3f}{'*' * sources[nm].startswith('estimate')}"
            for nm in (905, 1550)
        ]
        rows.append(f"| `{name}` | {' | '.join((data['description'], data['bsdf'], *cells))} |")
    return "\n".join(rows)


def test_materials_have_the_wavelengths_that_the_page_names() -> None:
    spectra = [tomllib.loads(text_of(catalog.path_of("materials", name)))["reflectivity"] for name in MATERIALS]
    nm = {tuple(row["wavelength_nm"] for row in rows) for rows in spectra if isinstance(rows, list)}
    (wavelengths,) = nm
    says("materials.md", "the wavelengths {}, {}, {}, {} and {} nm", *wavelengths)


def test_beams_of_the_catalogue_are_all_on_the_page() -> None:
    named = re.findall(r"`([\w-]+)`", " ".join(row[0] for row in table("sensors.md", "name | azimuth x elevation")))
    wide = [name for name in catalog.names("sensors") if float(load_sensor(name).laser.divergence_rad) > 0.0]
    assert sorted(named) == wide


GENERATED = {
    "columns": (CONVENTIONS, columns_table),
    "formats": (ROOT / "docs" / "formats.md", formats_table),
    "materials": (ROOT / "docs" / "materials.md", materials_table),
    "quantities": (ROOT / "docs" / "job_files.md", quantities_table),
}
"""Tables that are written from the code: mark -> page and function."""


@pytest.mark.parametrize("mark", GENERATED)
def test_generated_tables_are_up_to_date(mark: str) -> None:
    page, written = GENERATED[mark]
    table = re.search(rf"<!-- {mark} -->\n(.*?)\n\n", text_of(page), re.DOTALL)
    assert table
    assert table[1] == written(), "run: PYTHONPATH=src:tests python tests/docs/test_docs.py"


def default_of(info: Any) -> str:
    """A field's default as the page writes it."""
    if info.is_required():
        return "required"
    value = info.default if info.default is not PydanticUndefined else info.default_factory()
    if value is None:
        return "-"
    if isinstance(value, FileModel):
        return "table"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, str):
        return f'`"{value}"`'
    return f"`{list(value)}`" if isinstance(value, tuple) else f"`{value}`"


def test_models_are_all_found() -> None:
    assert {"BodyFile", "PoseFile", "ApdFile", "SipmFile", "ReflectivityRow", "AirFile", "LampsFile"} <= set(MODELS)


def bounds_of(schema: dict[str, Any]) -> str:
    """The bounds of a number in words: `300 to 2500`, `above 0, below 255`, `1 or more`."""
    low, above, high, below = (
        (f"{value:g}" if float(f"{value:g}") == value else str(value))
        .replace("e+0", "e")
        .replace("e+", "e")
        .replace("e-0", "e-")
        if (value := schema.get(key)) is not None
        else ""
        for key in ("minimum", "exclusiveMinimum", "maximum", "exclusiveMaximum")
    )
    start = f"above {above}" if above else low
    if finest := schema.get("not", {}).get("exclusiveMaximum"):
        return f"0, {finest:g} to {high}" if low == "0" else f"{low} to {high}, 0 or from {finest:g} in size"
    if high or below:
        return f"{start} to {high}" if high else f"{start}, below {below}"
    return f"{low} or more" if low else start


def values_of(schema: dict[str, Any]) -> str:
    """What a key takes, in words, from its JSON Schema."""
    choices = schema.get("anyOf", schema.get("oneOf"))
    if choices:
        kinds = [values_of(choice) for choice in choices if choice.get("type") != "null"]
        return " or ".join(dict.fromkeys(kinds))
    if "enum" in schema or "const" in schema:
        return ", ".join(f'`"{choice}"`' for choice in schema.get("enum", [schema.get("const")]))
    kind = schema.get("type", "table")
    if kind == "array":
        items = schema.get("prefixItems") or [schema["items"]]
        plural = {"table": "tables", "text": "texts"}
        words = list(
            dict.fromkeys(plural.get(values_of(schema_of_item), values_of(schema_of_item)) for schema_of_item in items)
        )
        least, most = schema.get("minItems", 0), schema.get("maxItems")
        count = f"{least}" if least == most else f"{least} to {most}" if most else f"{least} or more"
        return f"{count if least else 'list'} of {', '.join(words)}"
    if kind == "integer":
        return ", ".join(filter(None, ["whole", bounds_of(schema)]))
    words = {"number": bounds_of(schema) or "number", "string": "text", "boolean": "true, false"}
    return "date and time" if schema.get("format") == "date-time" else words.get(kind, "table")


def declared_keys(name: str) -> dict[str, tuple[str, str]]:
    """Default and values of each key, as the model has them, without keys of one value (`type`): headings name it."""
    properties = MODELS[name].model_json_schema()["properties"]
    return {
        key: (default_of(info), values_of(properties[key]))
        for field, info in MODELS[name].model_fields.items()
        for key in (info.alias or field,)
        if "const" not in properties[key]
    }


def keys_table(name: str) -> str:
    """Pattern of a model's table: its marker, the models whose tables have its other keys, its rows."""
    return rf"(<!-- keys {name}((?: \+ \w+)*) -->\n)\| key .*?\n\|---.*?\n(.*?)(?=\n\n|\n?\Z)"


def rows_of(name: str) -> tuple[list[str], dict[str, tuple[str, str, str]]]:
    """Models whose tables go on with this one's keys; default, values and meaning of each key in its own table."""
    tables = [table for page in KEYS if (table := re.search(keys_table(name), text_of(page), re.DOTALL))]
    assert len(tables) == 1, f"{len(tables)} tables of {name} in {', '.join(page.name for page in KEYS)}"
    (table,) = tables
    rows = [[cell.strip(" |") for cell in line.strip().split(" | ")] for line in table[3].splitlines()]
    return re.findall(r"\w+", table[2]), {row[0].strip("`"): (row[1], row[2], row[3]) for row in rows}


def keys_of(name: str) -> dict[str, tuple[str, str, str]]:
    """Default, values and meaning of each key, as the page has them."""
    parents, rows = rows_of(name)
    for parent in parents:
        inherited = keys_of(parent)
        rows |= {key: inherited[key] for key in declared_keys(name) if key not in rows and key in inherited}
    return rows


REFERENCE = re.compile(r"\bdocs/(\w+)\.md(?: (\d+)\b)?")


def linked(description: str) -> str:
    """The description with links in place of pages, such as `docs/theory_light.md 9`, as the page writes it."""

    def link(found: re.Match[str]) -> str:
        page, section = found[1], found[2]
        if section is None:
            return f"[{page.replace('_', ' ')}]({page}.md)"
        headings = re.findall(rf"^## ({section} .*)$", text_of(ROOT / "docs" / f"{page}.md"), re.MULTILINE)
        assert headings, f"docs/{page}.md has no section {section}"
        anchor = re.sub(r"[^\w\- ]", "", headings[0].lower()).replace(" ", "-")
        return f"[{page.partition('_')[0]}]({page}.md#{anchor})"

    return REFERENCE.sub(link, description)


def declared_rows(name: str) -> dict[str, tuple[str, str, str]]:
    """Default, values and meaning of each key, as the model declares them. Nothing is said of a key without words."""
    words = {info.alias or field: info.description or "" for field, info in MODELS[name].model_fields.items()}
    return {key: (*columns, linked(words[key])) for key, columns in declared_keys(name).items()}


WITHOUT_WORDS = {"bsdf", "projection", "lane_width_m", "value", "wavelength_nm"}
"""Keys whose name and values say enough."""


@pytest.mark.parametrize("name", MODELS)
def test_every_key_has_its_row(name: str) -> None:
    """Rationale: the declaration is the one source of the pages, and of what editors show by the JSON Schema."""
    declared = declared_rows(name)
    assert keys_of(name) == declared, "run: PYTHONPATH=src:tests python tests/docs/test_docs.py"
    assert {key for key, (*_, words) in declared.items() if not words} <= WITHOUT_WORDS


def limits(schema: Any) -> set[float]:
    """Every bound in a piece of JSON Schema."""
    if isinstance(schema, list):
        return set().union(*map(limits, schema))
    if not isinstance(schema, dict):
        return set()
    bounds = {float(value) for key, value in schema.items() if re.match("(exclusive)?(min|max)", key, re.IGNORECASE)}
    return bounds.union(*map(limits, schema.values()))


@pytest.mark.parametrize("name", MODELS)
def test_limits_of_keys(name: str) -> None:
    """The model has these bounds where a page says "300 to 2500", "up to 45" or "1 or more"."""
    properties = MODELS[name].model_json_schema()["properties"]
    for key, (_, _, meaning) in keys_of(name).items():
        words = re.sub(r"`[^`]*`|\([^)]*\)|up to 1.5 it is a point", "", meaning)
        number_ranges = re.findall(r"(-?[\d.]+) to (-?[\d.]+)|up to ([\d.]+)|(\d+) or more", words)
        for number in filter(None, (number for numbers in number_ranges for number in numbers)):
            assert float(number) in limits(properties[key]), f"{key}: {meaning}"


# --- writing them anew ------------------------------------------------------------------------------


def add_keys_table(name: str) -> None:
    """Add a heading and an empty table behind those of the models that may stand in the same place of a file."""
    place = ((field, info.annotation) for model in MODELS.values() for field, info in model.model_fields.items())
    key, siblings = next((field, get_args(union)) for field, union in place if MODELS[name] in get_args(union))
    kind = MODELS[name].model_json_schema()["properties"]["type"]["const"]
    heading = f'`[{key}]` with `type = "{kind}"`:'
    for page in KEYS:
        text = text_of(page)
        tables = [re.search(keys_table(model.__name__), text, re.DOTALL) for model in siblings]
        if end := max((table.end() for table in tables if table), default=0):
            table = f"\n\n{heading}\n\n<!-- keys {name} -->\n| key |\n|---|\n| `type` | - | - |  |"
            page.write_text(text[:end] + table + text[end:], encoding="utf-8")


def refresh_tables() -> None:
    """Write what is generated: the tables of keys, columns and formats, and the names of the columns."""
    for name in MODELS:
        if not any(re.search(keys_table(name), text_of(page), re.DOTALL) for page in KEYS):
            add_keys_table(name)
    texts = {page: text_of(page) for page in KEYS}
    for name in MODELS:
        parents, table_rows = rows_of(name)
        keys = declared_rows(name)
        inherited_keys = {key for parent in parents for key in keys_of(parent)}
        order = [key for key in table_rows if key in keys]
        order += [key for key in keys if key not in table_rows and key not in inherited_keys]
        rows = ["| key | default | values | meaning |", "|---|---|---|---|"]
        rows += [f"| `{key}` | {' | '.join(keys[key])} |" for key in order]
        new = "\n".join(rows)
        for page, text in texts.items():
            texts[page] = re.sub(keys_table(name), lambda table: table[1] + new, text, flags=re.DOTALL)  # noqa: B023
    for page, text in texts.items():
        page.write_text(text, encoding="utf-8")
    for mark, (page, written) in GENERATED.items():
        table = f"<!-- {mark} -->\n{written()}\n\n"
        text = re.sub(rf"<!-- {mark} -->\n(\|.*?\n)?\n", lambda _: table, text_of(page), flags=re.DOTALL)  # noqa: B023
        page.write_text(text, encoding="utf-8")


def refresh_examples() -> None:
    """Write what the examples of the theory print."""
    for page in THEORY:
        text = text_of(page)
        for block in blocks(page, "python"):
            if block.output is not None:
                before = f"```python\n{block.code}```\n\n```text\n"
                after = before + output_of_code(block.code)
                text = text.replace(f"{before}{block.output}```", f"{after}```")
        page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    refresh_tables()
    refresh_examples()
