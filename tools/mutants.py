#!/usr/bin/env python3
"""Faults put into the sources one at a time, and whether a test notices: what no test notices is held by none.

    tools/mutants.py map [TESTS...]        which test runs which function: one run of these tests (default: all), traced
    tools/mutants.py run -n 300 src/lidarscene/scene src/lidarscene/labels ...
                                           mutants drawn from these files and folders (default: all), each against the
                                           tests that run its function, the quickest first

The map stands in out/mutants/map, the verdicts in out/mutants/verdicts.jsonl. A run prints each mutant that
survives as a diff, and the share that was killed by room. Mutants are made in a copy of the checkout. A survivor is
one of three: a fault that no test notices, code that nobody needs, or a change that makes no difference.
"""

import argparse
import ast
import difflib
import importlib.util
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "lidarscene"
KEPT = ROOT / "out" / "mutants"
TRACED = "LIDARSCENE_MUTANTS_MAP"
"""The variable that makes pytest write which test runs what: a folder, where each process writes a file."""

SEED = {"TEST_SEED": "1", "EVERY_CASE": "1"}
"""Of maps and runs: no mutant survives since the case that catches it is not drawn."""

SWAPPED: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Pow: ast.Mult,
    ast.FloorDiv: ast.Div,
    ast.And: ast.Or,
    ast.Or: ast.And,
}
QUICK_S = 2.0
"""Choice: seconds of the tests that run first. pytest draws the order within a group."""
NAMES = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "any": "all", "all": "any"}
NAMES |= {"sin": "cos", "cos": "sin", "floor": "ceil", "ceil": "floor", "argmin": "argmax", "argmax": "argmin"}
SYMMETRIC = ("min", "max", "minimum", "maximum", "hypot", "isclose", "allclose", "array_equal", "dot")
"""Functions whose arguments may change places."""


class Mutant(NamedTuple):
    """One change of the sources: the file, the function, its line, what stands there and what takes its place."""

    path: str
    function: str
    line: int
    start: int
    end: int
    old: str
    new: str

    @property
    def room(self) -> str:
        """Folder of the file within the package."""
        return "/".join(Path(self.path).parts[2:-1])

    def text(self, code: bytes) -> bytes:
        """The file with the change."""
        return code[: self.start] + self.new.encode() + code[self.end :]


# --- mutants -----------------------------------------------------------------------------------------


def mutants(path: Path) -> list[Mutant]:
    """All of a file: each within a function, none in a message, a docstring, an annotation or a constant's own line."""
    code = path.read_bytes()
    lines = [0]
    for line in code.splitlines(keepends=True):
        lines.append(lines[-1] + len(line))
    found = []
    for function, node in _functions(ast.parse(code), ""):
        for inner, new in _changes(node):
            start = lines[inner.lineno - 1] + inner.col_offset
            end = lines[inner.end_lineno - 1] + inner.end_col_offset
            old = code[start:end].decode()
            name = str(path.relative_to(ROOT))
            if new != ast.unparse(inner):
                found.append(Mutant(name, function, inner.lineno, start, end, old, new))
    return found


def _functions(node: ast.AST, owner: str) -> Iterator[tuple[str, ast.FunctionDef]]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.ClassDef):
            yield from _functions(child, f"{owner}{child.name}.")
        elif isinstance(child, ast.FunctionDef):
            yield f"{owner}{child.name}", child


def _changes(function: ast.FunctionDef) -> Iterator[tuple[Any, str]]:
    """Nodes of a function's body with the code that takes their place."""
    rest: list[ast.AST] = [*function.args.defaults, *filter(None, function.args.kw_defaults), *function.body]
    while rest:
        node = rest.pop()
        # A message and an annotation decide nothing; the text of an f-string has no place of its own before 3.12.
        if isinstance(node, (ast.Raise, ast.JoinedStr, ast.Import, ast.ImportFrom)):
            continue
        if isinstance(node, ast.keyword) and node.arg == "strict":
            continue  # of zip: lists of one length, which it makes sure of
        yield from ((node, new) for new in _others(node))
        rest += [child for field, child in _children(node) if field not in ("annotation", "returns", "decorator_list")]


def _children(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    for field, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield field, child


def _others(node: ast.AST) -> Iterator[str]:
    """What could stand in place of a node, as code."""
    match node:
        case ast.BinOp(left, operator, right):
            if type(operator) in SWAPPED and not isinstance(left, ast.JoinedStr):
                yield f"({ast.unparse(ast.BinOp(left, SWAPPED[type(operator)](), right))})"
            if isinstance(operator, (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow)):
                yield f"({ast.unparse(left)})"
        case ast.Compare(left, [operator], [right]) if type(operator) in SWAPPED:
            yield f"({ast.unparse(ast.Compare(left, [SWAPPED[type(operator)]()], [right]))})"
        case ast.BoolOp(operator, values):
            yield f"({ast.unparse(ast.BoolOp(SWAPPED[type(operator)](), values))})"
            yield f"({ast.unparse(values[0])})"
        case ast.UnaryOp(ast.Not() | ast.USub() | ast.Invert(), operand):
            yield f"({ast.unparse(operand)})"
        case ast.Constant(value) if isinstance(value, bool):
            yield str(not value)
        case ast.Constant(value) if isinstance(value, int):
            yield str(value + 1)
        case ast.Constant(value) if isinstance(value, float):
            yield repr(2.0 * value or 1.0)
        case ast.IfExp(_, body, otherwise):
            yield f"({ast.unparse(body)})"
            yield f"({ast.unparse(otherwise)})"
        case ast.Call(function, arguments, keywords):
            name = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")
            if name in NAMES:
                yield ast.unparse(node)[: len(ast.unparse(function)) - len(name)] + NAMES[name] + _arguments(node)
            if (
                len(arguments) > 1
                and name not in SYMMETRIC
                and not any(isinstance(argument, ast.Starred) for argument in arguments[:2])
            ):
                yield ast.unparse(ast.Call(function, [arguments[1], arguments[0], *arguments[2:]], keywords))
        case ast.Expr(ast.Call()) | ast.AugAssign():
            yield "pass"


def _arguments(call: ast.Call) -> str:
    return ast.unparse(ast.Call(ast.Name("f"), call.args, call.keywords))[1:]


# --- which test runs what ----------------------------------------------------------------------------


class Trace:
    """Functions of the sources that each test of this process runs, as pytest's hooks below tell it."""

    def __init__(self, folder: Path) -> None:
        self.file = (folder / f"{os.getpid()}.jsonl").open("a", encoding="utf-8")
        self.seen: dict[CodeType, str | None] = {}
        self.ran: set[CodeType] = set()

    def start(self) -> None:
        self.ran = set()
        threading.settrace(self)
        sys.settrace(self)

    def stop(self, test: str, seconds: float) -> None:
        sys.settrace(None)
        names = sorted({name for code in self.ran if (name := self.seen[code])})
        self.file.write(json.dumps([test, round(seconds, 3), names]) + "\n")
        self.file.flush()

    def __call__(self, frame: FrameType, _event: str, _argument: object) -> None:
        code = frame.f_code
        if code not in self.ran:
            self.ran.add(code)
            if code not in self.seen:
                inside = code.co_filename.startswith(f"{SOURCE}{os.sep}")
                function = code.co_qualname.split(".<locals>")[0]
                self.seen[code] = f"{os.path.relpath(code.co_filename, ROOT)}:{function}" if inside else None


_TRACE = Trace(Path(folder)) if (folder := os.environ.get(TRACED)) else None
_STARTED = time.perf_counter()


def pytest_runtest_logstart() -> None:
    """A test begins, with its fixtures."""
    global _STARTED
    _STARTED = time.perf_counter()
    if _TRACE:
        _TRACE.start()


def pytest_runtest_logfinish(nodeid: str) -> None:
    """A test has ended."""
    if _TRACE:
        _TRACE.stop(nodeid, time.perf_counter() - _STARTED)


class Map:
    """Tests of each function, and the seconds that each test takes."""

    def __init__(self, folder: Path) -> None:
        self.tests: dict[str, list[str]] = {}
        self.seconds: dict[str, float] = {}
        for path in sorted(folder.glob("*.jsonl")):
            for line in path.read_text(encoding="utf-8").splitlines():
                test, seconds, names = json.loads(line)
                self.seconds[test] = seconds
                for name in names:
                    self.tests.setdefault(name, []).append(test)

    def of(self, mutant: Mutant, limit_s: float) -> list[list[str]]:
        """Tests that run the mutant's function, then those of the same files and of its room, up to a time.

        A test may use what an earlier one has computed, so that it runs the function no more.

        Returns:
            the quick ones, and the others
        """
        direct = sorted(set(self.tests.get(f"{mutant.path}:{mutant.function}", ())), key=self.seconds.__getitem__)
        files = {test.split("::")[0] for test in direct}
        room = f"tests/{mutant.room}/"
        beside = [t for t in self.seconds if direct and (t.split("::")[0] in files or t.startswith(room))]
        beside.sort(key=self.seconds.__getitem__)
        quick: list[str] = []
        slow: list[str] = []
        total = 0.0
        for test in dict.fromkeys([*direct, *beside]):
            if total + self.seconds[test] > limit_s and (quick or slow):
                break
            total += self.seconds[test]
            (quick if total < QUICK_S else slow).append(test)
        return [tests for tests in (quick, slow) if tests]


def make_map(tests: Sequence[str]) -> None:
    """Run the tests, traced."""
    folder = KEPT / "map"
    folder.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "pytest", "-p", "mutants", "-q", "-n", "0", "-p", "no:randomly", *tests]
    paths = os.pathsep.join(map(str, (ROOT / "tools", ROOT / "src")))
    subprocess.run(command, cwd=ROOT, env=os.environ | SEED | {TRACED: str(folder), "PYTHONPATH": paths}, check=False)


# --- a run -------------------------------------------------------------------------------------------


def verdict(mutant: Mutant, groups: Sequence[Sequence[str]], checkout: Path, limit_s: float) -> tuple[str, str]:
    """Killed, survived, out of time, or no test; and the first test that failed."""
    if not groups:
        return "no test", ""
    path = checkout / mutant.path
    whole = path.read_bytes()
    _replace(path, mutant.text(whole))
    clean = {name: value for name, value in os.environ.items() if name not in (TRACED, "PYTHONPATH")} | SEED
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", "--no-header"]
    try:
        for tests in groups:
            ran = subprocess.run(
                [*command, *tests],
                cwd=checkout,
                env=clean,
                capture_output=True,
                text=True,
                timeout=limit_s,
                check=False,
            )
            starts = ("FAILED", "ERROR")
            failed = [line.split(" - ")[0] for line in ran.stdout.splitlines() if line.startswith(starts)]
            # A mutant that cannot be imported ends pytest with 4, as does a test that is not there.
            if ran.returncode in (4, 5) and not failed:
                raise SystemExit(f"tools/mutants.py: the map is old: {' '.join(ran.stderr.split())[:300]}")
            if ran.returncode:
                return "killed", failed[0] if failed else f"exit {ran.returncode}"
    except subprocess.TimeoutExpired:
        return "out of time", ""
    finally:
        _replace(path, whole)
    return "survived", ""


def _replace(path: Path, source: bytes) -> None:
    """Write a module. Python goes by seconds and size, and would take the bytecode of another mutant of this second."""
    path.write_bytes(source)
    Path(importlib.util.cache_from_source(str(path))).unlink(missing_ok=True)


def copy_of_checkout(folder: Path) -> Path:
    """What git tracks, in a folder."""
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, names.split("\0")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, folder / name)
    return folder


def run(paths: Sequence[str], number: int, seed: int, jobs: int, limit_s: float) -> None:
    """Draw mutants, try them, and print what survives and the share by room."""
    known = Map(KEPT / "map")
    if not known.seconds:
        raise SystemExit("tools/mutants.py: there is no map yet: run tools/mutants.py map first")
    files = sorted(
        {file for path in paths for file in ([Path(path)] if path.endswith(".py") else Path(path).rglob("*.py"))}
    )
    if missing := [path for path in paths if not Path(path).exists()]:
        raise SystemExit(f"tools/mutants.py: no such file or folder: {', '.join(missing)}")
    all_of_them = [mutant for file in files for mutant in mutants(file.resolve())]
    drawn = random.Random(seed).sample(all_of_them, min(number, len(all_of_them)))
    print(f"{len(drawn)} of {len(all_of_them)} mutants of {len(files)} files, seed {seed}", flush=True)
    counts: dict[str, Counter[str]] = {}
    with tempfile.TemporaryDirectory(prefix="mutants_") as folder, ThreadPoolExecutor(jobs) as threads:
        free = [copy_of_checkout(Path(folder, str(job))) for job in range(jobs)]

        def tried(mutant: Mutant) -> tuple[Mutant, str, str]:
            checkout = free.pop()
            try:
                return mutant, *verdict(mutant, known.of(mutant, limit_s / 4), checkout, limit_s)
            finally:
                free.append(checkout)

        with (KEPT / "verdicts.jsonl").open("a", encoding="utf-8") as kept:
            for mutant, word, test in threads.map(tried, drawn):
                kept.write(json.dumps({**mutant._asdict(), "verdict": word, "test": test}) + "\n")
                kept.flush()
                counts.setdefault(mutant.room, Counter())[word] += 1
                if word != "killed":
                    print(f"{word}: {mutant.path}:{mutant.line} {mutant.function}\n{diff(mutant)}", flush=True)
    print(table(counts))


def diff(mutant: Mutant) -> str:
    """The change, as lines before and after."""
    code = (ROOT / mutant.path).read_bytes()
    before, after = (text.decode().splitlines() for text in (code, mutant.text(code)))
    lines = difflib.unified_diff(before, after, n=0, lineterm="")
    return "\n".join(f"    {line}" for line in lines if not line.startswith(("---", "+++", "@@")))


def table(counts: dict[str, Counter[str]]) -> str:
    """Killed and others by room, as Markdown."""
    words = ("killed", "survived", "out of time", "no test")
    rows = [f"| room | mutants | {' | '.join(words)} |", "|---" * (2 + len(words)) + "|"]
    for room, count in [*sorted(counts.items()), ("all", sum(counts.values(), Counter()))]:
        rows.append(f"| {room} | {count.total()} | {' | '.join(str(count[word]) for word in words)} |")
    return "\n".join(rows)


def main() -> None:
    """The command that is named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    mapped = commands.add_parser("map", help="run tests and write which runs what")
    mapped.add_argument("tests", nargs="*", default=["tests"])
    ran = commands.add_parser("run", help="draw mutants and try them")
    ran.add_argument("paths", nargs="*", default=[str(SOURCE)])
    ran.add_argument("-n", "--number", type=int, default=300)
    ran.add_argument("--seed", type=int, default=1)
    ran.add_argument("--jobs", type=int, default=1, help="mutants at a time, each in a copy of the checkout")
    ran.add_argument(
        "--limit-s", type=float, default=240, help="longest time of a mutant; a quarter of it is for tests"
    )
    options = parser.parse_args()
    if options.command == "map":
        make_map(options.tests)
    else:
        run(options.paths, options.number, options.seed, options.jobs, options.limit_s)


if __name__ == "__main__":
    main()
