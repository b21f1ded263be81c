"""Rotating head: a bank of lasers, each at its own elevation, turned about the vertical axis and fired in turn.

In a cycle every laser fires once, at its own time, while the head keeps turning; a beam's azimuth is the head's at
that moment plus the laser's own. That shear is visible in the cloud. The head carries lasers and receivers together,
so the receiver always faces its beam: A(theta_r) = A(0), times the responsivity of the laser's own receiver. The
sensor's x axis is azimuth 0.

A mirror with several faces can carry the beams of such a bank instead: each face sweeps them over the same field, at
twice the mirror's rate. Between two faces no pulse leaves (`sweep_deg`, `frame_hz`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ..errors import InputError
from ..files.table_model import Number
from ..maths.arrays import Lanes, LookupTable, Numbers, xp
from ..maths.pose import direction_from_angles
from ..maths.units import Quantity, SameTable, si
from ..maths.vectors import Vector
from .base import Encoder, Jitter, Mechanism, Rotation
from .clock import PulseClock
from .scanner_file import ScannerContext, ScannerFile, require_fewer
from .turns import Turns


@dataclass(frozen=True, slots=True, kw_only=True)
class Bank:
    """The lasers of a head, in any order.

    Attributes:
        channel: number of each laser, where one fires more than once in a cycle; None: 0, 1, 2, ...
        azimuth_rad: azimuth of each laser, from the head's own; None: all 0
        firing_s: after the cycle's start; None: all at once
        start_m: (x, y, z) of each laser's exit in the head; None: all in the origin
        responsivity: responsivity of each laser's receiver, over that of the sensor file's numbers; None: all 1
        background_gain: background that each receiver counts beside that, as with a wider field of view; None: all 1
        intensity_gain: reported reflectivity of each laser over the true one, what its calibration leaves; None: all 1
    """

    elevation_rad: Annotated[Sequence[float], Quantity("deg", ge=-90, le=90, least=1, about="of each laser")]
    channel: Annotated[
        Sequence[float] | None,
        Quantity(ge=0, le=1e6, about="number of each laser, where one fires more than once; 0, 1, 2, ... if left out"),
    ] = None
    azimuth_rad: Annotated[
        Sequence[float] | None,
        Quantity("deg", name="azimuth_offset_deg", ge=-360, le=360, about="of each laser in the head; 0 if left out"),
    ] = None
    firing_s: Annotated[
        Sequence[float] | None,
        Quantity(
            "us",
            name="firing_time_us",
            ge=0,
            le=1e7,
            finest=1e-3,
            about="after the start of the cycle; all at once if left out",
        ),
    ] = None
    start_m: tuple[Sequence[float], Sequence[float], Sequence[float]] | None = None
    responsivity: Annotated[
        Sequence[float] | None,
        Quantity(ge=0.01, le=100, about="of each laser's receiver, to echoes and background alike; all 1 if left out"),
    ] = None
    background_gain: Annotated[
        Sequence[float] | None,
        Quantity(
            ge=0.01,
            le=100,
            about="of each laser's receiver, to the background beside that, as of wider fields; all 1 if left out",
        ),
    ] = None
    intensity_gain: Annotated[
        Sequence[float] | None,
        Quantity(
            ge=0.1, le=10, about="of each laser's reported reflectivity, what its calibration leaves; all 1 if left out"
        ),
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AzimuthSweep:
    """Where frames begin, and how far they go: whole turns, or the field of a mirror's face.

    Attributes:
        sweep_rad: turn of the beams in a frame; the next one begins anew. None: they turn on
        frame_hz: frames per second; None: one after the other
    """

    start_azimuth_rad: Annotated[
        float, Quantity("deg", ge=-360, le=360, about="of the head at the start of the first frame")
    ] = 0.0
    sweep_rad: Annotated[
        float | None,
        Quantity("deg", gt=0, le=360, about="of a mirror's face, then the next one starts anew; else whole turns"),
    ] = None
    frame_hz: Annotated[float | None, Quantity(ge=1e-4, le=1e6, about="sweeps per second, with sweep_deg")] = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spinning(Mechanism):
    """A head of ``lasers`` lasers; one frame is the number of cycles nearest to one turn, or a sweep. Made by `create`.

    Tables by place in the firing order: elevation_rad, azimuth_rad (the laser's own), lead_rad (turn of the head from
    the cycle's start to the firing), lasers_by_place (number of the laser as given), start_m (x, y, z of the laser's
    exit in the head, or None), responsivity, background_gain and gains (of the reported reflectivity; or None: all 1).

    Attributes:
        sweep_period_s: time from sweep to sweep, each from the same azimuth; None: the head turns on
    """

    cycles: int
    lasers: int
    cycle_s: float
    firing_s: Numbers
    head: Turns
    elevation_rad: LookupTable
    azimuth_rad: LookupTable
    lead_rad: LookupTable
    lasers_by_place: LookupTable
    start_m: tuple[LookupTable, LookupTable, LookupTable] | None = None
    responsivity: LookupTable | None = None
    background_gain: LookupTable | None = None
    gains: LookupTable | None = None
    sweep_period_s: float | None = None

    @classmethod
    def create(
        cls,
        *,
        rotation_hz: Rotation,
        cycle_s: Annotated[
            float | None, Quantity("us", ge=0.01, le=1e7, about="from cycle to cycle; this or the next")
        ] = None,
        cycles_per_turn: Annotated[
            int | None, Quantity(name="columns_per_turn", ge=1, le=2**24, about="cycles in a turn")
        ] = None,
        bank: Annotated[Bank, SameTable()],
        sweep: Annotated[AzimuthSweep, SameTable()] = AzimuthSweep(),
        jitter_rad: Jitter = None,
        encoder_rad: Encoder = None,
    ) -> Spinning:
        """Build from the bank of lasers; numbers of `channel` are places in its lists.

        One of ``cycle_s`` and ``cycles_per_turn`` is None; with the latter frames close exactly.
        """
        azimuth_rad = bank.azimuth_rad or (0.0,) * len(bank.elevation_rad)
        firing_s, start_m = bank.firing_s or (0.0,) * len(bank.elevation_rad), bank.start_m
        period_s = 1.0 / abs(rotation_hz)
        # Clocked by the encoder, a turn has a whole number of cycles and every frame looks alike. Clocked by time, the
        # pattern drifts from turn to turn. A fraction keeps either exact over all pulse numbers.
        if cycles_per_turn is not None:
            cycle_s = period_s / cycles_per_turn
            step = Fraction(1 if rotation_hz > 0 else -1, cycles_per_turn)
        else:
            assert cycle_s is not None
            cycles_per_turn = max(1, round(period_s / cycle_s))
            step = Fraction(rotation_hz) * Fraction(cycle_s)
        if sweep.sweep_rad is not None:
            cycles_per_turn = max(1, round(sweep.sweep_rad / math.tau * cycles_per_turn))
        # Pulse numbers follow time, while a data sheet lists lasers from the top: `lasers_by_place` leads back.
        order = np.argsort(np.asarray(firing_s), kind="stable")

        def table(values: object) -> LookupTable:
            return LookupTable(np.asarray(values, dtype=np.float64)[order])

        return cls(
            cycles=cycles_per_turn,
            lasers=len(order),
            cycle_s=cycle_s,
            firing_s=np.asarray(firing_s, dtype=np.float64)[order],
            head=Turns.from_fraction(step, start_rad=sweep.start_azimuth_rad),
            elevation_rad=table(bank.elevation_rad),
            azimuth_rad=table(azimuth_rad),
            lead_rad=table(math.tau * rotation_hz * np.asarray(firing_s)),
            lasers_by_place=table(np.arange(len(order)) if bank.channel is None else bank.channel),
            start_m=None if start_m is None else (table(start_m[0]), table(start_m[1]), table(start_m[2])),
            responsivity=None if bank.responsivity is None else table(bank.responsivity),
            background_gain=None if bank.background_gain is None else table(bank.background_gain),
            gains=None if bank.intensity_gain is None else table(bank.intensity_gain),
            sweep_period_s=None if sweep.sweep_rad is None or sweep.frame_hz is None else 1.0 / sweep.frame_hz,
            jitter_rad=jitter_rad,
            encoder_rad=encoder_rad,
        )

    @property
    def pulses(self) -> int:
        """Pulses in one frame."""
        return self.cycles * self.lasers

    @property
    def frame_s(self) -> float:
        """Length of a frame."""
        return self.cycles * self.cycle_s if self.sweep_period_s is None else self.sweep_period_s

    @property
    def line_pulses(self) -> int:
        """Pulses of a cycle."""
        return self.lasers

    def _place(self, pulse: Lanes) -> tuple[Lanes, Lanes]:
        """Cycle of each pulse, and the laser's place in the firing order."""
        ops = xp(pulse)
        return ops.divmod(pulse, self.lasers)

    def _mechanism(self, pulse: Lanes) -> tuple[Lanes]:
        cycle, place = self._place(pulse)
        ops = xp(pulse)
        if self.sweep_period_s is not None:
            cycle = ops.divmod(cycle, self.cycles)[1]
        return (self.head.angle_rad(cycle) + ops.float32(ops.take(self.lead_rad, place)),)

    def _azimuth_elevation(self, pulse: Lanes, head: Lanes) -> tuple[Lanes, Lanes]:
        ops, place = xp(pulse), self._place(pulse)[1]
        # The head turns on while its lasers fire: `lead_rad` is in the head's angle, the laser's own offset comes here.
        azimuth = head + ops.float32(ops.take(self.azimuth_rad, place))
        # Into -pi to pi, where single precision is finest and where sensors report.
        azimuth = azimuth - math.tau * ops.rint(azimuth * (1.0 / math.tau))
        return azimuth, ops.float32(ops.take(self.elevation_rad, place))

    def _optics(self, pulse: Lanes, turned: tuple[Lanes, ...]) -> tuple[Vector, Lanes]:
        azimuth, elevation = self._azimuth_elevation(pulse, turned[0])
        return direction_from_angles(azimuth_rad=azimuth, elevation_rad=elevation), 1.0

    def angles(self, pulse: Lanes) -> tuple[Lanes, Lanes]:
        """Azimuth, -pi to pi, and elevation [rad] that the sensor reports."""
        return self._azimuth_elevation(pulse, self._read(pulse)[0])

    def aperture_share(self, pulse: Lanes) -> Lanes:
        """The receiver's responsivity: it counts less of all light, as with a smaller aperture."""
        return self._laser_factor(self.responsivity, pulse)

    def background_share(self, pulse: Lanes) -> Lanes:
        """The responsivity, times what each receiver counts of the background beside."""
        return self._laser_factor(self.responsivity, pulse) * self._laser_factor(self.background_gain, pulse)

    def intensity_gain(self, pulse: Lanes) -> Lanes | None:
        """Reported reflectivity over the true one, by laser."""
        return None if self.gains is None else self._laser_factor(self.gains, pulse)

    def _laser_factor(self, factors: LookupTable | None, pulse: Lanes) -> Lanes:
        if factors is None:
            return 1.0
        ops = xp(pulse)
        return ops.float32(ops.take(factors, self._place(pulse)[1]))

    def channel(self, pulse: Lanes) -> Lanes:
        """Number of the laser as given."""
        ops = xp(pulse)
        return ops.int32(ops.take(self.lasers_by_place, self._place(pulse)[1]))

    @property
    def channel_elevation_rad(self) -> Numbers:
        """Elevation of each laser, by its number."""
        laser = np.asarray(self.lasers_by_place.values, np.int64)
        elevation = np.full(laser.max() + 1, np.nan)
        elevation[laser] = self.elevation_rad.values
        return elevation

    def offset_m(self, pulse: Lanes) -> Vector | None:
        """The laser's exit, turned with the head; None if all are at the origin."""
        if self.start_m is None:
            return None
        ops, place = xp(pulse), self._place(pulse)[1]
        x, y, z = (ops.float32(ops.take(table, place)) for table in self.start_m)
        (head,) = self._mechanism(pulse)
        cos, sin = ops.cos(head), ops.sin(head)
        return cos * x - sin * y, sin * x + cos * y, z

    def phase(self, pulse: int) -> tuple[int, ...]:
        """The head's; () of sweeps, which begin anew."""
        return () if self.sweep_period_s is not None else (self.head.steps(pulse // self.lasers),)

    def at_phase(self, phase: tuple[Lanes, ...]) -> Self:
        """The scanner with the head there."""
        return replace(self, head=self.head.from_start(phase[0])) if phase else self

    @property
    def clock(self) -> PulseClock:
        """Sweeps, if the head does not turn on, cycles, and times from the firing table."""
        sweep = () if self.sweep_period_s is None else ((self.pulses, self.sweep_period_s),)
        return PulseClock(levels=(*sweep, (self.lasers, self.cycle_s)), times_s=self.firing_s)


Millimetres = Annotated[float, Number("mm", ge=-1e4, le=1e4, finest=0.1)]


class SpinningFile(ScannerFile[Spinning]):
    """[scanner] type = "spinning": a rotating head; the lists have one entry for each laser."""

    type: Literal["spinning"]
    elevation_shift_deg: Annotated[float, Field(ge=-10, le=10)] = Field(
        default=0.0, description="added to all elevations, as units differ"
    )
    elevation_scale: Annotated[float, Field(ge=0.8, le=1.2)] = Field(
        default=1.0, description="factor of all elevations, before the shift"
    )
    forward_mm: tuple[Millimetres, ...] | None = Field(
        default=None, description="where each beam starts, in the head; 0 if left out"
    )
    left_mm: tuple[Millimetres, ...] | None = Field(default=None, description="the same")
    height_mm: tuple[Millimetres, ...] | None = Field(default=None, description="the same")

    @property
    def cycle_s(self) -> float:
        """Time from cycle to cycle."""
        if self.cycle_us is not None:
            return si(float(self.cycle_us), "us")
        return 1.0 / float(abs(self.rotation_hz) * self.columns_per_turn)

    @property
    def firing_rate_hz(self) -> float:
        """All lasers once in each cycle."""
        return len(self.elevation_deg) / self.cycle_s

    @property
    def turn_rate_rad_s(self) -> float:
        """That of the head."""
        return math.tau * float(self.rotation_hz)

    def shot_period_us(self, pulse_period_us: float) -> float:
        """Each laser has a receiver, which listens until that laser's next pulse."""
        return self.cycle_s * 1e6

    @model_validator(mode="after")
    def _fits_together(self) -> SpinningFile:
        if (self.cycle_us is None) == (self.columns_per_turn is None):
            raise ValueError("one of cycle_us and columns_per_turn must be given, got both or none")
        if self.rotation_hz == 0.0:
            raise ValueError("rotation_hz: must not be 0")
        if (self.sweep_deg is None) != (self.frame_hz is None):
            raise ValueError("sweep_deg and frame_hz must be given together, got one")
        if self.sweep_deg is not None and self.sweep_deg / (360.0 * abs(self.rotation_hz)) * self.frame_hz > 1.0 + 1e-9:
            sweep_s = self.sweep_deg / (360.0 * abs(self.rotation_hz))
            raise ValueError(
                f"frame_hz: must be <= {1.0 / sweep_s:g}, for a sweep takes {sweep_s:g} s, got {self.frame_hz:g}"
            )
        lasers = len(self.elevation_deg)
        for key, values in self:
            if isinstance(values, tuple) and len(values) != lasers:
                raise ValueError(f"{key}: must have {lasers} entries, as elevation_deg has, got {len(values)}")
        last_us = max(self.firing_time_us or (0.0,))
        if si(last_us, "us") >= self.cycle_s:
            raise ValueError(f"firing_time_us: must be < {self.cycle_s * 1e6:g}, the cycle, got {last_us:g}")
        require_fewer(lasers / self.cycle_s / abs(self.rotation_hz))
        return self

    def build(self, context: ScannerContext) -> Spinning:
        """Convert to SI units; the laser's rate must agree with the firing table to 1 %.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        lasers = len(self.elevation_deg)
        rate_hz = self.firing_rate_hz
        # The rate follows from the firing table. The file states it too, for the laser: both must agree.
        if abs(context.rate_hz / rate_hz - 1.0) > 0.01:
            raise InputError(
                f"laser.repetition_rate_khz: must be {rate_hz * 1e-3:.3f}, for {lasers} lasers every"
                f" {self.cycle_s * 1e6:g} us, got {context.rate_hz * 1e-3:g}"
            )
        starts = self.forward_mm, self.left_mm, self.height_mm
        x, y, z = (si(values or (0.0,) * lasers, "mm") for values in starts)
        elevation_deg = [
            self.elevation_scale * angle_deg + self.elevation_shift_deg for angle_deg in self.elevation_deg
        ]
        if max(map(abs, elevation_deg)) > 90.0:
            raise InputError(f"scanner: elevations must be -90 to 90 degrees, got {max(elevation_deg, key=abs):g}")
        return self.in_si(
            elevation_rad=si(tuple(elevation_deg), "deg"), start_m=None if starts == (None, None, None) else (x, y, z)
        )
