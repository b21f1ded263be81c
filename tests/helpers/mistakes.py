"""Mistakes as tables, one a line: what is given, and what the answer must name. The wording of answers is free."""

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from inspect import signature
from pathlib import Path
from typing import Any

import pytest

from helpers.command_line import Run
from lidarscene.errors import LONGEST, InputError

GIVEN = "given"
"""Folder of the files that a test spoils."""


def mistakes(table: str, **words: str) -> pytest.MarkDecorator:
    r"""Parameters `given` and `named`, a case for each line `GIVEN | NAMED | NAMED ...` of a table.

    Args:
        table: its lines, where \n in GIVEN is a new line
        words: what capital words of the lines stand for
    """
    cases = []
    for line in filter(None, map(str.strip, table.splitlines())):
        given, named = f" {line}".split(" | ", 1)
        row = [given.strip().replace("\\n", "\n"), named]
        for word, text in words.items():
            row = [cell.replace(word, text) for cell in row]
        cases.append(pytest.param(*row, id=given.strip() or "nothing"))
    return pytest.mark.parametrize(("given", "named"), cases)


def calls(*rows: tuple[Any, ...]) -> Callable[..., None]:
    """Test of a table of calls, each in a folder where nothing is written.

    Args:
        rows: a call, whose parameters without defaults are fixtures, `NAMED | NAMED ...`, and the error's class if it
            is not InputError
    """
    cases = [pytest.param(call, named, *(error or [InputError]), id=named) for call, named, *error in rows]

    @pytest.mark.parametrize(("call", "named", "error"), cases)
    def test(
        call: Callable[..., Any],
        named: str,
        error: type[Exception],
        request: pytest.FixtureRequest,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        fixtures = {
            name: request.getfixturevalue(name)
            for name, entry in signature(call).parameters.items()
            if entry.default is entry.empty and entry.kind is not entry.VAR_POSITIONAL
        }
        before = {path.name for path in tmp_path.iterdir()}
        monkeypatch.chdir(tmp_path)
        with told(named, error):
            call(**fixtures)
        assert {path.name for path in tmp_path.iterdir()} <= before | {GIVEN}

    table: Callable[..., None] = test
    return table


def refused(
    call: Callable[..., Any], *rows: tuple[Any, ...], where: str = "", error: type[Exception] = InputError
) -> Callable[..., None]:
    """Test of a table of values that a function refuses, by `calls`.

    Args:
        call: function of a row's values, and of fixtures
        rows: values, and `NAMED | NAMED ...`
        where: what all rows name
    """
    prefix = f"{where} | " if where else ""
    return calls(*((partial(call, *values), prefix + named, error) for *values, named in rows))


def given_file(name: str, content: str | bytes = "") -> Path:
    """Write a file of a mistake into a folder of the working directory."""
    path = Path(GIVEN, name)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def assert_names(message: str, named: str, echoed: Iterable[str] = ()) -> None:
    """Assert that one line names each of `PLACE | CAME | EXPECTED`: whole words, none by the letters of another.

    Args:
        message: the line
        named: what it must name
        echoed: texts of the caller that it may repeat, whose words do not count
    """
    assert "\n" not in message
    assert message == message.strip() != ""
    assert len(message) <= LONGEST
    rest, required = message, [part.strip() for part in named.split(" | ")]
    for part in sorted([*required, *echoed], key=len, reverse=True):
        start = r"(?<![\w.])" if part[0].isdigit() else r"(?<!\w)" if part[0].isalpha() else ""
        end = r"(?!\w|\.\d)" if part[-1].isalnum() else ""
        rest, found = re.subn(start + re.escape(part) + end, "\0", rest, count=1)
        assert found or part not in required, f"{part!r} is not named by {message!r}"


@contextmanager
def told(named: str, error: type[Exception] = InputError, *, echoed: Iterable[str] = ()) -> Iterator[None]:
    """Expect an error whose message names all of `PLACE | CAME | EXPECTED`, apart from what it repeats."""
    with pytest.raises(error) as caught:
        yield
    assert_names(str(caught.value), named, echoed)


def typed(run: Run, named: str, *argv: str, code: int = InputError.exit_code) -> None:
    """Run a command line that ends in one line on the error stream, prints nothing and writes nothing."""
    before = _files()
    ran = run(*argv)
    front, message, end = ran.err[:19], ran.err[19:-1], ran.err[-1:]
    assert (ran.code, ran.out, front, end) == (code, "", "lidarscene: error: ", "\n"), ran
    first = Path(message.partition(": ")[0].partition(" --")[0])
    assert not first.is_absolute(), "the mistake comes first"
    assert not first.suffix or not first.exists(), "the file comes last"
    assert_names(message, named, [word for word in argv if "=" in word])
    assert _files() == before


def _files() -> set[tuple[Path, int]]:
    """Everything in the working directory, and when each file was written last."""
    return {(path, path.lstat().st_mtime_ns * path.is_file()) for path in Path().rglob("*")}
