"""Plugin of pytest: `--part=quick`, tests that take little time and those of what is changed; `--part=rest`, others.

tests/costly has the functions of tests that take much, with their CPU seconds as tools/costs.py has measured them.
Where sources or tests differ from the last commit, such functions are quick too, up to CHANGED_S: those of the files
of tests that are changed, that have the name of a changed module or import it, then those of its folder, then
tests/chain; of each the quickest first.
"""

import re
import shutil
import subprocess
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
CHANGED_S = 30.0
"""Choice: a quarter of the CPU that two cores have in a minute."""
Costs = Mapping[str, Mapping[str, float]]
"""CPU seconds of functions of tests that take much, by file, below tests/, and name."""


def read_costs(path: Path) -> dict[str, dict[str, float]]:
    """Read tests/costly: a file of tests on each line, with its functions."""
    lines = (line.partition(": ") for line in path.read_text(encoding="utf-8").splitlines())
    pairs = ((file, [word.partition("=") for word in words.split()]) for file, _, words in lines)
    return {file: {name: float(seconds) for name, _, seconds in words} for file, words in pairs}


def write_costs(path: Path, costs: Costs) -> None:
    """Write what `read_costs` reads, in order."""
    lines = (
        f"{file}: {' '.join(f'{name}={seconds:.1f}' for name, seconds in sorted(costs[file].items()))}\n"
        for file in sorted(costs)
        if costs[file]
    )
    path.write_text("".join(lines), encoding="utf-8")


def changed_files() -> list[str]:
    """What differs from the last commit below src/lidarscene and tests; nothing where git knows of no commit."""
    if not shutil.which("git"):
        return []
    listed = (
        subprocess.run(
            ["git", *words, "src/lidarscene", "tests"], cwd=TESTS.parent, capture_output=True, text=True, check=False
        )
        for words in (("diff", "--name-only", "HEAD", "--"), ("ls-files", "--others", "--exclude-standard", "--"))
    )
    return [name for done in listed if done.returncode == 0 for name in done.stdout.splitlines()]


def of_changes(changed: Collection[str], costs: Costs, limit_s: float = CHANGED_S) -> dict[str, set[str]]:
    """Functions of tests that take much and are run for these changes, by file.

    Args:
        changed: paths below the repository; a deleted or renamed file of tests has no functions
    """
    ranks = {file: min(_ranks(file, changed), default=None) for file in costs if (TESTS / file).exists()}
    ranked = sorted(
        (rank, seconds, file, name)
        for file, functions in costs.items()
        if (rank := ranks.get(file)) is not None
        for name, seconds in functions.items()
    )
    chosen: dict[str, set[str]] = {}
    for _, seconds, file, name in ranked:
        if (limit_s := limit_s - seconds) < 0.0:
            break
        chosen.setdefault(file, set()).add(name)
    return chosen


def _ranks(file: str, changed: Collection[str]) -> Iterator[int]:
    """How near a file of tests is to each of the changes; nothing for one that it is not about."""
    text = (TESTS / file).read_text(encoding="utf-8") if changed else ""
    for path in map(Path, changed):
        folder, stem = "/".join(path.parts[2:-1]), path.stem
        if path.parts[0] == "tests":
            if path == Path("tests", file):
                yield 0
            continue
        imports = rf"lidarscene\.{folder.replace('/', '.')}(\.| import [^\n]*\b){stem}\b"
        if Path(file).stem.startswith(f"test_{stem}") or re.search(imports, text):
            yield 0
        elif Path(file).parent == Path(folder):
            yield 1
        elif file.startswith("chain/"):
            yield 2


def pytest_addoption(parser: pytest.Parser) -> None:
    words = "the tests that take little time and those of what differs from the last commit, or all others"
    parser.addoption("--part", choices=("quick", "rest"), help=words)


def pytest_configure(config: pytest.Config) -> None:
    if config.option.part:
        config.pluginmanager.register(_Part(config.option.part == "quick", read_costs(TESTS / "costly")))


class _Part:
    """Keeps the tests of one part."""

    def __init__(self, quick: bool, costs: Costs) -> None:
        self.quick, self.costs = quick, costs
        self.near = of_changes(changed_files(), costs) if quick else {}

    def pytest_ignore_collect(self, collection_path: Path) -> bool | None:
        """Files without a quick test are not even imported for `--part=quick`."""
        file = collection_path.relative_to(TESTS).as_posix() if collection_path.is_relative_to(TESTS) else ""
        if not self.quick or file not in self.costs or file in self.near:
            return None  # others may know
        functions = re.findall(r"^def (test_\w+)", collection_path.read_text(encoding="utf-8"), re.MULTILINE)
        return set(functions) <= self.costs[file].keys() or None

    def _is_quick(self, item: pytest.Item) -> bool:
        file, name = item.path.relative_to(TESTS).as_posix(), item.name.partition("[")[0]
        return name not in self.costs.get(file, ()) or name in self.near.get(file, ())

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[pytest.Item]) -> None:
        config.hook.pytest_deselected(items=[item for item in items if self._is_quick(item) != self.quick])
        items[:] = [item for item in items if self._is_quick(item) == self.quick]
        items.sort(key=lambda item: item.path.relative_to(TESTS).as_posix() not in self.near)
