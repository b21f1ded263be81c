"""Sources with a change that a newcomer makes, and commands that run on them."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from helpers.child import assert_ended

ROOT = Path(__file__).parents[2]

COMMANDS = """
import contextlib, io, json, sys
from lidarscene.cli.main import main

printed = []
for line in json.loads(sys.argv[1]):
    with contextlib.redirect_stdout(io.StringIO()) as text:
        code = exec(line, {}) if "\\n" in line else main(line.split())
    if code:
        sys.exit(f"{line}: ended with {code}")
    printed.append(text.getvalue())
json.dump(printed, sys.stdout)
"""


def changed_sources(
    folder: Path, *, new: dict[str, str], lines: Sequence[tuple[str, str, str]], docs: bool = False
) -> Callable[..., str]:
    """Copy the sources with these changes; return a function that runs Python there and returns what it prints.

    Args:
        new: text of new files by path in the package
        lines: path in the package, a piece of the text, and by what it is replaced
        docs: True to copy the documentation and tests too
    """
    package = folder / "src" / "lidarscene"
    ignore = shutil.ignore_patterns("images")  # what is compiled is kept: it knows its source by size and time
    for name in ("src", "scenes", "assets", *(("docs", "tests", "README.md", "ARCHITECTURE.md") if docs else ())):
        if (ROOT / name).is_file():
            shutil.copy(ROOT / name, folder / name)
        else:
            shutil.copytree(ROOT / name, folder / name, ignore=ignore)
    for name, text in new.items():
        (package / name).write_text(text, encoding="utf-8")
    for name, before, after in lines:
        text = (package / name).read_text(encoding="utf-8")
        assert text.count(before) == 1, f"{name}: '{before}' stands there {text.count(before)} times"
        (package / name).write_text(text.replace(before, after), encoding="utf-8")
    paths = os.pathsep.join([str(folder / "src"), str(folder / "tests"), os.environ.get("PYTHONPATH", "")])

    def run(*words: str) -> str:
        process = subprocess.run(
            [sys.executable, *words],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": paths},
            capture_output=True,
            text=True,
        )
        assert_ended(process, stderr=None)
        return process.stdout

    return run


def command_lines(run: Callable[..., str], *lines: str) -> list[str]:
    """Run lines of `lidarscene`, and code of several lines, in turn in one process; return what each prints."""
    printed: list[str] = json.loads(run("-c", COMMANDS, json.dumps(lines)))
    return printed
