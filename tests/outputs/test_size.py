"""What a run of very many pulses will take is said before it begins, and how far it is, also in a log."""

import re
import warnings
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from helpers.command_line import COARSE, Run
from helpers.in_this_process import draw_nothing
from helpers.paper_results import results, use
from helpers.run_seed import chosen

from lidarscene.cli import render, terminal
from lidarscene.cli.terminal import Lines
from lidarscene.kernel.device.backend import is_cuda
from lidarscene.outputs.output_options import Outputs
from lidarscene.outputs.plan import Plan
from lidarscene.outputs.size import duration_text, warn_of_size
from lidarscene.rendering.render_options import TraceOptions

FINE = [
    "--set=scanner.azimuth_fov_deg=40",
    "--set=scanner.azimuth_step_deg=0.002",
    "--set=scanner.elevation_fov_deg=20",
    "--set=scanner.elevation_step_deg=0.002",
]
BEAMS = 20001 * 10001


@pytest.mark.parametrize(
    ("options", "disk", "memory"),
    [
        (["-o", "new/o.ply"], 1, 0.524),
        (["-o", "new/o.ply", "--ascii"], 3, 0.524),
        (["-o", "new/o.ply", "--frames", "2"], 0, 0.0),
        (["-o", "new/o.npz"], 1, None),
    ],
)
def test_it_is_said_before_anything_is_traced(run, wall, mi, monkeypatch, options, disk, memory):
    """Computed by hand: 200 million beams of one stop at 117 bytes, in 40 s. A run that is refused says nothing."""
    monkeypatch.setattr("lidarscene.outputs.record.FrameFiles.write", lambda *_: None)
    ran = run("render", wall, "--sensor=table1-apd", *options, *FINE)
    if not disk:
        assert ran.code == 2
        assert "note" not in ran.err
        return
    (line,) = ran.err.splitlines()
    of_point = _bytes_of_a_point()
    assert line.startswith(f"lidarscene: note: --output {options[1]}: {BEAMS:,} pulses take some 40 s")
    assert f", up to {disk * BEAMS * of_point / 1e9:.3g} GB of disk (" in line
    chunk = 2 if is_cuda() else 1  # times 2^20 pulses
    needed = 0.524288 * chunk + (2 * BEAMS * of_point / 1e9 if memory is None else 0.0)
    assert line.endswith(f" and up to {needed:.3g} GB of memory")


def _bytes_of_a_point() -> int:
    from lidarscene.formats.ply import _dtype

    return _dtype(has_truth=True, has_vectors=False, double=False).itemsize


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.4, "0 s"), (99, "99 s"), (125, "2 min"), (5999, "100 min"), (7200, "2 h"), (1e6, "12 days")],
)
def test_times_in_words(seconds: float, words: str) -> None:
    assert duration_text(seconds) == words


def test_lines_in_a_log(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Rationale: a run of a night shows that it lives, and its log stays short."""
    clock_s = [0.0]
    lines = Lines("pulses", clock=lambda: clock_s[0])
    for second in range(8 * 3600):
        clock_s[0] = float(second)
        lines(second, 8 * 3600)
    log_lines = capsys.readouterr().err.splitlines()
    assert log_lines[0] == "lidarscene: 10 of 28,800 pulses (0.0%), some 8 h left"
    assert 60 < len(log_lines) < 120
    lines(28_800, 28_800)
    assert capsys.readouterr().err == ""


def test_the_time_left_does_not_count_the_first_step(capsys: pytest.CaptureFixture[str]) -> None:
    """Computed by hand: a frame that waits 40 s for the compiler, then one each second, of 101."""
    clock_s = [0.0]
    lines = Lines("frames", clock=lambda: clock_s[0])
    for frame in range(1, 30):
        clock_s[0] = 39.0 + frame
        lines(frame, 101)
    first, second = capsys.readouterr().err.splitlines()
    assert first == "lidarscene: 1 of 101 frames (1.0%)"
    assert second == "lidarscene: 11 of 101 frames (10.9%), some 90 s left"


def test_a_bar_on_a_terminal_alone(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """It is there while the block lasts and told of each step; a log has none, and lines only if asked for."""
    steps: list[Any] = []

    @contextmanager
    def bar(label, total):
        steps.append((label, total))
        yield lambda finished, _: steps.append(finished)
        steps.append("gone")

    monkeypatch.setattr(terminal, "_bar", bar)
    with terminal.progress("steps") as report:
        report(0, 3)
        report(3, 3)
    assert steps == []
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    with terminal.progress("steps") as report:
        for step in range(3):
            report(step, 3)
    assert steps == [("steps", 3), 0, 1, 2, "gone"]
    with terminal.progress("pulses", after_s=1e6) as report:
        report(1, 3)
    assert len(steps) == 5
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("command", chosen(1, ["compare", "fov", "paper", "render"]))
def test_long_commands_tell_how_far_they_are(command, run, wall, mi, monkeypatch, tmp_path):
    """A bar shows it from the first step to the last, on a terminal."""
    draw_nothing(monkeypatch)
    if command == "paper":
        use(monkeypatch, results())
    reports: list[tuple[int, int]] = []

    @contextmanager
    def bar(label, total):
        yield lambda steps_done, _: reports.append((steps_done, total))

    monkeypatch.setattr(terminal, "_bar", bar)
    monkeypatch.setattr(render, "PATIENCE_S", 0.0)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    small = ("--time", "0.001,0.01", "--cell", "2")
    options: dict[str, tuple[str, ...]] = {
        "compare": (wall, "--sensors", "table1-apd,table1-sipm", *COARSE),
        "fov": ("table1-apd", *small, *COARSE),
        "paper": (),
        "render": (wall, "--frames", "2", *COARSE),
    }
    assert run(command, *options[command], "-o", "out").code == 0
    steps_done, total = zip(*reports, strict=True)
    assert len(set(total)) == 1
    assert list(steps_done) == sorted(steps_done)
    assert steps_done[-1] >= total[0] - 1
    assert len(steps_done) >= 2


def test_a_short_run_has_no_lines(run: Run, wall: str, mi: Any) -> None:
    ran = run("render", wall, "-o", "o.ply", "--sensor=table1-apd", "--set=scanner.azimuth_step_deg=1")
    assert (ran.code, ran.err) == (0, "")


def size_warning(*, frames=None, pulses=10**8, stops=1, rays=1, **outputs):
    """The note about a sensor of so many pulses and one of a quarter of them; "" if there is none."""
    sensor = SimpleNamespace(scanner=SimpleNamespace(pulses=pulses), tdc=SimpleNamespace(stops=stops))
    small = SimpleNamespace(scanner=SimpleNamespace(pulses=pulses // 4), tdc=SimpleNamespace(stops=stops))
    plan = Plan(Outputs("o", format="npz", **outputs), frames, rig=True)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mounted: Any = [SimpleNamespace(sensor=sensor_of_two) for sensor_of_two in (sensor, small)]
        warn_of_size(plan, mounted, TraceOptions(rays=rays), chunk=0)
    return str(caught[0].message) if caught else ""


def numbers_of(warning_text: str) -> tuple[str, float, float]:
    """Time, disk and memory [GB]."""
    words = re.search(
        r"take some (\d+ \w+) .*, up to ([\d.]+) GB of disk .* up to ([\d.e+]+) GB of memory", warning_text
    )
    assert words is not None, warning_text
    return words[1], float(words[2]), float(words[3])


def test_what_makes_a_run_larger() -> None:
    """Computed by hand: 125 million pulses at 5 million rays a second; of an NPZ the larger cloud is in memory
    twice.
    """
    of_point = _bytes_of_a_point()
    assert numbers_of(size_warning()) == (
        "25 s",
        pytest.approx(0.125 * of_point, rel=0.01),
        pytest.approx(0.2 * of_point, rel=0.01),
    )
    plain = numbers_of(size_warning())
    for options, longer, disk, memory in (
        ({"rays": 4}, "100 s", 1, 1),
        ({"stops": 3}, "25 s", 3, 3),
        ({"deskew": True}, "25 s", 2, 1),
        ({"merge": True}, "25 s", 1, 1.25),
        ({"frames": 2}, "50 s", 2, 1),
    ):
        numbers = numbers_of(size_warning(**options))
        assert numbers[0] == longer.replace("100 s", "2 min"), options
        assert numbers[1] == pytest.approx(disk * plain[1], rel=0.01), options
        assert numbers[2] == pytest.approx(memory * plain[2], rel=0.01), options


def test_from_a_hundred_million_pulses_on() -> None:
    assert size_warning(pulses=80_000_000) != ""
    assert size_warning(pulses=79_999_996) == ""
