"""`render` in every format, with labels, range images and data sets; mistakes before anything is traced."""

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import BEAMS, COARSE, Run

from lidarscene import load_sensor
from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.errors import LidarSceneError, OptionWarning
from lidarscene.formats.registry import FORMATS, LABELS
from lidarscene.outputs.plan import _tell_of_later_frames

pytestmark = pytest.mark.usefixtures("mi")


def test_every_format_by_its_name(run: Run, wall: str, tmp_path: Path) -> None:
    """The same points in each that can be read again."""
    for name, format_of_file in FORMATS.items():
        try:
            format_of_file.require()
        except LidarSceneError:
            continue
        printed = run.well("render", wall, "-o", f"a{format_of_file.suffix}", "--format", name, *COARSE)
        assert f"a{format_of_file.suffix}" in printed
        if format_of_file.read:
            cloud = PointCloud.load(tmp_path / f"a{format_of_file.suffix}", format=name)
            assert len(cloud) > 20
            assert set(cloud.column("body").tolist()) <= {0, -1}


def test_the_name_of_the_file_chooses(run: Run, wall: str, tmp_path: Path) -> None:
    assert run("render", wall, "-o", "a.pcd", "--ascii", *COARSE).code == 0
    assert b"\nDATA ascii\n" in (tmp_path / "a.pcd").read_bytes()
    assert run("render", wall, "-o", "a.pcd.bin", *COARSE).code == 0
    assert run("render", wall, "-o", "a.bin", *COARSE).code == 0
    five = np.fromfile(tmp_path / "a.pcd.bin", np.float32).reshape(-1, 5)
    four = np.fromfile(tmp_path / "a.bin", np.float32).reshape(-1, 4)
    np.testing.assert_array_equal(five[:, :4], four)
    assert np.median(four[:, 0]) == pytest.approx(10.0, abs=0.5)


@pytest.mark.parametrize("name", LABELS)
def test_labels_beside_the_cloud(run: Run, wall: str, tmp_path: Path, name: str) -> None:
    """Also where the cloud itself goes without truth."""
    ran = run("render", wall, "-o", "o/a.npz", "--labels", name, "--no-truth", "--json", *COARSE)
    assert ran.code == 0, ran.err
    written = [Path(f) for key, f in json.loads(ran.out).items() if key.startswith("output")]
    assert sorted(p.name for p in (tmp_path / "o").iterdir()) == sorted(p.name for p in written)
    assert [p.name for p in written[1:]] == [f"a{suffix}" for suffix in LABELS[name]]
    assert not PointCloud.load(tmp_path / "o" / "a.npz").has_truth


def test_labels_of_frames_and_of_deskewed_clouds(run: Run, wall: str, tmp_path: Path) -> None:
    ran = run(
        "render", wall, "-o", "d", "--frames", "2", "--format", "npz", "--labels", "nuscenes", "--deskew", *COARSE
    )
    assert ran.code == 0, ran.err
    stems = [f"frame_000{i}{kind}" for i in (0, 1) for kind in ("", ".deskewed")]
    expected = [stem + end for stem in stems for end in (".npz", ".boxes.json")]
    assert sorted(p.name for p in (tmp_path / "d").iterdir()) == sorted(expected)
    ran = run("render", wall, "-o", "d", "--frames", "1", "--format", "npz", *COARSE)
    assert (ran.code, ran.err.count("holds frame_0001.deskewed.npz of an earlier run")) == (0, 1), ran.err


def test_frames_of_an_earlier_run_come_later_by_number(tmp_path: Path) -> None:
    """Rationale: by name frame_10000 comes before frame_9999."""
    paths = [tmp_path / f"frame_{number}.npz" for number in (9999, 10000)]
    paths[1].touch()
    with pytest.warns(OptionWarning, match=r"holds frame_10000\.npz of an earlier run.* frame_9999\.npz"):
        _tell_of_later_frames(paths[:1], refuse=False)
    with warnings.catch_warnings(action="error"):
        _tell_of_later_frames(paths, refuse=True)


def test_data_sets(run: Run, wall: str, tmp_path: Path) -> None:
    """The scene is a wall that is called a car, since walls have no boxes; with the poses of all frames beside it."""
    (tmp_path / wall).write_text((tmp_path / wall).read_text() + 'class = "car"\n')
    for name, folder in (("kitti", "training"), ("semantickitti", "dataset/sequences/00")):
        ran = run("render", wall, "-o", name, "--dataset", name, "--frames", "2", "--poses", f"{name}.tum", *COARSE)
        assert ran.code == 0, ran.err
        assert len((tmp_path / f"{name}.tum").read_text().splitlines()) == 2
        assert sorted(p.name for p in (tmp_path / name / folder / "velodyne").iterdir()) == ["000000.bin", "000001.bin"]
    assert len((tmp_path / "kitti/training/label_2/000001.txt").read_text().split()) == 15
    assert len((tmp_path / "semantickitti/dataset/poses/00.txt").read_text().splitlines()) == 2


def test_range_image(run: Run, wall: str, tmp_path: Path) -> None:
    finer = ("--set=scanner.azimuth_step_deg=0.25", *(o for o in COARSE if "azimuth_step" not in o))
    run.well("render", wall, "-o", "a.npz", "--range-image", "r.npz", *finer)
    with np.load(tmp_path / "r.npz") as archive:
        echo_ranges = archive["range"][archive["point"] >= 0]
        assert len(echo_ranges) == len(PointCloud.load(tmp_path / "a.npz"))


def test_a_missing_package_is_told_before_the_work(
    run: Run, wall: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "laspy", None)
    ran = run("render", wall, "-o", "a.las", *COARSE)
    assert ran.code == 1
    assert "try: pip install 'lidarscene[las]', or pip install laspy lazrs" in ran.err
    assert sorted(p.name for p in tmp_path.iterdir()) == [wall]


@pytest.mark.parametrize(("output", "epoch"), [("drive.mcap", None), ("drive.db3", "2025-03-04"), ("drive", None)])
def test_frames_in_one_bag(run: Run, wall: str, tmp_path: Path, library: Any, output: str, epoch: str | None) -> None:
    """Read by rosbags: a message for each frame, stamped when the frame begins; the points are those of a folder.

    With the stamp, the times of the points are when their pulses left. `rosbag2` is a folder with `metadata.yaml`.
    """
    highlevel, typesys = library("rosbags.highlevel"), library("rosbags.typesys")
    options = ("--frames", "3", "--begin", "0.05", *COARSE)
    chosen = (*(("--epoch", epoch) if epoch else ()), *(() if "." in output else ("--format", "rosbag2")))
    printed = run.well("render", wall, "-o", output, *chosen, *options)
    assert printed.splitlines()[-1] == f"wrote         3 frames in {output}"
    assert run("render", wall, "-o", "apart", *options).code == 0
    clouds = [PointCloud.load(tmp_path / "apart" / f"frame_000{n}.ply") for n in range(3)]
    assert (tmp_path / output / "metadata.yaml").is_file() == (output != "drive.mcap")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    with highlevel.AnyReader([tmp_path / output], default_typestore=store) as bag:
        received = [
            (stamp, bag.deserialize(raw, connection.msgtype))
            for connection, stamp, raw in bag.messages()
            if connection.topic == "/points"
        ]
    assert len(received) == 3
    begin_ns = 10**9 * (1_741_046_400 if epoch else 1_767_225_600)  # by `date -u -d 2025-03-04 +%s`, and of 2026-01-01
    for (stamp_ns, message), cloud in zip(received, clouds, strict=True):
        assert stamp_ns == message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        assert stamp_ns - begin_ns == pytest.approx(1e9 * cloud.frame_start_s, abs=1.0)
        offsets = {field.name: field.offset for field in message.fields}
        rows = np.asarray(message.data).reshape(len(cloud), -1)

        def read(name: str, rows: Any = rows, offsets: Any = offsets) -> Any:
            return rows[:, offsets[name] : offsets[name] + 4].copy().view(np.float32)[:, 0]

        np.testing.assert_array_equal(read("time"), cloud.time_s.astype(np.float32))
        np.testing.assert_array_equal(read("x"), cloud.in_sensor_frame().xyz_m[:, 0])
    rate_hz = load_sensor("table1-apd").laser.repetition_rate_hz
    assert np.ptp([stamp for stamp, _ in received]) == pytest.approx(2e9 * BEAMS / rate_hz, abs=2.0)


def test_colours_on_the_command_line(run: Run, wall: str, tmp_path: Path) -> None:
    assert run("render", wall, "-o", "c.ply", "--colours", "range", *COARSE).code == 0
    assert b"property uchar red" in (tmp_path / "c.ply").read_bytes()
    error_text = run("render", wall, "-o", "c.ply", "--colours", "colour", *COARSE).err
    assert "--colours: must be one of x, y, z, range," in error_text
    assert "--colours: ply can have colours" in run("render", wall, "-o", "c.npz", "--colours", "range", *COARSE).err
    hidden = run("render", wall, "-o", "c.ply", "--colours", "class", "--no-truth", *COARSE).err
    assert "--colours: must be one of" in hidden


def test_the_vehicles_poses_come_a_hundred_times_a_second(run: Run, wall: str, tmp_path: Path, library: Any) -> None:
    """Poses between the starts of frames too, which are 26.8 ms apart, and at the end of the last.

    Reference: the scene's speed, 20 m/s along x.
    """
    (tmp_path / wall).write_text((tmp_path / wall).read_text() + "[ego]\nspeed_m_s = 20\n")
    rate = "--set=laser.repetition_rate_khz=8.616"  # 231 beams
    ran = run("render", wall, "-o", "a.mcap", "--frames", "2", "--topic", "top/x", "--frame-id", "top", *COARSE, rate)
    assert ran.code == 0, ran.err
    with library("rosbags.highlevel").AnyReader([tmp_path / "a.mcap"]) as bag:
        received = [(c.topic, bag.deserialize(raw, c.msgtype)) for c, _, raw in bag.messages()]
    transforms = [message.transforms[0] for topic, message in received if topic == "/tf"]
    stamps_s = np.array([(t.header.stamp.sec - 1_767_225_600) + 1e-9 * t.header.stamp.nanosec for t in transforms])
    frame_s = BEAMS / 8616
    expected = [frame * frame_s + 0.01 * step for frame in range(2) for step in range(3)] + [2 * frame_s]
    np.testing.assert_allclose(stamps_s, expected, atol=1e-8)
    x_m = [t.transform.translation.x for t in transforms]
    np.testing.assert_allclose(np.array(x_m) - x_m[0], 20.0 * stamps_s, atol=1e-6)
    assert {topic for topic, _ in received} == {"/top/x", "/tf", "/tf_static"}


def test_rays_of_every_pulse(run: Run, wall: str, tmp_path: Path) -> None:
    """Reference: the points and the missed pulses of the same run, which together are all pulses."""
    run.well("render", wall, "-o", "a.npz", "--keep-rays", "r.npz", "--keep-missed", "m.npz", *COARSE)
    with np.load(tmp_path / "r.npz") as rays, np.load(tmp_path / "m.npz") as missed:
        assert len(rays["pulse"]) == BEAMS
        np.testing.assert_array_equal(rays["outcome"][missed["pulse"]], missed["reason"])
        assert np.isfinite(rays["range"]).sum() == len(PointCloud.load(tmp_path / "a.npz"))
