"""What a shell may hand over: streams that are closed, full or without a reader, and a folder that is gone.

Files are written, and what can be said is said once.
"""

import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from helpers.run_seed import chosen
from helpers.waiting import PATIENCE_S

from lidarscene import catalog
from lidarscene.__main__ import run
from lidarscene.cloud.point_cloud import PointCloud

NO_ROOM = "lidarscene: error: standard output: cannot be written: No space left on device\n"


def shell(line: str, folder: Path, *, before: str = "") -> tuple[int, str, str]:
    """Run a command line of the program and a shell's redirections; returns exit code, standard output and errors."""
    words = ["bash", "-c", f"set -o pipefail; {before}{sys.executable} -m lidarscene {line}"]
    ran = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=PATIENCE_S)
    return ran.returncode, ran.stdout, ran.stderr


@pytest.fixture
def full() -> str:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full on this system")
    return "/dev/full"


@pytest.mark.parametrize("closed", chosen(1, ["2>&-", ">&-", ">&- 2>&- <&-"]))
def test_a_frame_is_written_beside_closed_streams(closed: str, tmp_path: Path, mi: object) -> None:
    """The answer goes to the stream that is open, and so does an error."""
    told = closed != ">&- 2>&- <&-"
    code, out, err = shell(f"render edges -o a.ply --seed 1 {closed}", tmp_path)
    assert (code, (out + err).count("wrote         a.ply")) == (0, told)
    assert len(PointCloud.load(tmp_path / "a.ply")) > 0
    code, out, err = shell(f"catalog sensors nono {closed}", tmp_path)
    assert (code, (out + err).count("lidarscene: error: no sensor 'nono'")) == (2, told)
    assert len((out + err).splitlines()) == told


@pytest.mark.parametrize("line", chosen(2, ["catalog scenes", "--help", "render -h", "--version"]))
def test_a_full_disk_behind_standard_output(line: str, tmp_path: Path, full: str) -> None:
    assert shell(f"{line} >{full}", tmp_path) == (2, "", NO_ROOM)


def test_a_full_disk_behind_the_error_stream_costs_nothing(tmp_path: Path, full: str) -> None:
    """The exit code still tells of a mistake, or that there was none but a note."""
    code, out, _ = shell(f"render edges -o a.ply --seed 1 --pose 0,0,-90 2>{full}", tmp_path)
    assert (code, "wrote         a.ply" in out) == (0, True)
    assert shell(f"render kar -o a.ply 2>{full}", tmp_path) == (2, "", "")
    assert shell(f"catalog scenes >{full} 2>{full}", tmp_path) == (2, "", "")
    assert shell(f"2>{full}", tmp_path) == (2, "", "")


def test_a_current_folder_that_is_gone_is_one_line(tmp_path: Path, mi: object) -> None:
    """Rationale: Mitsuba's import aborts the process there."""
    line = "lidarscene: error: the current folder cannot be read (No such file or directory); try: cd to another one\n"
    for output in chosen(1, [f"{tmp_path}/a.ply", "a.ply"]):
        gone = "mkdir gone; cd gone; rmdir ../gone; "
        assert shell(f"render edges -o {output}", tmp_path, before=gone) == (2, "", line)


def test_an_interrupt_while_it_is_imported_has_no_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    class Interrupted(ModuleType):
        def __getattr__(self, name: str) -> object:
            raise KeyboardInterrupt

    monkeypatch.setitem(sys.modules, "lidarscene.cli.main", Interrupted("lidarscene.cli.main"))
    assert run() == 130


def test_a_reader_that_has_gone_is_no_mistake(tmp_path: Path) -> None:
    lines = catalog.path_of("scenes", "street").read_text("utf-8").splitlines()
    assert shell("catalog scenes street | head -1", tmp_path) == (0, f"{lines[0]}\n", "")
    assert shell("kar 2>&1 >/dev/null | true", tmp_path) == (2, "", "")
