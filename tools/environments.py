#!/usr/bin/env python3
"""Environments that are not the one of `make`, as `make test-all` and .ci/run make them.

    wheel    the sdist and from it the wheel are built; the wheel is installed in empty environments (with the newest
             releases, with the lowest that pyproject.toml allows, with the newest Python) and used in an empty folder;
             then every command of README.md runs from it, with the extras that it names, and the walks of
             tools/walks.py
    lowest   a part of the suite on the lowest Python with the lowest releases that pyproject.toml allows
    newest   the same part on the newest Python of this machine, or on $PYTHON_NEWEST, with what uv.lock says; where no
             Python is newer than 3.12, uv installs one

A check that cannot be made is an error. Parts of the suite run side by side, in one process each.

Run it with the Python of .venv, which has uv and lidarscene: the formats that need an extra come from there.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from release import sdist_mistakes, tracked, version_mistakes, wheel_mistakes

from lidarscene import __version__
from lidarscene.formats.registry import FORMATS

ROOT = Path(__file__).resolve().parents[1]
KEPT = ROOT / "out" / "environments"
UV = shutil.which("uv", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}") or "uv"
LOWEST = ("--resolution", "lowest-direct")
LOWEST_PYTHON = (3, 11)  # as requires-python of pyproject.toml
NEWEST_PYTHON = (3, 13)  # or a newer one; from 3.12 on uv.lock has the newest releases, of NumPy above all
NOT_OURS = ("LIDARSCENE_", "DRJIT_", "PYTHON", "VIRTUAL_ENV", "UV_PROJECT", "MAKE", "MFLAGS")
COARSE = ("--set=scanner.azimuth_step_deg=2", "--set=scanner.elevation_step_deg=2")
ON_LLVM = {"LIDARSCENE_VARIANT": "llvm_ad_mono"}
# The command line on a machine whose system has no LLVM.
NO_SYSTEM_LLVM = """
import sys
from lidarscene.kernel.device import llvm
llvm._in_system = lambda: ()
from lidarscene.cli.main import main
sys.exit(main())
"""
# What meets the dependencies: files, formats, pictures, the command line, Dask, the kernels. Of each the quick tests.
PART = (
    "tests/maths",
    "tests/files",
    "tests/formats",
    "tests/cloud",
    "tests/recordings",
    "tests/scene/meshes",
    "tests/scene/test_scene_file.py",
    "tests/materials",
    "tests/figures",
    "tests/sensor/test_sensor_file.py",
    "tests/sensor/test_optics.py",
    "tests/batch/test_work.py",
    "tests/cli/test_outputs.py",
    "tests/kernel/rays",
    "tests/chain/test_scanners.py",
)
# What tests/docs/test_commands.py needs beside the package.
TEST_TOOLS = ("hypothesis", "pytest", "pytest-timeout", "pytest-xdist")
# Releases of last year warn of what today's Python and libraries will drop; the tests' own environment does not.
OLD = ("-W", "ignore::DeprecationWarning", "-W", "ignore::PendingDeprecationWarning")


def main() -> None:
    """The checks that are named, in the order given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checks", nargs="+", choices=("wheel", "lowest", "newest"))
    names = parser.parse_args().checks
    if missing := [path for path in PART if not (ROOT / path).exists()]:
        raise SystemExit(f"environments: PART: no such file or folder: {', '.join(missing)}")
    if "wheel" in names:
        check_wheel()
    parts = [{"lowest": check_lowest, "newest": check_newest}[name] for name in names if name != "wheel"]
    with ThreadPoolExecutor() as threads:
        list(threads.map(lambda check: check(), parts))


# --- the suite in an environment of its own ----------------------------------------------------------


def check_lowest() -> None:
    """Everything that pyproject.toml names, extras and tools of the tests too, at its lowest bound."""
    python = make_environment(KEPT / "lowest", lowest_python())
    install = ("pip", "install", "--quiet", "--python", python, *LOWEST)
    uv(*install, "--all-extras", "--group", "dev", "--requirements", "pyproject.toml", "--editable", ".")
    run_part("lowest bounds", python, *OLD)


def check_newest() -> None:
    """What uv.lock says on the newest Python; open3d, which is optional, where there is a wheel of it."""
    python = make_environment(KEPT / "newest", newest_python())
    sync = ("sync", "--quiet", "--locked", "--python", python)
    target = {"UV_PROJECT_ENVIRONMENT": str(KEPT / "newest")}
    if uv(*sync, check=False, **target):
        report("once more without open3d, which is optional")
        uv(*sync, "--no-install-package", "open3d", "--no-install-package", "libusb-package", **target)
    run_part("newest Python", python)


def run_part(name: str, python: str, *options: str) -> None:
    """Run the part and print it when it has ended."""
    with tempfile.TemporaryDirectory() as home:
        environment = clean_environment(home)
        report(f"{name}: {output(python, '--version')}, in {Path(python).parents[1]}")
        pytest = [python, "-m", "pytest", "-q", "-n", "0", "--part=quick", *options, *PART]
        process = subprocess.run(
            pytest,
            cwd=ROOT,
            env=environment | {"TEST_NO_SKIPS": "1"},
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            check=False,
        )
        report(f"{name}:\n{process.stdout}")
        if process.returncode:
            raise SystemExit(f"environments: {name}: the tests failed: {' '.join(pytest)}")


# --- the wheel in an empty environment ---------------------------------------------------------------


def check_wheel() -> None:
    """Build it as it is published, and use it with only what it asks for."""
    with tempfile.TemporaryDirectory() as folder:
        uv("build", "--quiet", "--out-dir", folder)  # the sdist, and the wheel from the sdist
        (wheel,), (sdist,) = Path(folder).glob("*.whl"), Path(folder).glob("*.tar.gz")
        mistakes = version_mistakes()
        if (ROOT / ".git").exists():  # an unpacked sdist does not know what git tracks
            mistakes += [*wheel_mistakes(wheel, tracked()), *sdist_mistakes(sdist, tracked())]
        if mistakes:
            raise SystemExit("\n".join(f"environments: wheel: {mistake}" for mistake in mistakes))
        kinds = [
            ("newest releases", sys.executable, ()),
            ("lowest bounds", lowest_python(), LOWEST),
            ("newest Python", newest_python(), ()),
        ]

        def check(kind: tuple[str, str, tuple[str, ...]]) -> None:
            name, version, options = kind
            home = Path(folder) / name.replace(" ", "_")
            python = make_environment(home / "env", version)
            uv("pip", "install", "--quiet", "--python", python, *options, str(wheel))
            # What an error says depends on no release: once is enough.
            use_package(home, python, errors=name == "newest releases")
            report(f"wheel: {name}: {output(python, '--version')}")

        with ThreadPoolExecutor(2) as threads:  # two at a time: a command waits for one core, mostly
            followed = threads.submit(follow_pages, Path(folder), wheel)
            list(threads.map(check, kinds))
            followed.result()


def follow_pages(folder: Path, wheel: Path) -> None:
    """The commands of README.md in an empty folder, as tests/docs/test_commands.py runs them, from the wheel."""
    python = make_environment(folder / "pages", sys.executable)
    install = ("pip", "install", "--quiet", "--no-config", "--python", python)  # overrides are the repository's alone
    uv(*install, "--dry-run", f"{wheel}[all]")
    uv(*install, f"{wheel}[batch,ouster,ros]", *TEST_TOOLS)
    home = folder / "pages_home"
    home.mkdir()
    # ouster-sdk brings pytest-asyncio, whose plugin warns while it is loaded.
    pytest = [python, "-m", "pytest", "-q", "-n", "0", "-p", "no:asyncio", "-o", "pythonpath=tests"]
    pytest += ["-k", "README"]
    environment = clean_environment(str(home)) | {"TEST_NO_SKIPS": "1"}
    ran = run([*pytest, "tests/docs/test_commands.py"], ROOT, environment)
    place = run([python, "-c", "import lidarscene; print(lidarscene.__file__)"], ROOT, environment).stdout.strip()
    if ran.returncode or "1 passed" not in ran.stdout or not place.startswith(str(folder)):
        raise SystemExit(f"environments: wheel: commands of README, from {place}:\n{ran.stdout}{ran.stderr}")
    report("wheel: every command of README.md")
    walked = run([python, str(ROOT / "tools" / "walks.py"), str(folder / "walks")], folder, environment)
    if walked.returncode:
        raise SystemExit(f"environments: wheel: {walked.stdout}{walked.stderr}")
    report(f"wheel: every walk of tools/walks.py\n{walked.stdout}")


def use_package(home: Path, python: str, *, errors: bool) -> None:
    """Every kind of command; with ``errors`` also what an extra is needed for, and a machine without LLVM."""
    folder = home / "elsewhere"
    folder.mkdir()
    environment = clean_environment(str(home))

    def lidarscene(*arguments: str, **more: str) -> subprocess.CompletedProcess[str]:
        return run([str(Path(python).with_name("lidarscene")), *arguments], folder, environment | more)

    code = "import lidarscene; [getattr(lidarscene, n) for n in lidarscene.__all__]; print(lidarscene.__file__)"
    require_outcome(run([python, "-c", code], folder, environment), 0, str(home / "env"))
    require_outcome(lidarscene("--version"), 0, f"lidarscene {__version__}")
    require_outcome(lidarscene("catalog", "scenes"), 0, "street")
    require_outcome(lidarscene("catalog"), 0, "table1-apd")
    require_outcome(lidarscene("catalog", "materials", "asphalt"), 0, "reflectivity")
    json.loads(require_outcome(lidarscene("schema", "scene"), 0, "$defs"))
    require_outcome(lidarscene("range", "apd-905", "--over", "illuminance_klux", "--plot", "range.png"), 0, "apd-905")
    require_outcome(lidarscene("doctor"), 0, "lidarscene can trace rays here")
    for scene in ("range", "car"):
        summary = require_outcome(lidarscene("render", scene, "-o", f"{scene}.ply", "--json", *COARSE), 0, "")
        if json.loads(summary)["points"] == 0 or not (folder / f"{scene}.ply").read_bytes().startswith(b"ply"):
            raise SystemExit(f"environments: {scene}: no cloud of points came out: {summary}")
    require_outcome(lidarscene("render", "range", "-o", "a.ply", "--picture", "a.png", *COARSE), 0, "a.png")
    require_outcome(lidarscene("view", "range", "--save", "view.html", *COARSE), 0, "view.html")

    if not errors:
        return
    for name, extra in {
        name: written_format.extra for name, written_format in FORMATS.items() if written_format.extra
    }.items():
        ran = lidarscene("render", "range", "-o", "a", "--format", name, *COARSE)
        one_line(ran, 1, f"try: pip install 'lidarscene[{extra}]'")
    (folder / "job.toml").write_text('scenes = ["range"]\n')
    one_line(lidarscene("batch", "job.toml", "-o", "job"), 1, "try: pip install 'lidarscene[batch]'")
    sun = "sun = { place = [48.0, 11.0], time = 2026-06-21T12:00:00Z, illuminance_klux = 100 }\n"
    wall = '[[bodies]]\nname = "wall"\nprimitive = "plane"\nsize_m = [4, 4]\nmaterial = "concrete"\n'
    (folder / "sun.toml").write_text(sun + wall)
    one_line(lidarscene("render", "sun.toml", "-o", "a.ply"), 1, "try: pip install 'lidarscene[sun]'")

    without_llvm_path = {"DRJIT_LIBLLVM_PATH": "/nowhere/libLLVM.so"} | ON_LLVM
    without_llvm(lidarscene, "DRJIT_LIBLLVM_PATH=/nowhere/libLLVM.so: no such file; try: ", **without_llvm_path)
    uv("pip", "uninstall", "--quiet", "--python", python, "karellen-llvm-core")

    def without_system(*arguments: str, **more: str) -> subprocess.CompletedProcess[str]:
        return run([python, "-c", NO_SYSTEM_LLVM, *arguments], folder, environment | more)

    without_llvm(without_system, "no LLVM library found; try: ", **ON_LLVM)


def without_llvm(lidarscene, message: str, **environment: str) -> None:
    """One error, exit code 3, nothing written; doctor's whole report all the same; what traces nothing works."""
    for command in (("render", "range", "-o", "new/a.ply"), ("view", "range", "--save", "b.html")):
        require_outcome(lidarscene(*command, **environment), 3, message, error=True)
    report = require_outcome(lidarscene("doctor", **environment), 1, message)
    if not report.rstrip().endswith("lidarscene cannot trace rays here"):
        raise SystemExit(f"environments: doctor does not end with its verdict:\n{report}")
    require_outcome(lidarscene("range", "table1-apd", **environment), 0, "table1-apd")


def one_line(ran: subprocess.CompletedProcess[str], code: int, message: str) -> None:
    """An error of one line, and nothing else."""
    if require_outcome(ran, code, message, error=True).count("\n") != 1:
        raise SystemExit(f"environments: more than one line: {ran.stderr}")


def require_outcome(ran: subprocess.CompletedProcess[str], code: int, message: str, *, error: bool = False) -> str:
    """What it printed, if this is how it ended and what it said, and it said nothing in the wrong place."""
    right, wrong = (ran.stderr, ran.stdout) if error else (ran.stdout, ran.stderr)
    begins = "lidarscene: error: " if error else ""
    if ran.returncode != code or message not in right or not right.startswith(begins) or wrong:
        raise SystemExit(
            f"environments: {' '.join(ran.args)}\nended with {ran.returncode}, expected {code} and {message!r}\n"
            f"--- stdout\n{ran.stdout}--- stderr\n{ran.stderr}"
        )
    return right


# --- Pythons and processes ---------------------------------------------------------------------------


def lowest_python() -> str:
    """A Python of the lowest release that is supported: one of this machine, or the one that uv installs."""
    pythons = dict(installed_pythons())
    return pythons.get(LOWEST_PYTHON) or download_python(LOWEST_PYTHON)


def newest_python() -> str:
    """$PYTHON_NEWEST, or the newest Python of this machine, or, where that is too old, the one that uv installs."""
    if newest := os.environ.get("PYTHON_NEWEST"):
        return newest
    release, path = max(installed_pythons(), default=((0, 0), ""))
    return path if release >= NEWEST_PYTHON else download_python(NEWEST_PYTHON)


def download_python(release: tuple[int, int]) -> str:
    """The Python that uv installs for its user."""
    uv("python", "install", "--quiet", "{}.{}".format(*release))
    return "{}.{}".format(*release)


def installed_pythons() -> Iterator[tuple[tuple[int, int], str]]:
    """The Pythons that uv finds, and pyenv's, which it cannot find where none of them is chosen."""
    listed = subprocess.run(
        [UV, "python", "list", "--only-installed", "--output-format", "json"],
        capture_output=True,
        text=True,
        check=False,
    )
    paths = [
        interpreter["path"]
        for interpreter in json.loads(listed.stdout or "[]")
        if interpreter["implementation"] == "cpython"
    ]
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    for path in [*paths, *map(str, pyenv.glob("versions/3.*/bin/python"))]:
        if path:
            major, minor = output(path, "-c", "import sys; print(*sys.version_info[:2])").split()
            yield (int(major), int(minor)), path


def make_environment(folder: Path, python: str) -> str:
    """The Python of a new environment, in the place of any that is there."""
    uv("venv", "--quiet", "--clear", "--python", python, str(folder))
    return str(next(path for path in (folder / "bin" / "python", folder / "Scripts" / "python.exe") if path.exists()))


def uv(*arguments: str, check: bool = True, **environment: str) -> int:
    """Run uv in the repository."""
    code = subprocess.run([UV, *arguments], cwd=ROOT, env=os.environ | environment, check=False).returncode
    if check and code:
        raise SystemExit(f"environments: uv {' '.join(arguments)}: ended with {code}")
    return code


def clean_environment(home: str) -> dict[str, str]:
    """The environment of this process without what chooses a back end, a cache or modules; HOME is `home`."""
    variables = {name: value for name, value in os.environ.items() if not name.startswith(NOT_OURS)}
    return variables | {"HOME": home, "USERPROFILE": home}


def run(command: list[str], folder: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """Run it to its end, with what it printed."""
    return subprocess.run(
        command,
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        timeout=600,
        check=False,
    )


def output(*command: str) -> str:
    """What a command prints."""
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def report(text: str) -> None:
    """Tell what goes on."""
    print(f"environments: {text}", flush=True)


if __name__ == "__main__":
    main()
