"""Protocol of all scanners, and base classes of those with moving parts.

The rest of the simulation uses only the protocol `Scanner`, so a new mechanism changes nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Protocol, Self

import numpy as np

from ..maths.arrays import Lanes, Numbers, xp
from ..maths.attributes import HintedAttributes
from ..maths.pose import direction_from_angles
from ..maths.units import Quantity
from ..maths.vectors import Vector, angles_of
from .clock import PulseClock


class Scanner(Protocol):
    """Pulse numbers in firing order to times and directions in the sensor's frame.

    A frame is pulses 0 .. pulses - 1; the next numbers belong to the next frame, and the pattern continues as the
    mechanism does. Pulse numbers are (n,) whole numbers: of 64 bits in numpy, below 2^31 in Dr.Jit, where they begin
    again after whole frames, with a scanner `at_phase`. Results are of the same kind, in float32; only times are in
    float64, and on the device by the `clock`.
    """

    @property
    def pulses(self) -> int:
        """Pulses in one frame."""

    @property
    def frame_s(self) -> float:
        """Time from the first pulse of a frame to the first of the next."""

    @property
    def line_pulses(self) -> int | None:
        """Pulses of a scan line, if lines follow each other side by side; else None.

        For a bank of lasers, one firing of all of them.
        """

    @property
    def jitter_rad(self) -> Lanes | None:
        """Standard deviation of the pointing, on each of two axes across the beam; None: none."""

    def direction(self, pulse: Lanes) -> Vector:
        """Unit vector (x, y, z) of each pulse, without the jitter."""

    def angles(self, pulse: Lanes) -> tuple[Lanes, Lanes]:
        """Azimuth and elevation [rad] that the sensor reports: `direction` as read by its encoders."""

    def channel(self, pulse: Lanes) -> Lanes:
        """Channel (row, laser, ring, facet) of each pulse."""

    @property
    def channel_elevation_rad(self) -> Numbers | None:
        """(channels,) elevation of each channel, NaN for numbers that none has; None if channels are no rows."""

    def aperture_share(self, pulse: Lanes) -> Lanes:
        """A(theta_r) / A(0) of (4): share of the receiver's aperture in each pulse's direction."""

    @property
    def typical_share(self) -> Lanes:
        """A / A(0) in the direction for which ranges are told: 1 on the axis, behind prisms the mean of the pulses."""

    def background_share(self, pulse: Lanes) -> Lanes:
        """Share of aperture times field of view in each pulse's direction, for (8).

        An extended source fills the detector, so its light goes with this product.
        """

    def intensity_gain(self, pulse: Lanes) -> Lanes | None:
        """Factor of each pulse's reported reflectivity that the maker's calibration leaves; None: all 1."""

    def offset_m(self, pulse: Lanes) -> Vector | None:
        """Start of each beam in the sensor's frame, or None: all start at its origin."""

    @property
    def clock(self) -> PulseClock:
        """Emission times, by the plain scanner: numbers on the device are in single precision."""

    def time_s(self, pulse: Numbers) -> Numbers:
        """(n,) float64 emission time since the first pulse of frame 0; a new array, which the caller may change."""

    def phase(self, pulse: int) -> tuple[int, ...]:
        """State of the mechanism at the first pulse of a frame, signed 32-bit numbers; () if all frames are alike."""

    def at_phase(self, phase: tuple[Lanes, ...]) -> Self:
        """The same scanner, with the mechanism in this state at pulse 0."""


Jitter = Annotated[
    Lanes | None,
    Quantity("mrad", ge=2e-4, le=3000, about="standard deviation of the pointing on each axis across the beam"),
]
Encoder = Annotated[
    Lanes | None,
    Quantity(
        "deg",
        name="encoder_step_deg",
        ge=1e-6,
        le=90,
        about="of the encoders on the mechanism; the reported angles are rounded to it",
    ),
]
Rotation = Annotated[float, Quantity(ge=-1e6, le=1e6, about="positive is counter-clockwise seen from above")]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mechanism(HintedAttributes):
    """Base of the scanners: mechanical angles, and optics that turn them into directions.

    The beam follows the mechanism; the sensor reports its encoders, which round to the nearest step.

    Attributes:
        jitter_rad: as in `Scanner`
        encoder_rad: step of the encoders on the mechanical angles, or None: read exactly
    """

    FOREIGN_NAMES: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("fov", "field_of_view", "resolution"), "lidarscene.fov(sensor) studies it"),
        **dict.fromkeys(
            ("frame_rate", "fps", "rpm", "rotation_rate", "frequency", "rate"), "1 / sensor.scanner.frame_s"
        ),
        **dict.fromkeys(
            ("channels", "beams", "rings", "lasers", "lines", "elevation", "elevations"),
            "sensor.scanner.channel_elevation_rad has the elevation of each channel",
        ),
        **dict.fromkeys(("points", "n_points", "shots", "points_per_frame"), "sensor.scanner.pulses"),
        "pattern": "sensor.plot()",
    }

    jitter_rad: Jitter = None
    encoder_rad: Encoder = None

    @property
    def line_pulses(self) -> int | None:
        """None: no scan lines."""
        return None

    def _mechanism(self, pulse: Lanes) -> tuple[Lanes, ...]:
        """Mechanical angles [rad] that an encoder could read."""
        raise NotImplementedError

    def _optics(self, pulse: Lanes, turned: tuple[Lanes, ...]) -> tuple[Vector, Lanes]:
        """Direction, and share of the aperture, for these mechanical angles."""
        raise NotImplementedError

    def _read(self, pulse: Lanes) -> tuple[Lanes, ...]:
        """The mechanical angles as the encoders report them."""
        # An encoder sits on the shaft: it rounds the mechanical angle, before any optics.
        step = self.encoder_rad
        turned = self._mechanism(pulse)
        return turned if step is None else tuple(xp(a).rint(a / step) * step for a in turned)

    def direction(self, pulse: Lanes) -> Vector:
        """Unit vector (x, y, z) of each pulse."""
        return self._optics(pulse, self._mechanism(pulse))[0]

    def angles(self, pulse: Lanes) -> tuple[Lanes, Lanes]:
        """Azimuth and elevation [rad] that the sensor reports."""
        return angles_of(self._optics(pulse, self._read(pulse))[0])

    def aperture_share(self, pulse: Lanes) -> Lanes:
        """A(theta_r) / A(0)."""
        return self._optics(pulse, self._mechanism(pulse))[1]

    @property
    def typical_share(self) -> Lanes:
        """1: on the axis."""
        return 1.0

    def background_share(self, pulse: Lanes) -> Lanes:
        """Aperture share: what stops the beam leaves the field of view unchanged."""
        return self.aperture_share(pulse)

    def intensity_gain(self, pulse: Lanes) -> Lanes | None:
        """None: all are calibrated alike."""
        return None

    @property
    def clock(self) -> PulseClock:
        """Emission times."""
        raise NotImplementedError

    def time_s(self, pulse: Numbers) -> Numbers:
        """Times by the clock, in NumPy."""
        return np.asarray(self.clock.time_s(np.asarray(pulse, dtype=np.int64)))

    def channel(self, pulse: Lanes) -> Lanes:
        """0: there is one laser."""
        return xp(pulse).int32(pulse) * 0

    @property
    def channel_elevation_rad(self) -> Numbers | None:
        """None: channels are no rows."""
        return None

    def offset_m(self, pulse: Lanes) -> Vector | None:
        """None: all beams start at the sensor's origin."""
        return None

    def phase(self, pulse: int) -> tuple[int, ...]:
        """(): all frames are alike."""
        return ()

    def at_phase(self, phase: tuple[Lanes, ...]) -> Self:
        """The scanner itself: all frames are alike."""
        return self


class GivenAngles(Mechanism):
    """Base of the scanners whose directions are given: the mechanical angles are those of the beam.

    The mechanism is unknown, so its aperture is too: A(theta_r) = A(0).
    """

    __slots__ = ()

    def _optics(self, pulse: Lanes, turned: tuple[Lanes, ...]) -> tuple[Vector, Lanes]:
        azimuth, elevation = turned
        return direction_from_angles(azimuth_rad=azimuth, elevation_rad=elevation), 1.0

    def angles(self, pulse: Lanes) -> tuple[Lanes, Lanes]:
        """Azimuth and elevation [rad], as the encoders read them."""
        azimuth, elevation = self._read(pulse)
        return azimuth, elevation


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SteadyPulses(Mechanism):
    """Base of the scanners that fire one pulse after the other, without a pause.

    Attributes:
        pulses: as in `Scanner`
    """

    pulses: int
    rate_hz: float

    @property
    def frame_s(self) -> float:
        """Length of a frame."""
        return self.pulses / self.rate_hz

    @property
    def clock(self) -> PulseClock:
        """One pulse after the other, without a pause."""
        return PulseClock(rate_hz=self.rate_hz)


class LineByLine(Mechanism):
    """Base of the scanners of which a frame is ``rows`` lines of ``columns`` pulses, and a line is a channel."""

    __slots__ = ()
    columns: int
    rows: int

    @property
    def pulses(self) -> int:
        """Pulses in one frame."""
        return self.columns * self.rows

    @property
    def line_pulses(self) -> int:
        """Pulses of a line."""
        return self.columns

    def _row_and_column(self, pulse: Lanes) -> tuple[Lanes, Lanes]:
        ops = xp(pulse)
        line, column = ops.divmod(pulse, self.columns)
        return ops.divmod(line, self.rows)[1], column

    def channel(self, pulse: Lanes) -> Lanes:
        """Row of each pulse, 0 at the top."""
        return self._row_and_column(pulse)[0]

    @property
    def channel_elevation_rad(self) -> Numbers | None:
        """Elevation of each row in its middle."""
        return self._row_elevations()

    def _row_elevations(self) -> Numbers:
        middle = np.arange(self.columns // 2, self.pulses, self.columns)
        elevation = np.zeros(self.rows)
        elevation[np.asarray(self.channel(middle))] = self.angles(middle)[1]
        return elevation
