"""Study files: what `lidarscene design` searches, TOML in, `StudyFile` out. Paths in it are relative to it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field, field_validator, model_validator

from ...errors import InputError
from ...files.toml import FileModel
from ...rendering.render_options import SEEDS
from ..ranging.conditions import CLEAR_AIR, PROBABILITY, Conditions

T = TypeVar("T")
Name = Annotated[str, Field(min_length=1)]
MOST_EVALUATIONS = 1_000_000

CLOSED_FORM = {
    "range": "farthest at which a plane is detected with `probability`, at most the converter's window",
    "range_of_units": "range that the fraction `units` of built units reaches, by the study's `[tolerance]`",
    "detection_probability": "P_d of a plane at `distance`",
    "snr": "signal-to-noise ratio of a plane at `distance`",
    "scatter_mm": "standard deviation of the reported range of a plane at `distance`, from 20,000 simulated shots",
    "false_points": "expected false alarms among the points of a frame, all pulses on the plane but beyond its echo",
    "class_1_margin": "limit of class 1 over emission; at least 1 is class 1",
    "class_1": "the same, but a billion for a sensor whose pulse is not known or in no table",
    "mean_power_mw": "energy of a pulse times pulses per second, all shots counted",
    "electrical_power_w": "of the whole sensor, by `[power]` of its file: driver, electronics and scanner",
    "fill_factor": "active fraction of a SiPM's or a pixel's area, by `detector.cell_gap_um`",
    "detection_efficiency": "of a SiPM or SPADs, with fill factor, overvoltage and temperature",
    "dark_counts_hz": "of all cells or SPADs, with overvoltage and temperature",
    "aperture_area_mm2": "of the receiver's lens",
    "points_per_s": "pulses per second",
    "pulses_per_frame": "pulses of a frame",
    "frame_s": "time of a frame",
    "beams": "channels that a frame has",
    "data_rate_mbit_s": "of all returns of all pulses, with `bits_per_point`",
    "cost": "sum of `[cost]` over all sensors",
    "coverage": "fraction of the field of view that has a pulse before `time_s`",
    "revisit_s": "mean time between visits of a cell, over `time_s`",
}
TRACED = {
    "body_points": "expected points of a frame on the bodies of the class, of all sensors together",
    "bodies_detected": "mean probability that a body of the class has at least `least_points` points",
}
"""Quantities that need a scene and a back end."""
RANGES = {"range", "range_of_units"}
"""Quantities that are a range at a P_d."""
OF_ALL_SENSORS = {*TRACED, "cost"}
"""Quantities of a design as a whole."""
UNITS = {
    "range": "m",
    "range_of_units": "m",
    "scatter_mm": "mm",
    "mean_power_mw": "mW",
    "electrical_power_w": "W",
    "dark_counts_hz": "1/s",
    "aperture_area_mm2": "mm²",
    "points_per_s": "1/s",
    "frame_s": "s",
    "data_rate_mbit_s": "Mbit/s",
    "revisit_s": "s",
}
QUANTITIES = CLOSED_FORM | TRACED
"""Names of quantities, with their meanings; any number of a sensor file is one too, by its key."""

CLASS_1 = "class 1"
"""Name of the constraint that a study has unless its `eye_safety` is off."""


class FreeFile(FileModel):
    """One free key: values from low to high, or a list of choices."""

    low: float | None = Field(default=None, description="minimum")
    high: float | None = Field(default=None, description="maximum")
    step: Annotated[float, Field(gt=0)] | None = Field(default=None, description="between values; any if left out")
    log: bool = Field(default=False, description="search in equal ratios, not in equal steps")
    choices: tuple[float | int | bool | str | dict[str, Any], ...] | None = Field(
        default=None, description="values, in place of low and high; a table replaces the file's"
    )

    @model_validator(mode="after")
    def _one_way(self) -> FreeFile:
        if self.choices is not None:
            if self.model_fields_set != {"choices"}:
                raise ValueError("must have choices, or low and high, got both")
            if len(self.choices) < 2:
                raise ValueError(f"choices: must be two or more, got {len(self.choices)}")
            return self
        if self.low is None or self.high is None:
            raise ValueError("must have low and high, or choices")
        if self.low >= self.high:
            raise ValueError(f"low: must be below high, got {self.low:g} and {self.high:g}")
        if self.log and self.low <= 0.0:
            raise ValueError(f"low: must be more than 0 with log, got {self.low:g}")
        if self.log and self.step is not None:
            raise ValueError("step: cannot be combined with log")
        if self.step is not None and self.low + self.step > self.high:
            raise ValueError(
                f"step: must leave two values or more, got {self.step:g} from {self.low:g} to {self.high:g}"
            )
        return self


class QuantityFile(FileModel):
    """What is computed of a design, and under which conditions; keys that a quantity does not need are refused."""

    sensor: str | None = Field(default=None, description="label, of a study with several sensors")
    probability: float = Field(default=PROBABILITY, description="P_d at the range")
    units: Annotated[float, Field(ge=0.5, lt=1)] = Field(default=0.95, description="fraction of the built units")
    distance: float = Field(default=100.0, description="of the plane, m")
    illuminance_klux: float = Field(default=100.0, description="of the sun, klux")
    sun_angle: float = Field(default=60.0, description="between sun and normal of the plane, degrees")
    reflectivity: float = Field(default=0.1, description="of the plane")
    incidence: float = Field(default=0.0, description="of the beam on the plane, degrees")
    transmittance: float | None = Field(
        default=None, description=f"of the air, one way, at any range; {CLEAR_AIR} without visibility"
    )
    visibility: float | None = Field(default=None, description="of the air, km")
    motion: Literal["scanned", "stationary"] = Field(default="scanned", description="of the beam, for class_1_margin")
    time_s: Annotated[float, Field(gt=0, le=1000)] = Field(default=0.1, description="for coverage and revisit_s")
    cell_deg: Annotated[float, Field(ge=0.02, le=10)] = Field(default=0.28, description="for coverage and revisit_s")
    class_name: str | None = Field(default=None, alias="class", description="of the bodies; all if left out")
    least_points: Annotated[int, Field(ge=1, le=10_000)] = Field(default=5, description="for bodies_detected")
    bits_per_point: Annotated[int, Field(ge=1, le=10_000)] = Field(
        default=128, description="for data_rate_mbit_s: x, y, z and intensity in single precision"
    )

    @property
    def quantity_name(self) -> str:
        """Name of the quantity, or key of a sensor file."""
        raise NotImplementedError

    @property
    def words(self) -> str:
        """Conditions under which it holds, those of importance and those that are given."""
        quantity = self.quantity_name
        said = self.model_fields_set | (set() if quantity in TRACED else _ALWAYS_SAID)
        keys = _USED.get(quantity, set()) & said
        values = {key: getattr(self, key) for key in _WORDS if key in keys}
        return ", ".join(_WORDS[key].format(value) for key, value in values.items() if value is not None)

    def conditions(self) -> Conditions:
        """P_d, target, light and air.

        Raises:
            InputError: for a value out of bounds
        """
        return Conditions(**{key: getattr(self, key) for key in _CONDITIONS})


_CONDITIONS = (
    "probability",
    "distance",
    "illuminance_klux",
    "sun_angle",
    "reflectivity",
    "incidence",
    "transmittance",
    "visibility",
)
_PLANE = set(_CONDITIONS) - {"probability", "distance"}
_USED = {
    "range": _PLANE | {"probability"},
    "range_of_units": _PLANE | {"probability", "units"},
    "detection_probability": _PLANE | {"distance"},
    "snr": _PLANE | {"distance"},
    "scatter_mm": _PLANE | {"distance"},
    "false_points": _PLANE,
    "class_1_margin": {"motion"},
    "class_1": {"motion"},
    "coverage": {"time_s", "cell_deg"},
    "revisit_s": {"time_s", "cell_deg"},
    "body_points": {"class_name", "illuminance_klux"},
    "bodies_detected": {"class_name", "least_points", "illuminance_klux"},
    "data_rate_mbit_s": {"bits_per_point"},
}
"""Keys of `QuantityFile` that a quantity has use for, besides sensor."""

_WORDS = {
    "probability": "P_d {:g}",
    "units": "{:.0%} of the units",
    "distance": "at {:g} m",
    "reflectivity": "reflectivity {:g}",
    "illuminance_klux": "{:g} klux",
    "sun_angle": "sun {:g}° off the normal",
    "incidence": "incidence {:g}°",
    "transmittance": "transmittance {:g}",
    "visibility": "visibility {:g} km",
    "motion": "beam {}",
    "time_s": "{:g} s",
    "cell_deg": "cells of {:g}°",
    "class_name": "class {}",
    "least_points": "{} points or more",
    "bits_per_point": "{} bits a point",
}
"""Choice: words for the condition under each key."""

_ALWAYS_SAID = {"probability", "distance", "reflectivity", "illuminance_klux"}
"""Choice: conditions that are said where they are not given, too; light of a scene is the scene's."""


def _require_used(quantity: str, entry: QuantityFile, also: set[str]) -> None:
    """Raise ValueError for a key that this quantity does not use, and for a condition out of bounds."""
    used = _USED.get(quantity, set()) | also | (set() if quantity in OF_ALL_SENSORS else {"sensor"})
    for key in sorted(entry.model_fields_set - used):
        name = "class" if key == "class_name" else key
        raise ValueError(f"{name}: has no effect on {quantity}")
    try:
        entry.conditions()
    except InputError as error:
        raise ValueError(str(error)) from None


class ObjectiveFile(QuantityFile):
    """One objective: a quantity, or a key of a sensor file, to maximize or to minimize."""

    maximize: Name | None = Field(default=None, description="quantity, or key of the sensor file")
    minimize: Name | None = Field(default=None, description="the same")

    @model_validator(mode="after")
    def _one_goal(self) -> ObjectiveFile:
        if (self.maximize is None) == (self.minimize is None):
            raise ValueError("must have maximize or minimize, and not both")
        _require_used(self.quantity_name, self, {"maximize", "minimize"})
        return self

    @property
    def quantity_name(self) -> str:
        """Name of the quantity, or key of a sensor file."""
        return self.maximize or self.minimize or ""

    @property
    def sign(self) -> float:
        """Factor with which smaller is better."""
        return 1.0 if self.maximize is None else -1.0


class ConstraintFile(QuantityFile):
    """One constraint: bounds of a quantity, or of a key of a sensor file."""

    quantity: Name = Field(description="quantity, or key of the sensor file")
    at_least: float | None = Field(default=None, description="minimum that is allowed")
    at_most: float | None = Field(default=None, description="maximum that is allowed")

    @model_validator(mode="after")
    def _bounded(self) -> ConstraintFile:
        if self.at_least is None and self.at_most is None:
            raise ValueError("must have at_least or at_most")
        if self.at_least is not None and self.at_most is not None and self.at_least > self.at_most:
            raise ValueError(f"at_least: must be <= at_most, got {self.at_least:g} and {self.at_most:g}")
        _require_used(self.quantity, self, {"quantity", "at_least", "at_most"})
        return self

    @property
    def quantity_name(self) -> str:
        """Name of the quantity, or key of a sensor file."""
        return self.quantity

    @property
    def bounds_text(self) -> str:
        """Both bounds in words."""
        bounds = (("at least", self.at_least), ("at most", self.at_most))
        return " and ".join(f"{words} {bound:g}" for words, bound in bounds if bound is not None)

    def allows(self, value: float) -> bool:
        """Whether a value is within the bounds."""
        return (self.at_least is None or value >= self.at_least) and (self.at_most is None or value <= self.at_most)


def _require_different(names: T) -> T:
    """Raise ValueError for a sensor that is named twice."""
    if isinstance(names, tuple) and len(set(names)) < len(names):
        raise ValueError(f"must be different sensors, got {', '.join(names)}")
    return names


def _joined_tables(tables: dict[str, Any], before: str) -> Iterator[tuple[str, Any]]:
    """Keys and entries of [free]; a table of tables is the beginning of keys."""
    for key, entry in tables.items():
        if isinstance(entry, dict) and entry and all(isinstance(inner, dict) for inner in entry.values()):
            yield from _joined_tables(entry, f"{before}{key}.")
        else:
            yield f"{before}{key}", entry


class PlacedFile(FileModel):
    """[sensors.LABEL]: one of several sensors on a vehicle."""

    base: Name | Annotated[tuple[Name, ...], Field(min_length=2)] = Field(
        description='catalogue name or sensor file; of a list one is chosen, and "none" leaves the sensor out'
    )
    set: dict[str, Any] = Field(default={}, description="values of its keys that are not free")

    @field_validator("base")
    @classmethod
    def _different(cls, base: str | tuple[str, ...]) -> str | tuple[str, ...]:
        return _require_different(base)

    @property
    def bases(self) -> tuple[str, ...]:
        """All of its bases."""
        return (self.base,) if isinstance(self.base, str) else self.base


class StudyFile(FileModel):
    """A whole study file."""

    name: str = Field(default="", description="for people")
    sensor: Name | Annotated[tuple[Name, ...], Field(min_length=2)] | None = Field(
        default=None, description="catalogue name or sensor file to start from; of a list one is chosen"
    )
    sensors: dict[str, PlacedFile] = Field(default={}, description="several sensors in place of one")
    set: dict[str, Any] = Field(default={}, description="values of the sensor's keys that are not free")
    scene: Name | None = Field(default=None, description="shipped scene or scene file, for what is traced")
    pose: tuple[float, float, float] | None = Field(
        default=None, description="x, y, z of the vehicle in the scene; the scene's sensor pose if left out"
    )
    free: dict[str, FreeFile] = Field(default={}, description="keys of the sensor file and their ranges")
    objectives: Annotated[dict[str, ObjectiveFile], Field(min_length=1)] = Field(description="what is wanted, by name")
    constraints: dict[str, ConstraintFile] = Field(default={}, description="what is allowed, by name")
    eye_safety: Literal["class 1", "off"] = Field(
        default="class 1", description="constraint of each sensor, the beam scanning, unless one on its margin is given"
    )
    tolerance: dict[str, Annotated[float, Field(gt=0)]] = Field(
        default={}, description="by key of the sensor file, in its unit: 95 % of built units are within it, either way"
    )
    cost: dict[str, Annotated[tuple[tuple[float | str, float], ...], Field(min_length=1)]] = Field(
        default={},
        description='by key of the sensor file, or "sensor": pairs of value and cost, in a unit of your own; between '
        "numbers in proportion",
    )
    evaluations: Annotated[int, Field(ge=2, le=MOST_EVALUATIONS)] = Field(
        default=2000, description="designs to try at most"
    )
    seed: Annotated[int, Field(ge=SEEDS.low, le=SEEDS.high)] = Field(
        default=0, description="of the search and of the traced frame"
    )

    @field_validator("free", mode="before")
    @classmethod
    def _joined_keys(cls, free: Any) -> Any:
        """Join the parts of a dotted key without quotes, which TOML takes apart: detector.gain = { low = 5 }."""
        return dict(_joined_tables(free, "")) if isinstance(free, dict) else free

    @field_validator("sensor")
    @classmethod
    def _different(cls, sensor: str | tuple[str, ...] | None) -> str | tuple[str, ...] | None:
        return sensor if sensor is None else _require_different(sensor)

    @field_validator("cost")
    @classmethod
    def _of_one_cost(cls, cost: dict[str, tuple[tuple[float | str, float], ...]]) -> Any:
        for key, pairs in cost.items():
            values = [value for value, _ in pairs]
            twice = [value for value in values if values.count(value) > 1]
            if twice:
                raise ValueError(f"{key}: must have one cost of {twice[0]}, got {len(twice)}")
        return cost

    @field_validator("objectives", "constraints")
    @classmethod
    def _named(cls, entries: dict[str, Any]) -> dict[str, Any]:
        for name in entries:
            if not re.fullmatch(r"\w[\w .-]*", name):
                raise ValueError(f"must have names of letters, digits, spaces, dots and dashes, got '{name}'")
        return entries

    @model_validator(mode="after")
    def _complete(self) -> StudyFile:
        if (self.sensor is None) == (not self.sensors):
            raise ValueError("must have sensor or [sensors], and not both")
        if self.sensors and self.set:
            raise ValueError("set: needs sensor; each of [sensors] has its own set")
        if not self.free and not any(len(placed.bases) > 1 for placed in self.placed.values()):
            raise ValueError("free: must have a key or more")
        shared = self.objectives.keys() & self.constraints.keys()
        if shared:
            raise ValueError(f"constraints.{min(shared)}: must have another name than the objective")
        for table, entries in (("objectives", self.objectives), ("constraints", self.constraints)):
            for name, entry in entries.items():
                self._check_entry(f"{table}.{name}", entry)
        quantities = {entry.quantity_name for entry in (*self.objectives.values(), *self.constraints.values())}
        for table, quantity in (("cost", "cost"), ("tolerance", "range_of_units")):
            if getattr(self, table) and quantity not in quantities:
                raise ValueError(f"{table}: needs an objective or a constraint of {quantity}")
        return self.model_copy(update={"constraints": {**self.constraints, **self._class_1()}})

    def _class_1(self) -> dict[str, ConstraintFile]:
        """Constraints of `eye_safety`: of each sensor whose margin has no bound."""
        if self.eye_safety == "off":
            return {}
        bounded = {entry.sensor or "" for entry in self.constraints.values() if entry.quantity.startswith("class_1")}
        return {
            f"{CLASS_1} {label}".rstrip(): ConstraintFile(quantity="class_1", at_least=1.0, sensor=label or None)
            for label in self.placed
            if label not in bounded and not (bounded and len(self.placed) == 1)
        }

    def _check_entry(self, where: str, entry: ObjectiveFile | ConstraintFile) -> None:
        if entry.quantity_name in TRACED:
            if self.scene is None:
                raise ValueError(f"{where}: {entry.quantity_name} needs a scene")
        elif entry.quantity_name == "cost" and not self.cost:
            raise ValueError(f"{where}: cost needs [cost]")
        elif entry.quantity_name == "range_of_units" and not self.tolerance:
            raise ValueError(f"{where}: range_of_units needs [tolerance]")
        if entry.sensor and not self.sensors:
            raise ValueError(f"{where}.sensor: needs [sensors], got {entry.sensor}")
        needs_label = entry.quantity_name not in OF_ALL_SENSORS and len(self.placed) > 1
        if needs_label and entry.sensor not in self.placed:
            raise ValueError(f"{where}.sensor: must be one of {', '.join(self.placed)}, got {entry.sensor or 'none'}")

    @property
    def placed(self) -> dict[str, PlacedFile]:
        """Sensors by label; the label of a study of one sensor is empty."""
        return self.sensors or {"": PlacedFile(base=self.sensor or "", set=self.set)}

    @property
    def is_traced(self) -> bool:
        """Whether a quantity needs the scene."""
        return any(entry.quantity_name in TRACED for entry in (*self.objectives.values(), *self.constraints.values()))
