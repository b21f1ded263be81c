"""A Pandar64's packets read as the maker's own driver does, value by value: HesaiLidar_General_SDK at d7f39ee,
ParseL64Data and CalcL64PointXYZIT, with its tables of firing times.
"""

import struct
from collections.abc import Iterator

ORDER = (
    (50, 60),
    (44, 59),
    (38, 56),
    (8, 54),
    (48, 62),
    (42, 58),
    (6, 55),
    (52, 63),
    (46, 61),
    (40, 57),
    (5, 53),
    (4, 47),
    (3, 49),
    (2, 51),
    (1, 45),
    (0, 43),
    (23, 32),
    (26, 41),
    (20, 35),
    (14, 29),
    (21, 36),
    (15, 30),
    (9, 24),
    (18, 33),
    (12, 27),
    (19, 34),
    (13, 28),
    (7, 22),
    (16, 31),
    (10, 25),
    (17, 37),
    (11, 39),
)
"""Lasers that fire together, the last ones first."""

BEFORE_US = {
    laser: 3.62 + 1.304 * min(place, 15) + 1.968 * max(place - 15, 0)
    for place, pair in enumerate(ORDER)
    for laser in pair
}
"""When a laser fires, before the end of its block."""


def points_of(payload: bytes) -> Iterator[tuple[int, float, float, float, int]]:
    """Laser, azimuth without its own [degrees, clockwise], time within the minute [s], range [m], reflectivity."""
    start, lasers, blocks, _, step_mm = struct.unpack_from(">HBBBB", payload)
    assert (start, lasers, blocks, len(payload)) == (0xEEFF, 64, 6, 8 + 6 * 194 + 22)
    tail = 8 + 6 * 194 + 8
    turns, stamp_us, echo = struct.unpack_from("<HIB", payload, tail)
    second = payload[tail + 13]
    for block in range(blocks):
        offset = 8 + 194 * block
        azimuth = struct.unpack_from("<H", payload, offset)[0]
        ahead = (5 - block) // 2 if echo == 0x39 else 5 - block
        for laser in range(64):
            distance, reflectivity = struct.unpack_from("<HB", payload, offset + 2 + 3 * laser)
            if distance:
                turned = 0.01 * azimuth - turns * 6e-6 * BEFORE_US[laser]
                time_s = second + 1e-6 * (stamp_us - 55.56 * ahead - 42.58 - BEFORE_US[laser])
                yield laser, turned, time_s, 1e-3 * distance * step_mm, reflectivity
