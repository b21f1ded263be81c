"""SPADs of one pixel as data."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Literal

from ...maths.arrays import Lanes
from ...maths.units import STATIC, FileKey, Quantity
from .geiger import GeigerDetector


@dataclass(frozen=True, slots=True, kw_only=True)
class SpadArray(GeigerDetector):
    """Macro-pixel of single-photon avalanche diodes. SI units.

    Attributes:
        stamps: "all": a SPAD fires again after its dead time; "first": once in a shot
        coincidence: 1: each SPAD has its own time stamps; else the pixel has one for a bin in which that many SPADs
            fire
        afterpulse: afterpulses of each firing, whether their SPAD is free by then or not; None: no such thing
    """

    label: ClassVar[str] = "SPAD histogram"
    unit: ClassVar[str] = "photons"
    fills_histogram: ClassVar[bool] = True

    spads: Annotated[Lanes, Quantity(ge=1, le=1e6, whole=True, about="SPADs of one pixel")]
    radius_m: Annotated[
        Lanes, Quantity("mm", ge=1e-3, le=100, about="of a disc of the pixel's area: the field of view")
    ]
    dead_time_s: Annotated[Lanes, Quantity("ns", ge=0.01, le=1e5, about="after a firing")]
    jitter_s: Annotated[
        Lanes, Quantity("ps", ge=0, le=1e6, finest=1e-3, about="standard deviation of a time stamp")
    ] = 0.0
    stamps: Annotated[
        Literal["all", "first"],
        FileKey(about='time stamps of a SPAD in a shot: "all" that its dead time allows, or the "first"'),
    ] = "all"
    coincidence: Annotated[
        int, Quantity(ge=1, le=16, about="SPADs that must fire in one bin to count; 1: each one counts")
    ] = field(default=1, metadata=STATIC)
    afterpulse: Annotated[
        Lanes | None,
        Quantity(
            ge=0,
            le=0.5,
            about="with `afterpulse_ns`: fraction of firings after which the same SPAD fires again if it is free; none "
            "if left out",
        ),
    ] = None
    afterpulse_s: Annotated[
        Lanes | None, Quantity("ns", ge=0.01, le=1e5, about="with `afterpulse`: their mean delay, exponential")
    ] = None

    @property
    def number_of_cells(self) -> Lanes:
        """SPADs of the pixel."""
        return self.spads

    @property
    def fires_once(self) -> bool:
        """True if a SPAD fires once in a shot."""
        return self.stamps == "first"
