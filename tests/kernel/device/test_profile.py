"""What --profile counts: kernels by Dr.Jit's history, memory by the system."""

import json
from pathlib import Path
from typing import Any

import pytest
from helpers.child import assert_ended
from helpers.walls import WALL

from lidarscene import load_scene
from lidarscene.cli import main
from lidarscene.kernel.device.profile import KernelHistory, kernel_history

COARSE = ("--set=scanner.azimuth_step_deg=2", "--set=scanner.elevation_step_deg=2")


def test_launched_and_compiled(mi: Any) -> None:
    """Three launches of one kernel with numbers that no other test has: written once at most, used thrice."""
    import drjit as dr

    with kernel_history() as history:
        for first in range(3):
            x = dr.arange(mi.Float, 1000) + dr.opaque(mi.Float, float(first))
            dr.eval(dr.sin(x * 1.2345678) * dr.cos(x * 8.7654321))
        history.take()
        assert history.launched == 3
        assert history.compiled + history.from_disk <= 1
        before = history.launched
        history.take()
        assert history.launched == before  # nothing is counted twice
        assert history.device_s > 0.0
    assert not dr.flag(dr.JitFlag.KernelHistory)


def test_peak_memory_is_that_of_the_largest_moment(run_python: Any) -> None:
    """Rationale: 512 MB written and given back still count; a bare Python with numpy holds less than 200 MB."""
    code = (
        "import numpy as np\nfrom lidarscene.kernel.device.profile import peak_memory_bytes as peak\n"
        "before = peak()\nheld = np.ones(2**26)\ndel held\nprint(before, peak())"
    )
    process = run_python(code)
    assert_ended(process, stderr=None)
    if "None" in process.stdout:
        pytest.skip("the system does not tell")
    before, after = map(int, process.stdout.split())
    assert 5e6 < before < 200e6
    assert 512 * 2**20 <= after - before + 50e6 < 512 * 2**20 + 100e6


def test_render_prints_it(mi, tmp_path, monkeypatch, capsys):
    """Later frames of the same process launch kernels, and need none that is new.

    A sequence has kernels of its own, since its frames go together: they are built once before. The text of a kernel
    has the alignment of the memory that it reads: a table that NumPy placed by chance is compiled again by chance.
    """
    monkeypatch.chdir(tmp_path)
    Path("wall.toml").write_text(WALL)

    def profile(*argv: str) -> dict[str, Any]:
        assert main.main(["render", "wall.toml", *COARSE, "--profile", "--json", *argv]) == 0
        report: dict[str, Any] = json.loads(capsys.readouterr().out)
        return report["profile"]

    profile("-o", "first.ply")
    profile("-o", "first", "--frames", "4")
    one_frame = profile("-o", "a.ply")
    four_frames = profile("-o", "a", "--frames", "4")
    assert four_frames["kernels"]["launched"] > one_frame["kernels"]["launched"] > 0
    for frames in (one_frame, four_frames):
        assert frames["kernels"]["compiled"] + frames["kernels"]["from_disk"] == 0
    assert four_frames["peak_memory_bytes"] is None or four_frames["peak_memory_bytes"] > 1e7
    assert main.main(["render", "wall.toml", *COARSE, "--profile", "-o", "b.ply"]) == 0
    text = capsys.readouterr().out.split("\nprofile\n")[1]
    assert [line.split()[0] for line in text.splitlines()][-3:] == ["kernels", "their", "peak"]
    assert text.count("%") == 6  # load, build, record, trace, collect, write: nothing is assembled


def test_texts_of_kernels_do_not_gather(mi, tmp_path, monkeypatch, capsys):
    """A frame of very many chunks would hold gigabytes of them: 41 chunks of 48 pulses, counted in three pieces."""
    monkeypatch.chdir(tmp_path)
    Path("wall.toml").write_text(WALL)
    take, lengths = KernelHistory.take, []

    def count_launches(history: KernelHistory) -> None:
        before = history.launched
        take(history)
        lengths.append(history.launched - before)

    monkeypatch.setattr(KernelHistory, "take", count_launches)
    steps = ("--set=scanner.azimuth_step_deg=2", "--set=scanner.elevation_step_deg=0.8")
    assert main.main(["render", "wall.toml", *steps, "--profile", "--json", "-o", "a.ply", "--chunk", "48"]) == 0
    report = json.loads(capsys.readouterr().out)
    chunks = -(-report["beams"] // 48)
    assert len(lengths) == chunks // 16 + 1 >= 3
    assert sum(lengths) == report["profile"]["kernels"]["launched"] >= chunks
    assert max(lengths) < 0.5 * sum(lengths)


def test_scene_set(mi: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command line sets what the file would say."""
    monkeypatch.chdir(tmp_path)
    Path("wall.toml").write_text(WALL)
    Path("near.toml").write_text('name = "wall"\n' + WALL.replace("[10, 0, 1.8]", "[8.5, 0, 1.8]"))
    moved = "bodies.wall.position_m=[8.5, 0, 1.8]"
    assert main.main(["render", "wall.toml", *COARSE, "-o", "a.ply", "--scene-set", moved]) == 0
    assert main.main(["render", "near.toml", *COARSE, "-o", "b.ply"]) == 0
    assert Path("a.ply").read_bytes() == Path("b.ply").read_bytes()
    assert load_scene("wall.toml", overrides=[moved]).bodies[0].pose.position_m.tolist() == [8.5, 0.0, 1.8]
