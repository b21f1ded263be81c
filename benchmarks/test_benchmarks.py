"""`make bench-check`: `make bench` works end to end, in small, with every row there. How fast, no one asks."""

import os
import re
import runpy
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from helpers.waiting import PATIENCE_S

ROOT = Path(__file__).parents[1]
SENSORS = ("table1-apd", "table1-sipm")
SECTIONS = {
    "Seconds": [*SENSORS, "Mitsuba, bare"],
    "Times as fast": [
        *(f"{peer} / {task}" for peer in ("Open3D, bare", "Open3D", "Open3D with rays") for task in SENSORS),
        *(f"{task} / Mitsuba, bare" for task in ("Open3D", *SENSORS)),
    ],
    "Where the time goes": [
        f"{sensor}: {stage}"
        for sensor in SENSORS
        for stage in ("record", "trace", "collect", "assemble", "device, hits", "device, echoes", "device, returns")
    ],
    "Against bare Embree": [
        f"{scene}, 12k beams: lidarscene / bare Embree" for scene in ("car.toml", "2,000 triangles")
    ],
    "Receivers": [
        f"{receiver} / table1-apd"
        for receiver in (
            "Gaussian response",
            "single pole",
            "constant fraction",
            "peak",
            "matched filter",
            "histogram (os1-128)",
        )
    ],
    "Against other ray casters": [
        f"{scene}, 12k beams, 1 threads: {caster}"
        for scene in ("car.toml", "2,000 triangles")
        for caster in ("lidarscene", "Open3D", "trimesh + embreex", "mujoco-lidar")
    ],
    "Many rays to a pulse": [
        "rate of 16 rays a pulse / one",
        "trace of 16 rays to each pulse / of one",
        *(f"waveform / trace, {sampler}" for sampler in ("TDC", "multi-level TDC", "ADC", "TDC that keeps 16 returns")),
    ],
    "Motion": [
        "vehicle drives / still",
        "1 bodies move / still",
        "20 bodies move, out of the way / still",
        "tables of 3 motions",
    ],
    "From process start to a file": [
        "process start to end: render car.toml",
        "its time of the processor",
        *(f"of which: {step}" for step in ("interpreter", "import lidarscene", "read files", "write")),
    ],
    "A large frame": [
        "peak memory, car.toml to .ply",
        "peak memory, car.toml to .laz",
        "peak memory, car.toml to .ply with picture, labels, keep-missed",
        "peak memory, car.toml to a cloud in Python",
        "its time from start to end",
    ],
    "Two workers against one": ["1 worker", "2 workers", "efficiency of two"],
    "Labelled frames on a GPU": ["2 labelled frames, car, vlp-16"],
}


HALVES = (("chain", "bare", "receivers", "peers", "memory"), ("sensors", "motion", "rays", "start", "batch", "gpu"))
"""Parts that are run in one process, beside the others in another: both take some 20 s of a processor."""


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    """What --quick writes, which it also prints: of all parts, half of them at a time."""
    folder = tmp_path_factory.mktemp("bench")
    # Meshes are kept for this run alone: what an earlier one left must not decide a test.
    environment = os.environ | {"PYTHONPATH": str(ROOT / "src"), "LIDARSCENE_CACHE": str(folder / "meshes")}

    def run(parts: tuple[str, ...]) -> str:
        target = folder / parts[0] / "out" / "benchmarks.md"
        command = [sys.executable, str(ROOT / "benchmarks" / "run.py"), "--quick", "-o", str(target)]
        process = subprocess.run(
            [*command, "--only", *parts], env=environment, capture_output=True, text=True, timeout=PATIENCE_S
        )
        assert process.returncode == 0, process.stderr
        text = target.read_text(encoding="utf-8")
        assert process.stdout == text
        return text

    with ThreadPoolExecutor(len(HALVES)) as threads:
        return "\n".join(threads.map(run, HALVES))


def test_every_part_is_run() -> None:
    """A part that `make bench` has and this file forgets would be tried by no one."""
    listed = re.search(r"^PARTS = \((.*)\)$", (ROOT / "benchmarks" / "run.py").read_text("utf-8"), re.MULTILINE)
    assert listed is not None
    assert sorted(re.findall(r'"(\w+)"', listed[1])) == sorted(part for half in HALVES for part in half)


@pytest.mark.parametrize("title", SECTIONS)
def test_every_row_is_there_with_a_figure(page: str, title: str) -> None:
    section = page.split(f"## {title}\n")[1].split("\n## ")[0]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in section.splitlines() if line[:1] == "|"]
    assert rows[0] == ["what", "median", "lowest to highest", "note", "goal"]
    assert all(len(row) == 5 for row in rows)
    figures = {row[0]: row[1] for row in rows[2:]}
    assert set(SECTIONS[title]) <= set(figures)
    assert all(figures.values())


def test_every_sensor_has_a_row(page: str) -> None:
    """One sensor's in small: the ratios are numbers, those to Open3D where there is one."""
    section = page.split("## Every sensor\n")[1].split("\n## ")[0]
    head, _, *rows = (
        [cell.strip() for cell in line.split("|")[1:-1]] for line in section.splitlines() if line[:1] == "|"
    )
    assert [row[0] for row in rows] == ["vlp-16"]
    assert head[3:6] == ["first surface / bare", "default / bare", "default / bare through glass"]
    assert all(cell == "-" or float(cell) > 0.0 for cell in rows[0][2:])


def test_the_gpu_part_runs_on_a_cpu(page: str) -> None:
    """All figures of a sensor; those of Warp where it is installed."""
    head, _, row = (
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in page.split("## A GPU\n")[1].split("\n## ")[0].splitlines()
        if line[:1] == "|"
    )
    figures = dict(zip(head, row, strict=True))
    assert figures.pop("scene, sensor") == "car, vlp-16"
    assert figures.pop("beams") == "28,928"
    if find_spec("warp") is None:
        assert figures.pop("Warp, ms") == "-"
    assert all(float(figure) > 0.0 for figure in figures.values())


def test_the_machine_is_described_and_quick_runs_judge_nothing(page: str) -> None:
    head = page.split("\n## ")[0]
    assert all(word in head for word in ("say nothing about speed", "CPU:", "GiB", "Python", "mitsuba 3."))
    assert "met |" not in page


def test_a_segmenter_learns_from_generated_frames() -> None:
    """`segmentation.py` in small. Ground is known again on held-out frames and on the recorded one: a guess of one
    class for all would have an IoU below 0.6, the share of ground.
    """
    command = [sys.executable, str(ROOT / "benchmarks" / "segmentation.py"), "--frames", "2", "--held-out", "1"]
    environment = os.environ | {"PYTHONPATH": str(ROOT / "src")}
    process = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=PATIENCE_S)
    assert process.returncode == 0, process.stderr
    rows = [re.split(r"\s{2,}", line) for line in process.stdout.splitlines()[4:10]]
    assert [row[:2] for row in rows] == [
        [learned, judged]
        for learned in ("as the sensor reports", "without noise")
        for judged in ("held-out frames", "the same without noise", "recorded frame")
    ]
    assert all(0.8 < float(row[3]) <= 1.0 for row in rows), process.stdout


def test_a_detector_learns_from_generated_frames(tmp_path: Path) -> None:
    """`detection.py` in small. Its readers of KITTI and of Argoverse 2 find the same objects in a frame that we write
    for both.
    """
    feather = pytest.importorskip("pyarrow.feather")
    import pyarrow

    environment = os.environ | {"PYTHONPATH": f"{ROOT / 'src'}:{ROOT / 'benchmarks'}"}
    place = ["--all-around", "--no-own-car"]
    write = [sys.executable, "-m", "lidarscene", "render", "car", "--sensor", "hdl-64e", "--dataset", "kitti", *place]
    subprocess.run([*write, "-o", str(tmp_path / "set"), "-q"], env=environment, check=True, timeout=PATIENCE_S)
    (tmp_path / "set/training").rename(tmp_path / "kitti")
    sys.path.insert(0, str(ROOT / "benchmarks"))
    import detection

    ((points, objects),) = detection.kitti_frames(tmp_path / "kitti")
    log = tmp_path / "av2/log"
    log.mkdir(parents=True)
    rows = {
        "timestamp_ns": [1] * len(objects.classes),
        "category": [("SIGN", "REGULAR_VEHICLE", "PEDESTRIAN")[number] for number in objects.classes],
        **dict(zip(("length_m", "width_m", "height_m"), objects.sizes_m.T, strict=True)),
        **dict(zip(("tx_m", "ty_m", "tz_m"), np.array([pose.position_m for pose in objects.poses]).T, strict=True)),
    }
    yaw = np.array([np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0]) for pose in objects.poses])
    rows |= {"qw": np.cos(0.5 * yaw), "qz": np.sin(0.5 * yaw)}
    feather.write_feather(pyarrow.table(rows), log / "annotations.feather")
    feather.write_feather(pyarrow.table(dict(zip("xyz", points.T, strict=True))), log / "1.feather")
    command = [sys.executable, str(ROOT / "benchmarks" / "detection.py"), "--frames", "2", "--held-out", "1"]
    process = subprocess.run(
        [*command, "--real", str(tmp_path)], env=environment, capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert process.returncode == 0, process.stderr
    lines = process.stdout.splitlines()
    assert lines[2].split(";")[1:] == lines[3].split(";")[1:] != []
    assert re.search(r"car: [1-9]\d*, a cluster on [1-9]", lines[2])
    rows_of = [re.split(r"\s{2,}", line) for line in lines[6:15]]
    assert [row[1] for row in rows_of] == ["held-out towns", "KITTI", "Argoverse 2"] * 3
    # One car alone, in two frames, need not teach what a car is.
    assert all(float(row[2].split()[0]) > 0.5 for row in rows_of[:6] if row[1] == "held-out towns"), process.stdout
    assert all(kitti[2:] == av2[2:] for kitti, av2 in zip(rows_of[1::3], rows_of[2::3], strict=True))


def test_range_images_beside_those_of_kitti_have_points_in_their_pixels() -> None:
    """Pixels by hand: 5 and 20 m ahead in the lowest row, where the nearer hides the farther, and 10 m to the left."""
    tool = runpy.run_path(str(ROOT / "benchmarks" / "beside_kitti.py"))
    low, aside = np.radians([-24.33, 30.0])
    ahead = np.array([np.cos(low), 0.0, np.sin(low)])
    left = np.array([np.cos(low) * np.cos(aside), np.cos(low) * np.sin(aside), np.sin(low)])
    range_image, intensity = tool["strips_of"](np.c_[[5.0 * ahead, 20.0 * ahead, 10.0 * left], [0.2, 0.9, 0.4]])
    assert range_image.shape == intensity.shape == (3 * 64 + 6, round(2 * tool["HALF_DEG"] / tool["COLUMN_DEG"]))
    near, far = np.log(tool["RANGES_M"])
    for degrees, range_m in ((0.0, 5.0), (30.0, 10.0)):
        column = round((tool["HALF_DEG"] - degrees) / tool["COLUMN_DEG"])
        grey = 20 + 235 * (np.log(range_m) - near) / (far - near)
        assert abs(int(range_image[3 * 63, column - 1 : column + 1].max()) - grey) < 1.5
    assert not range_image[: 3 * 63].any()


def test_a_recording_and_its_simulation_are_told_apart() -> None:
    """`told_apart.py` on the recording of the package: each group is between chance and certainty, with its error."""
    pytest.importorskip("ouster.sdk")
    command = [sys.executable, str(ROOT / "benchmarks" / "told_apart.py")]
    environment = os.environ | {"PYTHONPATH": str(ROOT / "src")}
    process = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=PATIENCE_S)
    assert process.returncode == 0, process.stderr
    head, row = (re.split(r"\s{2,}", line) for line in process.stdout.splitlines())
    assert head[:7] == ["recording", "recorded twice", "all", "range texture", "holes", "edges", "intensity"]
    control, *accuracies = map(float, row[1:7])
    assert abs(control - 0.5) < 0.15  # 96 patches of each side, with an error of 0.04
    assert all(0.3 < accuracy <= 1.0 for accuracy in accuracies)
    assert row[7].startswith("+/- 0.0")
