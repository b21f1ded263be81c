"""Files appear whole or not at all, and a failure leaves nothing behind but one line."""

import errno
import os
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from helpers.folders import begun, part_name, raise_disk_full
from helpers.mistakes import told

from lidarscene.errors import OutputError
from lidarscene.files import atomic
from lidarscene.files.atomic import atomic_folder, atomic_output, require_writable


def write(path: Path | str, text: str = "new") -> None:
    with atomic_output(path) as temporary:
        temporary.write_text(text)


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def test_writes_and_replaces(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "er" / "a b.txt"
    for text in ("one", "two"):
        write(target, text)
        assert target.read_text() == text
        assert names(target.parent) == ["a b.txt"]


def test_temporary_is_hidden_and_beside(tmp_path: Path) -> None:
    with atomic_output(tmp_path / "a.ply") as temporary:
        assert temporary.parent == tmp_path
        assert begun(tmp_path, os.getpid()) == {"a.ply"}
        assert not (tmp_path / "a.ply").exists()


@pytest.mark.parametrize("error", [RuntimeError("no"), KeyboardInterrupt(), OSError(errno.ENOSPC, "No space left")])
def test_failure_leaves_the_old_file(tmp_path: Path, error: BaseException) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")

    def break_off() -> None:
        with atomic_output(target) as temporary:
            temporary.write_text("half")
            raise error

    with pytest.raises(OutputError if isinstance(error, OSError) else type(error)):
        break_off()
    assert target.read_text() == "old"
    assert names(tmp_path) == ["a.txt"]


def test_failure_leaves_no_folder(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), atomic_output(tmp_path / "x" / "y" / "a.txt"):
        raise RuntimeError
    assert names(tmp_path) == []


@pytest.mark.parametrize("step", ["fsync", "replace"])
def test_disk_full_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str) -> None:
    """Rationale: some file systems only notice a full disk when they are asked to sync."""
    target = tmp_path / "a.txt"
    target.write_text("old")

    monkeypatch.setattr(os, step, raise_disk_full)
    with told(f"{target} | No space left on device", OutputError):
        write(target)
    assert target.read_text() == "old"
    assert names(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("check", [write, require_writable])
def test_impossible_paths_say_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, check) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("x")
    os.mkfifo("pipe")
    for path, named in (
        (".", "a file | a folder"),
        ("file/a.ply", "file/a.ply | file' is | a folder"),
        ("file/b/a.ply", "file/b/a.ply | file' is | a folder"),
        ("pipe", "a file | device or pipe"),
        ("/dev/null", "/dev/null | a file | device or pipe"),
        ("n" * 300, "File name too long"),
        (f"{'n' * 300}/a.ply", "a.ply | File name too long"),
        ("a\0b", "NUL"),
    ):
        with told(named, OutputError):
            check(Path(path))
    assert names(tmp_path) == ["file", "pipe"]


@pytest.mark.parametrize("check", [write, require_writable, lambda path: atomic_folder(path).__enter__()])
def test_a_current_folder_that_is_gone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, check) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir("gone")
    (tmp_path / "gone").rmdir()
    with told("current folder | cd", OutputError):
        check(Path("a.ply"))


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no /proc")
def test_folder_that_takes_no_files() -> None:
    """Rationale: root may write into any ordinary folder, but not even root into /proc."""
    for check in (write, require_writable):
        with told("/proc/new/a.ply", OutputError):
            check("/proc/new/a.ply")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_protected_file_and_folder(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    target.chmod(0o400)
    with told(f"{target} | write-protected", OutputError):
        write(target)
    tmp_path.chmod(0o500)
    with told("b.txt | Permission denied", OutputError):
        write(tmp_path / "b.txt")
    tmp_path.chmod(0o700)


def test_link_is_followed(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link.txt").symlink_to(tmp_path / "real" / "a.txt")
    write(tmp_path / "link.txt")
    assert (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "real" / "a.txt").read_text() == "new"


@pytest.mark.parametrize(
    ("link", "named"),
    [("disk/a.txt", "a link | '{folder}/disk/a.txt'"), ("link.txt", "Too many levels of symbolic links")],
    ids=["of a disk that is not mounted", "to itself"],
)
@pytest.mark.parametrize("check", [write, require_writable])
def test_links_that_lead_nowhere(tmp_path: Path, check: Callable[[Path], None], link: str, named: str) -> None:
    """Rationale: the file would go to another disk than its owner thinks, or take the place of the link."""
    path = tmp_path / "link.txt"
    path.symlink_to(tmp_path / link)
    with told(f"{path} | {named.format(folder=tmp_path)}", OutputError):
        check(path)
    assert names(tmp_path) == ["link.txt"]
    assert path.is_symlink()


def test_a_folder_on_a_disk_that_is_not_mounted(tmp_path: Path) -> None:
    (tmp_path / "out").symlink_to(tmp_path / "disk" / "out")
    for write_into in (lambda: write(tmp_path / "out" / "a.txt"), lambda: atomic_folder(tmp_path / "out").__enter__()):
        with told(f"{tmp_path / 'out'} | {tmp_path / 'disk' / 'out'}", OutputError):
            write_into()
    assert names(tmp_path) == ["out"]


def mode_of(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.mark.skipif(os.name == "nt", reason="no modes")
def test_a_file_that_is_replaced_hands_its_mode_on(tmp_path: Path) -> None:
    """Rationale: what others may not read stays so, while it is written too; what they may write as well."""
    for mode in (0o600, 0o640, 0o666, 0o755):
        target = tmp_path / f"{mode:o}.txt"
        target.write_text("old")
        target.chmod(mode)
        with atomic_output(target) as temporary:
            assert mode_of(temporary) & ~mode & 0o077 == 0
            with atomic.folder_beside(temporary) as folder:
                assert mode_of(folder) == 0o700
                (folder / "a").write_text("new")
                os.replace(folder / "a", temporary)
        assert (target.read_text(), mode_of(target)) == ("new", mode)
    private = tmp_path / "600.txt"
    with atomic_folder(tmp_path) as temporary:
        write(temporary / private.name, "again")
        write(temporary / "new.txt")
    assert (private.read_text(), mode_of(private)) == ("again", 0o600)
    (tmp_path / "usual.txt").touch()
    assert mode_of(tmp_path / "new.txt") == mode_of(tmp_path / "usual.txt")


def test_remains_of_the_dead_are_removed_and_only_they(tmp_path: Path) -> None:
    dead = subprocess.Popen(["true"])
    dead.wait()
    own = {"pid": os.getpid(), "start": atomic._start_of(os.getpid())}
    removed = [part_name("a[1].txt", pid=dead.pid), part_name("a[1].txt.folder", pid=dead.pid)]
    stay = [
        part_name("a[1].txt", **own),
        part_name("a[1].txt", pid=os.getppid(), start=0),
        part_name("a[1].txt", pid=dead.pid, place="0" * 8),  # of another host or PID namespace
        part_name("b.txt", pid=dead.pid),
        ".a[1].txt.x.part",
        part_name("a1.txt", pid=dead.pid),
    ]
    for name in removed + stay:
        (tmp_path / name).write_text("half")
    write(tmp_path / "a[1].txt")
    assert names(tmp_path) == sorted([*stay, "a[1].txt"])


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc")
def test_a_pid_that_another_process_has_got(tmp_path: Path) -> None:
    own = {"pid": os.getpid(), "start": atomic._start_of(os.getpid())}
    kept, removed = part_name("a.txt", **own), part_name("a.txt", **own | {"start": own["start"] - 1})
    for name in (kept, removed):
        (tmp_path / name).touch()
    write(tmp_path / "a.txt")
    assert names(tmp_path) == sorted([kept, "a.txt"])


def test_remains_of_nobody_knows_whom_go_when_they_are_old(tmp_path: Path) -> None:
    """What another machine writes may live. A folder is as old as the newest file in it."""
    old_s = time.time() - atomic.ABANDONED_S - 60.0
    for target in ("a.txt", "b.txt", "c.txt"):
        part = tmp_path / part_name(target, place="0" * 8)
        if target == "a.txt":
            part.touch()
        else:
            part.mkdir()
            (part / "half").touch()
            os.utime(part / "half", None if target == "c.txt" else (old_s, old_s))
        os.utime(part, (old_s, old_s))
        write(tmp_path / target)
    assert names(tmp_path) == sorted(["a.txt", "b.txt", "c.txt", part_name("c.txt", place="0" * 8)])


WRITER = """
import os, sys
from lidarscene.files.atomic import atomic_output
os.getpid = lambda: int(sys.argv[3])
with atomic_output(sys.argv[1]) as temporary, open(temporary, "w") as file:
    for _ in range(2):
        file.write(sys.argv[2])
        file.flush()
        print("half", flush=True)
        sys.stdin.readline()
"""


def test_two_processes_of_one_pid(tmp_path: Path) -> None:
    """It happens in two containers: each file is whole, and the last stays."""
    target = tmp_path / "a.txt"
    environment = os.environ | {"PYTHONPATH": str(Path(atomic.__file__).parents[2])}
    with ExitStack() as opened:
        writers = []
        for text in ("one ", "two "):
            command = [sys.executable, "-c", WRITER, str(target), text, str(os.getpid())]
            writer = opened.enter_context(
                subprocess.Popen(
                    command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1, env=environment
                )
            )
            writers.append(writer)
            assert writer.stdout is not None
            assert writer.stdout.readline() == "half\n"
        for writer, text in zip(writers, ("one one ", "two two "), strict=True):
            writer.communicate("\n\n")
            assert (writer.returncode, target.read_text()) == (0, text)
    assert names(tmp_path) == ["a.txt"]


def test_a_folder_that_another_process_removes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another run that asks whether it can write makes the folder, too, and removes it while it is empty."""
    made = os.open

    def remove_folder_first(path: Any, *arguments: Any) -> int:
        monkeypatch.setattr(os, "open", made)
        (tmp_path / "out").rmdir()
        return made(path, *arguments)

    monkeypatch.setattr(os, "open", remove_folder_first)
    write(tmp_path / "out" / "a.txt")
    assert names(tmp_path / "out") == ["a.txt"]


def test_two_at_once_in_one_process(tmp_path: Path) -> None:
    with atomic_output(tmp_path / "a.txt") as temporary:
        temporary.write_text("first")
        with pytest.raises(OutputError, match="another thread"):
            write(tmp_path / "a.txt")
        write(tmp_path / "b.txt")
    assert (tmp_path / "a.txt").read_text() == "first"
    assert not atomic._ours


def test_require_writable_changes_nothing(tmp_path: Path) -> None:
    target = tmp_path / "new" / "a.txt"
    require_writable(target)
    assert names(tmp_path) == []
    write(target, "old")
    require_writable(target)
    assert target.read_text() == "old"


def test_a_folder_appears_whole(tmp_path: Path) -> None:
    with atomic_folder(tmp_path / "new" / "out") as temporary:
        write(temporary / "a")
        assert not (tmp_path / "new" / "out").exists()
    assert names(tmp_path / "new") == ["out"]
    (tmp_path / "new" / "out" / "other").touch()
    with atomic_folder(tmp_path / "new" / "out") as temporary:
        write(temporary / "a", "again")
        write(temporary / "b")
        assert (tmp_path / "new" / "out" / "a").read_text() == "new"
    assert names(tmp_path / "new" / "out") == ["a", "b", "other"]
    assert (tmp_path / "new" / "out" / "a").read_text() == "again"


def test_two_processes_make_one_folder(tmp_path: Path) -> None:
    with atomic_folder(tmp_path / "out") as slow:
        with atomic_folder(tmp_path / "out") as quick:
            write(quick / "a", "quick")
            write(quick / "b", "quick")
        write(slow / "a", "slow")
    assert names(tmp_path / "out") == ["a", "b"]
    assert (tmp_path / "out" / "a").read_text() == "slow"
    assert names(tmp_path) == ["out"]


@pytest.mark.parametrize("error", [RuntimeError("no"), KeyboardInterrupt(), OSError(errno.ENOSPC, "No space left")])
@pytest.mark.parametrize("is_there", [True, False])
def test_a_folder_that_fails_leaves_nothing(tmp_path: Path, error: BaseException, is_there: bool) -> None:
    folder = tmp_path / "new" / "out"
    if is_there:
        write(folder / "a", "old")
    before = sorted(tmp_path.rglob("*"))
    expected = OutputError if isinstance(error, OSError) else type(error)

    def fail() -> None:
        with atomic_folder(folder) as temporary:
            write(temporary / "a")
            raise error

    with pytest.raises(expected):
        fail()
    assert sorted(tmp_path.rglob("*")) == before


def test_errors_name_the_folder_that_was_asked_for(tmp_path: Path) -> None:
    def fail() -> None:
        with atomic_folder(tmp_path / "out") as temporary:
            (temporary / "a").mkdir()
            write(temporary / "a")

    with told(f"{tmp_path / 'out'}/a | name of a file | a folder", OutputError):
        fail()


@pytest.mark.parametrize("is_there", [True, False])
def test_folders_of_dead_processes_go(tmp_path: Path, is_there: bool) -> None:
    folder = tmp_path / "out"
    place = folder if is_there else tmp_path
    for name in (part_name("out"), part_name("out.folder")):
        (place / name).mkdir(parents=True)
        (place / name / "a").touch()
    with atomic_folder(folder) as temporary:
        write(temporary / "b")
    assert names(tmp_path) == ["out"]
    assert names(folder) == ["b"]


@pytest.mark.parametrize("name", ["a" * 251 + ".txt", "ä" * 125 + ".txt", "a" * 230])
def test_names_as_long_as_a_file_system_takes(tmp_path: Path, name: str) -> None:
    """The temporary name has no room for them, so it has a hash; what a dead process leaves goes all the same."""
    target = tmp_path / name
    remains = target.with_name(part_name(atomic._part_prefix(target).strip(".")))
    remains.write_text("half")
    require_writable(target)
    with atomic_output(target) as temporary:
        temporary.write_text("whole")
        with atomic.folder_beside(temporary) as folder:
            assert folder.is_dir()
    assert target.read_text() == "whole"
    assert os.listdir(tmp_path) == [name]
