"""The architecture: which folder may import which, what signatures say, and what `import lidarscene` may cost.

Both are asked here because to parse all files takes longest.
"""

import ast
import itertools
from collections.abc import Iterable, Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from helpers.child import assert_ended
from helpers.sources import parse

import lidarscene

SOURCE = Path(__file__).parents[2] / "src" / "lidarscene"
PACKAGE = "lidarscene"

# The architecture, lowest first: one line is a tier of folders (or of modules right under lidarscene). A file imports
# from its own folder and from tiers below its own, never from a neighbour in its tier. Imports inside functions, under
# TYPE_CHECKING and by a string that names a module of ours count as all others do.
TIERS = (
    ("errors", "_version"),
    ("maths",),
    ("physics", "catalog"),
    ("files",),
    ("materials", "scan"),
    ("sensor",),
    ("scene",),
    ("light",),
    ("detection",),
    ("formats",),
    ("kernel",),
    ("cloud",),
    ("labels", "figures", "rendering", "recordings"),
    ("outputs",),
    ("studies", "batch"),
    ("checking",),
    ("view",),
    ("cli",),
    ("__main__",),
)
RANK = {name: rank for rank, names in enumerate(TIERS) for name in names}

# Only these know the big libraries: a folder, or one file.
MAY_IMPORT = {
    "mitsuba": ("kernel",),
    "drjit": ("kernel", "maths/arrays.py"),
    "matplotlib": ("figures",),
    "open3d": ("files/open3d.py",),
    "pandas": ("files/pvlib.py",),  # elsewhere by name, through files/optional.py
    "pvlib": ("files/pvlib.py",),
    "distributed": ("batch",),
}

CHAIN = ("light", "detection", "physics", "scan", "kernel", "rendering")
"""Folders whose annotations mean something."""

LARGEST_SHARE_OF_ANY = 0.05

HEAVY = "numpy mitsuba drjit open3d matplotlib pandas pvlib trimesh distributed pyarrow pydantic"


def module_of(file: Path) -> str:
    """Dotted name of a file, relative to the package."""
    parts = file.with_suffix("").parts
    return ".".join((PACKAGE, *(parts[:-1] if parts[-1] == "__init__" else parts)))


def room(module: str) -> str:
    """The folder, or the module right under lidarscene, that a module belongs to; '' for lidarscene itself."""
    return [*module.split("."), ""][1]


@cache
def nodes(code: str) -> tuple[ast.AST, ...]:
    """Those of its syntax tree that are asked for below; parsed once for all tests."""
    kinds = (ast.Import, ast.ImportFrom, ast.FunctionDef, ast.AsyncFunctionDef, ast.Assign, ast.AnnAssign)
    return tuple(
        node
        for node in ast.walk(parse(code))
        if isinstance(node, kinds)
        or (isinstance(node, ast.Constant) and isinstance(node.value, str) and PACKAGE in node.value)
    )


def imported_modules(code: str, *, file: Path, modules: Iterable[str]) -> Iterator[str]:
    """Dotted names of everything that `code` in `file` (relative to the package) imports, anywhere.

    A string that names a module of ours, as `import_module` and `__import__` take it, counts too, f-strings by what
    they begin with.
    """
    package = (PACKAGE, *file.parts[:-1])
    module_names = set(modules)
    for node in nodes(code):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            origin = ".".join([*base, *([node.module] if node.module else [])])
            for alias in node.names:
                deeper = f"{origin}.{alias.name}"
                yield deeper if deeper in module_names or (origin == PACKAGE and alias.name in RANK) else origin
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            name = node.value.strip(".")
            if name.startswith(f"{PACKAGE}.") and (name in module_names or room(name) in RANK) and " " not in name:
                yield name


def problems(sources: dict[Path, str]) -> list[str]:
    """What is against the architecture, one line each."""
    complaints = []
    files = {module_of(file): file for file in sources}
    graph: dict[str, set[str]] = {}
    for module, file in files.items():
        importing_room = room(module)
        if importing_room == "":  # the face of the package shows everything
            continue
        if importing_room not in RANK:
            complaints.append(
                f"{file}: '{importing_room}' has no place in the architecture; add it to TIERS in {__file__}"
            )
            continue
        names = {n for n in imported_modules(sources[file], file=file, modules=files) if n.split(".")[0] == PACKAGE}
        graph[module] = {name for name in names if name in files and name != module}
        for name in sorted(names):
            imported_room = room(name)
            if imported_room == "":
                complaints.append(f"{file}: imports from {PACKAGE} itself; name the module")
            elif imported_room not in RANK:
                complaints.append(f"{file}: imports '{imported_room}', which has no place in TIERS in {__file__}")
            elif imported_room != importing_room and RANK[imported_room] >= RANK[importing_room]:
                complaints.append(
                    f"{file}: '{importing_room}' must not import '{imported_room}', which is not below it ({name})"
                )
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as circle:
        complaints.append(f"a circle of files: {' -> '.join(circle.args[1])}")
    return complaints


@cache
def sources() -> dict[Path, str]:
    """The code of the package by file."""
    return {path.relative_to(SOURCE): path.read_text(encoding="utf-8") for path in sorted(SOURCE.rglob("*.py"))}


@cache
def libraries() -> dict[Path, set[str]]:
    """What each file imports, by the first word of its name."""
    return {
        file: {name.split(".")[0] for name in imported_modules(code, file=file, modules=())}
        for file, code in sources().items()
    }


def test_imports_point_downwards() -> None:
    """Rationale: the list is the architecture (ARCHITECTURE.md). It finds circles of files too."""
    assert problems(sources()) == []


@pytest.mark.parametrize(
    ("file", "code", "complaint"),
    [
        ("light/beams.py", "from ..detection.report import R", "'light' must not import 'detection'"),
        ("light/beams.py", "def f():\n    from lidarscene.kernel.rays.trace import t", "must not import 'kernel'"),
        ("light/beams.py", "import lidarscene.cli.main", "must not import 'cli'"),
        ("light/beams.py", "from lidarscene import cli", "must not import 'cli'"),
        ("light/beams.py", "from .. import cli", "must not import 'cli'"),
        ("light/beams.py", "import importlib\nimportlib.import_module('lidarscene.cli.main')", "not import 'cli'"),
        ("light/beams.py", "import_module(f'lidarscene.formats.{name}')", "must not import 'formats'"),
        ("labels/boxes.py", "from ..rendering.frame import f", "'labels' must not import 'rendering'"),
        ("physics/optics/beam.py", "from ...kernel.device import backend", "must not import 'kernel'"),
        ("physics/__init__.py", "from ..light.beams import Beams", "must not import 'light'"),
        ("physics/optics/beam.py", "from ... import Beams", "imports from lidarscene itself"),
        ("cli/main.py", "from .._version import __version__", ""),
        ("physics/optics/beam.py", "from . import y\nfrom ..constants import c\nfrom ...maths.arrays import xp", ""),
        ("kernel/rays/trace.py", "from ...light.hits import Hits\nfrom ..device.backend import m", ""),
        ("misc.py", "", "'misc' has no place"),
        ("cli/main.py", "from ..misc import x", "imports 'misc', which has no place"),
        ("__init__.py", "from .cli import main", ""),
    ],
)
def test_the_rule_finds_what_it_should(file: str, code: str, complaint: str) -> None:
    complaints = [line for line in problems({Path(file): code}) if line.startswith(file)]
    assert len(complaints) == bool(complaint), complaints
    assert all(complaint in line for line in complaints)


def test_a_circle_of_files_is_found() -> None:
    """A circle is found inside one folder too, where no tier forbids it."""
    code = {Path("light/a.py"): "from .b import x", Path("light/b.py"): "def f():\n    from .a import y"}
    assert ["circle" in line for line in problems(code)] == [True]


def test_at_the_top_are_packages_and_four_files() -> None:
    """Rationale: whoever opens the folder sees the tiers, and nothing else."""
    assert {file.name for file in sources() if len(file.parts) == 1} == {
        "__init__.py",
        "__main__.py",
        "_version.py",
        "errors.py",
    }


@pytest.mark.parametrize("library", MAY_IMPORT)
def test_only_the_named_files_import(library: str) -> None:
    for file, names in libraries().items():
        if not any(file.as_posix().startswith(place) for place in MAY_IMPORT[library]):
            assert library not in names, f"{file} must not import {library}"


def annotations(code: str) -> Iterator[tuple[str, ast.expr]]:
    """Place and annotation of every parameter that has one."""
    for node in nodes(code):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            for argument in ast.walk(node.args):
                if isinstance(argument, ast.arg) and argument.annotation is not None:
                    yield f"{node.lineno} {node.name}: {argument.arg}", argument.annotation


def says_any(annotation: ast.expr) -> bool:
    """Whether Any is part of an annotation, in quotation marks too."""
    return any(
        (isinstance(node, ast.Name) and node.id == "Any")
        or (isinstance(node, ast.Attribute) and node.attr == "Any")
        or (isinstance(node, ast.Constant) and isinstance(node.value, str) and "Any" in node.value)
        for node in ast.walk(annotation)
    )


@pytest.mark.parametrize("folder", CHAIN)
def test_few_parameters_are_any(folder: str) -> None:
    annotated = [
        (f"{file}:{place}", annotation)
        for file, code in sources().items()
        if file.parts[0] == folder
        for place, annotation in annotations(code)
    ]
    loose = [place for place, annotation in annotated if says_any(annotation)]
    assert len(annotated) > 100  # the folder is there
    assert len(loose) <= LARGEST_SHARE_OF_ANY * len(annotated), "\n".join(loose)


def test_any_has_no_other_name() -> None:
    """An alias of Any, or of an array of anything, would hide it from the count above."""
    hidden = []
    for file, code in sources().items():
        assert "np.ndarray[Any, Any]" not in code, f"{file}: must say `maths.arrays.Numbers`"
        for node in nodes(code):
            value = node.value if isinstance(node, ast.Assign | ast.AnnAssign) else None
            if isinstance(value, ast.Name) and value.id == "Any":
                hidden.append(f"{file}:{node.lineno}")
    assert hidden == []


def test_public_names_are_no_folders() -> None:
    """Rationale: `import lidarscene.render` would hide the function of that name; a package that is called does not."""
    folders = {path.name for path in SOURCE.iterdir() if path.is_dir()}
    assert folders.intersection(lidarscene.__all__) == set(lidarscene._FUNCTIONS)


def test_names_that_people_try_first_say_what_to_call(run_python) -> None:
    """Outcome in a fresh process, where no package of such a name is imported yet."""
    names = ("catalog", "load", "simulate")
    code = f"""
import lidarscene
for name in {names}:
    try:
        getattr(lidarscene, name)
    except AttributeError as error:
        print(error)
"""
    process = run_python(code)
    assert_ended(process)
    said = dict(line.split("; ", 1) for line in process.stdout.splitlines())
    assert list(said) == [f"lidarscene has no '{name}'" for name in names]
    with pytest.raises(AttributeError, match="nothing_of_ours"):
        _ = lidarscene.nothing_of_ours


def test_import_is_light_and_every_public_name_can_be_had(run_python) -> None:
    """Rationale: `import lidarscene` needs no LLVM, and `lidarscene --help` answers at once (NumPy: 0.2 s). Names that
    come lazily are easily misspelt.
    """
    heavy = f"print(*(n for n in {HEAVY!r}.split() if n in sys.modules), end='|')"
    code = f"""
import sys, lidarscene
{heavy}
import lidarscene.cli.main
{heavy}
for name in lidarscene.__all__:
    getattr(lidarscene, name)
"""
    process = run_python(code, DRJIT_LIBLLVM_PATH="/nowhere/libLLVM.so")
    assert_ended(process)
    assert process.stdout == "||"


def test_tiers_name_each_folder_once() -> None:
    names = list(itertools.chain.from_iterable(TIERS))
    assert len(names) == len(set(names))
