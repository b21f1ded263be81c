"""The architecture: who may import whom, and what `import lidarscene` may cost."""

import ast
import itertools
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[2] / "src" / "lidarscene"

# The architecture, lowest first. A module or package imports from tiers below its own; inside one
# tier too, as long as no circle closes. Relative, absolute and function-level imports are alike.
TIERS = (
    ("constants", "errors"),
    ("arrays",),
    ("noise", "geometry", "trajectory"),
    ("physics",),
    ("scene", "weather", "materials", "sensor", "detectors", "overlap", "scan"),
    ("motion",),
    ("beams", "footprint"),
    ("hits",),
    ("echoes",),
    ("ambient", "field_of_view", "intensity", "interference", "air_light", "train"),
    ("comparator", "waveform", "rises", "samplers", "returns", "multi_echo", "waveforms"),
    ("formats", "cloud", "kinds", "boxes", "labels"),
    ("kernel",),
    ("simulate", "stages", "metadata", "frame", "chunk", "summary", "rig", "deskew"),
    ("catalog", "io", "pixels", "thinning", "plots", "charts", "charts_fov", "charts_compare"),
    ("api", "report"),
    ("analysis", "batch"),
    ("view",),
    (
        "cli",
        "cli_analysis",
        "cli_batch",
        "cli_compare",
        "cli_fov",
        "cli_frame",
        "cli_output",
        "cli_render",
        "cli_types",
        "cli_view",
        "doctor",
        "__main__",
    ),
)
RANK = {name: rank for rank, names in enumerate(TIERS) for name in names}

# Only these know the big libraries: path inside the package, or the folder of it.
MAY_IMPORT = {
    "mitsuba": ("kernel",),
    "drjit": ("kernel", "arrays.py"),
    "matplotlib": ("plots.py", "charts.py", "charts_fov.py", "charts_compare.py"),
    "open3d": ("io",),
    "pandas": ("io",),
    "pvlib": ("io",),
    "distributed": ("batch",),
}

HEAVY = ("mitsuba", "drjit", "open3d", "matplotlib", "pandas", "pvlib", "trimesh", "distributed", "pyarrow")


def imported(code: str, *, file: Path, modules: set[str]) -> Iterator[str]:
    """Dotted names of everything that `code` in `file` (relative to the package) imports, anywhere.

    `from lidarscene.light import beams` is the module lidarscene.light.beams if there is one.
    """
    package = ("lidarscene", *file.parts[:-1])
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            origin = ".".join([*base, *([node.module] if node.module else [])])
            for alias in node.names:
                if origin != "lidarscene":
                    yield origin
                elif alias.name != "__version__":  # all that the package itself holds
                    yield f"{origin}.{alias.name}" if alias.name in modules else origin


def component(file: Path) -> str:
    """The module or package right under lidarscene that a file belongs to."""
    return file.parts[0].removesuffix(".py")


def files() -> list[Path]:
    return sorted(path.relative_to(SOURCE) for path in SOURCE.rglob("*.py"))


def own_imports(code: str, *, file: Path, modules: set[str]) -> set[str]:
    """The other components that a file imports; '' for lidarscene itself."""
    names = (n.split(".") for n in imported(code, file=file, modules=modules))
    inside = {(n[1] if len(n) > 1 else "") for n in names if n[0] == "lidarscene"}
    return inside - {component(file)}


def problems(sources: dict[Path, str]) -> list[str]:
    """What is against the architecture, one line each."""
    found = []
    modules = {component(file) for file in sources}
    same_tier: dict[str, set[str]] = {}
    for file, code in sources.items():
        name = component(file)
        if name == "__init__":  # the face of the package shows everything
            continue
        if name not in RANK:
            found.append(f"{file}: '{name}' has no place in the architecture; add it to TIERS in {__file__}")
            continue
        for other in sorted(own_imports(code, file=file, modules=modules)):
            if other == "":
                found.append(f"{file}: imports from lidarscene itself; name the module")
            elif other not in RANK:
                found.append(f"{file}: imports '{other}', which has no place in TIERS in {__file__}")
            elif RANK[other] > RANK[name]:
                found.append(f"{file}: '{name}' must not import '{other}', which is above it")
            elif RANK[other] == RANK[name]:
                same_tier.setdefault(name, set()).add(other)
    try:
        TopologicalSorter(same_tier).prepare()
    except ValueError as circle:
        found.append(f"a circle of imports inside one tier: {circle.args[1]}")
    return found


def test_imports_point_downwards() -> None:
    """Rationale: the list is the architecture (docs/architecture.md)."""
    assert problems({file: (SOURCE / file).read_text(encoding="utf-8") for file in files()}) == []


@pytest.mark.parametrize(
    ("file", "code", "complaint"),
    [
        ("beams.py", "from .hits import Hits", "'beams' must not import 'hits'"),
        ("beams.py", "def f():\n    from lidarscene.kernel.rays.trace import t", "must not import 'kernel'"),
        ("beams.py", "import lidarscene.cli.main", "must not import 'cli'"),
        ("beams.py", "from lidarscene.cli import main as cli", "must not import 'cli'"),
        ("beams.py", "from . import cli", "must not import 'cli'"),
        ("physics/tdc.py", "from ..kernel import backend", "must not import 'kernel'"),
        ("physics/deep/tdc.py", "from ...kernel import backend", "must not import 'kernel'"),
        ("physics/__init__.py", "from ..beams import Beams", "must not import 'beams'"),
        ("physics/tdc.py", "from .. import Beams", "imports from lidarscene itself"),
        ("cli.py", "from . import __version__", ""),
        ("physics/tdc.py", "from .beams import x\nfrom . import y\nfrom ..arrays import xp", ""),
        ("kernel/trace.py", "from ..hits import Hits\nfrom .backend import mitsuba", ""),
        ("misc.py", "", "'misc' has no place"),
        ("cli.py", "from .misc import x", "imports 'misc', which has no place"),
        ("sensor.py", "from .scan import Scanner", ""),
        ("__init__.py", "from .cli import main", ""),
    ],
)
def test_the_rule_finds_what_it_should(file: str, code: str, complaint: str) -> None:
    sources = {Path("cli.py"): "", Path("hits.py"): ""} | {Path(file): code}
    found = [line for line in problems(sources) if line.startswith(file)]
    assert len(found) == bool(complaint), found
    assert all(complaint in line for line in found)


def test_a_circle_inside_a_tier_is_found() -> None:
    sources = {Path("sensor.py"): "from .scan import a", Path("scan/b.py"): "from ..sensor import c"}
    assert ["circle" in line for line in problems(sources)] == [True]


@pytest.mark.parametrize("library", MAY_IMPORT)
def test_only_the_named_files_import(library: str) -> None:
    allowed = MAY_IMPORT[library]
    for file in files():
        names = imported((SOURCE / file).read_text(encoding="utf-8"), file=file, modules=set())
        if file.parts[0] not in allowed:
            assert library not in {name.split(".")[0] for name in names}, f"{file} must not import {library}"


@pytest.mark.parametrize("module", ["lidarscene", "lidarscene.cli.main"])
def test_import_is_light(module: str, run_python) -> None:
    """Rationale: `import lidarscene` needs no LLVM, and `lidarscene --help` answers at once."""
    code = f"import sys, {module}; print(*(n for n in {HEAVY} if n in sys.modules))"
    done = run_python(code)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == []


def test_import_needs_no_llvm(run_python) -> None:
    done = run_python("import lidarscene, lidarscene.cli.main", DRJIT_LIBLLVM_PATH="/nowhere/libLLVM.so")
    assert (done.returncode, done.stderr) == (0, "")


def test_every_public_name_can_be_had(run_python) -> None:
    """Rationale: names that come lazily are easily misspelt."""
    done = run_python("import lidarscene\nfor n in lidarscene.__all__: getattr(lidarscene, n)")
    assert done.returncode == 0, done.stderr


def test_tiers_name_each_module_once() -> None:
    names = list(itertools.chain.from_iterable(TIERS))
    assert len(names) == len(set(names))
