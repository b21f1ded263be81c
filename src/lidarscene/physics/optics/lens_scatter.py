"""Stray light in a lens: the share of one channel's light that reaches the detector of another.

Polish, dust and edges of a lens scatter light around its image, and surfaces reflect it back and forth. What scatters
falls with the angle like Harvey and Shack's law for polished surfaces with an exponent of 2 (J. E. Harvey, PhD thesis,
University of Arizona, 1976); ghosts between surfaces make an even veil.

Symbols: theta angle between two channels, h half angle.
"""

from __future__ import annotations

from ...maths.arrays import Lanes


def stray_share(*, angle_rad: Lanes, near: Lanes, half_angle_rad: Lanes, veil: Lanes) -> Lanes:
    """Share of a channel's light on the detector of another, theory (T122).

    Args:
        angle_rad: between the directions of both
        near: share at a small angle, without the veil
        half_angle_rad: angle at which that has fallen to half
        veil: share at any angle
    """
    ratio = angle_rad / half_angle_rad
    return veil + near / (1.0 + ratio * ratio)
