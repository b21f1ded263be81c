"""Missed pulses piece by piece: the bytes that numpy writes of all of them."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from lidarscene import load_sensor
from lidarscene.detection.outcomes import OUTCOME_TEXT
from lidarscene.files import spool
from lidarscene.outputs.streams import missed_stream

SENSOR = load_sensor("table1-apd")
FRAME = 2
"""Later than the first: times are since its start."""


@pytest.mark.parametrize("cuts", [[0, 0], [0, 100], [0, 1, 1, 37, 100]], ids=str)
def test_the_archive_is_that_of_numpy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cuts: list[int]) -> None:
    """Reference: `numpy.savez` of arrays that are computed of all pulses at once. Blocks of 30 rows."""
    monkeypatch.setattr(spool, "BLOCK_ROWS", 30)
    first = FRAME * SENSOR.scanner.pulses
    pulse = (first + 3 + 7 * np.arange(cuts[-1])).astype(np.int64)  # the first one has an echo
    reason = (1 + np.arange(cuts[-1]) % 4).astype(np.uint8)
    with missed_stream(tmp_path / "pieces.npz", SENSOR) as append:
        for begin, end in itertools.pairwise(cuts):
            append(pulse[begin:end], reason[begin:end])
    azimuth, elevation = SENSOR.scanner.angles(pulse)
    begin_s = SENSOR.scanner.time_s(np.array([first]))
    np.savez(
        tmp_path / "whole.npz",
        pulse=pulse,
        reason=reason,
        time_s=SENSOR.scanner.time_s(pulse) - begin_s,
        channel=SENSOR.scanner.channel(pulse),
        azimuth_rad=azimuth,
        elevation_rad=elevation,
        reason_names=np.array(["kept", *OUTCOME_TEXT.values()]),
    )
    assert (tmp_path / "pieces.npz").read_bytes() == (tmp_path / "whole.npz").read_bytes()


def test_rows_come_back_as_often_as_wanted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also between two appends; and nobody sees the file."""
    monkeypatch.setattr(spool, "BLOCK_ROWS", 3)
    with spool.Spool(tmp_path, [("a", "u4"), ("b", "f8")]) as rows:
        assert list(rows.blocks()) == []
        rows.append(a=np.arange(5), b=np.arange(5) / 2)
        assert [len(block) for block in rows.blocks()] == [3, 2]
        rows.append(a=np.arange(5, 7), b=np.arange(5, 7) / 2)
        for _ in range(2):
            all_rows = np.concatenate(list(rows.blocks()))
            assert all_rows["a"].tolist() == list(range(7))
            assert (all_rows["b"] == all_rows["a"] / 2).all()
        assert len(rows) == 7
        assert list(tmp_path.iterdir()) == []
