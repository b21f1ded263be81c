"""`make release`: what it refuses, on archives made here; `tools/environments.py wheel` builds real ones."""

import io
import subprocess
import tarfile
import zipfile
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from helpers.documentation import ROOT
from helpers.sources import module_of

from lidarscene import __version__

TRACKED = ["src/lidarscene/__init__.py", "scenes/car.toml", "assets/meshes/car.glb", "docs/index.md", ".ci/run"]
IN_WHEEL = {"lidarscene/__init__.py", "lidarscene/catalog/scenes/car.toml", "lidarscene/catalog/assets/meshes/car.glb"}
INFO = f"lidarscene-{__version__}.dist-info"
LICENCES = {f"{INFO}/licenses/LICENSE", f"{INFO}/licenses/src/lidarscene/catalog/examples/LICENSE"}


@pytest.fixture
def release(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """tools/release.py, whose repository has the files of TRACKED."""
    module = module_of(ROOT / "tools" / "release.py")
    monkeypatch.setattr(module, "tracked", lambda: TRACKED)
    return module


def write_wheel(folder: Path, names: set[str], version: str = __version__) -> Path:
    path = folder / f"lidarscene-{__version__}-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        for name in sorted(names):
            archive.writestr(name, "")
        archive.writestr(f"{INFO}/METADATA", f"Metadata-Version: 2.4\nName: lidarscene\nVersion: {version}\n")
    return path


def write_sdist(folder: Path, names: list[str]) -> Path:
    path = folder / f"lidarscene-{__version__}.tar.gz"
    with tarfile.open(path, "w:gz") as archive:
        for name in names:
            archive.addfile(tarfile.TarInfo(f"lidarscene-{__version__}/{name}"), io.BytesIO())
    return path


@pytest.mark.parametrize(
    ("change", "version", "mistake"),
    [
        (lambda names: names, __version__, None),
        (lambda names: names - {"lidarscene/catalog/scenes/car.toml"}, __version__, "scenes/car.toml is missing"),
        (lambda names: names | {"lidarscene/notes.txt"}, __version__, "lidarscene/notes.txt does not belong there"),
        (lambda names: names | {"tests/test_a.py"}, __version__, "tests/test_a.py does not belong there"),
        (lambda names: names - {f"{INFO}/licenses/LICENSE"}, __version__, "licenses/LICENSE is missing"),
        (lambda names: names, "9.9", f"must be version {__version__}, got 9.9"),
    ],
)
def test_a_wheel_has_all_and_nothing_else(change, version, mistake, release, tmp_path):
    wheel = write_wheel(tmp_path, change(IN_WHEEL | LICENCES), version)
    mistakes = release.wheel_mistakes(wheel, TRACKED)
    assert any(mistake in line for line in mistakes) if mistake else not mistakes


def test_a_source_archive_has_what_git_knows_but_ci(release: ModuleType, tmp_path: Path) -> None:
    assert release.sdist_mistakes(write_sdist(tmp_path, TRACKED[:-1]), TRACKED) == []
    (mistake,) = release.sdist_mistakes(write_sdist(tmp_path, TRACKED[:-2]), TRACKED)
    assert mistake.endswith("docs/index.md is missing")


def test_one_version_everywhere(release: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """The repository's own files have it, or nothing would be built."""
    assert release.version_mistakes() == []
    monkeypatch.setattr(release, "__version__", "9.9")
    assert [line.partition(":")[0] for line in release.version_mistakes()] == [
        "CITATION.cff",
        "CHANGELOG.md, first heading",
    ]


def test_what_is_built_is_checked_and_nothing_is_sent(release, tmp_path, monkeypatch, capsys):
    """uv and twine are called as below; a wheel that lacks a file ends it before twine looks at it."""
    called: list[list[str]] = []
    contents = IN_WHEEL | LICENCES

    def call(command: list[str], **_: Any) -> None:
        called.append(command[1:])
        if command[1] == "build":
            release.DIST.mkdir()
            write_wheel(release.DIST, contents)
            write_sdist(release.DIST, TRACKED)

    monkeypatch.setattr(subprocess, "run", call)
    monkeypatch.setattr(release, "ROOT", ROOT)
    monkeypatch.setattr(release, "DIST", tmp_path / "dist")
    monkeypatch.setattr(Path, "relative_to", lambda path, _: Path(path.name))
    release.main()
    assert [command[:3] for command in called] == [["build", "--quiet", "--out-dir"], ["tool", "run", "twine"]]
    assert called[1][3:5] == ["check", "--strict"]
    assert "before it is published, replace in pyproject.toml: Homepage https://example.org" in capsys.readouterr().out
    called.clear()
    contents.remove("lidarscene/__init__.py")
    with pytest.raises(SystemExit, match=r"release: .*lidarscene/__init__\.py is missing"):
        release.main()
    assert len(called) == 1
