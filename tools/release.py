#!/usr/bin/env python3
"""Build what is published into dist/, and check it: `make release`.

The sdist and from it the wheel; versions, contents, licences, placeholders of addresses, twine's checks. Nothing is
uploaded. The site of `make docs` lies in out/site, ready for any static host.
"""

import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from email import message_from_bytes
from pathlib import Path

from lidarscene import __version__

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"
UV = str(Path(sys.executable).with_name("uv"))
IN_WHEEL = {"src/lidarscene/": "lidarscene/", "scenes/": "lidarscene/catalog/scenes/"}
IN_WHEEL |= {"assets/meshes/": "lidarscene/catalog/assets/meshes/"}
"""Folder of the repository -> its place in the wheel."""
NOT_IN_SDIST = (".gitattributes", ".ci/", ".github/")


def main() -> None:
    """Build, check, and say what there is."""
    mistakes = version_mistakes()
    if mistakes:
        raise SystemExit("\n".join(f"release: {mistake}" for mistake in mistakes))
    shutil.rmtree(DIST, ignore_errors=True)
    subprocess.run([UV, "build", "--quiet", "--out-dir", str(DIST)], cwd=ROOT, check=True)
    (wheel,), (sdist,) = DIST.glob("*.whl"), DIST.glob("*.tar.gz")
    mistakes = [*wheel_mistakes(wheel, tracked()), *sdist_mistakes(sdist, tracked())]
    if mistakes:
        raise SystemExit("\n".join(f"release: {mistake}" for mistake in mistakes))
    subprocess.run([UV, "tool", "run", "twine", "check", "--strict", str(wheel), str(sdist)], check=True)
    if placeholders := address_placeholders():
        print(f"release: before it is published, replace in pyproject.toml: {', '.join(placeholders)}")
    for file in (wheel, sdist):
        print(f"release: {file.relative_to(ROOT)} ({file.stat().st_size / 1e6:.1f} MB)")


def tracked() -> list[str]:
    """Files that git knows and that are there, from the root."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return [name for name in listed.split("\0") if name and (ROOT / name).is_file()]


def version_mistakes() -> list[str]:
    """CITATION.cff and CHANGELOG.md must name the version of _version.py, from which the package takes it."""
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
    headed = re.search(r"^## (\S+?),? ", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    stated = {"CITATION.cff": cited and cited[1], "CHANGELOG.md, first heading": headed and headed[1].rstrip(",")}
    return [
        f"{place}: must be version {__version__}, got {version}"
        for place, version in stated.items()
        if version != __version__
    ]


def wheel_mistakes(wheel: Path, files: list[str]) -> list[str]:
    """The wheel must hold the package, scenes and meshes, all of them and nothing else, with version and licences."""
    expected = {
        place + name.removeprefix(folder)
        for name in files
        for folder, place in IN_WHEEL.items()
        if name.startswith(folder)
    }
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if not name.endswith("/")}
        (metadata_name,) = [name for name in names if name.endswith(".dist-info/METADATA")]
        metadata = message_from_bytes(archive.read(metadata_name))
    inside = {name for name in names if ".dist-info/" not in name}
    licences = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["license-files"]
    missing = [f"licenses/{name}" for name in licences if not any(n.endswith(f"/licenses/{name}") for n in names)]
    mistakes = [f"{wheel.name}: {name} is missing" for name in [*sorted(expected - inside), *missing]]
    mistakes += [f"{wheel.name}: {name} does not belong there" for name in sorted(inside - expected)]
    if metadata["Version"] != __version__:
        mistakes.append(f"{wheel.name}: must be version {__version__}, got {metadata['Version']}")
    return mistakes


def sdist_mistakes(sdist: Path, files: list[str]) -> list[str]:
    """The sdist must hold every file that git knows, from which everything can be built and tested again."""
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    return [
        f"{sdist.name}: {name} is missing" for name in files if name not in names and not name.startswith(NOT_IN_SDIST)
    ]


def address_placeholders() -> list[str]:
    """Addresses of pyproject.toml that are still those of example.org."""
    urls = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["urls"]
    return [f"{name} {url}" for name, url in urls.items() if "example.org" in url]


if __name__ == "__main__":
    main()
