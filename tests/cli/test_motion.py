"""`lidarscene render` with frames, rigs and deskewing: every file there, what is in it, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.command_line import BEAMS, COARSE, WALL, Run
from helpers.walls import LEFT_AND_RIGHT

from lidarscene.cloud.point_cloud import PointCloud

DRIVE = "[ego]\nspeed_m_s = 20\n" + WALL + "[bodies.motion]\nvelocity_m_s = [-10, 0, 0]\n"
FRAME_S = BEAMS / 50e3  # of the coarse raster


@pytest.fixture
def drive(tmp_path: Path) -> str:
    """A wall at 10 m that comes nearer, and a vehicle that drives towards it."""
    (tmp_path / "drive.toml").write_text(DRIVE)
    (tmp_path / "two.toml").write_text(LEFT_AND_RIGHT)
    return "drive.toml"


def files_of(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()} - {"drive.toml", "two.toml"}


def render_as_json(run: Run, *typed: str) -> dict:
    """What the command counts; each argument is of one word or more."""
    rendered = run("render", *" ".join(typed).split(), *COARSE, "--json")
    assert (rendered.code, rendered.err) == (0, ""), rendered
    return json.loads(rendered.out)


def test_frames_in_a_folder(mi, run: Run, small_pictures: None, drive: str, tmp_path: Path) -> None:
    """Frame after frame, each with its picture and its missed pulses; the wall comes at 30 m/s."""
    counts_of_run = render_as_json(
        run, drive, "-o new/out --frames 3 --begin 0.1 --coordinates vehicle --keep-missed m/x.npz --picture", "m/p.png"
    )
    numbers = ("0000", "0001", "0002")
    assert files_of(tmp_path) == {
        name for n in numbers for name in (f"new/out/frame_{n}.ply", f"m/x_{n}.npz", f"m/p_{n}.png")
    }
    assert counts_of_run["beams"] == 3 * BEAMS
    assert [frame["beams"] for frame in counts_of_run["frames"]] == [BEAMS] * 3
    assert [frame["output"] for frame in counts_of_run["frames"]] == [f"new/out/frame_{n}.ply" for n in numbers]
    assert counts_of_run["points"] == sum(frame["points"] for frame in counts_of_run["frames"])
    for number in range(3):
        cloud = PointCloud.load(f"new/out/frame_{number:04d}.ply")
        assert cloud.metadata["frame"] == "vehicle"
        assert float(cloud.metadata["frame_start_s"]) == pytest.approx(0.1 + number * FRAME_S, abs=1e-12)
        assert 0.0 <= cloud.time_s.min() < cloud.time_s.max() < FRAME_S
        cos_ahead = np.cos(cloud.elevation_rad) * np.cos(cloud.azimuth_rad)
        wall_m = 10.0 - 30.0 * (0.1 + number * FRAME_S + cloud.time_s)
        echo = cloud.status == 0
        np.testing.assert_allclose((cloud.true_range_m * cos_ahead)[echo], wall_m[echo], atol=1e-4)
        missed = np.load(f"m/x_{number:04d}.npz")
        assert len(missed["pulse"]) == BEAMS - counts_of_run["frames"][number]["echoes"]
        assert missed["pulse"].min() // BEAMS == missed["pulse"].max() // BEAMS == number
        # Times since the start of the frame, as in the clouds.
        np.testing.assert_allclose(missed["time_s"], missed["pulse"] % BEAMS / 50e3, atol=1e-12)


def test_deskewed_beside_raw(mi, run: Run, drive: str, tmp_path: Path) -> None:
    """The one file and its twin. Raw points lie where they were seen from the start; deskewed ones in the world."""
    counts_of_run = render_as_json(run, drive, "-o", "a.ply", "--deskew", "--ascii")
    assert files_of(tmp_path) == {"a.ply", "a.deskewed.ply"}
    assert counts_of_run["deskewed"] == "a.deskewed.ply"
    raw, deskewed = PointCloud.load("a.ply"), PointCloud.load("a.deskewed.ply")
    np.testing.assert_allclose(deskewed.xyz_m - raw.xyz_m, raw.time_s[:, None] * [20.0, 0.0, 0.0], atol=1e-5)
    assert (raw.metadata["ego_motion"], deskewed.metadata["ego_motion"]) == ("in the points", "removed")


def test_one_frame_is_the_first_of_many(mi, run: Run, drive: str) -> None:
    render_as_json(run, drive, "-o", "one.ply", "--seed", "5")
    render_as_json(run, drive, "-o", "many", "--frames", "1", "--seed", "5")
    single, first = PointCloud.load("one.ply"), PointCloud.load("many/frame_0000.ply")
    np.testing.assert_array_equal(single.xyz_m, first.xyz_m)


def test_a_rig_one_cloud_each(mi, run: Run, small_pictures: None, drive: str, tmp_path: Path) -> None:
    counts_of_run = render_as_json(
        run,
        drive,
        "--rig two.toml -o out --set right:laser.peak_power_w=50 --picture p.png --keep-missed m.npz",
        "--deskew",
    )
    assert files_of(tmp_path) == {
        f"{name}"
        for label in ("left", "right")
        for name in (f"out/{label}.ply", f"out/{label}.deskewed.ply", f"p_{label}.png", f"m_{label}.npz")
    }
    assert counts_of_run["beams"] == 2 * BEAMS
    left, right = (PointCloud.load(f"out/{label}.ply") for label in ("left", "right"))
    np.testing.assert_allclose(
        [left.sensor_position_m, right.sensor_position_m], [[0, 1, 1.8], [0, -1, 1.8]], atol=1e-12
    )
    assert left.metadata["sensor"] == "table1-apd"
    assert right.metadata["sensor"] == "table1-sipm"


def test_a_rig_merged_in_several_frames(mi, run: Run, small_pictures: None, drive: str, tmp_path: Path) -> None:
    """One cloud a frame, whose `sensor_index` and `sensor_names` tell them apart; --no-truth keeps them."""
    counts_of_run = render_as_json(
        run, drive, "--rig two.toml --merge -o out --frames 2 --picture p.svg --deskew --no-truth"
    )
    assert files_of(tmp_path) == {
        name for n in ("0000", "0001") for name in (f"out/frame_{n}.ply", f"out/frame_{n}.deskewed.ply", f"p_{n}.svg")
    }
    assert [frame["beams"] for frame in counts_of_run["frames"]] == [2 * BEAMS] * 2
    for name in ("frame_0001.ply", "frame_0001.deskewed.ply"):
        cloud = PointCloud.load(f"out/{name}")
        assert cloud.sensor_names == ("left", "right")
        assert set(np.unique(cloud.sensor_index)) == {0, 1}
        assert not cloud.has_truth
    render_as_json(run, drive, "--rig", "two.toml", "--merge", "-o", "one.ply", "--pose", "0,0,1")
    assert PointCloud.load("one.ply").sensor_position_m.tolist() == [0, 1, 2.8]


def test_text_of_many(mi, run: Run, drive: str) -> None:
    printed = run("render", drive, "-o", "out", "--frames", "2", *COARSE)
    assert printed.out.splitlines()[1] == f"beams         {2 * BEAMS:>12,}"
    assert printed.out.endswith("wrote         2 clouds in out\n")
    beside = ("--labels", "semantickitti", "--poses", "way.tum", "--picture", "look.png")
    printed = run("render", drive, "-o", "out", "--frames", "2", *COARSE, *beside)
    assert printed.out.endswith("wrote         2 clouds in out, 2 .label in out, 2 .png in ., way.tum\n")


def test_the_view_rides_with_the_vehicle(
    mi, run: Run, drive: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """[picture] is in the vehicle's frame: in the world it is where the vehicle is when the frame begins."""
    from lidarscene.figures import pictures

    options_of_pictures: list[dict] = []
    monkeypatch.setattr(pictures, "frame_picture", lambda cloud, path, **options: options_of_pictures.append(options))
    (tmp_path / "drive.toml").write_text(
        "[picture]\neye_m = [-5, 0, 3]\ntarget_m = [10, 0, 0]\n"
        + DRIVE.replace("speed_m_s = 20", "yaw_deg = 90\nspeed_m_s = 20", 1)
    )
    for frame, eye in (("world", (0, -3, 3)), ("vehicle", (-5, 0, 3)), ("sensor", None)):
        render_as_json(run, drive, "-o", "a.ply", "--coordinates", frame, "--begin", "0.1", "--picture", "p.png")
        picture_options = options_of_pictures.pop()
        assert picture_options["colour_by"] == "intensity"
        assert (picture_options["view"] is None) == (eye is None)
        np.testing.assert_allclose(picture_options["view"].eye_m, eye, atol=1e-12) if eye else None
    render_as_json(run, drive, "--rig", "two.toml", "--merge", "-o", "a.ply", "--picture", "p.png")
    assert options_of_pictures[0]["colour_by"] == "sensor_index"
    np.testing.assert_allclose(options_of_pictures[0]["view"].eye_m, (0, -5, 3), atol=1e-12)
