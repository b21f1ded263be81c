"""The command `batch`: what it prints, its exit code, and the mistakes that it tells before anything is rendered."""

import contextlib
import importlib.util
import json
import os
import re
import subprocess
import sys
import urllib.request
from pathlib import Path
from typing import Any

import pytest
from helpers.waiting import PATIENCE_S

from lidarscene.batch import cluster
from lidarscene.batch.dispatch import Connect
from lidarscene.cli import main
from lidarscene.files import optional

ROOT = Path(__file__).parents[2]

Printed = pytest.CaptureFixture[str]


def test_what_a_user_sees(
    threads: Connect, job_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Printed
) -> None:
    """Good frames are written, the bad ones have a line each, and the exit code is 1."""
    wall = (tmp_path / "wall.toml").read_text()
    (tmp_path / "bad.toml").write_text(wall.replace("concrete", "concrate"))
    job_file.write_text(job_file.read_text().replace('["wall.toml"]', '["wall.toml", "bad.toml"]'))
    monkeypatch.setattr(cluster, "local_client", threads)
    monkeypatch.chdir(tmp_path)
    assert main.main(["batch", "job.toml", "-o", "out", "--workers", "1"]) == 1
    out, err = capsys.readouterr()
    assert [line.split()[:3] for line in out.splitlines()][1:4] == [
        ["rendered", "4"],
        ["there", "already", "0"],
        ["failed", "4", "their"],
    ]
    failed = [line for line in err.splitlines() if line.startswith("failed")]
    assert len(failed) == 4
    assert all("bad.toml table1-apd" in line and "no material 'concrate'" in line for line in failed)
    assert "Traceback" not in err
    assert (tmp_path / "out" / "manifest.parquet").is_file()


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are of POSIX")
def test_a_script_on_a_terminal(mi: Any, job_file: Path, tmp_path: Path) -> None:
    """The dashboard's address, where it answers, and a bar that counts to the last frame.

    Rationale: new processes of Python import the script that starts them, and would run it again.
    The dashboard ends with the last frame: its workers are held until it has answered. It is asked for the numbers that
    it shows, since to draw all its charts takes it seconds.
    """
    pytest.importorskip("bokeh")
    psutil = pytest.importorskip("psutil")
    import pty

    (tmp_path / "script.py").write_text(
        "from lidarscene.cli import main\nprint(main.main('batch job.toml -o out --workers 1'.split()))\n"
    )
    ours, theirs = pty.openpty()
    running = subprocess.Popen(
        [sys.executable, "script.py"],
        cwd=tmp_path,
        env=os.environ | {"TERM": "xterm", "COLUMNS": "100"},
        stdout=subprocess.PIPE,
        text=True,
        stderr=theirs,
    )
    os.close(theirs)
    terminal_output, answers = b"", None
    while part := _read(ours):
        terminal_output += part
        link = re.search(rb"dashboard +(http://127\.0\.0\.1:\d+/status)", terminal_output)
        if link and answers is None:
            workers = psutil.Process(running.pid).children(recursive=True)
            for worker in workers:
                worker.suspend()
            try:
                counts_url = link[1].decode().replace("status", "json/counts.json")
                with urllib.request.urlopen(counts_url, timeout=PATIENCE_S) as page:
                    answers = json.loads(page.read())
            finally:
                for worker in workers:
                    worker.resume()
    os.close(ours)
    printed, _ = running.communicate(timeout=PATIENCE_S)
    assert (printed.count("rendered"), printed[-3:]) == (1, "\n0\n"), terminal_output
    assert answers is not None
    assert answers["workers"] == 1
    assert b"0/4" in terminal_output
    assert b"4/4" in terminal_output
    assert (tmp_path / "out" / "manifest.parquet").is_file()


def _read(terminal: int) -> bytes:
    """What it shows next; nothing when its other end is closed, which Linux calls an error."""
    with contextlib.suppress(OSError):
        return os.read(terminal, 1 << 16)
    return b""


@pytest.mark.parametrize("package", ["distributed", "cryptography"])
def test_without_packages(
    job_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Printed, package: str
) -> None:
    """All that a job lacks is named at once, for its format too.

    Rationale: without keys the processes of this machine would take code from all of its users. The scheduler of
    others needs no key of ours.
    """
    pytest.importorskip("distributed")
    find, hidden = importlib.util.find_spec, (package, "lzf")
    monkeypatch.setattr(optional.importlib.util, "find_spec", lambda name: None if name in hidden else find(name))
    job_file.write_text('format = "pcd-compressed"\n' + job_file.read_text())
    argv = ["batch", str(job_file), "-o", str(tmp_path / "out")]
    assert main.main(argv) == 1
    error_text = capsys.readouterr().err
    missing = f"lidarscene: error: {package} and python-neo-lzf are needed and cannot be found; try: pip install "
    assert error_text.startswith(f"{missing}'lidarscene[batch,pcd]', or pip install {package} python-neo-lzf")
    assert main.main([*argv, "--scheduler", "nonsense"]) == 1
    assert capsys.readouterr().err.startswith(missing) == (package == "distributed")
