"""Words of the command line, parsed: whole numbers, numbers, pulses, poses.

A wrong argument raises a one-line error that names the valid ones: "must be ..., got ...".
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from ..errors import InputError
from ..rendering.option_fields import Whole

if TYPE_CHECKING:
    from ..maths.pose import Pose


def number(text: str) -> float:
    """Parse a finite number (an argparse type)."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"must be a number, got {text}")
    return value


def whole_number(numbers: Whole) -> Callable[[str], int]:
    """Make an argparse type that parses one of these whole numbers."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = numbers.low - 1
        if not numbers.low <= value <= numbers.high:
            raise argparse.ArgumentTypeError(f"must be {numbers}, got {text}")
        return value

    return parse


def rising_numbers(quantity: str, example: str) -> Callable[[str], tuple[float, ...]]:
    """Make an argparse type that parses rising positive numbers with commas between them."""

    def parse(text: str) -> tuple[float, ...]:
        try:
            values = tuple(float(word) for word in text.split(","))
        except ValueError:
            values = ()
        in_order = all(a < b for a, b in itertools.pairwise(values))
        if not values or not in_order or not all(math.isfinite(v) and v > 0.0 for v in values):
            raise argparse.ArgumentTypeError(f"must be {quantity} that rise, such as {example}, got {text}")
        return values

    return parse


def pulses(text: str) -> tuple[int, ...]:
    """Parse whole numbers and ranges of them, both ends included, with commas between (an argparse type)."""
    from ..detection.sampled_waveforms import MOST_PULSES

    chosen: list[int] = []
    try:
        for word in text.split(","):
            # "7" is the range from 7 to 7.
            first, _, last = word.partition("-")
            numbers = range(int(first), int(last or first) + 1)
            if not numbers or len(numbers) + len(chosen) > MOST_PULSES:
                raise ValueError
            chosen += numbers
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"must be up to {MOST_PULSES} pulse numbers and ranges, such as 0,100,2000-2010, got {text}"
        ) from None
    return tuple(chosen)


def require_no_empty(argv: Sequence[str]) -> None:
    """Raise InputError for an argument without a letter: as a path it would be the current folder."""
    if "" in argv:
        before = argv[argv.index("") - 1] if argv[0] else "lidarscene"
        raise InputError(f"an argument is empty, behind {before}: is a variable of the shell not set?")


def with_joined_pose(argv: Sequence[str]) -> list[str]:
    """Join ``--pose -5,0,2`` to ``--pose=-5,0,2``: argparse takes a value with a minus for an option."""
    words = list(argv)
    # Backwards, because joining two words moves those behind them.
    for position in range(len(words) - 1, 0, -1):
        value = words[position]
        if words[position - 1] == "--pose" and value.startswith("-") and "," in value:
            words[position - 1 : position + 1] = [f"--pose={value}"]
    return words


def pose(text: str) -> Pose:
    """Parse a pose of three to six numbers, metres and degrees (an argparse type)."""
    from ..sensor.pose_file import LARGEST_COORDINATE_M, to_pose

    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if not 3 <= len(numbers) <= 6 or not all(abs(number) <= LARGEST_COORDINATE_M for number in numbers):
        raise argparse.ArgumentTypeError(
            f"must be X,Y,Z[,YAW,PITCH,ROLL] in metres (to {LARGEST_COORDINATE_M:g}) and degrees, got {text}"
        )
    return to_pose(numbers)


def frame_numbers(text: str) -> tuple[int, ...]:
    """Parse the numbers of frames, each once.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    words = text.split(",")
    if not all(word.isdecimal() for word in words):
        raise InputError(f"--frames: must be numbers with commas between them, such as 0,1,2, got '{text}'")
    return tuple(dict.fromkeys(int(word) for word in words))
