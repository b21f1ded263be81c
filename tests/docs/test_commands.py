"""Every command that the documentation shows runs, page by page, on the files that the page shows.

They run as they stand but for what takes long: shipped scenes on a raster of 2 degrees, two frames for ten, fields of
view after 0.1 s in cells of 2 degrees, the view written by `--save` instead of served. What is only parsed is in
`PARSED_ONLY`, with the test that runs its like.
"""

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
from helpers.documentation import PAGES, ROOT, blocks, commands, in_order, make_workplace, shell_lines

from lidarscene import catalog
from lidarscene.cli import main

# What needs more than this machine.
PARSED_ONLY = {
    "lidarscene batch scenes/job.toml -o /shared": "tests/batch/test_cluster.py::test_the_bits_of_render",
}

# What a page takes for granted: sensors copied from the catalogue, clouds that another page makes.
COPIES = {"my-sensor": "table1-sipm", "my-risley": "livox-mid-40", "my-spinning": "vlp-16"}
MADE_BEFORE = {
    "view.md": (
        "lidarscene render scenes/car.toml -o out/car.ply",
        "lidarscene render scenes/drive.toml -o out/frames --frames 2",
    ),
}
AXES = ("scanner.azimuth_step_deg", "scanner.elevation_step_deg")
OTHERS = ("git", "cd", "pip", "python", "python3", "source", ".")
done: set[str] = set()
"""What has run already, for another page."""
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")


def test_pages_show_commands() -> None:
    assert sum(len(commands(page)) for page in PAGES) > 60


def incomplete(command: str) -> bool:
    """Words about a command rather than one: `lidarscene render scene.xml` does not say where to write."""
    words = command.split()
    return (len(words) == 2 and words[1] != "doctor") or (words[1] == "render" and "-o" not in words)


def parsed_only(command: str) -> bool:
    return any(command.startswith(start) for start in PARSED_ONLY)


def coarse(arguments: list[str]) -> list[str]:
    """The same command, in less time."""
    command, *rest = arguments
    if "--frames" in rest:
        rest[rest.index("--frames") + 1] = "2"
    if "--pulses" in rest:  # a coarse frame has fewer
        rest[rest.index("--pulses") + 1] = "0"
    if command == "view" and "--save" not in rest:
        rest += ["--save", "out/view.html"]
    raster = "--sensor" not in rest or rest[rest.index("--sensor") + 1].startswith("table1")
    if (
        command in ("render", "view")
        and raster
        and re.search(r"scenes/(car|street|fog|range)", " ".join(rest))
    ):
        rest += [word for axis in AXES for word in ("--set", f"{axis}=2")]
    if command == "fov":
        rest += ["--time", "0.1", "--cell", "2"]
    if command in ("compare", "fov"):
        named = rest[rest.index("--sensors") + 1].split(",") if "--sensors" in rest else rest
        sensors = [name for name in named if name.startswith("table1")]
        rest += [word for axis in AXES for name in sensors for word in ("--set", f"{name}:{axis}=2")]
    return [command, *rest]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One for all pages, as a reader has it."""
    return tmp_path_factory.mktemp("documentation")


def run(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Run it, or parse it; `> FILE` takes what it prints."""
    command, _, target = command.partition(" > ")
    arguments = shlex.split(command)[1:]
    assert main._parser().parse_args(main.with_joined_pose(arguments)).run
    if parsed_only(command):
        return
    if command in done:
        return
    done.add(command)
    capsys.readouterr()
    assert main.main(coarse(arguments)) == 0, f"{command}\n{capsys.readouterr().err}"
    printed = capsys.readouterr().out
    assert printed
    if target:
        Path(target).write_text(printed, encoding="utf-8")


@pytest.mark.parametrize("page", [page for page in PAGES if commands(page)], ids=lambda page: page.name)
def test_commands_run(
    page: Path, mi: Any, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the order of the page, and its Python between them where it has files of its own."""
    make_workplace(folder, page, monkeypatch)
    for name, original in COPIES.items():
        if not Path(f"{name}.toml").exists():
            Path(f"{name}.toml").write_text(catalog.path_of("sensors", original).read_text("utf-8"), "utf-8")
    for command in MADE_BEFORE.get(page.name, ()):
        run(command, capsys)
    shown = set(shell_lines(page))
    own_files = any(block.file_name for block in blocks(page))
    for block in in_order(page):
        if block.language == "python" and own_files:
            exec(compile(block.code, str(block), "exec"), {"__name__": "documentation"})
        for line in block.code.splitlines() if block.language == "sh" else ():
            command = re.split(" #", line)[0].strip().removeprefix(".venv/bin/")
            if command.startswith("lidarscene "):
                run(command, capsys)
    for command in commands(page):
        if command not in shown and not incomplete(command):
            run(command, capsys)


def test_what_is_only_parsed_is_shown_and_run_elsewhere() -> None:
    shown = [command for page in PAGES for command in commands(page)]
    for start, test in PARSED_ONLY.items():
        assert any(command.startswith(start) for command in shown), start
        file, _, name = test.partition("::")
        assert f"def {name}(" in (ROOT / file).read_text(encoding="utf-8")


def test_other_lines_of_shell_blocks() -> None:
    """`make` has every target that is named, and nothing unexpected is typed."""
    for page in PAGES:
        for line in shell_lines(page):
            words = line.split()
            if not words or words[0].removeprefix(".venv/bin/") == "lidarscene":
                continue
            if "make" in words:
                assert re.search(rf"^{words[words.index('make') + 1]}:", MAKEFILE, re.MULTILINE), line
            else:
                assert words[0] in OTHERS, line
