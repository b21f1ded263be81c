"""Clock of bags and packets: times of the scene in, nanoseconds since 1970 out.

A scene's time usually begins at 0. To other programs a stamp of 0 means that there is none, so a date stands for the
scene's second 0. Whole nanoseconds keep what a double loses: it has steps of 0.24 us today.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

EPOCH = datetime(2026, 1, 1, tzinfo=UTC)
"""Date of the scene's second 0, unless another one is given."""

COUNTED_FROM_1970_S = 1e9
"""Choice: time (2001) from which on times are dates themselves: of a recorded trajectory, whose clock began in 1970."""

FIRST, LAST = datetime(1970, 1, 1, tzinfo=UTC), datetime(2038, 1, 1, tzinfo=UTC)
"""Dates that all stamps can hold: ROS 2 counts seconds in 32 bits with a sign."""


def to_ns(date: datetime) -> int:
    """Nanoseconds from 1970 to a date."""
    return (date - FIRST) // timedelta(microseconds=1) * 1000


def default_epoch_ns(begin_s: float) -> int:
    """Nanoseconds from 1970 to the second 0 of a scene whose first frame begins at ``begin_s``."""
    return 0 if begin_s >= COUNTED_FROM_1970_S else to_ns(EPOCH)


def parse_date(text: str) -> datetime:
    """Parse an ISO 8601 date, with or without time; UTC unless it says otherwise.

    Raises:
        ValueError: if a value is not allowed
    """
    date = datetime.fromisoformat(text)
    date = date if date.tzinfo else date.replace(tzinfo=UTC)
    if not FIRST <= date <= LAST:
        raise ValueError(f"must be from {FIRST:%Y} to {LAST:%Y}")
    return date


def stamp_ns(time_s: float, epoch_ns: int) -> int:
    """Stamp of a time of the scene."""
    return epoch_ns + round(1e9 * time_s)
