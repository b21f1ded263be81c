"""Quantities of a design: what its objectives and constraints are computed from.

Closed forms need no back end. What is traced uses probabilities in place of draws, and the same seed for all designs:
two designs differ by what they are, not by luck. A scene is compiled once for each wavelength, and the rays of designs
that differ in light and electronics alone are traced once.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError, did_you_mean
from ...files.overrides import get_entry, key_path, number_list_entries, short_text
from ...maths.arrays import Lanes, Numbers
from ...maths.pose import Pose
from ...maths.units import key_in_si
from ...physics.optics.pulse import pulse_energy_j
from ...sensor.detectors import GeigerDetector
from ...sensor.parts import PARTS
from ...sensor.sensor_model import Sensor
from .. import published_values
from ..eye_safety.exposure import stationary_train
from ..eye_safety.eye_safety_report import EyeSafetyReport, eye_safety_report, not_known
from ..field_of_view.pattern_coverage import CellMaps, cell_maps, field_cells, fired_pulses
from ..field_of_view.sphere_cells import SphereCells
from ..ranging import equal_terms, plane, statistics
from ..ranging.curves import with_haze
from ..ranging.sensitivities import parameters
from ..ranging.sweep_axes import numeric_keys
from .designs import TURNS, Chosen, DesignSpace, Values, entry_number, has_number, list_under
from .study_file import CLOSED_FORM, QUANTITIES, TRACED, QuantityFile, StudyFile

if TYPE_CHECKING:
    from ...cloud.point_cloud import PointCloud
    from ...scene.scene import Scene
    from ..compare.bench import Bench

Formula = Callable[[Sensor, QuantityFile], float]

CostTables = Mapping[str, Sequence[tuple[float | str, float]]]
"""Pairs of value and cost by key of the sensor file."""

NOT_JUDGED = 1e9
"""Choice: margin of a sensor of which class 1 cannot be judged: no bound, and a number that optimisers take."""

_REFERENCE_W = 1.0
"""Choice: peak power for which the report of eye safety is made; emissions are linear in it."""


class Evaluator:
    """Quantities of the designs of one study. Scene, worlds and pulse trains are shared between designs."""

    def __init__(self, study: StudyFile, space: DesignSpace, folder: Path, where: str) -> None:
        """Load the scene, if the study has one.

        Args:
            folder: of the study file
            where: study file, for messages

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        self.study, self.space = study, space
        self.entries = {**study.objectives, **study.constraints}
        self._tolerances = {
            name: half * factor for key, half in study.tolerance.items() for name, factor in [key_in_si(key)]
        }
        self._reports: dict[Any, EyeSafetyReport] = {}
        try:
            self._bench = _bench(study, folder) if study.is_traced else None
        except InputError as error:
            raise InputError(f"{where}: scene: {error}") from None
        self._check_keys(where)

    def _check_keys(self, where: str) -> None:
        """Raise InputError for a quantity that is neither known nor a number of its sensors, and for no such class."""
        for name, entry in self.entries.items():
            quantity = entry.quantity_name
            key = f"{where}: {'objectives' if name in self.study.objectives else 'constraints'}.{name}"
            if quantity in TRACED:
                assert self._bench is not None
                bodies_of_class(self._bench.scene, entry.class_name, f"{key}.class")
            if quantity == "range_of_units":
                self._check_tolerances(entry, where)
            if quantity in QUANTITIES:
                continue
            for base in self.space.bases[entry.sensor or next(iter(self.space.bases))]:
                if base.tables is not None and not has_number(base.tables, quantity):
                    hint = did_you_mean(quantity, [*QUANTITIES, *numeric_keys(base.tables)])
                    message = f"{key}: must be of a quantity or a number of {base.name}, got '{quantity}'"
                    raise InputError(f"{message}; {hint}".rstrip("; "))

    def _check_tolerances(self, entry: QuantityFile, where: str) -> None:
        for base in self.space.bases[self.label_of(entry)]:
            if base.tables is None:
                continue
            sensor = Chosen(base=base, changes={}).sensor()
            known = parameters(sensor, target_of(sensor, entry))
            for key in self.study.tolerance:
                if key_in_si(key)[0] not in known:
                    hint = did_you_mean(key, list(numeric_keys(base.tables)))
                    message = f"{where}: tolerance.{key}: must be a number that the range of {base.name} depends on"
                    raise InputError(f"{message}; {hint}".rstrip("; "))

    def range_interval_m(self, entry: QuantityFile, values: Values) -> tuple[float, float] | None:
        """Ends of the range of a design that the uncertainties of its sensor file give; None without any."""
        sensor = self.space.sensors(values).get(self.label_of(entry))
        if sensor is None:
            return None
        target = target_of(sensor, entry)
        range_m = plane.range_at_probability_m(sensor, target, entry.probability)
        return equal_terms.range_interval_m(sensor, target, range_m, probability=entry.probability)

    def __call__(self, values: Values, names: Collection[str] | None = None) -> dict[str, float]:
        """Objectives and constraints of a design by name; of these names only, if given.

        Raises:
            InputError: for a sensor that cannot be
        """
        chosen = self.space.chosen(values)
        sensors = {label: placed.sensor() for label, placed in chosen.items()}
        traced: dict[float | None, _Seen] = {}
        results = {}
        for name, entry in self.entries.items():
            if names is not None and name not in names:
                continue
            if entry.quantity_name in TRACED:
                klux = entry.illuminance_klux if "illuminance_klux" in entry.model_fields_set else None
                if klux not in traced:
                    traced[klux] = self._trace(sensors, klux)
                results[name] = traced[klux].quantity(entry)
            else:
                results[name] = self.closed_form(entry, chosen, sensors)
        return results

    def label_of(self, entry: QuantityFile) -> str:
        """Label of the sensor that a quantity is of."""
        return entry.sensor or next(iter(self.space.bases))

    def closed_form(self, entry: QuantityFile, chosen: Mapping[str, Chosen], sensors: Mapping[str, Sensor]) -> float:
        """Quantity that is not traced, or number of a sensor file; 0 of a sensor that is left out."""
        quantity, label = entry.quantity_name, self.label_of(entry)
        if quantity == "cost":
            return _cost(chosen, self.study.cost)
        if label not in sensors:
            return 0.0
        sensor = sensors[label]
        if quantity == "class_1_margin":
            return self.eye_safety(sensor, entry.motion).margin
        if quantity == "class_1":
            return self._class_1(sensor, entry.motion)
        if quantity == "range_of_units":
            return range_of_units_m(
                sensor, target_of(sensor, entry), self._tolerances, units=entry.units, probability=entry.probability
            )
        if quantity in CLOSED_FORM:
            return _FORMULAS[quantity](sensor, entry)
        return float(_value(chosen[label], quantity))

    def _class_1(self, sensor: Sensor, motion: str) -> float:
        """Margin of class 1; `NOT_JUDGED` where the pulse is not known, or no table has it."""
        try:
            return NOT_JUDGED if not_known(sensor) else self.eye_safety(sensor, motion).margin
        except InputError:
            return NOT_JUDGED

    def eye_safety(self, sensor: Sensor, motion: str) -> EyeSafetyReport:
        """Report of a sensor. The scan's geometry is traced once for all designs that differ in power only."""
        power_w = float(sensor.laser.peak_power_w)
        at_reference = replace(sensor, laser=replace(sensor.laser, peak_power_w=_REFERENCE_W))
        key = (motion, at_reference.laser, at_reference.histogram, _scan_key(sensor))
        if key not in self._reports:
            self._reports[key] = eye_safety_report(at_reference, scanned=motion == "scanned")
        return self._reports[key].at_power_w(power_w)

    def clouds(self, values: Values) -> dict[str, PointCloud]:
        """Cloud of each sensor of a design in the study's scene, by label."""
        assert self._bench is not None
        sensors = self.space.sensors(values)
        return {label: self._bench.observe(label or sensor.name, sensor).cloud for label, sensor in sensors.items()}

    def _trace(self, sensors: Mapping[str, Sensor], illuminance_klux: float | None) -> _Seen:
        assert self._bench is not None
        return _Seen(self._bench, sensors, illuminance_klux)


def _bench(study: StudyFile, folder: Path) -> Bench:
    from ...rendering.render_options import FrameOptions
    from ...scene.scene_file import load_scene
    from ..compare.bench import Bench

    assert study.scene is not None
    scene = load_scene(folder / study.scene if study.scene.endswith((".toml", ".xml")) else study.scene)
    pose = None if study.pose is None else Pose(position_m=np.array(study.pose))
    return Bench(scene, FrameOptions(seed=study.seed, pose=pose), keeps_paths=True)


class _Seen:
    """Probabilities of a point of all pulses of a design on the bodies of the scene: P_d within the window, else 0."""

    def __init__(self, bench: Bench, sensors: Mapping[str, Sensor], illuminance_klux: float | None) -> None:
        self.scene = bench.scene
        self._body, self._probability = [np.zeros(0, np.int64)], [np.zeros(0)]
        for label, sensor in sensors.items():
            surfaces = bench.observe(label, sensor, illuminance_klux=illuminance_klux).rated_surfaces
            assert surfaces.probability is not None
            range_m = surfaces.true_range_m
            listens = (range_m > plane.blanking_m(sensor)) & (range_m <= plane.window_m(sensor))
            self._body.append(surfaces.body.astype(np.int64))
            self._probability.append(np.where((surfaces.body >= 0) & listens, surfaces.probability, 0.0))

    def quantity(self, entry: QuantityFile) -> float:
        """Value of a traced quantity."""
        numbers = bodies_of_class(self.scene, entry.class_name)
        body, probability = np.concatenate(self._body), np.concatenate(self._probability)
        if entry.quantity_name == "body_points":
            return float(probability[np.isin(body, numbers)].sum())
        shares = [probability_of_points(probability[body == number], entry.least_points) for number in numbers]
        return float(np.mean(shares))


def probability_of_points(probability: Numbers, least: int) -> float:
    """Probability of at least ``least`` successes in independent trials of these probabilities.

    The distribution of the count is the convolution of its trials', cut off at ``least``: exact.
    """
    below = np.zeros(least)
    below[0] = 1.0
    for share in probability[probability > 0.0]:
        below[1:] = below[1:] * (1.0 - share) + below[:-1] * share
        below[0] *= 1.0 - share
        if below.sum() < 1e-12:
            break
    return float(1.0 - below.sum())


def _scan_key(sensor: Sensor) -> str:
    """Text that is equal for equal scans: directions and times of some thousand pulses spread over a frame."""
    pulses = sensor.scanner.pulses
    pulse = np.linspace(0, pulses - 1, min(pulses, 4096)).astype(np.uint32)
    x, y, z = (np.asarray(component, dtype=np.float64) for component in sensor.scanner.direction(pulse))
    parts = [sensor.scanner.time_s(pulse), x + 0.0 * y + 0.0 * z, y, z]
    return json.dumps([pulses, sensor.scanner.frame_s]) + "".join(
        str(hash(np.ascontiguousarray(part).tobytes())) for part in parts
    )


def _value(chosen: Chosen, key: str) -> Any:
    """Value under a key of a sensor file with its changes, or its default."""
    if key in PARTS:
        return chosen.changes.get(key, chosen.base.settings.get(key))
    value: Any = chosen.tables
    entry = numeric_keys(value).get(key)
    if entry is not None:
        return math.nan if entry.value is None else entry.value
    if key in TURNS:
        return value.get("mounting", {}).get(key.partition(".")[2], 0.0)
    plain, number = entry_number(key)
    if number is not None and (entries := list_under(value, plain)) is not None:
        return entries[number]
    for part in number_list_entries(key_path(key), value):
        value = get_entry(value, int(part) if isinstance(value, list) else part)
    return value


def _cost(chosen: Mapping[str, Chosen], costs: CostTables, where: str = "cost") -> float:
    """Sum of the costs of all sensors.

    Raises:
        InputError: for a value whose cost is not given
    """
    total = 0.0
    for placed in chosen.values():
        for key, pairs in costs.items():
            value = placed.base.name if key == "sensor" else _value(placed, key)
            known = dict(pairs)
            if isinstance(value, dict | list):
                raise InputError(f"{where}.{key}: must be of a number or a text, got {short_text(value)}")
            if value in known:
                total += known[value]
                continue
            numbers = sorted((x, cost) for x, cost in pairs if not isinstance(x, str))
            if isinstance(value, str) or value is None or not numbers or not numbers[0][0] <= value <= numbers[-1][0]:
                raise InputError(f"{where}.{key}: must have a cost of {value!r}, got {', '.join(map(str, known))}")
            total += float(np.interp(value, [x for x, _ in numbers], [cost for _, cost in numbers]))
    return total


def bodies_of_class(scene: Scene, class_name: str | None, where: str = "class") -> list[int]:
    """Numbers of the bodies of a class; of all for None.

    Raises:
        InputError: if there is none
    """
    numbers = [number for number, body in enumerate(scene.bodies) if class_name in (None, body.class_name)]
    if not numbers:
        classes = sorted({body.class_name for body in scene.bodies if body.class_name})
        raise InputError(f"{where}: must be of a class of {', '.join(classes)}, got '{class_name}'")
    return numbers


def target_of(sensor: Sensor, entry: QuantityFile) -> plane.Target:
    """Plane target of a quantity; the extinction of its air depends on the sensor's wavelength."""
    conditions = entry.conditions()
    return with_haze(sensor, conditions.target(), conditions.visibility_m)


def range_of_units_m(
    sensor: Sensor, target: plane.Target, tolerances: Mapping[str, float], *, units: float, probability: float
) -> float:
    """Range that a share of built units reach: R - z sigma_R, for independent normal numbers (T223).

    Args:
        tolerances: half of the interval of 95 % of the units by dotted name, in SI units
        units: share of them, z its normal quantile
    """
    range_m = plane.range_at_probability_m(sensor, target, probability)
    moves = equal_terms.range_moves_m(sensor, target, range_m, tolerances, probability=probability)
    sigma_m = math.hypot(*(0.5 * (moves[:, 1] - moves[:, 0]))) / NormalDist().inv_cdf(0.975)
    return max(range_m - NormalDist().inv_cdf(units) * sigma_m, 0.0)


def _scatter_mm(sensor: Sensor, entry: QuantityFile) -> float:
    scatter_m = published_values.scatter_m(sensor, target_of(sensor, entry), range_m=entry.distance)
    return math.inf if scatter_m is None else scatter_m * 1e3


def mean_power_w(sensor: Sensor) -> float:
    """Mean power of the laser, all shots of a point counted."""
    laser = sensor.laser
    energy_j = float(pulse_energy_j(peak_power_w=laser.peak_power_w, fwhm_s=laser.pulse_fwhm_s))
    return energy_j * stationary_train(sensor).mean_rate_hz


def _electrical_power_w(sensor: Sensor, _: QuantityFile) -> float:
    if sensor.power is None:
        raise InputError(f"power: must be in the file of {sensor.name} for electrical_power_w, got none")
    return sensor.power.total_w(mean_power_w(sensor))


def _of_cells(formula: Callable[[GeigerDetector], Lanes]) -> Formula:
    """Quantity of cells in Geiger mode, which no other detector has."""

    def value(sensor: Sensor, _: QuantityFile) -> float:
        if not isinstance(sensor.detector, GeigerDetector):
            raise InputError(f"detector.type: must be sipm or spad for a quantity of cells, got that of {sensor.name}")
        return float(formula(sensor.detector))

    return value


def _cell_maps(sensor: Sensor, entry: QuantityFile) -> CellMaps:
    cells = SphereCells.of_size(entry.cell_deg)
    mask, _ = field_cells(sensor.scanner, cells, entry.time_s)
    return cell_maps(fired_pulses(sensor.scanner, entry.time_s), cells, mask)


def _revisit_s(sensor: Sensor, entry: QuantityFile) -> float:
    revisit_s = _cell_maps(sensor, entry).revisit_s
    return float(np.nanmean(revisit_s)) if np.isfinite(revisit_s).any() else math.inf


_FORMULAS: dict[str, Formula] = {
    "range": lambda sensor, entry: plane.range_at_probability_m(sensor, target_of(sensor, entry), entry.probability),
    "detection_probability": lambda sensor, entry: float(
        plane.detection_probability(sensor, target_of(sensor, entry), entry.distance)[0]
    ),
    "snr": lambda sensor, entry: float(plane.snr(sensor, target_of(sensor, entry), entry.distance)[0]),
    "scatter_mm": _scatter_mm,
    # In the light of the plane: in the dark of the sky the threshold of a SiPM is its floor, and no key moves it.
    "false_points": lambda sensor, entry: statistics.false_points(sensor, target_of(sensor, entry), math.inf).per_frame,
    "mean_power_mw": lambda sensor, entry: 1e3 * mean_power_w(sensor),
    "electrical_power_w": _electrical_power_w,
    "fill_factor": _of_cells(lambda detector: detector.fill_factor),
    "detection_efficiency": _of_cells(lambda detector: detector.efficiency),
    "dark_counts_hz": _of_cells(lambda detector: detector.dark_rate_hz * detector.number_of_cells),
    "aperture_area_mm2": lambda sensor, entry: 1e6 * float(sensor.optics.aperture_m2),
    "points_per_s": lambda sensor, entry: published_values.points_per_second(sensor),
    "pulses_per_frame": lambda sensor, entry: float(sensor.scanner.pulses),
    "frame_s": lambda sensor, entry: sensor.scanner.frame_s,
    "beams": lambda sensor, entry: float(
        len(np.unique(sensor.scanner.channel(np.arange(sensor.scanner.pulses, dtype=np.uint32))))
    ),
    "data_rate_mbit_s": lambda sensor, entry: (
        1e-6 * published_values.points_per_second(sensor) * sensor.tdc.stops * entry.bits_per_point
    ),
    "coverage": lambda sensor, entry: float(_cell_maps(sensor, entry).coverage(np.array([entry.time_s]))[0]),
    "revisit_s": _revisit_s,
}
