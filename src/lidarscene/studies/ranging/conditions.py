"""Conditions of a study: target, light and air as options, with their bounds, and which of them an axis can be.

The command line reads them for ``--help``, so that this module loads no NumPy.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ...errors import OptionError, OptionWarning, warn
from ...files.arguments import require_type
from ...physics.constants import SUN_KLUX
from ...rendering.option_fields import Finite, OneOf, Whole, check_options, list_options, option

if TYPE_CHECKING:
    from .plane import Target


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """Allowed values of a condition, and the default ends of an axis over it.

    Attributes:
        above: True if ``low`` itself is excluded
        meaning: words for the axis of a chart
        multiple: this unit over the one that is typed by mistake: 1e3 of klux, for lux
        likely: largest value that needs no warning of that mistake
    """

    unit: str
    low: float
    high: float
    start: float = 0.0
    stop: float = 1.0
    log: bool = False
    above: bool = False
    meaning: str = ""
    multiple: float = 1.0
    likely: float = math.inf

    def check(self, option: str, value: float) -> None:
        """Raise OptionError unless the value is one of these."""
        if not self._holds(value):
            least = f"more than {self.low:g}" if self.above else f"{self.low:g} or more"
            most = f"{self.high:g} {self.unit}".rstrip()
            intended = value / self.multiple
            hint = f": did you mean {intended:g}?" if self.multiple != 1.0 and self._holds(intended) else ""
            raise OptionError(f"{{{option}}} {{0:g}}: must be {least} and up to {most}{hint}", value)

    def warn_of_unit(self, option: str, value: float) -> None:
        """Warn of an illuminance that no sun has, as a scene of it does: it is probably in lux."""
        if value > self.likely:
            warn(
                OptionWarning(
                    f"{{{option}}} is {{0:g}} {self.unit}, and no sun has more than {{1:g}}: if these are lux, give "
                    f"{{{option}}} {{2:g}}",
                    value,
                    self.likely,
                    value / self.multiple,
                )
            )

    def _holds(self, value: float) -> bool:
        return self.low <= value <= self.high and not (self.above and value == self.low)


CONDITIONS: dict[str, Bounds] = {
    "distance": Bounds(unit="m", low=0.0, high=1e6, start=10.0, stop=1000.0, log=True, above=True, meaning="distance"),
    "illuminance_klux": Bounds(
        unit="klux",
        low=0.0,
        high=1e4,
        start=0.1,
        stop=100.0,
        log=True,
        meaning="illuminance of the sun",
        multiple=1e3,
        likely=SUN_KLUX,
    ),
    "elevation": Bounds(unit="deg", low=-90.0, high=90.0, start=-12.5, stop=12.5, meaning="elevation of the beam"),
    "azimuth": Bounds(unit="deg", low=-180.0, high=180.0, start=-60.0, stop=60.0, meaning="azimuth of the beam"),
    "reflectivity": Bounds(
        unit="", low=0.0, high=1.0, start=0.01, stop=1.0, log=True, meaning="reflectivity of the target", multiple=100.0
    ),
    "incidence": Bounds(unit="deg", low=0.0, high=90.0, start=0.0, stop=85.0, meaning="angle of incidence"),
}
"""Conditions that can be swept, besides the keys of the sensor file."""

QUANTITIES = {"snr": "signal-to-noise ratio", "range": "range", "pd": "detection probability"}
"""Quantity that can be swept -> words."""

PROBABILITY = 0.9
"""Choice: P_d at the range, if no other is asked for. Makers state ranges at 0.5 to 0.9."""

APERTURE_LAWS = ("scanner", "constant", "cosine", "mirror")

CLEAR_AIR = 0.98
"""Source: Table 1 of the paper; transmittance of the air one way at any range."""


@list_options
@dataclass(frozen=True, slots=True, kw_only=True)
class Conditions:
    """Target, light and air, in the units of the command line.

    Raises:
        InputError: for a value out of bounds
    """

    probability: float = option(
        PROBABILITY,
        Bounds(unit="", low=0.001, high=0.999),
        help="detection probability that defines the range (default {default:g}); another one is part of the "
        "column's name: range_pd50_m",
        metavar="P_D",
    )
    distance: float = option(
        100.0,
        CONDITIONS["distance"],
        help="distance of the target in metres, for snr and pd (default {default:g})",
        metavar="M",
    )
    illuminance_klux: float = option(
        100.0, CONDITIONS["illuminance_klux"], help="illuminance on the target (default {default:g})", metavar="KLUX"
    )
    sun_angle: float = option(
        60.0,
        Bounds(unit="deg", low=0, high=180),
        help="angle between sun and surface normal (default {default:g})",
        metavar="DEG",
    )
    reflectivity: float = option(
        0.1, CONDITIONS["reflectivity"], help="reflectivity of the target (default {default:g})", metavar="SHARE"
    )
    incidence: float = option(
        0.0,
        CONDITIONS["incidence"],
        help="angle of incidence of the beam on the target (default {default:g})",
        metavar="DEG",
    )
    transmittance: float | None = option(
        None,
        Bounds(unit="", low=0.0, high=1.0, above=True),
        help=f"one-way transmittance of the air at any range (default {CLEAR_AIR})",
        metavar="SHARE",
    )
    extinction: float | None = option(
        None, Bounds(unit="per metre", low=0, high=100), help="extinction of the air, exp(-alpha R)", metavar="PER_M"
    )
    visibility: float | None = option(
        None,
        Bounds(unit="km", low=0.0, high=1e4, above=True),
        help="visibility in the air, with Kim's extinction",
        metavar="KM",
    )

    def __post_init__(self) -> None:
        check_options(self)
        CONDITIONS["illuminance_klux"].warn_of_unit("illuminance_klux", self.illuminance_klux)

    @property
    def range_words(self) -> str:
        """Words for the range: at which P_d."""
        return f"range at P_d {self.probability:g}"

    @property
    def range_column(self) -> str:
        """Name of the range in tables and files; another P_d than `PROBABILITY` is in it, in per cent."""
        return "range_m" if self.probability == PROBABILITY else f"range_pd{100.0 * self.probability:g}_m"

    @property
    def visibility_m(self) -> float | None:
        """Visibility in metres; None if it was not given."""
        return None if self.visibility is None else self.visibility * 1e3

    def target(self) -> Target:
        """Plane target under these conditions; the extinction of a visibility depends on the sensor's wavelength."""
        from .plane import Target

        clear = CLEAR_AIR if self.extinction is None and self.visibility is None else 1.0
        return Target(
            reflectivity=self.reflectivity,
            cos_incidence=max(math.cos(math.radians(self.incidence)), 0.0),
            # The cosine of 60 degrees misses the 0.5 of Table 1 by a rounding.
            cos_sun=0.5 if self.sun_angle == 60.0 else math.cos(math.radians(self.sun_angle)),
            illuminance_klux=self.illuminance_klux,
            transmittance=clear if self.transmittance is None else self.transmittance,
            extinction_per_m=self.extinction or 0.0,
        )


@list_options
@dataclass(frozen=True, slots=True, kw_only=True)
class SweepOptions:
    """Axis of a sweep and the quantity along it.

    Attributes:
        log: logarithmic steps, or even ones; None: as is usual for the axis
    """

    over: str | None = option(
        None,
        help="quantity to sweep: distance, illuminance_klux, elevation, azimuth, reflectivity, incidence, or a "
        "key such as detector.gain",
        metavar="AXIS",
    )
    quantity: str | None = option(
        None, OneOf(QUANTITIES), help="quantity to compute (default: snr over distance, range over everything else)"
    )
    start: float | None = option(
        None, Finite("the axis's unit"), help="start of the axis, in its unit", metavar="X", flags=("--from",)
    )
    stop: float | None = option(None, Finite("the axis's unit"), help="end of the axis", metavar="X", flags=("--to",))
    points: int = option(
        200, Whole(2, 100_000), help="number of points on the axis (default {default})", metavar="N", flags=("--n",)
    )
    aperture_law: str | None = option(
        None,
        OneOf(APERTURE_LAWS),
        help="aperture of the receiver off the axis, over elevation or azimuth (default: that of the sensor's scanner)",
    )
    log: bool | None = None

    def __post_init__(self) -> None:
        check_options(self)
        require_type("log", self.log, bool | None)

    @property
    def quantity_name(self) -> str:
        """Quantity along the axis, the default included."""
        return self.quantity or ("snr" if self.over == "distance" else "range")

    def require_sense(self, conditions: Collection[str]) -> None:
        """Raise OptionError for options that contradict each other, or a condition that would be ignored.

        Args:
            conditions: names of the conditions that the user set
        """
        axis, quantity = self.over, self.quantity_name
        if axis == "distance" and quantity == "range":
            raise OptionError(
                "{over} distance {quantity} range: the quantity must be snr or pd; the range is their limit"
            )
        if axis in conditions:
            raise OptionError(f"{{{axis}}} cannot be combined with {{over}} {axis}")
        if "distance" in conditions and quantity == "range":
            raise OptionError("{distance} needs {quantity} snr or pd, got range")
        if self.aperture_law and axis not in ("elevation", "azimuth"):
            raise OptionError("{aperture_law} needs {over} elevation or azimuth")
