"""Pulses of several frames, side by side."""

from typing import Any

import numpy as np

from lidarscene.recordings.sweep import Sweep
from lidarscene.studies.fit.recorded_pulses import gather_pulses


def sweep_of_turn(columns: int, **changed: Any) -> Sweep:
    """Two rows; the beams go round from straight ahead to the left."""
    azimuth = np.broadcast_to(np.linspace(0.0, 1.0, columns), (2, columns))
    fields = {
        "range_m": np.full((2, columns), 10.0),
        "recorded": np.ones((2, columns), bool),
        "direction": np.stack([np.cos(azimuth), np.sin(azimuth), 0.0 * azimuth], axis=-1),
    }
    return Sweep(**fields | changed)


def test_blocks_go_on_from_frame_to_frame() -> None:
    """45 and 25 columns: blocks of 20, 20 and 5, then of 20 and 5; the fourth is held out."""
    pulses = gather_pulses([sweep_of_turn(45), sweep_of_turn(25)])
    sizes = np.bincount(pulses.block)
    assert sizes.tolist() == [20, 20, 5, 20, 5]
    assert pulses.frames == 2
    assert np.bincount(pulses.frame).tolist() == [45, 25]
    assert np.array_equal(np.unique(pulses.block[~pulses.fitted]), [3])
    np.testing.assert_allclose(pulses.azimuth_rad[0, :45], np.linspace(0.0, 1.0, 45), atol=1e-12)


def test_columns_that_nothing_is_known_of_leave_a_gap_in_their_block() -> None:
    recorded = np.ones((2, 45), bool)
    recorded[:, 10:22] = False
    pulses = gather_pulses([sweep_of_turn(45, recorded=recorded)])
    assert np.bincount(pulses.block).tolist() == [10, 18, 5]
    assert pulses.blocks(np.broadcast_to(pulses.block == 2, (2, 33))).tolist() == [0] * 10
