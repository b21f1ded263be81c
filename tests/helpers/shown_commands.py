"""The commands that the documentation shows, run page by page in this process, on the files that the page shows.

They run as they stand but for what takes long: sensors with fewer pulses (`COARSE`, `COARSE_RIG`), two frames for ten,
fields of view after 0.05 s in cells of 4 degrees, two illuminances for four, charts and pictures of fewer pixels, a
job of four frames for twelve on one worker, the view written by `--save` instead of served. What is only parsed is in
`PARSED_ONLY`, with the test that runs its like.
"""

import re
import shlex
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from helpers.documentation import PAGES, ROOT, blocks, commands, in_order, make_workplace, shell_lines
from helpers.in_this_process import draw_roughly
from lidarscene import catalog
from lidarscene.cli import main
from lidarscene.scene.file import load_scene

# What needs more than this machine, and what another test runs as it stands.
PARSED_ONLY = {
    "lidarscene batch scenes/job.toml -o /shared": "tests/batch/test_cluster.py::test_the_bits_of_render",
    "lidarscene fit os2.pcap": "tests/studies/fit/test_study.py::test_sensor_file_and_page_have_what_was_found",
    "lidarscene paper -o out/paper": "tests/cli/test_paper.py::test_all_files_are_there_and_nothing_else",
}

# What a page takes for granted: sensors copied from the catalogue, clouds that another page makes.
COPIES = {"my-sensor": "table1-sipm", "my-risley": "livox-mid-40", "my-spinning": "vlp-16"}
MADE_BEFORE = {
    "view.md": (
        "lidarscene render scenes/car.toml -o out/car.ply",
        "lidarscene render scenes/drive.toml -o out/frames --frames 2",
    ),
}
RASTER = ("scanner.azimuth_step_deg=4", "scanner.elevation_step_deg=4")
SPINNING = ("scanner.columns_per_turn=64", "laser.repetition_rate_khz=81.92")
COARSE = {
    "table1-apd": RASTER, "table1-sipm": RASTER, "biaxial-905": RASTER, "os1-128": SPINNING,
    "livox-mid-40": ("laser.repetition_rate_khz=10",), "livox-avia": ("laser.repetition_rate_khz=24",),
}  # fmt: skip
"""What is set of a sensor so that it has a few thousand pulses a frame."""
COARSE_RIG = (
    *(f"roof:{one}" for one in SPINNING), "left:laser.repetition_rate_khz=24", "right:laser.repetition_rate_khz=24",
)  # fmt: skip
"""The same of `scenes/rig.toml`."""
COARSE_JOB = {
    '["car.toml"]': '["scenes/car.toml"]',
    "seed_count = 2": "seed_count = 1",
    "[1, 10, 100]": "[1, 100]",
    "[sweep.scene]": "[sweep.sensor]\n"
    + "".join(f'"{key}" = [{value}]\n' for key, value in (one.split("=") for one in RASTER))
    + "\n[sweep.scene]",
}
"""What `scenes/job.toml` says, and what instead: four frames for twelve."""

OF_STUDIES = ("compare.md", "fov.md", "motion.md", "range.md", "sensors.md", "your_own.md")
"""Pages with commands that take as long as those of all others: two files of tests, for two processes."""


def pages(*, of_studies: bool) -> list[Path]:
    return [page for page in PAGES if commands(page) and (page.name in OF_STUDIES) == of_studies]


def incomplete(command: str) -> bool:
    """Words about a command rather than one: `lidarscene render scene.xml` does not say where to write."""
    words = command.split()
    return (len(words) == 2 and words[1] != "doctor") or (words[1] == "render" and "-o" not in words)


def parsed_only(command: str) -> bool:
    return any(command.startswith(start) for start in PARSED_ONLY)


def coarse_job() -> str:
    text = (ROOT / "scenes" / "job.toml").read_text(encoding="utf-8")
    for old, new in COARSE_JOB.items():
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text


def value_of(option: str, words: list[str]) -> str | None:
    return words[words.index(option) + 1] if option in words else None


def coarse(arguments: list[str]) -> list[str]:
    """The same command, in less time."""
    command, *rest = arguments
    if "--frames" in rest:
        rest[rest.index("--frames") + 1] = "2"
    if "--pulses" in rest:  # a coarse frame has fewer
        rest[rest.index("--pulses") + 1] = "0"
    if command == "view" and "--save" not in rest:
        rest += ["--save", "out/view.html"]
    if command == "batch" and "scenes/job.toml" in rest:
        Path("job.toml").write_text(coarse_job(), encoding="utf-8")
        rest[rest.index("scenes/job.toml")] = "job.toml"
        rest += ["--workers", "1"] if "--workers" not in rest else []
    if "--illuminance" in rest:
        rest[rest.index("--illuminance") + 1] = "10,100"
    if command == "fov":
        rest += ["--time", "0.05", "--cell", "4"]
    rig, scene = value_of("--rig", rest), next((word for word in rest if word.startswith("scenes/")), None)
    if rig == "scenes/rig.toml":
        sets: tuple[str, ...] = COARSE_RIG
    elif command in ("compare", "fov"):
        names = (value_of("--sensors", rest) or ",".join(rest)).split(",")
        sets = tuple(f"{name}:{one}" for name in names if name in COARSE for one in COARSE[name])
    elif command in ("render", "view") and scene is not None and rig is None:
        sensor = value_of("--sensor", rest) or load_scene(scene).sensor_name
        sets = COARSE.get(sensor, ())
    else:
        sets = ()
    return [command, *rest, *(f"--set={one}" for one in sets)]


@dataclass(frozen=True)
class Reader:
    """Who follows one page after the other, in one folder; ``done`` is what runs for another page."""

    folder: Path
    done: set[str] = field(default_factory=set)

    def follow(self, page: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        """In the order of the page, and its Python between them where it has files of its own."""
        make_workplace(self.folder, page, monkeypatch)
        draw_roughly(monkeypatch)
        for name, original in COPIES.items():
            if not Path(f"{name}.toml").exists():
                Path(f"{name}.toml").write_text(
                    catalog.path_of("sensors", original).read_text("utf-8"), "utf-8"
                )
        self._run(capsys, MADE_BEFORE.get(page.name, ()))
        shown = set(shell_lines(page))
        own_files = any(block.file_name for block in blocks(page))
        for block in in_order(page):
            if block.language == "python" and own_files:
                exec(compile(block.code, str(block), "exec"), {"__name__": "documentation"})
            if block.language == "sh":
                typed = [re.split(" #", line)[0].strip() for line in block.code.splitlines()]
                self._run(capsys, (line.removeprefix(".venv/bin/") for line in typed))
        self._run(capsys, (one for one in commands(page) if one not in shown and not incomplete(one)))

    def _run(self, capsys: pytest.CaptureFixture[str], shown: Iterable[str]) -> None:
        """Run or parse those of ours; `> FILE` takes what one prints."""
        for line in shown:
            if not line.startswith("lidarscene ") or line in self.done:
                continue
            self.done.add(line)
            command, _, target = line.partition(" > ")
            arguments = shlex.split(command)[1:]
            assert main._parser().parse_args(main.with_joined_pose(arguments)).run
            if parsed_only(command):
                continue
            capsys.readouterr()
            assert main.main(coarse(arguments)) == 0, f"{command}\n{capsys.readouterr().err}"
            printed = capsys.readouterr().out
            assert printed
            if target:
                Path(target).write_text(printed, encoding="utf-8")
