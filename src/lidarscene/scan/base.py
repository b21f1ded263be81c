"""What every scanner can do, and what those with moving parts share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Protocol

import numpy as np

from ..maths.arrays import Array, xp
from ..maths.pose import direction_from_angles
from ..maths.units import Quantity
from ..maths.vectors import Vector, angles_of

Matrix = np.ndarray[Any, Any]


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
    def jitter_rad(self) -> Array | None:
        """Standard deviation of the pointing across the beam, on each of two axes, or None: exact."""

    def direction(self, pulse: Array) -> Vector:
        """Unit vector (x, y, z) in which each pulse leaves, without the jitter."""

    def angles(self, pulse: Array) -> tuple[Array, Array]:
        """Azimuth and elevation [rad] that the sensor reports: of `direction`, as its encoders read it."""

    def channel(self, pulse: Array) -> Array:
        """Channel (row, laser, ring, facet) of each pulse."""

    def aperture_share(self, pulse: Array) -> Array:
        """A(theta_r) / A(0) of (4): what is left of the receiver's aperture in each pulse's direction."""

    def background_share(self, pulse: Array) -> Array:
        """The same of aperture times field of view, by which an extended source fills the detector: of (8)."""

    def offset_m(self, pulse: Array) -> Vector | None:
        """Where each beam starts in the sensor's frame, or None: all of them in its origin."""

    def time_s(self, pulse: Matrix) -> Matrix:
        """(n,) float64 emission time from the first pulse of frame 0."""


Jitter = Annotated[
    Array | None,
    Quantity("mrad", gt=0, about="standard deviation of the pointing on each axis across the beam"),
]
Encoder = Annotated[
    Array | None,
    Quantity(
        "deg",
        name="encoder_step_deg",
        gt=0,
        about="of the encoders on the mechanism; the reported angles are rounded to it",
    ),
]
Rotation = Annotated[float, Quantity(ge=-1e6, le=1e6, about="positive is counter-clockwise seen from above")]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mechanism:
    """Base of the scanners: mechanical angles, and optics that make directions of them.

    jitter_rad   as in `Scanner`
    encoder_rad  step of the encoders on the mechanical angles, or None: they are known exactly

    The beam leaves where the mechanism is; the sensor believes its encoders, which round to the nearest step.
    """

    jitter_rad: Jitter = None
    encoder_rad: Encoder = None

    @property
    def line_pulses(self) -> int | None:
        """There are no scan lines."""
        return None

    def _mechanism(self, pulse: Array) -> tuple[Array, ...]:
        """Mechanical angles [rad] that an encoder could read."""
        raise NotImplementedError

    def _optics(self, pulse: Array, turned: tuple[Array, ...]) -> tuple[Vector, Array]:
        """Direction, and share of the aperture, with the mechanism turned by so much."""
        raise NotImplementedError

    def _read(self, pulse: Array) -> tuple[Array, ...]:
        """The mechanical angles as the encoders give them."""
        step = self.encoder_rad
        turned = self._mechanism(pulse)
        return turned if step is None else tuple(xp(a).rint(a / step) * step for a in turned)

    def direction(self, pulse: Array) -> Vector:
        """Unit vector (x, y, z) in which each pulse leaves."""
        return self._optics(pulse, self._mechanism(pulse))[0]

    def angles(self, pulse: Array) -> tuple[Array, Array]:
        """Azimuth and elevation [rad] that the sensor reports."""
        return angles_of(self._optics(pulse, self._read(pulse))[0])

    def aperture_share(self, pulse: Array) -> Array:
        """A(theta_r) / A(0)."""
        return self._optics(pulse, self._mechanism(pulse))[1]

    def background_share(self, pulse: Array) -> Array:
        """What stops the beam takes aperture away and leaves the field of view as it is."""
        return self.aperture_share(pulse)

    def channel(self, pulse: Array) -> Array:
        """Channel 0: there is one laser."""
        return xp(pulse).int32(pulse) * 0

    def offset_m(self, pulse: Array) -> Vector | None:
        """All beams start in the sensor's origin."""
        return None


class GivenAngles(Mechanism):
    """Base of the scanners whose directions are given, not derived: the mechanical angles are those of the beam.

    Nothing is known of an aperture in motion either, so A(theta_r) = A(0).
    """

    __slots__ = ()

    def _optics(self, pulse: Array, turned: tuple[Array, ...]) -> tuple[Vector, Array]:
        azimuth, elevation = turned
        return direction_from_angles(azimuth_rad=azimuth, elevation_rad=elevation), 1.0

    def angles(self, pulse: Array) -> tuple[Array, Array]:
        """Azimuth and elevation [rad], as the encoders read them."""
        azimuth, elevation = self._read(pulse)
        return azimuth, elevation


def in_frame(pulse: Matrix, pulses: int) -> tuple[Matrix, Matrix]:
    """Number of the frame, and of the pulse in it; 64 bits."""
    return np.divmod(np.asarray(pulse, dtype=np.int64), pulses)
