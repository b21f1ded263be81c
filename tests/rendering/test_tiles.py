"""The order in which pulses are traced."""

import dataclasses

import numpy as np
import pytest
from helpers import chain, scanners
from helpers.run_seed import chosen

from lidarscene import Simulator
from lidarscene.kernel.device import transfer
from lidarscene.maths.trajectory import Course
from lidarscene.rendering.render_options import FrameOptions
from lidarscene.rendering.tiles import CACHED, HEIGHT, PACKET, Numbering, Tiling

PULSES = np.arange(200, dtype=np.uint32)


def tiled_scanner_names():
    """Names of the scanners that are cut into tiles."""
    return [name for name, make in scanners.ALL.items() if Tiling.from_scanner(make()) is not None]


def girth(scanner, pulse):
    """Mean largest angle between two rays that are traced together."""
    lanes = pulse[: len(pulse) // PACKET * PACKET]
    x, y, z = (np.broadcast_to(np.asarray(c, np.float64), len(lanes)) for c in scanner.direction(lanes))
    rays = np.stack([x, y, z], axis=-1).reshape(-1, PACKET, 3)
    distance = np.linalg.norm(rays[:, :, None] - rays[:, None], axis=-1)
    return float(distance.max(axis=(1, 2)).mean())


def test_scanners_of_lines_are_tiled_and_others_are_not():
    assert {"raster", "mirror_step", "mirror_round", "flash"} <= set(tiled_scanner_names())
    assert not {"mid40", "lissajous_pair"} & set(tiled_scanner_names())


@pytest.mark.parametrize("name", tiled_scanner_names())
def test_every_pulse_has_one_lane(name):
    tiling = Tiling.from_scanner(scanners.ALL[name]())
    for count in (1, tiling.band - 1, tiling.band, 3 * tiling.band + tiling.line + 1):
        np.testing.assert_array_equal(np.sort(tiling.order(count)), np.arange(count))


@pytest.mark.parametrize("name", tiled_scanner_names())
def test_rays_traced_together_are_nearer_to_each_other_than_in_firing_order(name):
    """Some lines have steps so different that the firing order is the best there is: never worse, by rounding."""
    scanner = scanners.ALL[name]()
    tiling = Tiling.from_scanner(scanner)
    count = scanner.pulses // tiling.band * tiling.band
    pulse = np.arange(count, dtype=np.uint32)
    assert girth(scanner, tiling.order(count)) <= girth(scanner, pulse) * 1.001


def test_a_packet_of_an_even_grid_is_two_across_and_four_up():
    """Computed by hand: of 1 x 8, 2 x 4, 4 x 2, 8 x 1 the two in the middle have the least girth, and the upright one
    wins.
    """
    scanner = chain.sensor("table1-apd", "scanner.azimuth_step_deg=0.5", "scanner.elevation_step_deg=0.5").scanner
    tiling = Tiling.from_scanner(scanner)
    assert tiling.width == 2
    first = tiling.order(tiling.band)[:PACKET].astype(np.int64)
    lines, places = np.divmod(first, tiling.line)
    np.testing.assert_array_equal(lines, [0, 0, 1, 1, 2, 2, 3, 3])
    np.testing.assert_array_equal(places, [tiling.line - 1, tiling.line - 2] * 4)
    assert HEIGHT == 8


def test_lines_there_and_back_are_laid_side_by_side():
    """Rationale: of a mirror that turns round, neighbours are mirror images in the line. Reference: the azimuths."""
    scanner = dataclasses.replace(scanners.ALL["mirror_step"](), waveform="triangle")
    tiling = Tiling.from_scanner(scanner)
    assert not np.array_equal(tiling.along[0], tiling.along[1])
    azimuth = scanner.angles(np.arange(2 * tiling.line, dtype=np.uint32))[0].reshape(2, -1)
    sorted_lines = np.take_along_axis(azimuth, tiling.along, axis=1)
    # Tolerance: the slow mirror turns between the lines, and the fast one then looks a little elsewhere.
    np.testing.assert_allclose(sorted_lines[0], sorted_lines[1], atol=2e-2)


@pytest.mark.usefixtures("mi")
@pytest.mark.parametrize("name", chosen(3, tiled_scanner_names()))
def test_points_are_those_of_the_firing_order(name):
    """Rationale: an order is no physics. Reference: the same frame with the pulses as they are fired, bit for bit."""
    sensor = dataclasses.replace(
        chain.sensor("table1-apd", "tdc.stops=2", "tdc.threshold_to_noise=2.5"), scanner=scanners.ALL[name]()
    )
    scene = chain.scene(chain.ball(at=(0.0, 0.0, 0.0), radius_m=20.0), chain.facing(range_m=15.0, size_m=6.0))
    frames = []
    for tiles in (True, False):
        simulator = Simulator(scene, sensor)
        if not tiles:
            vars(simulator)["numbering"] = Numbering(sensor.scanner, tiled=False)
        missed_pulses, counts = [], []
        cloud = simulator.render(
            seed=5,
            chunk=4 * Tiling.from_scanner(sensor.scanner).band + 3,
            missed=lambda pulse, outcome, missed_pulses=missed_pulses: missed_pulses.append(np.stack([pulse, outcome])),
            ambient=lambda pulse, number, counts=counts: counts.append(np.stack([pulse, number])),
        )
        columns = {
            field.name: getattr(cloud, field.name)
            for field in dataclasses.fields(cloud)
            if isinstance(getattr(cloud, field.name), np.ndarray)
        }
        frames.append((columns, np.concatenate(missed_pulses, axis=1), np.concatenate(counts, axis=1)))
    (columns, missed_pulses, counts), (plain, plain_lost, plain_counts) = frames
    for key, values in plain.items():
        np.testing.assert_array_equal(columns[key], values, err_msg=key)
    np.testing.assert_array_equal(np.sort(missed_pulses, axis=1)[0], np.sort(plain_lost, axis=1)[0])
    np.testing.assert_array_equal(
        missed_pulses[1][np.argsort(missed_pulses[0])], plain_lost[1][np.argsort(plain_lost[0])]
    )
    np.testing.assert_array_equal(counts, plain_counts)


@pytest.mark.usefixtures("mi")
@pytest.mark.parametrize("name", ["raster", "mirror_step"])
def test_a_frame_on_the_move_does_not_depend_on_those_before(name):
    """The times of pulses are kept from frame to frame. Reference: the same frame by a simulator that made no other."""
    sensor = dataclasses.replace(chain.sensor("table1-apd"), scanner=scanners.ALL[name]())
    scene = chain.scene(chain.facing(range_m=15.0, size_m=6.0), chain.ball(at=(0.0, 0.0, 0.0), radius_m=20.0))
    scene = dataclasses.replace(scene, ego=Course(speed_m_s=3.0, yaw_rate_rad_s=0.5))
    simulator, chunk = Simulator(scene, sensor), sensor.scanner.pulses // 3
    for number in (0, 1, 5):
        simulator.render(number=number, chunk=chunk)
    assert len(simulator.numbering._departures) == CACHED
    for options in ({"number": 2}, {"number": 3, "chunk": chunk}):
        cloud, fresh_cloud = simulator.render(**options), Simulator(scene, sensor).render(**options)
        assert len(cloud) > 100
        for column in ("time_s", "true_range_m", "xyz_m"):
            np.testing.assert_array_equal(getattr(cloud, column), getattr(fresh_cloud, column))
    frames = {n: simulator._frame(FrameOptions(number=n)) for n in (0, 7)}
    numbers = {n: transfer.unsigned_numbers(n * sensor.scanner.pulses + PULSES) for n in frames}
    times = {n: simulator.numbering.chosen(frames[n], numbers[n]).departures()[0].numpy() for n in frames}
    assert (times[0] == times[7]).all()
    # Tolerance: a float32 of a frame's length.
    expected_s = sensor.scanner.time_s(PULSES) - sensor.scanner.time_s(PULSES[:1])
    np.testing.assert_allclose(times[0], expected_s, atol=6e-8 * sensor.scanner.frame_s)
