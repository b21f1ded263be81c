"""Frames of a recording by number, from both ends."""

from pathlib import Path
from typing import Any

import pytest

from lidarscene.errors import InputError
from lidarscene.recordings.recording import Recording


def test_frames_are_counted_from_both_ends() -> None:
    read: Any = lambda frame: frame  # noqa: E731
    recording: Any = Recording(path=Path("a"), count=3, read=read)
    assert [recording[place] for place in (0, 1, 2, -1, -2, -3)] == [0, 1, 2, 2, 1, 0]
    assert list(recording) == [0, 1, 2]
    for place in (3, -4):
        with pytest.raises(InputError, match=f"frame must be 0 to 2, got {place}"):
            recording[place]
