"""Pages of `lidarscene view`: served by a process of its own, as users have it, or saved and opened."""

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import Request, urlopen

from helpers.chromium import Chromium
from helpers.waiting import PATIENCE_S
from lidarscene import PointCloud
from lidarscene.cli.main import main


@dataclass
class Served:
    process: subprocess.Popen[str]
    url: str

    def get(self, path: str, body: bytes | None = None, **headers: str) -> tuple[int, bytes]:
        """Status and content; POST if there is a body."""
        try:
            with urlopen(Request(self.url + path, body, headers), timeout=PATIENCE_S) as answer:
                return answer.status, answer.read()
        except HTTPError as error:
            return error.code, error.read()

    def interrupt(self) -> tuple[int, str, str]:
        """Ctrl-C; exit code, and what it printed since the page's address."""
        self.process.send_signal(signal.SIGINT)
        out, err = self.process.communicate(timeout=PATIENCE_S)
        return self.process.returncode, out, err


def _hears_ctrl_c() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def open_saved(browser: Chromium, folder: Path, *shown: PointCloud | Path) -> Path:
    """Save the page of a cloud, which is saved too, or of files, and open it; returns its path."""
    page, words = folder / "a.html", []
    for each in shown:
        if isinstance(each, PointCloud):
            each.save(folder / "a.ply")
        words.append(str(folder / "a.ply" if isinstance(each, PointCloud) else each))
    assert main(["view", *words, "--save", str(page)]) == 0
    browser.open(page.as_uri())
    return page


@contextmanager
def served(*arguments: str | Path) -> Iterator[Served]:
    """A running `lidarscene view`, which ends with the block."""
    process = subprocess.Popen(
        [sys.executable, "-m", "lidarscene", "view", *map(str, arguments), "--no-browser"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # Tests that run in the background ignore Ctrl-C, and so would what they start.
        preexec_fn=_hears_ctrl_c,
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        address = re.search(r"http://127\.0\.0\.1:\d+/", line)
        assert address, line + process.communicate(timeout=PATIENCE_S)[1]
        yield Served(process, address[0])
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()
