"""Flags of lanes as lists of lanes, against loops in Python."""

from types import SimpleNamespace

import numpy as np
import pytest

from lidarscene.kernel.rays import kept_lanes


def detection(mi, flags):
    """A detection with these flags (stops, n) as what each stop reports."""
    return SimpleNamespace(stops=[SimpleNamespace(reported=mi.Bool(row)) for row in flags])


@pytest.mark.parametrize("ordered", [False, True])
@pytest.mark.parametrize("stops", [1, 3])
def test_returns_come_by_pulse_and_then_by_stop(mi, stops, ordered):
    rng = np.random.default_rng(7)
    flags = rng.random((stops, 50)) < 0.3  # of lanes
    lane_of = rng.permutation(50).astype(np.uint32) if ordered else np.arange(50, dtype=np.uint32)
    lane, stop, count = kept_lanes.reported_lanes(detection(mi, flags), mi.UInt32(lane_of) if ordered else None)
    expected = [(lane_of[pulse], s) for pulse in range(50) for s in range(stops) if flags[s, lane_of[pulse]]]
    reported_pairs = np.broadcast_arrays(lane.numpy(), stop.numpy())
    assert count == len(expected)
    assert list(zip(*reported_pairs, strict=True)) == expected


@pytest.mark.parametrize("stops", [1, 2])
@pytest.mark.parametrize("again", [[4, 11, 3], [7, 7]])
def test_returns_of_lanes_traced_again_are_in_their_places(mi, stops, again):
    """There are as many returns as they have then; a single lane is traced as two, and its returns come once."""
    rng = np.random.default_rng(7)
    lane_of = rng.permutation(15).astype(np.uint32)
    first, later = rng.random((stops, 15)) < 0.5, rng.random((stops, len(again))) < 0.7
    later[:, :2] = True
    mask = np.isin(np.arange(15), again)
    first[:, mask] = False
    retraced = kept_lanes.Retraced.from_lanes(mi.UInt32(again), mi.Bool(mask))
    lane, stop, count = kept_lanes.reported_lanes(
        detection(mi, first), mi.UInt32(lane_of), again=[(retraced, detection(mi, later))]
    )
    merged = first.copy()
    merged[:, again] = later
    expected = [(number, s) for number in lane_of for s in range(stops) if merged[s, number]]
    assert count == len(expected)
    assert list(zip(*np.broadcast_arrays(lane.numpy(), stop.numpy()), strict=True)) == expected
    index, (place, later_stop) = retraced.among(lane, stop, stops=stops)
    rows = [row for row, (number, _) in enumerate(expected) if mask[number]]
    assert set(index.numpy()) == set(rows)
    assert [again[lane] for lane in place.numpy()] == [expected[row][0] for row in index.numpy()]
    stops_there = np.broadcast_to(later_stop.numpy(), len(index.numpy()))
    assert stops_there.tolist() == [expected[row][1] for row in index.numpy()]


@pytest.mark.parametrize(("reported", "count"), [((), 0), ((3,), 1)])
def test_one_return_or_none_is_two_lanes(mi, reported, count):
    """Dr.Jit would take one lane for all lanes, and compile anew."""
    flags = np.isin(np.arange(5), reported)[None]
    lane, _, lane_count = kept_lanes.reported_lanes(detection(mi, flags))
    assert lane_count == count
    assert len(lane.numpy()) == 2
    if reported:
        assert lane.numpy()[0] == reported[0]


def test_flags_of_rays_and_lanes(mi):
    flags = np.array([0, 1, 0, 0, 0, 0, 1, 1, 0], dtype=bool)
    assert kept_lanes.any_of_pulse(mi.Bool(flags), 3).numpy().tolist() == [True, False, True]
    lanes = kept_lanes.lanes_where(mi.Bool(flags))
    assert lanes.numpy().tolist() == [1, 6, 7]
    retraced = kept_lanes.Retraced.from_lanes(lanes, mi.Bool(flags))
    number, (value,) = retraced.pulses(mi.UInt32(np.arange(9) * 2), [mi.Float(0.5 * np.arange(9))])
    assert (number.numpy().tolist(), value.numpy().tolist()) == ([2, 12, 14], [0.5, 3.0, 3.5])
    assert retraced.place.numpy()[[1, 6, 7]].tolist() == [0, 1, 2]
    assert kept_lanes.lanes_where(mi.Bool(np.zeros(4, bool))) is None


def test_each_frame_begins_a_packet(mi):
    """Four frames of ten lanes, of which five, none, one and two are kept."""
    lanes = [0, 1, 2, 8, 9, 24, 30, 31]
    packed = kept_lanes.in_packets(mi.UInt32(lanes), 10, 4).numpy()
    none = kept_lanes.NO_LANE
    assert packed.tolist() == [0, 1, 2, 8, 9, none, none, none, 24, 24, none, none, 30, 31, none, none]
    flags = np.isin(np.arange(40), lanes)
    retraced = kept_lanes.Retraced.from_lanes(mi.UInt32(packed), mi.Bool(flags))
    pulse = np.where(packed == none, kept_lanes.NO_PULSE, 3 * packed.astype(np.int64))
    assert retraced.pulses(mi.UInt32(3 * np.arange(40)))[0].numpy().tolist() == pulse.tolist()
    place = retraced.place.numpy()
    assert packed[place[flags]].tolist() == lanes
    assert not place[~flags].any()


def test_a_lane_without_a_pulse_looks_up_the_first(mi):
    """The number of such a lane is beyond all tables: a GPU ends the process where something is read from there."""
    pulse = [0, 7, kept_lanes.NO_PULSE - 1, kept_lanes.NO_PULSE, kept_lanes.NO_PULSE + 5]
    for numbers in (np.array(pulse, np.uint32), mi.UInt32(pulse)):
        np.testing.assert_array_equal(kept_lanes.existing(numbers), [0, 7, kept_lanes.NO_PULSE - 1, 0, 0])
