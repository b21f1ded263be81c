"""The clock of stamps: dates by `date -u`, and no step of a double."""

import pytest
from helpers.mistakes import refused

from lidarscene.formats.clock import default_epoch_ns, parse_date, stamp_ns, to_ns


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("1970-01-01", 0),
        ("2026-01-01", 1_767_225_600),
        ("2026-01-31T12:00:00Z", 1_769_860_800),
        ("2026-01-31T12:00:00+01:00", 1_769_857_200),
    ],
)
def test_dates(text: str, seconds: int) -> None:
    """Reference: `date -u -d TEXT +%s`."""
    assert to_ns(parse_date(text)) == seconds * 10**9


test_dates_that_no_stamp_holds = refused(
    lambda text: parse_date(text),
    ("noon", "'noon'"),
    ("1969-12-31", "1970 | 2038"),
    ("2040-01-01", "1970 | 2038"),
    error=ValueError,
)


def test_stamps_keep_nanoseconds() -> None:
    """A double of today's seconds has steps of 238 ns: the date is added in whole numbers."""
    epoch_ns = to_ns(parse_date("2026-01-01"))
    assert [stamp_ns(1e-9 * n, epoch_ns) - epoch_ns for n in (0, 1, 99_975_168)] == [0, 1, 99_975_168]


def test_a_clock_that_began_in_1970_keeps_its_date() -> None:
    assert default_epoch_ns(0.0) == 1_767_225_600 * 10**9
    assert default_epoch_ns(1_700_000_000.25) == 0
