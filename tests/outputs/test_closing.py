"""Files that are completed on a thread while the next frame is traced: the same files, and no mistake is lost."""

import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from helpers.folders import file_contents
from helpers.mistakes import told
from helpers.run_seed import chosen

from lidarscene import Outputs, load_scene, record
from lidarscene.errors import OutputError
from lidarscene.labels import kitti_dataset
from lidarscene.outputs.closing import Closing
from lidarscene.outputs.record import _Run

WAIT_S = 60.0
COARSE = ["scanner.azimuth_step_deg=4", "scanner.elevation_step_deg=4"]


def test_the_caller_goes_on_until_the_next_frame() -> None:
    """Frames are completed one after the other; the block ends when all are."""
    goes_on, completed = threading.Event(), list[int]()

    def close(number: int) -> None:
        assert goes_on.wait(WAIT_S)
        completed.append(number)

    with Closing() as closing:
        for number in (1, 2):
            with ExitStack() as files:
                files.callback(close, number)
                if number == 2:
                    assert completed == []
                    goes_on.set()
                closing(files)
        assert completed[0] == 1
    assert completed == [1, 2]


def test_several_frames_wait_for_the_disk_at_once() -> None:
    """The caller waits only where too many do; each frame's turn comes when the one before is complete."""
    goes_on, told_of = [threading.Event() for _ in range(3)], list[int]()

    def close(number: int, in_turn: Callable[[], object]) -> None:
        assert goes_on[number].wait(WAIT_S)
        in_turn()
        told_of.append(number)

    with Closing(2) as closing:
        for number, event in enumerate(goes_on):
            with ExitStack() as files:
                files.callback(close, number, closing.in_turn())
                if number == 2:
                    assert told_of == []
                    goes_on[0].set()
                closing(files)
            if number == 1:  # is ready before the first, and waits
                event.set()
        goes_on[2].set()
    assert told_of == [0, 1, 2]


@pytest.mark.parametrize("failing", chosen(1, [0, 2]))
def test_a_file_that_cannot_be_written_ends_the_run(mi, tmp_path, monkeypatch, failing):
    """Earlier frames are whole, there is no half of a file, and the error is that of the file."""
    write = kitti_dataset._write_line

    def fail(path: Path, frame: int, line: str) -> None:
        if frame == failing and path.name == "times.txt":
            raise OutputError(f"{path}: cannot be written: no room")
        write(path, frame, line)

    monkeypatch.setattr(kitti_dataset, "_write_line", fail)
    outputs = Outputs(tmp_path / "set", dataset="semantickitti")
    with told("times.txt | no room", OutputError):
        record("car", "table1-apd", outputs=outputs, frames=3, overrides=COARSE)
    times = tmp_path / "set/dataset/sequences/00/times.txt"
    assert len(times.read_text().splitlines() if failing else []) == failing
    assert not [*tmp_path.rglob("*.part")]
    for number in range(failing):
        assert times.with_name("labels").joinpath(f"{number:06d}.label").stat().st_size


@pytest.mark.parametrize("dataset", chosen(1, ["kitti", "semantickitti"]))
def test_files_are_those_of_one_thread(mi: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dataset: str) -> None:
    scene, threads = load_scene("drive"), list[str]()
    write = kitti_dataset._write_text

    def noted(path: Path, lines: list[str]) -> None:
        threads.append(threading.current_thread().name)
        write(path, lines)

    monkeypatch.setattr(kitti_dataset, "_write_text", noted)
    for name in ("beside", "alone"):
        if name == "alone":
            monkeypatch.setattr(_Run, "_closed_later", lambda *_: 0)
        outputs = Outputs(tmp_path / name, dataset=dataset)
        record(scene, "table1-apd", outputs=outputs, frames=2, overrides=COARSE)
    main = threading.main_thread().name
    assert main not in threads[: len(threads) // 2]
    assert {main} == {*threads[len(threads) // 2 :]}
    assert file_contents(tmp_path / "beside") == file_contents(tmp_path / "alone")
