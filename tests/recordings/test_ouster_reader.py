"""Ouster: a packet of a real sensor, and OSF as the maker's own library writes it."""

import contextlib
import hashlib
import itertools
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.mistakes import told
from helpers.recordings import OUSTER
from helpers.run_seed import chosen

from lidarscene.errors import InputError
from lidarscene.files import in_child
from lidarscene.recordings.child_reader import open_in_child
from lidarscene.recordings.opening import open_recording
from lidarscene.recordings.ouster_reader import open_ouster
from lidarscene.recordings.pcap_reader import metadata_of
from lidarscene.recordings.units.unit_file import read_unit


@pytest.fixture(autouse=True)
def core(library: Callable[[str], Any]) -> Any:
    return library("ouster.sdk.core")


def test_one_packet_is_sixteen_columns(core: Any) -> None:
    with open_recording(OUSTER) as recording:
        assert (len(recording), recording.metadata["mode"]) == (1, "1024x10")
        sweep = recording[0]
    assert sweep.shape == (32, 1024)
    columns = np.flatnonzero(sweep.recorded.all(axis=0))
    assert len(columns) == 16
    assert sweep.recorded.sum() == 32 * 16
    assert not sweep.has_return[~sweep.recorded].any()
    np.testing.assert_array_equal(sweep.has_return | sweep.lost, sweep.recorded)
    assert sweep.time_s is not None
    # 1024 columns in 0.1 s; a real head's angle between two of them is off by up to 1.5 mdeg, 4 us.
    np.testing.assert_allclose(np.diff(sweep.time_s[0, columns]), 0.1 / 1024, atol=5e-6)
    for values in (sweep.signal, sweep.near_ir):
        assert values is not None
        assert np.isfinite(values[sweep.lost]).all()  # of lost pulses, too, the maker says what light there was
    assert sweep.second is not None
    assert np.isfinite(sweep.second.range_m[sweep.lost]).sum() == 0
    assert (sweep.pose, sweep.includes_lost) == (None, True)


@pytest.mark.parametrize("serial", [b"", bytes(8)], ids=["serial", "none"])
@pytest.mark.parametrize("flags", [b"\x40", b"\x20"], ids=["whole", "first_fragment"])
def test_two_sensors_without_serials_at_one_port_are_told(tmp_path: Path, serial: bytes, flags: bytes) -> None:
    """Rationale: ouster-sdk makes one cloud of both. The whole packet of another address, or its first fragment."""
    content = OUSTER.read_bytes()
    place = content.index(bytes([127, 0, 0, 1])) - 12
    first = bytearray(content[24:])
    payload = place + 28 - 24
    first[payload + 4 : payload + 4 + len(serial)] = serial
    other = first.copy()
    other[place + 15 - 24], other[place + 6 - 24 : place + 7 - 24] = 2, flags
    path = tmp_path / "two.pcap"
    path.write_bytes(content[:24] + first + other)
    with told("two.pcap | 7502 | 127.0.0.1, 127.0.0.2 | serials | src host") if serial else contextlib.nullcontext():
        open_recording(path, OUSTER.with_suffix(".json")).close_file()


def test_metadata_of_newer_tools_are_found_too(tmp_path: Path, core: Any) -> None:
    """NAME_0.json, for the first of several sensors."""
    path = Path(shutil.copy(OUSTER, tmp_path / "a.pcap"))
    shutil.copy(OUSTER.with_suffix(".json"), tmp_path / "a_0.json")
    with open_recording(path) as recording:
        assert recording[0].recorded.sum() == 32 * 16


def test_points_are_those_of_the_makers_table(core: Any) -> None:
    """Rationale: the recording's own beams, to 2 um: half a unit of float64 differences over a kilometre is less."""
    sdk_info = core.SensorInfo(OUSTER.with_suffix(".json").read_text())
    sweep = open_recording(OUSTER)[0]
    millimetres = np.rint(1e3 * np.nan_to_num(sweep.range_m)).astype(np.uint32)
    expected = np.asarray(core.XYZLut(sdk_info, use_extrinsics=False)(millimetres))
    np.testing.assert_allclose(sweep.xyz_m[sweep.has_return], expected[sweep.has_return], atol=2e-6)
    np.testing.assert_allclose(np.linalg.norm(sweep.direction, axis=-1), 1.0, atol=1e-9)


def osf(folder: Path, core: Any, library: Callable[[str], Any], frames: int = 2, sensors: int = 1) -> Path:
    """Frames of the real packet's sensor, with ranges and poses of ours.

    Args:
        sensors: number of such sensors; each has its own serial number, beams a degree higher and ranges 1 m longer
    """
    infos = [core.SensorInfo(OUSTER.with_suffix(".json").read_text()) for _ in range(sensors)]
    for index, info in enumerate(infos):
        info.sn += index
        info.beam_altitude_angles = np.asarray(info.beam_altitude_angles) + index
    path = folder / "a.osf"
    writer = library("ouster.sdk.osf").Writer(str(path), infos)
    for number, index in itertools.product(range(frames), range(sensors)):
        frame = core.LidarFrame(infos[index])
        frame.frame_id = number
        frame.status[:] = 1
        frame.timestamp[:] = 10**9 * (5 + number) + np.arange(1024) * 97_656
        frame.measurement_id[:] = np.arange(1024)
        frame.field("RANGE")[:] = 4000 + 1000 * index + number
        frame.field("RANGE")[7, 100] = 0
        frame.field("SIGNAL")[:] = 33
        poses = np.broadcast_to(np.eye(4), (1024, 4, 4)).copy()
        poses[:, 0, 3] = 10.0 * number
        frame.body_to_world[:] = poses
        writer.save(index, frame)
    writer.close()
    return path


def test_every_sensor_of_an_osf_is_in_reach_with_its_own_metadata(
    tmp_path: Path, core: Any, library: Callable[[str], Any]
) -> None:
    """Rationale: only the first sensor was read, and the metadata within the file by no command."""
    path = osf(tmp_path, core, library, frames=1, sensors=2)
    assert metadata_of(path, None) == path
    described = read_unit(OUSTER.with_suffix(".json"))
    for index in range(2):
        with open_recording(path, sensor_index=index) as recording:
            assert (len(recording), recording.metadata["serial"]) == (1, str(992137000142 + index))
            assert np.nanmax(recording[0].range_m) == 4.0 + index
        unit = read_unit(path, sensor_index=index)
        assert unit.name == f"OS-0-32-U1 {992137000142 + index}"
        assert (unit.model, unit.scanner) == (described.model, described.scanner)
        np.testing.assert_allclose(unit.lists["elevation_deg"], np.array(described.lists["elevation_deg"]) + index)
        for key in ("azimuth_offset_deg", "forward_mm", "height_mm"):
            np.testing.assert_allclose(unit.lists[key], described.lists[key])
    with told("a.osf | 0 | 1 | 2"):
        open_recording(path, sensor_index=2)
    with told("sensor_index 1 | OSF"):
        open_recording(OUSTER, sensor_index=1)


def test_a_field_of_zeros_is_not_recorded(tmp_path: Path, core: Any, library: Callable[[str], Any]) -> None:
    """Writers fill the fields of a profile that they lack with zeros: black surfaces and no light, taken as numbers."""
    with open_recording(osf(tmp_path, core, library, frames=1)) as recording:
        sweep = recording[0]
    assert (sweep.near_ir, sweep.reflectivity) == (None, None)
    assert sweep.signal is not None
    assert np.unique(sweep.signal).tolist() == [33.0]


def test_osf_frames_losses_and_poses(tmp_path: Path, core: Any, library: Callable[[str], Any]) -> None:
    path = osf(tmp_path, core, library)
    before = hashlib.sha256(path.read_bytes()).hexdigest()
    with open_recording(path) as recording:
        assert len(recording) == 2
        first, second = recording[0], recording[1]
    assert np.argwhere(first.lost).tolist() == [[7, 100]]
    assert np.nanmax(second.range_m) == 4.001
    assert (first.start_s, second.start_s) == (5.0, 6.0)
    assert first.pose is None
    assert second.pose is not None
    np.testing.assert_array_equal(second.pose.position_m, [10.0, 0.0, 0.0])
    assert hashlib.sha256(path.read_bytes()).hexdigest() == before  # recordings are read only


def test_a_damaged_osf_says_which_frame(tmp_path: Path, core: Any, library: Callable[[str], Any]) -> None:
    """Rationale: one wrong byte in the frames, and the sdk said 'Indexed past the end of the frame set source'."""
    path = osf(tmp_path, core, library)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(bytes(content))
    with open_recording(path) as recording, told("a.osf | frame 0 | damaged"):
        recording[0]


@pytest.mark.parametrize("spoilt", chosen(4, range(12)))
def test_a_spoilt_osf_is_damaged_and_never_a_crash(
    tmp_path: Path, core: Any, library: Callable[[str], Any], spoilt: int
) -> None:
    """Bytes of the header, the index and the frames at random places: frames, or one line, as the file allows.

    Rationale: ouster-sdk ends the process over one in six of them.
    """
    path, rng = osf(tmp_path, core, library), np.random.default_rng(spoilt)
    content = bytearray(path.read_bytes())
    first = 0 if spoilt % 2 else len(content) - 600  # the index is at the end
    for place in rng.integers(first, len(content), 8):
        content[place] = rng.integers(256)
    path.write_bytes(bytes(content))
    with contextlib.suppress(InputError), open_recording(path) as recording:
        for frame in range(len(recording)):
            recording[frame]


@pytest.mark.parametrize("way", ["crash", "hang"])
def test_a_reader_that_ends_or_waits_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, way: str) -> None:
    path = tmp_path / "a.osf"
    path.write_bytes(b"x")
    monkeypatch.setattr(in_child, "LEAST_S", 0.5)
    modules = {"crash": "import os; os.abort()", "hang": "import time; time.sleep(1000)"}
    (tmp_path / "sitecustomize.py").write_text(modules[way])
    monkeypatch.syspath_prepend(tmp_path)
    with told("a.osf | damaged"):
        open_in_child(open_ouster, path, None)


def test_an_osf_without_index_is_copied_first(
    tmp_path: Path, core: Any, library: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: ouster-sdk would write the index into the recording itself. It writes none without one, so one is said
    to be missing here.
    """
    path, sdk = osf(tmp_path, core, library), library("ouster.sdk")
    plain, opened = sdk.open_source, []

    class Bare:
        is_indexed = False
        sensor_info: tuple[Any, ...] = (None,)

        def __init__(self, file: str) -> None:
            assert file == str(path)

        def close(self) -> None:
            pass

    def open_source(file: str, **options: Any) -> Any:
        opened.append(Path(file))
        return plain(file, **options)

    monkeypatch.setattr(library("ouster.sdk.osf"), "OsfFrameSetSource", Bare)
    monkeypatch.setattr(sdk, "open_source", open_source)
    with open_ouster(path, None) as recording:
        assert len(recording) == 2
        (copy,) = opened
        assert copy != path
        assert copy.read_bytes() == path.read_bytes()
    assert not copy.exists()


def test_what_is_wrong_is_one_line(tmp_path: Path, core: Any, library: Callable[[str], Any]) -> None:
    path = tmp_path / "a.pcap"

    def check(named: str, content: bytes = OUSTER.read_bytes(), metadata: Path | None = None) -> None:
        path.write_bytes(content)
        with told(named):
            open_recording(path, metadata)

    check("a.pcap | Ouster | a.json")
    check("b.json | metadata file", metadata=tmp_path / "b.json")
    other_metadata = tmp_path / "other.json"
    other_metadata.write_text("{}")
    check("other.json", metadata=other_metadata)
    described = json.loads(OUSTER.with_suffix(".json").read_text())
    other_metadata.write_text(
        json.dumps(described | {"beam_altitude_angles": [0.0] * 16, "beam_azimuth_angles": [0.0] * 16})
    )
    check("other.json", metadata=other_metadata)
    shutil.copy(OUSTER.with_suffix(".json"), path.with_suffix(".json"))
    check(
        "a.pcap | damaged | packet 1 | 262144", OUSTER.read_bytes()[:32] + bytes(3) + b"\x7f" + OUSTER.read_bytes()[36:]
    )
    check("a.pcap | packets", OUSTER.read_bytes()[:24])


def test_what_is_of_packets_that_came(tmp_path: Path, core: Any, library: Callable[[str], Any]) -> None:
    """Nothing is taken of columns that were not received: neither stamp, nor pose, nor range; and a pose is of the
    body, on which the sensor sits turned and aside: first the sensor on the body, then the body in the world.
    """
    info = core.SensorInfo(OUSTER.with_suffix(".json").read_text())
    body = np.array([[0, -1, 0, 5.0], [1, 0, 0, 6.0], [0, 0, 1, 7.0], [0, 0, 0, 1]])
    mounted = np.array([[1, 0, 0, 0.5], [0, 0, -1, 0.0], [0, 1, 0, 0.25], [0, 0, 0, 1]])
    info.sensor_to_body = mounted
    frame = core.LidarFrame(info)
    frame.status[:] = 0
    frame.status[16:] = 1
    frame.timestamp[:] = 10**9 * 5 + np.arange(1024) * 97_656
    frame.timestamp[:16] = 0
    frame.measurement_id[:] = np.arange(1024)
    for number, name in enumerate(("RANGE", "RANGE2", "SIGNAL", "SIGNAL2", "REFLECTIVITY", "REFLECTIVITY2"), start=1):
        frame.field(name)[:] = 10 * number
    poses = np.broadcast_to(np.eye(4), (1024, 4, 4)).copy()
    poses[16:] = body
    frame.body_to_world[:] = poses
    writer = library("ouster.sdk.osf").Writer(str(tmp_path / "a.osf"), info)
    writer.save(0, frame)
    writer.close()
    with open_recording(tmp_path / "a.osf") as recording:
        sweep = recording[0]
    assert sweep.start_s == pytest.approx(5.0 + 16 * 97_656e-9, abs=1e-9)
    assert sweep.time_s is not None
    assert np.isnan(sweep.time_s[:, :16]).all()
    np.testing.assert_allclose(sweep.time_s[0, 16:], np.arange(1008) * 97_656e-9, atol=1e-9)
    assert not sweep.has_return[:, :16].any()
    assert sweep.has_return[:, 16:].all()
    assert sweep.second is not None
    for reported_range_m, value in (
        (sweep.range_m, 0.010),
        (sweep.second.range_m, 0.020),
        (sweep.signal, 30),
        (sweep.second.signal, 40),
        (sweep.reflectivity, 50),
        (sweep.second.reflectivity, 60),
    ):
        assert reported_range_m is not None
        np.testing.assert_allclose(reported_range_m[:, 16:], value, rtol=1e-12)
        assert np.isnan(reported_range_m[:, :16]).all()
    assert sweep.pose is not None
    np.testing.assert_allclose(sweep.pose.position_m, [5.0, 6.5, 7.25], atol=1e-12)
    np.testing.assert_allclose(sweep.pose.rotation, (body @ mounted)[:3, :3], atol=1e-12)
