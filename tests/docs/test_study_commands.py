"""Every command that the documentation shows runs, page by page, on the files that the page shows.

Here those of the pages of studies; the others in tests/docs/test_commands.py.
"""

from pathlib import Path
from typing import Any

import pytest
from helpers.shown_commands import Reader, drawn_pages

pytestmark = pytest.mark.fixed_streams


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Reader:
    return Reader(tmp_path_factory.mktemp("documentation"))


@pytest.mark.parametrize("page", drawn_pages(of_studies=True), ids=lambda page: page.name)
def test_commands_run(
    page: Path, mi: Any, reader: Reader, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    reader.follow(page, monkeypatch, capsys)
