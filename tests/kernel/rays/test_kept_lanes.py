"""Flags of lanes as lists of lanes, against loops in Python."""

from types import SimpleNamespace

import numpy as np
import pytest

from lidarscene.kernel.rays import kept_lanes


def detection(mi, flags):
    """With these flags (stops, n) as what each stop reports."""
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


@pytest.mark.parametrize(("reported", "twice", "count"), [((), False, 0), ((3,), False, 1), ((0, 1), True, 1)])
def test_one_return_or_none_is_two_lanes(mi, reported, twice, count):
    """Dr.Jit would take one lane for all lanes, and compile anew."""
    flags = np.isin(np.arange(2 if twice else 5), reported)[None]
    lane, _, lane_count = kept_lanes.reported_lanes(detection(mi, flags), twice=twice)
    assert lane_count == count
    assert len(lane.numpy()) == 2
    if reported:
        assert lane.numpy()[0] == reported[0]


def test_flags_of_rays_and_lanes(mi):
    flags = np.array([0, 1, 0, 0, 0, 0, 1, 1, 0], dtype=bool)
    assert kept_lanes.any_of_pulse(mi.Bool(flags), 3).numpy().tolist() == [True, False, True]
    lanes = kept_lanes.lanes_where(mi.Bool(flags))
    assert lanes.numpy().tolist() == [1, 6, 7]
    assert kept_lanes.gather_lanes(mi.Float(np.arange(9) * 2.0), lanes).numpy().tolist() == [2.0, 12.0, 14.0]
    assert kept_lanes.lanes_where(mi.Bool(np.zeros(4, bool))) is None
