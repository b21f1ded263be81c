"""Causes of points and outcomes of pulses.

Files, clouds and summaries need these names without the electronics behind them, so they stand alone: `lidarscene -h`
lists the formats of clouds without loading a detector.
"""

from __future__ import annotations

import enum


class Status(enum.IntEnum):
    """Cause of a point."""

    ECHO = 0
    FALSE_ALARM = 1
    INTERFERENCE = 2  # another lidar's pulse
    WEATHER = 3  # light from fog, rain or snow
    ALIASED = 4  # an echo of the pulse before: from beyond the unambiguous range
    STRAY = 5  # an echo of another channel that fired at the same instant
    REVIVED = 6  # the sun on SPADs that an echo fired and that come back together, a dead time behind it


class Outcome(enum.IntEnum):
    """Outcome of a pulse's echo."""

    KEPT = 0  # reported as a point
    NO_SURFACE = 1  # no ray met a surface
    BELOW_THRESHOLD = 2  # light may have returned, but the comparator did not trip
    OUT_OF_WINDOW = 3  # the echo crossed too early or too late: the converter did not listen
    HIDDEN = 4  # others had used up the converter's stops, or the sensor withheld it


OUTCOME_TEXT = {
    Outcome.NO_SURFACE: "no surface",
    Outcome.BELOW_THRESHOLD: "below threshold",
    Outcome.OUT_OF_WINDOW: "out of window",
    Outcome.HIDDEN: "hidden",
}
"""Reason why a pulse has no echo point, in words."""
