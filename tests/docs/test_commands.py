"""Every command that the documentation shows runs, page by page, on the files that the page shows; a run draws pages.

And what all shell blocks may hold.
"""

import argparse
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
from helpers.documentation import PAGES, ROOT, commands, shell_lines
from helpers.shown_commands import PARSED_ONLY, Reader, drawn_pages, incomplete

from lidarscene.cli import main
from lidarscene.cli.words import with_joined_pose

pytestmark = pytest.mark.fixed_streams

OTHERS = ("git", "cd", "pip", "python", "python3", "source", ".")
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Reader:
    return Reader(tmp_path_factory.mktemp("documentation"))


def test_pages_show_commands_that_exist() -> None:
    """Each is one, before any of them runs."""
    shown = [command for page in PAGES for command in commands(page) if not incomplete(command)]
    assert len(shown) > 60
    for command in shown:
        words = shlex.split(command.partition(" > ")[0])[1:]
        assert main._parser().parse_args(with_joined_pose(words)).run, command


@pytest.mark.parametrize("page", drawn_pages(), ids=lambda page: page.name)
def test_commands_run(
    page: Path, mi: Any, reader: Reader, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    reader.follow(page, monkeypatch, capsys)


def test_what_is_only_parsed_is_shown_and_run_elsewhere() -> None:
    shown = {command.removeprefix("lidarscene ") for page in PAGES for command in commands(page)}
    assert {command for elsewhere in PARSED_ONLY.values() for command in elsewhere} - shown == set()
    for test in PARSED_ONLY:
        file, _, name = test.partition("::")
        assert f"def {name}(" in (ROOT / file).read_text(encoding="utf-8")


def test_every_option_is_in_an_example() -> None:
    """One command is enough: an option has one meaning in all."""
    (chosen,) = [a for a in main._parser()._actions if isinstance(a, argparse._SubParsersAction)]
    actions = [action for command in chosen.choices.values() for action in command._actions]
    words = {word.partition("=")[0] for page in PAGES for command in commands(page) for word in command.split()}
    unseen = {
        action.option_strings[-1]
        for action in actions
        if action.option_strings and not words & {*action.option_strings}
    }
    assert unseen == set()


def test_other_lines_of_shell_blocks() -> None:
    """`make` has every target that is named, and nothing unexpected is typed."""
    for page in PAGES:
        for line in shell_lines(page):
            words = line.split()
            if not words or words[0].removeprefix(".venv/bin/") == "lidarscene":
                continue
            if "make" in words:
                assert re.search(rf"^{words[words.index('make') + 1]}:", MAKEFILE, re.MULTILINE), line
            else:
                assert words[0] in OTHERS, line
