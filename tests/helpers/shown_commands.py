"""The commands that the documentation shows, run page by page in this process, on the files that the page shows.

They run as they stand but for what takes long: sensors with fewer pulses (`COARSE`, `COARSE_RIG`), scenes of
`scenes/` with one body of a kind, two frames for ten, fields of view after 0.02 s in cells of 8 degrees, two
illuminances for four, a design study of 12 evaluations, charts and pictures that are not drawn, a job of four frames
for twelve on a thread of this process, the view written by `--save` instead of served. Of `render` commands whose
files the page does not go on with a third is traced, others in each run (`TRACED`); of the rest all is read and
checked. What is only parsed is in `PARSED_ONLY`, with
the test that runs its like. Of two commands of which one has more options than the other only that one is run, unless
the page goes on with the file of the shorter one. Whole scenes are rendered in tests/cli/test_main.py, charts drawn
by the tests of each command.
"""

import contextlib
import functools
import re
import shlex
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest
import trimesh

from helpers.documentation import (
    IN_AN_EMPTY_FOLDER,
    PAGES,
    README,
    blocks,
    commands,
    in_order,
    make_workplace,
    shell_lines,
)
from helpers.fuzzing import untraced
from helpers.in_this_process import draw_nothing, draw_roughly
from helpers.kept_scenes import use_trimmed
from helpers.run_seed import chosen
from helpers.small_job import threads_of_this_process, use_no_worlds_of_others
from lidarscene import catalog
from lidarscene.batch import cluster
from lidarscene.cli import main
from lidarscene.cli.words import with_joined_pose
from lidarscene.scene.scene import Body, Scene
from lidarscene.scene.scene_file import sensor_of_scene

PARSED_ONLY = {
    "tests/batch/test_dataset.py::test_as_many_labels_as_clouds": ("batch factory.toml -o out/factory",),
    "tests/batch/test_cluster.py::test_the_bits_of_render": (
        "batch job -o /shared/job --scheduler tcp://10.0.0.1:8786",
    ),
    "tests/outputs/test_captures.py::test_ouster_metadata_and_background": (
        "render drive --sensor os0-128 --set scanner.columns_per_turn=512 -o out/os0.pcap",
    ),
    "tests/scene/street/test_street.py::test_keys_of_a_street_and_of_its_bodies_can_be_changed": (
        "render town -o out/town.ply --scene-set street.seed=4",
        "render town -o out/town --frames 1200",
    ),
    "tests/cli/test_main.py::test_shipped_scene_renders": (
        "render parallax -o out/parallax.ply",
        "render rain -o out/rain.ply",
        "render snow -o out/snow.ply",
        "render interference -o out/interference.ply",
    ),
    "tests/scene/street/test_street.py::test_a_longer_street_keeps_its_drivers_and_its_numbers_in_sight_few": (
        (
            "render town -o out/long --frames 6000 --scene-set street.loop=false --scene-set street.length_m=5000 "
            "--scene-set street.seed=7"
        ),
    ),
    "tests/scene/street/test_networks.py::test_a_drawn_town_has_hills_lights_and_a_roundabout_at_which_vehicles_turn": (
        'street --town 4 --seed 3 --set "slope_percent=[0, 6]" -o out/drawn',
        "street --town 3 --seed 3 -o out/loop",
    ),
    "tests/scene/street/test_networks.py::test_every_body_of_drawn_traffic_loads": (
        (
            "render out/drawn/street.toml --begin 54 -o out/drawn.ply --picture out/drawn.png "
            '--scene-set "picture.eye_m=[-24, 5, 15]"'
        ),
        'street --osm map.osm --set "house_share=[0.2, 0.6]" -o out/map',
    ),
    "tests/scene/street/test_street.py::test_nothing_floats_on_hills": (
        'street --seed 8 --length-m 200 --set "slope_percent=[7, 10]" -o out/hills',
        (
            "render out/hills/street.toml --begin 6 -o out/hills.ply --picture out/hills.png "
            '--scene-set "picture.eye_m=[-22, 5, 13]"'
        ),
    ),
    "tests/scene/street/test_networks.py::test_the_vehicle_of_a_map_keeps_to_its_side": (
        "street --osm london.osm --left-hand -o out/london",
    ),
    "tests/scene/street/test_networks.py::test_a_road_of_opendrive_is_where_its_geometry_says": (
        "street --opendrive town.xodr --seed 3 -o out/town",
    ),
    "tests/scene/street/test_networks.py::test_the_vehicles_are_where_sumo_says": (
        "street --sumo scenario.sumocfg -o out/scenario",
        "street --sumo scenario.sumocfg --ego bus.7 -o out/scenario",
    ),
    "tests/outputs/test_run_motion.py::test_synchronous_packets_of_an_ousters_imu": (
        (
            "render out/loop/street.toml --sensor os1-128 --set scanner.columns_per_turn=1024 "
            "--set imu.rate_hz=640 -o out/loop.pcap --frames 1160 --poses out/loop.txt"
        ),
    ),
    "tests/cli/recordings/test_recording_options.py::test_view_saves_all_frames_or_one": (
        "view out/os0.pcap",
        "view os1.pcap --metadata os1.json --frame 3",
    ),
    "tests/cli/recordings/test_sensor.py::test_a_unit_of_an_ouster": (
        "sensor --from os1.json -o my-os1.toml",
        "sensor --from os1.json --mode 2048x10 -o my-os1-2048.toml",
    ),
    "tests/recordings/units/test_hesai_unit.py::test_a_model_that_the_catalogue_lacks_needs_a_like_and_warns": (
        "sensor --from angles.csv --like pandar64 -o my-pandar.toml",
    ),
    "tests/recordings/test_ouster_reader.py::test_every_sensor_of_an_osf_is_in_reach_with_its_own_metadata": (
        "sensor --from drive.osf --sensor-index 1 -o my-os0.toml",
    ),
    "tests/formats/test_rerun.py::test_frames_go_to_a_viewer_as_they_come": (
        "render drive -o out/shown.ply --rrd --frames 2",
    ),
    "tests/view/test_serve.py::test_a_live_scene_is_what_render_gives": ("view car --port 8000 --no-browser",),
    "tests/cli/recordings/test_twin.py::test_a_twin_of_a_recording": ("twin os1.pcap --held-out columns -o out/twin",),
    "tests/cli/recordings/test_certify.py::test_turns_at_rest": (
        "certify os0-32 -o out/certificate",
        "certify os1.pcap -o out/certificate",
        "certify turns/ --sensor pandar64 -o out/certificate",
        "certify os1.pcap --sensor my-os1.toml --frame 3 --seed 1 -o out/certificate",
        "certify os1.pcap --scene out/twin/scene.toml -o out/validated",
    ),
    "tests/studies/fit/on_scene/test_scene_fit.py::test_the_unit_that_recorded_is_found_again": (
        "fit os1.pcap --scene out/twin/scene.toml -o my-os1.toml --report out/fit",
    ),
    "tests/studies/fit/test_recording_fit.py::test_sensor_file_and_page_have_what_was_found": (
        "fit os2.pcap --sensor os2-128 -o my-os2.toml --report out/fit",
    ),
    "tests/studies/fit/test_at_rest.py::test_turns_at_rest_are_fitted_without_a_scene": (
        "fit turns/ --sensor pandar64 -o my-pandar.toml --report out/fit",
    ),
    "tests/cli/test_paper.py::test_all_files_are_there_and_nothing_else": ("paper -o out/paper",),
    "tests/studies/design/test_design_study.py::test_the_front_is_that_of_a_grid": ("design aperture -o out/aperture",),
    "tests/studies/design/test_design_study.py::test_workers_give_the_same_front": (
        "design my-study.toml -o out/study --workers 2",
    ),
    "tests/sensor/test_sensor_catalogue.py::test_check_prints_every_sensor": (
        "catalog check",
        "catalog check --real",
        "catalog check livox-mid-40",
    ),
}
"""Whole commands, without their first word, that need more than this machine or run in another test, by that test."""

# What a page takes for granted: sensors copied from the catalogue, clouds that another page makes.
COPIES = {"my-sensor": "table1-sipm", "my-risley": "livox-mid-40", "my-spinning": "vlp-16"}
MESH, VAN = "my_mesh.glb", "van.obj"
"""A box of each name is written."""
MADE_BEFORE = {
    "index.md": ("lidarscene render car -o out/car.ply",),
    "view.md": (
        "lidarscene render car -o out/car.ply --picture out/car.png",
        "lidarscene render scenes/drive.toml -o out/frames --frames 2",
    ),
}
RASTER = ("scanner.azimuth_step_deg=4", "scanner.elevation_step_deg=4")
SPINNING = ("scanner.columns_per_turn=64", "laser.repetition_rate_khz=81.92")
COARSE = {
    "apd-905": RASTER,
    "sipm-905": RASTER,
    "table1-apd": RASTER,
    "table1-sipm": RASTER,
    "biaxial-905": RASTER,
    "os1-128": SPINNING,
    "livox-mid-40": ("laser.repetition_rate_khz=10",),
    "livox-avia": ("laser.repetition_rate_khz=24",),
}
"""What is set of a sensor so that it has a few thousand pulses a frame."""
COARSE_RIG = (
    *(f"roof:{setting}" for setting in SPINNING),
    "left:laser.repetition_rate_khz=24",
    "right:laser.repetition_rate_khz=24",
)
"""The same of the example `rig`."""
COARSE_JOB = {
    "seed_count = 2": "seed_count = 1",
    "[1, 10, 100]": "[1, 100]",
    "[sweep.scene]": "[sweep.sensor]\n"
    + "".join(f'"{key}" = [{value}]\n' for key, value in (setting.split("=") for setting in RASTER))
    + "\n[sweep.scene]",
}
"""What the example `job` says, and what instead: four frames for twelve."""


def by_names(line: str) -> str:
    """The command with files of `scenes/` called by their names, so that `car` and `scenes/car.toml` are one."""
    return re.sub(rf"scenes/({'|'.join(catalog.names('scenes'))})\.toml", r"\1", line)


def value_of(option: str, words: list[str]) -> str | None:
    return words[words.index(option) + 1] if option in words else None


def use_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """`batch` on a thread of this process: tests/batch starts processes."""
    monkeypatch.setattr(cluster, "local_client", threads_of_this_process)
    use_no_worlds_of_others(monkeypatch)


def drawn_pages() -> list[Path]:
    """README and one of three other pages, others in each run; all commands of all pages are parsed in each."""
    others = [page for page in PAGES if commands(page) and page != README]
    return [README, *chosen(len(others) // 3, others)]


def incomplete(command: str) -> bool:
    """Words about a command rather than one: `lidarscene render scene.xml` does not say where to write."""
    words = command.split()
    return (len(words) == 2 and words[1] != "doctor") or (words[1] == "render" and "-o" not in words)


def parsed_only(command: str) -> bool:
    return any(command.removeprefix("lidarscene ") in elsewhere for elsewhere in PARSED_ONLY.values())


def in_a_longer_one(command: str) -> bool:
    """Whether another command that is shown is this one with more options."""
    start = f"{by_names(command)} --"
    return any(longer.startswith(start) for longer in _all_by_names())


@functools.cache
def _all_by_names() -> tuple[str, ...]:
    return tuple(by_names(line) for page in PAGES for line in commands(page))


def is_read_later(command: str, page: Path) -> bool:
    """Whether the page names what the command writes in another command, or in its Python."""
    target = command.partition(" > ")[2] or value_of("-o", command.split())
    texts = [other_command for other_command in commands(page) if other_command != command]
    texts += [block.code for block in blocks(page, "python")]
    return target is not None and any(re.search(rf"{re.escape(target)}(?![\w.-])", text) for text in texts)


def _is_only_written(line: str, page: Path) -> bool:
    return line.startswith("lidarscene render ") and not is_read_later(line, page)


_ONLY_WRITTEN = sorted({by_names(line) for page in PAGES for line in commands(page) if _is_only_written(line, page)})
TRACED = frozenset(chosen(len(_ONLY_WRITTEN) // 3, _ONLY_WRITTEN))
"""Frames that are traced although the page does not go on with them: tests of each effect trace it, too."""


def coarse_job() -> str:
    text = catalog.path_of("examples", "job").read_text(encoding="utf-8")
    for old, new in COARSE_JOB.items():
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text


def is_shipped(word: str) -> bool:
    """Whether a word is a scene of `scenes/`, by its file or its name, or a bare mesh."""
    return word.startswith("scenes/") or word in catalog.names("scenes") + catalog.names("meshes") or word == MESH


def sparse(scene: Scene) -> Scene:
    """The scene with one body of a kind: of copies the first, of those that move the first of each class."""
    kinds: dict[str, Body] = {}
    for body in scene.bodies:
        kinds.setdefault(body.class_name if body.motion else body.name.partition(".")[0], body)
    return replace(scene, bodies=tuple(kinds.values()))


def coarse(arguments: list[str]) -> list[str]:
    """The same command, in less time."""
    command, *options = arguments
    if "--frames" in options:
        options[options.index("--frames") + 1] = "2"
    if "--pulses" in options:  # a coarse frame has fewer
        options[options.index("--pulses") + 1] = "0"
    if command == "view" and "--save" not in options:
        options += ["--save", "out/view.html"]
    if command == "batch" and options[0] == "job":
        Path("job.toml").write_text(coarse_job(), encoding="utf-8")
        options[0] = "job.toml"
        options += ["--workers", "1"] if "--workers" not in options else []
    if command == "design" and (study := Path(options[0])).suffix == ".toml":
        study.write_text(re.sub("evaluations = .*", "evaluations = 12", study.read_text("utf-8")), "utf-8")
    if "--illuminance-klux" in options:
        options[options.index("--illuminance-klux") + 1] = "10,100"
    if command == "fov":
        for option, value in (("--time", "0.02"), ("--cell", "8")):
            if option in options:
                options[options.index(option) + 1] = value
            else:
                options += [option, value]
    rig, scene = value_of("--rig", options), next(filter(is_shipped, options), None)
    if rig == "rig":
        sets: tuple[str, ...] = COARSE_RIG
    elif command in ("compare", "fov"):
        names = (value_of("--sensors", options) or ",".join(options)).split(",")
        sets = tuple(f"{name}:{setting}" for name in names if name in COARSE for setting in COARSE[name])
    elif command in ("render", "view") and scene is not None and rig is None:
        sensor = value_of("--sensor", options) or sensor_of_scene(scene)
        own_scanner = any(option.startswith("scanner={") for option in options)
        sets = () if own_scanner else COARSE.get(sensor, ())
    else:
        sets = ()
    return [command, *options, *(f"--set={setting}" for setting in sets)]


@dataclass(frozen=True)
class Reader:
    """Runs the commands of one page after the other, each page in a folder of its own; ``ran``: commands run so far.

    A command runs once more only for a page that goes on with what it writes, so that each page can be followed alone.
    """

    folder: Path
    ran: set[str] = field(default_factory=set)
    scenes: dict[Any, Scene] = field(default_factory=dict)

    def follow(self, page: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        """Run the commands in the order of the page, and its Python between them where it has files of its own."""
        folder = self.folder / page.stem
        folder.mkdir()
        make_workplace(folder, page, monkeypatch)
        draw_roughly(monkeypatch)
        draw_nothing(monkeypatch)
        use_threads(monkeypatch)
        if page.name not in IN_AN_EMPTY_FOLDER:
            for name, original in COPIES.items():
                if not Path(f"{name}.toml").exists():
                    Path(f"{name}.toml").write_text(catalog.path_of("sensors", original).read_text("utf-8"), "utf-8")
            for name in (MESH, VAN):
                trimesh.creation.box((4.0, 1.8, 1.5)).export(name)
        for command in MADE_BEFORE.get(page.name, ()):
            self._run(capsys, command)
        shell_commands = set(shell_lines(page))
        own_files = any(block.file_name for block in blocks(page))
        for block in in_order(page):
            if block.language == "python" and own_files:
                exec(compile(block.code, str(block), "exec"), {"__name__": "documentation"})
            if block.language == "sh":
                for line in block.code.splitlines():
                    self._try(capsys, page, re.split(" #", line)[0].strip().removeprefix(".venv/bin/"))
        for command in commands(page):
            if command not in shell_commands and not incomplete(command):
                self._try(capsys, page, command)

    def _try(self, capsys: pytest.CaptureFixture[str], page: Path, line: str) -> None:
        """Run or parse a line of the page if it is a command of ours that is still to be tried."""
        if not line.startswith("lidarscene "):
            return
        read_later = is_read_later(line, page)
        if by_names(line) in self.ran and not read_later:
            return
        self.ran.add(by_names(line))
        arguments = shlex.split(line.partition(" > ")[0])[1:]
        assert main._parser().parse_args(with_joined_pose(arguments)).run
        runs_elsewhere = arguments[0] in ("render", "fov") and in_a_longer_one(line) and not read_later
        if parsed_only(line) or runs_elsewhere:
            return
        self._run(capsys, line, traced=not _is_only_written(line, page) or by_names(line) in TRACED)

    def _run(self, capsys: pytest.CaptureFixture[str], line: str, *, traced: bool = True) -> None:
        """Run a command; `> FILE` takes what it prints."""
        command, _, target = line.partition(" > ")
        capsys.readouterr()
        with contextlib.nullcontext() if traced else untraced(), pytest.MonkeyPatch.context() as patch:
            use_trimmed(patch, sparse, self.scenes)  # Python between the commands has whole ones
            assert main.main(coarse(shlex.split(command)[1:])) == 0, f"{command}\n{capsys.readouterr().err}"
        printed = capsys.readouterr().out
        assert not traced or bool(printed) != ("-q" in command.split())
        if target:
            Path(target).write_text(printed, encoding="utf-8")
