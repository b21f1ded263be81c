"""Wear of a lidar: drops on its window, weak and dead lasers, a mounting that is off.

Film and grains all over the window are numbers of `Optics` (`sensor.wear_file`): less light both ways, and a halo.
Drops are small and stand in the way of some beams only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..maths.arrays import Lanes, LookupTable, Numbers, xp
from ..maths.pose import direction_from_angles
from ..maths.vectors import Vector, angles_of
from ..physics.optics.receiver import circles_overlap


@dataclass(frozen=True, slots=True, kw_only=True)
class Drops:
    """Drops on a spherical window: the share of a beam that passes between them, by its direction.

    Attributes:
        outward: clear share of the laser's beam, over azimuth and elevation
        inward: clear share of the receiver's aperture, likewise
        start_rad: azimuth and elevation of the first entry
        per_rad: one over the tables' extent on each axis
    """

    outward: LookupTable
    inward: LookupTable
    start_rad: tuple[Lanes, Lanes]
    per_rad: tuple[Lanes, Lanes]

    @classmethod
    def tabulate(
        cls,
        places: Numbers,
        *,
        axes_rad: tuple[Numbers, Numbers],
        window_m: float,
        drop_m: float,
        lens_m: float,
        exit_m: float,
        offset_m: tuple[float, float],
    ) -> Drops:
        """Tabulate the clear shares of both beams.

        Args:
            places: (drops, 3) unit vectors to the drops
            axes_rad: azimuths and elevations of the tables, in even steps
            window_m: radius of the window's sphere
            drop_m: radius of a drop
            lens_m: radius of the receiver's lens
            exit_m: radius of the laser's beam where it leaves
            offset_m: to the left and up from the receiver's axis, where the beam leaves
        """
        shape = len(axes_rad[0]), len(axes_rad[1])
        azimuth, elevation = (axis.ravel() for axis in np.meshgrid(*axes_rad, indexing="ij"))
        beams = directions(azimuth, elevation)
        left = np.stack([-np.sin(azimuth), np.cos(azimuth), 0.0 * azimuth], axis=1)
        exits = window_m * beams + offset_m[0] * left + offset_m[1] * np.cross(beams, left)
        outward, inward = (
            LookupTable(_clear_share(centres, radius_m, window_m * places, drop_m).reshape(shape))
            for centres, radius_m in ((exits, exit_m), (window_m * beams, lens_m))
        )
        return cls(
            outward=outward,
            inward=inward,
            start_rad=(float(axes_rad[0][0]), float(axes_rad[1][0])),
            per_rad=(1.0 / float(np.ptp(axes_rad[0])), 1.0 / float(np.ptp(axes_rad[1]))),
        )

    def shares(self, direction: Vector) -> tuple[Lanes, Lanes]:
        """Shares of the laser's light that leaves, and of the echo that enters, (n,) each."""
        first, second = (
            (angle - start) * scale
            for angle, start, scale in zip(angles_of(direction), self.start_rad, self.per_rad, strict=True)
        )
        return self.outward.at(first, second), self.inward.at(first, second)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wear:
    """Wear that differs from beam to beam, or that the sensor's reports do not know. Film and grains are in `Optics`.

    Attributes:
        calibrated_share: share of an echo that film and grains leave, which the maker's intensity scale does not know
        drops: drops on the window, or None
        laser_power: relative power of each channel's laser, 0 of a dead one; None: all 1
        rotation: nine numbers, row by row: from the axes of the sensor to those of its mounting; None: none
    """

    calibrated_share: Lanes = 1.0
    drops: Drops | None = None
    laser_power: LookupTable | None = None
    rotation: tuple[Lanes, ...] | None = None

    def turn(self, direction: Vector) -> Vector:
        """True direction of a beam in the axes that the sensor was mounted with."""
        if self.rotation is None:
            return direction
        r = self.rotation
        x, y, z = (r[i] * direction[0] + r[i + 1] * direction[1] + r[i + 2] * direction[2] for i in (0, 3, 6))
        return x, y, z

    def shares(self, direction: Vector, channel: Lanes) -> tuple[Lanes, Lanes]:
        """Shares of the laser's power that leave, and of the echo's that enter, (n,) each, besides film and grains.

        Args:
            direction: of the beams against the sensor
            channel: (n,) channel of each pulse
        """
        outward, inward = (1.0, 1.0) if self.drops is None else self.drops.shares(direction)
        if self.laser_power is not None:
            outward = outward * xp(channel).take(self.laser_power, channel)
        return outward, inward

    def loss(self, direction: Vector, channel: Lanes) -> Lanes:
        """Share of the echo's power that all wear takes, (n,): the label of a point."""
        outward, inward = self.shares(direction, channel)
        return 1.0 - self.calibrated_share * outward * inward


def directions(azimuth_rad: Numbers, elevation_rad: Numbers) -> Numbers:
    """(n, 3) unit vectors of these angles."""
    return np.stack(direction_from_angles(azimuth_rad=azimuth_rad, elevation_rad=elevation_rad), axis=1)


def _clear_share(centres: Numbers, radius_m: float, drops: Numbers, drop_m: float) -> Numbers:
    """(n,) share of discs that no drop covers; drops that lie on each other count twice, to a least share of 0.

    Args:
        centres: (n, 3) middles of the discs, m
        radius_m: of each; 0: a point
        drops: (m, 3) middles of the drops, m
    """
    from scipy.spatial import cKDTree  # takes a quarter of a second to import, and few sensors have drops

    radius_m = max(radius_m, 1e-6)
    covered = np.zeros(len(centres))
    # As many neighbours as there are: a tree finds the discs near each drop.
    for drop, near in zip(drops, cKDTree(centres).query_ball_point(drops, radius_m + drop_m), strict=True):
        distance = np.linalg.norm(centres[near] - drop, axis=1)
        covered[near] += circles_overlap(first_radius=radius_m, second_radius=drop_m, distance=distance)
    return np.asarray(np.maximum(1.0 - covered / (math.pi * radius_m**2), 0.0))
