"""Packets of Velodyne: an independent decoder gives back every point, its laser and its time."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.packets import cut_short, packets_of, random_frame

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.formats.packets.layouts import VELODYNE_PACKET
from lidarscene.formats.packets.select_encoder import select_encoder
from lidarscene.formats.packets.velodyne_encoder import MODELS
from lidarscene.sensor.sensor_file import load_sensor
from lidarscene.sensor.sensor_model import Sensor

NAMES = [model.name for model in MODELS]
DUAL = ('tdc.keep="strongest_and_last"',)
X, Y, INTENSITY, TIME, RING = 0, 1, 3, 4, 6
"""Columns of the decoder's points."""

LATER_S = 8e-6 / 3.0
"""velodyne-decoder, after VeloView, has the second half of a VLS-128's lasers a group later than its manual."""


def decode_points(library: Callable[[str], Any], packets: list[Any]) -> Any:
    """(n, 8) points, their times on the sensor's clock."""
    velodyne = library("velodyne_decoder")
    decoder = velodyne.ScanDecoder(velodyne.Config(min_range=0.0, max_range=400.0))
    read = [velodyne.VelodynePacket(packet.time_s, packet.payload) for packet in packets]
    # It learns how fast a VLS-128 turns and fires from the packet before.
    decoder.decode(read[:2])
    stamp, points = decoder.decode(read)
    points = np.asarray(points, np.float64)
    points[:, TIME] += stamp.device
    return points


def in_order(ring: Any, time_s: Any, range_m: Any) -> Any:
    """Sort by laser, firing and range; two firings of a laser are 40 us apart."""
    return np.lexsort((range_m, np.rint(time_s / 20e-6), ring))


def without_its_delay(points: Any, is_late: Any) -> Any:
    """The decoder's points as the manual's table has them."""
    back_rad = np.where(is_late, 2.0 * np.pi * 10.0 * LATER_S, 0.0)  # it turns clockwise
    x, y = points[:, X], points[:, Y]
    changed = points.copy()
    changed[:, X] = x * np.cos(back_rad) - y * np.sin(back_rad)
    changed[:, Y] = y * np.cos(back_rad) + x * np.sin(back_rad)
    changed[:, TIME] -= np.where(is_late, LATER_S, 0.0)
    return changed


@pytest.mark.parametrize("sets", [(), DUAL], ids=["single", "dual"])
@pytest.mark.parametrize("name", NAMES)
def test_every_point_comes_back(library: Callable[[str], Any], name: str, sets: tuple[str, ...]) -> None:
    """Rationale: 3 mm, 0.01 degrees and 1 us are the acceptance: distances have steps of 2 and 4 mm, azimuths of 0.01
    degrees, stamps of 1 us. A VLS-128's packet with two returns is one firing, and the decoder takes how fast the head
    turns from the rounded azimuths of two: 0.01 degrees more. It also takes that a VLS-128 fires every 53.3 us, as the
    manual says, where recorded ones do so every 55.3 us: the third firing of a packet is 4.4 us and 0.016 degrees early
    in its points.
    """
    sensor = load_sensor(name, overrides=sets)
    clouds = [random_frame(sensor, number=number, second=bool(sets)) for number in range(1 if name == "vls-128" else 2)]
    points = decode_points(library, packets_of(select_encoder(sensor), sensor, clouds))
    ring, time_s, xyz_m, range_m, intensity, channel = columns_of_clouds(sensor, clouds)
    expected = in_order(ring, time_s, range_m)
    is_late = np.isin(points[:, RING], ring[channel >= 64])  # of a VLS-128 alone
    order = in_order(points[:, RING], points[:, TIME] - LATER_S * is_late, np.linalg.norm(points[:, :3], axis=1))
    assert len(order) == len(expected)
    points = without_its_delay(points[order], is_late[order])
    assert (points[:, RING] == ring[expected]).all()
    good_to_s = 4.5e-6 if name == "vls-128" else 1e-6
    assert np.abs(points[:, TIME] - time_s[expected]).max() < good_to_s
    assert (points[:, INTENSITY] == intensity[expected]).all()
    apart_m = np.linalg.norm(points[:, :3] - xyz_m[expected], axis=1)
    across = np.radians(0.02 if name == "vls-128" else 0.01)
    assert (apart_m < 0.003 + across * range_m[expected]).all()


def columns_of_clouds(sensor: Sensor, clouds: list[PointCloud]) -> list[Any]:
    """Ring, time by the scene's clock, place, range, intensity and channel of all points."""
    of_each = [
        (cloud.ring, cloud.time_s + cloud.frame_start_s, cloud.xyz_m, cloud.range_m, cloud.intensity, cloud.channel)
        for cloud in clouds
    ]
    return [np.concatenate(values) for values in zip(*of_each, strict=True)]


def test_two_returns_are_the_last_and_the_strongest(library: Callable[[str], Any]) -> None:
    """Or the second strongest, if the strongest is the last; both blocks have a lone return."""
    sensor = load_sensor("hdl-32e", overrides=DUAL)
    cloud = random_frame(sensor, second=True)
    packets = packets_of(select_encoder(sensor), sensor, [cloud])
    blocks = np.frombuffer(b"".join(packet.payload for packet in packets), VELODYNE_PACKET)["blocks"]
    last, strongest = (blocks["points"]["distance"][:, place::2].reshape(-1, 32) for place in (0, 1))
    assert ((last == 0) == (strongest == 0)).all()
    assert (last >= strongest).all()
    has_two_returns = np.unique(np.stack([cloud.time_s, cloud.channel]), axis=1, return_counts=True)[1] == 2
    assert (last > strongest).sum() == has_two_returns.sum() > 1000


def test_lost_pulses_are_zeros_and_the_last_packet_is_filled_up() -> None:
    """A firing of VLP-16 is 55.296 us, a packet 24 of them; its azimuths are those of each second one."""
    sensor = load_sensor("vlp-16")
    cloud = random_frame(sensor)
    packets_of_frame = packets_of(select_encoder(sensor), sensor, [cloud])
    packets = np.frombuffer(b"".join(packet.payload for packet in packets_of_frame), VELODYNE_PACKET)
    assert len(packets) == -(-sensor.scanner.cycles // 24)
    distance = packets["blocks"]["points"]["distance"]
    assert (distance > 0).sum() == len(cloud)
    firings_left = sensor.scanner.cycles % 24
    assert (distance[-1].reshape(24, 16)[firings_left:] == 0).all()
    # 10 turns a second are 0.3981 degrees in two firings, to 0.01 degrees at both ends.
    steps = np.diff(packets["blocks"]["azimuth"].astype(int).ravel()) % 36_000
    assert set(steps) <= {39, 40, 41}
    assert steps.mean() == pytest.approx(36_000 * 10 * 2 * 55.296e-6, abs=1e-3)
    assert set(packets["mode"]) == {0x37}
    assert set(np.diff(packets["stamp"].astype(int))) <= {1327, 1328}


def test_what_is_farther_than_a_distance_can_say_is_lost() -> None:
    sensor = load_sensor("vlp-16")
    cloud = random_frame(sensor, farthest_m=200.0)
    with pytest.warns(UserWarning, match=r"end at 131\.07 m: returns beyond are left out"):
        packets = packets_of(select_encoder(sensor), sensor, [cloud])
    distance = np.frombuffer(b"".join(packet.payload for packet in packets), VELODYNE_PACKET)["blocks"]["points"][
        "distance"
    ]
    assert (distance > 0).sum() == (np.rint(cloud.range_m.astype(float) / 0.002) < 65_536).sum() < len(cloud)


def test_the_last_return_alone_is_told_by_the_mode() -> None:
    sensor = load_sensor("vlp-16", overrides=['tdc.keep="last"'])
    packets = packets_of(select_encoder(sensor), sensor, [random_frame(sensor)])
    assert packets[0].payload[-2:] == bytes([0x38, 0x22])


def test_packets_run_on_from_frame_to_frame() -> None:
    """Rationale: 1808 firings are not whole packets of 24; the one in between has firings of both frames."""
    sensor = load_sensor("vlp-16")
    clouds = [random_frame(sensor, number=number) for number in range(3)]
    packets = packets_of(select_encoder(sensor), sensor, clouds)
    assert len(packets) == 3 * sensor.scanner.cycles // 24
    times_s = np.diff([packet.time_s for packet in packets])
    np.testing.assert_allclose(times_s, 24 * 55.296e-6, atol=1e-9)


def test_an_encoder_is_read_at_its_nearest_step() -> None:
    """Steps of 0.5 degrees: every azimuth is one of them, and never farther from the head than half of one.

    Tolerance: the hundredth to which a packet rounds the head's own azimuth.
    """
    azimuths = []
    for sets in ((), ("scanner.encoder_step_deg=0.5",)):
        sensor = load_sensor("vlp-16", overrides=sets)
        packets = packets_of(select_encoder(sensor), sensor, [random_frame(sensor)])
        blocks = np.frombuffer(b"".join(packet.payload for packet in packets), VELODYNE_PACKET)["blocks"]
        azimuths.append(blocks["azimuth"].astype(int).ravel())
    head, encoder = azimuths
    assert (encoder % 50 == 0).all()
    encoder_error = (head - encoder + 18_000) % 36_000 - 18_000
    assert np.abs(encoder_error).max() <= 26
    assert encoder_error.min() < -20 < 20 < encoder_error.max()


def test_stamps_begin_anew_with_every_hour() -> None:
    """They count microseconds of the hour. A packet is sent when its last laser has fired: 23 firings of 55.296 us and
    15 of 16 lasers of 2.304 us after it began.
    """
    sensor = load_sensor("vlp-16")
    cloud = random_frame(sensor)
    later_cloud = replace(cloud, metadata=dict(cloud.metadata) | {"frame_start_s": "7199.95"})
    packets = packets_of(select_encoder(sensor), sensor, [later_cloud])
    stamp = np.frombuffer(b"".join(packet.payload for packet in packets), VELODYNE_PACKET)["stamp"].astype(int)
    assert stamp[0] == 3_599_950_000
    later = np.arange(len(stamp)) * 24 * 55.296
    np.testing.assert_allclose((stamp - stamp[0]) % 3_600_000_000, later, atol=0.51)
    assert stamp[-1] == pytest.approx(later[-1] - 50_000, abs=0.51)
    assert packets[0].time_s - 7199.95 == pytest.approx(1e-6 * (23 * 55.296 + 15 * 2.304), abs=1e-9)


def test_the_last_packet_goes_on_without_points() -> None:
    """A frame that ends after thirty firings: azimuths and times are those that the whole frame has there."""
    (ours_s, ours), (theirs_s, theirs) = cut_short(load_sensor("vlp-16"), 30, VELODYNE_PACKET)
    np.testing.assert_array_equal(ours["blocks"]["azimuth"], theirs["blocks"]["azimuth"])
    np.testing.assert_array_equal(ours["stamp"], theirs["stamp"])
    np.testing.assert_allclose(ours_s, theirs_s, atol=1e-9)


@pytest.mark.parametrize(("sets", "mode"), [((), 0x37), (DUAL, 0x39)], ids=["single", "dual"])
@pytest.mark.parametrize(("name", "code"), [("vlp-16", 0x22), ("hdl-32e", 0x21), ("vls-128", 0xA1)])
def test_what_a_packet_says_of_itself(name: str, code: int, sets: tuple[str, ...], mode: int) -> None:
    """The manuals' bytes: mode and model in the last two bytes; blocks of lasers 0 to 31, 32 to 63 and so on begin with
    EEFF, DDFF, CCFF and BBFF, and with two returns the last four of a VLS-128 have no lasers.
    """
    sensor = load_sensor(name, overrides=sets)
    payload = packets_of(select_encoder(sensor), sensor, [random_frame(sensor)])[0].payload
    assert payload[-2:] == bytes([mode, code])
    banks = [payload[100 * block : 100 * block + 2].hex() for block in range(12)]
    four = ["ffee", "ffdd", "ffcc", "ffbb"]
    if name != "vls-128":
        assert banks == ["ffee"] * 12
    elif sets:
        assert banks == [bank for bank in four for _ in (0, 1)] + ["ffff"] * 4
    else:
        assert banks == four * 3
