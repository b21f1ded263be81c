"""Files appear whole or not at all, and a failure leaves nothing behind but one line."""

import errno
import os
import subprocess
from pathlib import Path

import pytest
from helpers.folders import raise_disk_full

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
        assert temporary == tmp_path / f".a.ply.{os.getpid()}.part"
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
    with pytest.raises(OutputError) as caught:
        write(target)
    assert str(caught.value) == f"{target}: cannot be written: No space left on device"
    assert target.read_text() == "old"
    assert names(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("check", [write, require_writable])
def test_impossible_paths_say_why(tmp_path: Path, check) -> None:
    (tmp_path / "file").write_text("x")
    os.mkfifo(tmp_path / "pipe")
    cases = {
        tmp_path: "must be the name of a file, got a folder",
        tmp_path / "file" / "a.ply": f"'{tmp_path / 'file'}' is a file, not a folder",
        tmp_path / "file" / "b" / "a.ply": f"'{tmp_path / 'file'}' is a file, not a folder",
        tmp_path / "pipe": "must be the name of a file, got a device or pipe",
        Path("/dev/null"): "must be the name of a file, got a device or pipe",
        tmp_path / ("n" * 300): "File name too long",
        tmp_path / ("n" * 300) / "a.ply": "File name too long",
    }
    for path, reason in cases.items():
        with pytest.raises(OutputError) as caught:
            check(path)
        assert str(caught.value) == f"{path}: cannot be written: {reason}"
    assert names(tmp_path) == ["file", "pipe"]


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no /proc")
def test_folder_that_takes_no_files() -> None:
    """Rationale: root may write into any ordinary folder, but not even root into /proc."""
    for check in (write, require_writable):
        with pytest.raises(OutputError, match=r"^/proc/new/a\.ply: cannot be written: "):
            check("/proc/new/a.ply")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_protected_file_and_folder(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    target.chmod(0o400)
    with pytest.raises(OutputError, match="write-protected"):
        write(target)
    tmp_path.chmod(0o500)
    with pytest.raises(OutputError, match="Permission denied"):
        write(tmp_path / "b.txt")
    tmp_path.chmod(0o700)


def test_link_is_followed(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link.txt").symlink_to(tmp_path / "real" / "a.txt")
    write(tmp_path / "link.txt")
    assert (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "real" / "a.txt").read_text() == "new"


def test_remains_of_the_dead_are_removed_and_only_they(tmp_path: Path) -> None:
    dead = subprocess.Popen(["true"])
    dead.wait()
    removed = [f".a[1].txt.{dead.pid}.part", f".a[1].txt.{os.getpid()}.part"]
    stay = [f".a[1].txt.{os.getppid()}.part", f".b.txt.{dead.pid}.part", ".a[1].txt.x.part", ".a1.txt.5.part"]
    for name in removed + stay:
        (tmp_path / name).write_text("half")
    write(tmp_path / "a[1].txt")
    assert names(tmp_path) == sorted([*stay, "a[1].txt"])


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

    with pytest.raises(OutputError) as error:
        fail()
    assert str(error.value) == f"{tmp_path / 'out'}/a: cannot be written: must be the name of a file, got a folder"


@pytest.mark.parametrize("is_there", [True, False])
def test_folders_of_dead_processes_go(tmp_path: Path, is_there: bool) -> None:
    folder = tmp_path / "out"
    place = folder if is_there else tmp_path
    for name in (".out.999999999.part", ".out.folder.999999999.part"):
        (place / name).mkdir(parents=True)
        (place / name / "a").touch()
    with atomic_folder(folder) as temporary:
        write(temporary / "b")
    assert names(tmp_path) == ["out"]
    assert names(folder) == ["b"]


def test_a_name_with_nul(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="its name has a NUL character"):
        require_writable(tmp_path / "a\0b")


@pytest.mark.parametrize("name", ["a" * 251 + ".txt", "ä" * 125 + ".txt", "a" * 230])
def test_names_as_long_as_a_file_system_takes(tmp_path: Path, name: str) -> None:
    """The temporary name has no room for them, so it has a hash; what a dead process leaves goes all the same."""
    target = tmp_path / name
    remains = target.with_name(atomic._part_prefix(target) + "999999999.part")
    remains.write_text("half")
    require_writable(target)
    with atomic_output(target) as temporary:
        temporary.write_text("whole")
        with atomic.folder_beside(temporary) as folder:
            assert folder.is_dir()
    assert target.read_text() == "whole"
    assert os.listdir(tmp_path) == [name]
