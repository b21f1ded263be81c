"""Units of the numbers in files, and the declaration of such a number beside the field that holds it.

A number is declared once, on the field of the dataclass that takes it in SI units:
``pulse_fwhm_s: Annotated[float, Quantity("ns", gt=0)] = 5e-9``. The key of the file (`pulse_fwhm_ns`), its bounds,
its default, its place in the JSON Schema and the conversion follow from that (`files.table_model.Table`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import KW_ONLY, Field, dataclass
from typing import Any, TypeVar, get_type_hints

UNITS = {
    "nm": ("m", 1e-9),
    "um": ("m", 1e-6),
    "mm": ("m", 1e-3),
    "km": ("m", 1e3),
    "ps": ("s", 1e-12),
    "ns": ("s", 1e-9),
    "us": ("s", 1e-6),
    "ms": ("s", 1e-3),
    "khz": ("hz", 1e3),
    "mhz": ("hz", 1e6),
    "na": ("a", 1e-9),
    "ua": ("a", 1e-6),
    "mrad": ("rad", 1e-3),
    "deg": ("rad", math.pi / 180.0),
    "deg_s": ("rad_s", math.pi / 180.0),
    "deg_h": ("rad_s", math.pi / 648_000.0),
    "deg_s_sqrt_hz": ("rad_s_sqrt_hz", math.pi / 180.0),
    "mg": ("m_s2", 9.80665e-3),
    "ug": ("m_s2", 9.80665e-6),
    "ug_sqrt_hz": ("m_s2_sqrt_hz", 9.80665e-6),
}
"""Source: SI prefixes; units that people write, as the names of keys end: the SI unit, and the factor to it."""

SYMBOLS = {unit: unit for unit in (*UNITS, "m", "s", "rad", "klux")} | {
    "um": "µm",
    "us": "µs",
    "hz": "Hz",
    "khz": "kHz",
    "mhz": "MHz",
    "a": "A",
    "na": "nA",
    "ua": "µA",
    "deg": "°",
    "deg_s": "°/s",
    "deg_h": "°/h",
    "deg_s_sqrt_hz": "°/s/√Hz",
    "rad_s_sqrt_hz": "rad/s/√Hz",
    "m_s2": "m/s²",
    "m_s2_sqrt_hz": "m/s²/√Hz",
    "ug": "µg",
    "ug_sqrt_hz": "µg/√Hz",
    "w": "W",
    "w_m2": "W/m²",
    "m2": "m²",
    "per_m": "1/m",
    "ohm": "Ω",
    "k": "K",
    "v": "V",
    "v_k": "V/K",
}
"""Units as names of keys and fields end -> as charts and tables write them."""


def split_unit(name: str) -> tuple[str, str]:
    """Split the unit off the name of a key or field: "laser.pulse_fwhm_us" -> ("laser.pulse_fwhm", "µs")."""
    unit = max((unit for unit in SYMBOLS if name.endswith(f"_{unit}")), key=len, default="")
    return name.removesuffix(f"_{unit}"), SYMBOLS.get(unit, "")


def keys_like(typed: str, keys: Iterable[str]) -> list[str]:
    """Dotted keys whose last part has the words of that of a typed key, units aside: laser.peak_power_w of "power".

    Keys of just these words come before those of more, then those that have some in the table's name, such as
    "laser_power"; [] if more than MOST_KEYS fit.
    """
    words = _words(typed)
    if max(map(len, words)) < 3:
        return []
    listed = [*keys]
    fitting = [key for key in listed if set(words) <= set(key.rpartition(".")[2].split("_"))]
    fitting = fitting or [key for key in listed if set(words) <= set(key.replace(".", "_").split("_"))]
    equal = [key for key in fitting if words == _words(key)]
    return equal or (fitting if len(fitting) <= MOST_KEYS else [])


MOST_KEYS = 4
"""Most keys that a message suggests."""

_UNIT_WORDS = frozenset(word for unit in (*SYMBOLS, "lux", "mw", "kw") for word in unit.split("_"))
"""Parts of the units at the ends of keys, and of those that people type instead."""


def _words(key: str) -> list[str]:
    """Words of the last part of a dotted key, without its unit: ["peak", "power"] of "laser.peak_power_w"."""
    # With two underscores keywords of other libraries say what is in what: laser__peak_power_w.
    words = key.replace("__", ".").rpartition(".")[2].lower().replace("-", "_").split("_")
    while len(words) > 1 and words[-1] in _UNIT_WORDS:
        words.pop()
    return words


STATIC = {"static": True}
"""Metadata of a field that chooses code, such as the number of a kernel's outputs or steps, or the size of its memory.

It stays a Python number where others go to the device (`kernel.device.transfer.opaque`).
"""

COUNT = {"static": False}
"""Metadata of a field that is a whole number and chooses no code."""


def is_static(field: Field[Any]) -> bool:
    """Whether a field of a dataclass is `STATIC`."""
    return bool(field.metadata.get("static", False))


def is_continuous(field: Field[Any]) -> bool:
    """Whether a number of a dataclass may change by a little: it is neither `STATIC` nor a `COUNT`."""
    return "static" not in field.metadata


Number = TypeVar("Number", float, float | None, tuple[float, ...])
Note = TypeVar("Note")


def note_of(hint: Any, kind: type[Note]) -> Note | None:
    """First note of this kind in ``Annotated[type, note]``; None without."""
    return next((note for note in getattr(hint, "__metadata__", ()) if isinstance(note, kind)), None)


def sliders(owner: type[Any]) -> dict[str, tuple[Quantity, Slider]]:
    """Numbers of a class that have a slider, by field."""
    notes = {
        field: (note_of(hint, Quantity), note_of(hint, Slider))
        for field, hint in get_type_hints(owner, include_extras=True).items()
    }
    return {field: (quantity, slider) for field, (quantity, slider) in notes.items() if quantity and slider}


def si(value: Number, unit: str) -> Number:
    """Convert a number in this unit, or several, to SI units; None stays None."""
    if value is None:
        return None
    factor = UNITS[unit][1]
    return tuple(number * factor for number in value) if isinstance(value, tuple) else value * factor


def key_in_si(key: str) -> tuple[str, float]:
    """Name of the field that holds a key's number in SI units, and the factor: laser.pulse_fwhm_s, 1e-9."""
    unit = max((unit for unit in UNITS if key.endswith(f"_{unit}")), key=len, default="")
    if not unit:
        return key, 1.0
    ending, factor = UNITS[unit]
    return f"{key.removesuffix(unit)}{ending}", factor


@dataclass(frozen=True, slots=True)
class FileKey:
    """Declaration of a field that can be given in a file.

    Attributes:
        name: of the key in the file, where it is not the field's own (with the unit of the file)
        about: what it is, for the JSON Schema
    """

    _: KW_ONLY
    name: str | None = None
    about: str | None = None

    def for_field(self, field: str) -> str:
        """The key in the file."""
        return self.name or field

    def in_si(self, value: Any) -> Any:
        """The field's value from the file's."""
        return value

    def in_file(self, value: Any) -> Any:
        """The file's value from the field's."""
        return value


@dataclass(frozen=True, slots=True)
class Slider:
    """Slider of the view for a number of a file: its label, and its ends in the unit of the file.

    Attributes:
        unit: as the page writes it
        log: in even steps of its logarithm
    """

    label: str
    unit: str
    low: float
    high: float
    log: bool = False


@dataclass(frozen=True, slots=True)
class SameTable:
    """Mark of a field that is a dataclass, whose own fields are keys of the same table of the file."""


@dataclass(frozen=True, slots=True)
class Quantity(FileKey):
    """Declaration of a number that can be given in a file.

    Attributes:
        unit: in the file, a key of `UNITS`; None: the field's own
        gt: what it must be greater than, in the unit of the file; each number where the field has several. Bounds are
            some hundred times wider than any device: what is beyond is a mistake, most often of the unit
        ge: what it must be greater than or equal to, likewise
        lt: what it must be less than, likewise
        le: what it must be less than or equal to, likewise
        finest: the smallest size of a number that is not 0, in the unit of the file
        multiple: the file's unit over the SI unit, where the field has the file's: 1e3 of klux
        whole: the file takes whole numbers only; a field of floats or arrays gets the float
        least: how many numbers there are at least, where the field has several
    """

    unit: str | None = None
    _: KW_ONLY
    gt: float | None = None
    ge: float | None = None
    lt: float | None = None
    le: float | None = None
    finest: float | None = None
    multiple: float = 1.0
    whole: bool = False
    least: int = 0

    @property
    def bounds(self) -> dict[str, Any]:
        """Bounds that are set, by name."""
        limits = {"gt": self.gt, "ge": self.ge, "lt": self.lt, "le": self.le}
        return {name: limit for name, limit in limits.items() if limit is not None}

    def must_be(self, value: float) -> str | None:
        """Return the bound that a number of the file violates, such as ">= 0"; None if it keeps all."""
        is_broken = {
            ">": self.gt is not None and value <= self.gt,
            ">=": self.ge is not None and value < self.ge,
            "<": self.lt is not None and value >= self.lt,
            "<=": self.le is not None and value > self.le,
        }
        limits = {">": self.gt, ">=": self.ge, "<": self.lt, "<=": self.le}
        for bound_sign in (sign for sign, breaks in is_broken.items() if breaks):
            return f"{bound_sign} {limits[bound_sign]:g}"
        if self.finest is not None and 0.0 < abs(value) < self.finest:
            return f"0 or >= {self.finest:g}" if value > 0.0 else f"0 or <= {-self.finest:g}"
        return None

    def as_written_in_si(self, value: float) -> float | None:
        """Return a number outside of the bounds as if it were written in the SI unit; None if it stays outside."""
        factor = self.multiple if self.unit is None else UNITS[self.unit][1]
        return value / factor if factor != 1.0 and value and self.must_be(value / factor) is None else None

    def for_field(self, field: str) -> str:
        """The key in the file: with its unit in place of the field's."""
        if self.name or self.unit is None:
            return self.name or field
        ending = f"_{UNITS[self.unit][0]}"
        if not field.endswith(ending):
            raise TypeError(f"{field}: the name must end in {ending} for a number in {self.unit}")
        return f"{field.removesuffix(ending)}_{self.unit}"

    def in_si(self, value: Any) -> Any:
        """Convert the file's value to the field's; a whole number becomes a float."""
        if self.unit is not None:
            return si(value, self.unit)
        return float(value) if self.whole else value

    def in_file(self, value: Any) -> Any:
        """The file's value from the field's: the shortest number that gives exactly the same, if one does."""
        if self.unit is None or not value:
            return value
        number = value / UNITS[self.unit][1]
        near = (*(float(f"{number:.{digits}g}") for digits in (12, 15, 16)), number)
        near += (math.nextafter(number, -math.inf), math.nextafter(number, math.inf))
        return next((near_number for near_number in near if si(near_number, self.unit) == value), number)
