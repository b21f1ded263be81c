"""What every scanner can do, and what those with moving parts share."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np

from ..maths.arrays import Lanes, Numbers, xp
from ..maths.pose import direction_from_angles
from ..maths.vectors import Vector, angles_of


class Scanner(Protocol):
    """Pulse numbers in firing order to times and directions in the sensor's frame.

    A frame is pulses 0 .. pulses - 1; the numbers that follow belong to the frames that follow, and the pattern
    goes on as the mechanism does. Pulse numbers are (n,) 32-bit unsigned below 2^31, numpy or Dr.Jit, and what comes
    back is like them, float32; only times are always numpy, float64.
    """

    @property
    def pulses(self) -> int:
        """Pulses in one frame."""

    @property
    def frame_s(self) -> float:
        """From the first pulse of a frame to the first of the next."""

    @property
    def line_pulses(self) -> int | None:
        """Pulses of a scan line (of a bank of lasers, a firing of all) if lines follow each other side by side."""

    @property
    def jitter_rad(self) -> Lanes | None:
        """Standard deviation of the pointing across the beam, on each of two axes, or None: exact."""

    def direction(self, pulse: Lanes) -> Vector:
        """Unit vector (x, y, z) in which each pulse leaves, without the jitter."""

    def angles(self, pulse: Lanes) -> tuple[Lanes, Lanes]:
        """Azimuth and elevation [rad] that the sensor reports: of `direction`, as its encoders read it."""

    def channel(self, pulse: Lanes) -> Lanes:
        """Channel (row, laser, ring, facet) of each pulse."""

    def aperture_share(self, pulse: Lanes) -> Lanes:
        """A(theta_r) / A(0) of (4): what is left of the receiver's aperture in each pulse's direction."""

    def background_share(self, pulse: Lanes) -> Lanes:
        """The same of aperture times field of view, by which an extended source fills the detector: of (8)."""

    def offset_m(self, pulse: Lanes) -> Vector | None:
        """Where each beam starts in the sensor's frame, or None: all of them in its origin."""

    def time_s(self, pulse: Numbers) -> Numbers:
        """(n,) float64 emission time from the first pulse of frame 0."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mechanism:
    """Base of the scanners: mechanical angles, and optics that make directions of them.

    jitter_rad   as in `Scanner`
    encoder_rad  step of the encoders on the mechanical angles, or None: they are known exactly

    The beam leaves where the mechanism is; the sensor believes its encoders, which round to the nearest step.
    """

    jitter_rad: Lanes | None = None
    encoder_rad: Lanes | None = None

    def with_errors(self, *, jitter_rad: Lanes | None, encoder_rad: Lanes | None) -> Self:
        """The same mechanism with this pointing jitter and these encoders."""
        return replace(self, jitter_rad=jitter_rad, encoder_rad=encoder_rad)

    @property
    def line_pulses(self) -> int | None:
        """There are no scan lines."""
        return None

    def _mechanism(self, pulse: Lanes) -> tuple[Lanes, ...]:
        """Mechanical angles [rad] that an encoder could read."""
        raise NotImplementedError

    def _optics(self, pulse: Lanes, turned: tuple[Lanes, ...]) -> tuple[Vector, Lanes]:
        """Direction, and share of the aperture, with the mechanism turned by so much."""
        raise NotImplementedError

    def _read(self, pulse: Lanes) -> tuple[Lanes, ...]:
        """The mechanical angles as the encoders give them."""
        step = self.encoder_rad
        turned = self._mechanism(pulse)
        return turned if step is None else tuple(xp(a).rint(a / step) * step for a in turned)

    def direction(self, pulse: Lanes) -> Vector:
        """Unit vector (x, y, z) in which each pulse leaves."""
        return self._optics(pulse, self._mechanism(pulse))[0]

    def angles(self, pulse: Lanes) -> tuple[Lanes, Lanes]:
        """Azimuth and elevation [rad] that the sensor reports."""
        return angles_of(self._optics(pulse, self._read(pulse))[0])

    def aperture_share(self, pulse: Lanes) -> Lanes:
        """A(theta_r) / A(0)."""
        return self._optics(pulse, self._mechanism(pulse))[1]

    def background_share(self, pulse: Lanes) -> Lanes:
        """What stops the beam takes aperture away and leaves the field of view as it is."""
        return self.aperture_share(pulse)

    def channel(self, pulse: Lanes) -> Lanes:
        """Channel 0: there is one laser."""
        return xp(pulse).int32(pulse) * 0

    def offset_m(self, pulse: Lanes) -> Vector | None:
        """All beams start in the sensor's origin."""
        return None


class GivenAngles(Mechanism):
    """Base of the scanners whose directions are given, not derived: the mechanical angles are those of the beam.

    Nothing is known of an aperture in motion either, so A(theta_r) = A(0).
    """

    __slots__ = ()

    def _optics(self, pulse: Lanes, turned: tuple[Lanes, ...]) -> tuple[Vector, Lanes]:
        azimuth, elevation = turned
        return direction_from_angles(azimuth_rad=azimuth, elevation_rad=elevation), 1.0

    def angles(self, pulse: Lanes) -> tuple[Lanes, Lanes]:
        """Azimuth and elevation [rad], as the encoders read them."""
        azimuth, elevation = self._read(pulse)
        return azimuth, elevation


def in_frame(pulse: Numbers, pulses: int) -> tuple[Numbers, Numbers]:
    """Number of the frame, and of the pulse in it; 64 bits."""
    return np.divmod(np.asarray(pulse, dtype=np.int64), pulses)
