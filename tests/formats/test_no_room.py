"""A disk without room, for every format: one line, and nothing is left.

The room is a limit on the size of a file, so that the errors are those of the system and of each library.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from helpers.clouds import small_cloud
from helpers.formats import file_of, need
from helpers.run_seed import chosen
from helpers.waiting import PATIENCE_S, wait_until

from lidarscene.errors import OutputError
from lidarscene.formats.registry import BAGS, FORMATS

resource = pytest.importorskip("resource")

ROOT = Path(__file__).parents[2]
KILLED = """
import sys, time
sys.path[:0] = sys.argv[1:3]
from helpers.clouds import small_cloud
from lidarscene.cli.terminal import end_cleanly
from lidarscene.formats.ros import ros_frames
end_cleanly()
with ros_frames(sys.argv[3], storage="sqlite3") as append:
    append(small_cloud())
    print("half", flush=True)
    time.sleep(1000)
"""


@contextmanager
def no_room() -> Iterator[None]:
    """No file of this process grows beyond 40 bytes; Python ignores the signal, so that writing fails.

    Only within the block: what pytest prints may go to a file too.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (40, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("name", [*FORMATS, *BAGS])
def test_no_room_is_one_line(tmp_path: Path, name: str) -> None:
    need(name)
    cloud, path = small_cloud(), file_of(tmp_path / "new", name)
    cloud.save(tmp_path / "warm", format=name)  # libraries that are imported late write their byte code
    with pytest.raises(OutputError) as error, no_room():
        cloud.save(path, format=name)
    message = str(error.value)
    assert message.startswith(f"{path}: cannot be written: ")
    assert "\n" not in message
    assert len(message) < 400
    assert [path.name for path in tmp_path.iterdir()] == ["warm"]


@pytest.mark.parametrize("signal_name", chosen(1, ["SIGTERM", "SIGKILL"]))
def test_a_killed_bag_leaves_no_folder(tmp_path: Path, signal_name: str, library: Any) -> None:
    """Asked to end, it cleans up; what no process can clean up is gone after the next write to the name."""
    import signal

    need("rosbag2")
    path = tmp_path / "new" / "a.db3"
    writing = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(ROOT / "src"), str(ROOT / "tests"), str(path)],
        stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": ""},
    )
    assert writing.stdout is not None
    assert writing.stdout.readline() == b"half\n"
    wait_until(lambda: any(entry.is_dir() for entry in path.parent.iterdir()))
    writing.send_signal(getattr(signal, signal_name))
    writing.communicate(timeout=PATIENCE_S)
    if signal_name == "SIGTERM":
        assert writing.returncode == 128 + signal.SIGTERM
        assert list(tmp_path.iterdir()) == []
    small_cloud().save(path)
    assert [path.name for path in path.parent.iterdir()] == ["a.db3"]
