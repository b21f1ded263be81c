"""Sensitivities: exact derivatives against central differences of the range itself, and known exponents."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from helpers import rounding
from helpers.mistakes import told
from helpers.run_seed import chosen

from lidarscene import catalog, load_sensor
from lidarscene.errors import InputError
from lidarscene.files.toml import read_toml, validate
from lidarscene.sensor.overlap import Overlap
from lidarscene.sensor.sensor_file import SensorFile
from lidarscene.sensor.sensor_model import overlap_geometry
from lidarscene.studies.ranging import gain, plane, sensitivities
from lidarscene.studies.ranging.conditions import Conditions
from lidarscene.studies.ranging.plane import Target

APD, SIPM = load_sensor("table1-apd"), load_sensor("table1-sipm")
HAZE = Target(extinction_per_m=2e-4, diffuse_share=0.1, transmittance=1.0, cos_incidence=0.8)
EVERY = pytest.mark.parametrize(
    ("sensor", "target"),
    [
        (APD, Target()),
        (SIPM, Target()),
        (APD, HAZE),
        (SIPM, HAZE),
        (SIPM, Target(illuminance_klux=0.01)),
        (load_sensor("table1-sipm", overrides=["detector.statistics='published'"]), Target()),
        (
            dataclasses.replace(APD, tdc=dataclasses.replace(APD.tdc, threshold_to_noise=None, threshold_level=1e-6)),
            Target(),
        ),
        (load_sensor("table1-apd", overrides=["detector.circuit_noise_na=20"]), Target(illuminance_klux=0.0)),
    ],
    ids=["apd", "sipm", "apd-haze", "sipm-haze", "sipm-one-cell", "sipm-published", "apd-fixed-level", "apd-dark"],
)


def limit_m(sensor, target):
    return float(plane.detection_range_m(sensor, target, 0.9)[0])


@pytest.fixture(scope="module")
def slopes():
    """Slopes by fourth-order central differences, of the range by root finding and of P_d, by parameter.

    Found once for both methods: a function of sensor, target, the distance of P_d and the parameters.
    """
    computed = {}

    def slopes_of(sensor, target, distance, values):
        case = id(sensor), id(target)  # of `EVERY`, which keeps them
        if case not in computed:
            computed[case] = {}
            for name, value in values.items():
                step = 1e-3 * abs(value) or {"extinction_per_m": 1e-7}.get(name.partition(".")[2], 1e-5)
                if name.endswith("current_a") and not value:
                    step = 1e-12
                places = value + step * np.array([-2.0, -1.0, 1.0, 2.0])
                changed = sensitivities.with_parameters(sensor, target, {name: places})
                reach = plane.detection_range_m(*changed, 0.9)[0]
                detection = plane.detection_probability(*changed, distance)
                of_range, of_detection = (
                    steps @ [1.0, -8.0, 8.0, -1.0] / (12.0 * step) for steps in (reach, detection)
                )
                computed[case][name] = of_range, of_detection, abs(value) or step
        return computed[case]

    return slopes_of


def check(sensor, target, slopes, *, method, rel):
    """Every row against the differences of `slopes`."""
    distance = 0.97 * limit_m(sensor, target)
    table = sensitivities.sensitivities(sensor, target, distance_m=distance, method=method)
    assert len(table.rows) > 20
    expected = slopes(sensor, target, distance, {row.parameter: row.value for row in table.rows})
    for row in table.rows:
        of_range, of_detection, scale = expected[row.parameter]
        # The range is found to 1e-10; P_d has a step of 1e-10 in the middle of the Gaussian.
        assert row.range_slope == pytest.approx(of_range, rel=rel, abs=1e-6 * table.range_m / scale), row
        assert row.detection_slope == pytest.approx(of_detection, rel=rel, abs=1e-6 / scale), row


@EVERY
def test_by_drjit(mi, slopes, sensor, target):
    """docs/validation.md, check 6: 1e-3 is asked for, 1e-6 comes."""
    check(sensor, target, slopes, method="drjit", rel=rounding.limit(1e-6))


@EVERY
def test_by_differences(slopes, sensor, target):
    """What a machine without a back end gets."""
    check(sensor, target, slopes, method="differences", rel=1e-5)


def test_every_number_is_a_parameter():
    names = set(sensitivities.parameters(APD, Target()))
    for part in ("laser", "optics", "detector", "tdc"):
        for field in dataclasses.fields(getattr(APD, part)):
            value = getattr(getattr(APD, part), field.name)
            number = isinstance(value, (int, float)) and not isinstance(value, bool) and field.name != "stops"
            assert (f"{part}.{field.name}" in names) == number
    numbers = {field.name for field in dataclasses.fields(Target) if field.default is not None}
    assert {f"target.{name}" for name in numbers} <= names


def report_text(sensor, **options):
    return sensitivities.report_text(sensor, Target(), sensitivities.sensitivities(sensor, Target(), **options))


def test_report():
    text = report_text(APD, method="differences")
    assert f"table1-apd: range {limit_m(APD, Target()):.3f} m at P_d 0.9" in text
    assert "P_d 90.00 % at " in text
    assert "sixth-order central differences" in text
    line = next(line for line in text.splitlines() if line.startswith("laser.peak_power_w"))
    assert line.split()[1:4] == ["45", "W", "+0.5000"]
    assert re.search(
        r"\ntarget\.extinction_per_m +-\d[^ ]* m, -\d[^ ]* of P_d per 1/m\n", text.partition("zero now")[2]
    )
    assert "laser.repetition_rate_hz" in text.partition("no effect")[2]
    assert "gain of the best SNR: 30.9 by search, 30.9 in closed form; the present 80 has 92.2 %" in text
    assert "gain of the best" not in report_text(SIPM, method="differences")


def test_report_of_whole_cells_says_that_p_d_has_steps():
    """The text and the page of binomial counts do, those of the paper's Gaussian do not."""
    whole = dataclasses.replace(SIPM, detector=dataclasses.replace(SIPM.detector, counting="binomial"))
    steps = "P_d steps where the threshold passes a whole number of cells"
    for sensor in (whole, SIPM):
        assert (steps in report_text(sensor, method="differences")) == (sensor is whole)
    report = sensitivities.sensitivity_report([("whole", whole)], Conditions())
    assert steps in report.summary


def test_report_says_when_it_is_exact(mi):
    assert "exact, by Dr.Jit" in report_text(APD)


def test_no_range_no_sensitivities():
    blind = load_sensor("table1-sipm", overrides=["tdc.threshold_to_noise=1000"])
    with told("range"):
        sensitivities.sensitivities(blind, Target())
    with pytest.raises(ValueError, match="no method"):
        sensitivities.sensitivities(APD, Target(), method="guess")


@pytest.mark.parametrize("overrides", [[], ["detector.bulk_dark_current_na=5"], ["detector.circuit_noise_na=30"]])
@pytest.mark.parametrize("klux", [1.0, 100.0])
def test_best_gain(overrides, klux):
    """Closed form and search agree; 1e-6 is what a flat maximum lets a search see."""
    target = Target(illuminance_klux=klux)
    tuned = load_sensor("table1-apd", overrides=overrides)
    best = gain.best_gain(tuned, target)
    assert best.searched == pytest.approx(best.closed_form, rel=1e-5)
    assert 0.0 < best.snr_share <= 1.0
    for ratio in (0.001, 0.02, 0.5, 1.0):
        diode = dataclasses.replace(tuned.detector, excess_noise_index=None, ionisation_ratio=ratio)
        best = gain.best_gain(dataclasses.replace(tuned, detector=diode), target)
        assert best.searched == pytest.approx(best.closed_form, rel=1e-5)


def test_best_gain_of_table_1():
    assert gain.best_gain(APD, Target()).closed_form == pytest.approx(30.873, abs=1e-3)
    with pytest.raises(ValueError, match="no gain"):
        gain.best_gain(SIPM, Target())
    silent = dataclasses.replace(
        APD.detector, temperature_k=0.0, surface_dark_current_a=0.0
    )  # nothing for a gain to lift the signal above
    assert gain.best_gain(dataclasses.replace(APD, detector=silent), Target()).closed_form == 1.0


def test_a_signal_that_rises_with_range_has_no_sensitivities(monkeypatch):
    """Rationale: right before two lenses the near field grows faster than the square of the range falls."""

    def rising(_, values):
        return 0.5, dict.fromkeys(values, 1.0)

    monkeypatch.setattr(sensitivities, "choose_derivation", lambda _: ("differences", rising))
    with pytest.raises(InputError, match=r"P_d at .* m does not fall with range"):
        sensitivities.sensitivities(APD, Target())


def test_no_gain_is_below_one():
    """Light that drowns the amplifier's noise asks for less than one, which no diode has."""
    best = gain.best_gain(APD, Target(illuminance_klux=1e7))
    assert best.closed_form == 1.0
    assert best.searched == pytest.approx(1.0, abs=1e-6)
    assert best.snr_share < 1.0


def test_rows_go_by_size_and_points_are_of_a_per_cent():
    """Elasticities of both signs, the largest first; a per cent of a parameter moves P_d by slope times value / 100."""
    table = sensitivities.sensitivities(APD, Target(), method="differences")
    sizes = [abs(row.range_elasticity or 0.0) for row in table.rows]
    assert sizes == pytest.approx(sorted(sizes, reverse=True), abs=1e-6)
    assert min(row.range_elasticity or 0.0 for row in table.rows) < -0.01
    power = next(row for row in table.rows if row.parameter == "laser.peak_power_w")
    shots = [
        100.0
        * float(
            plane.detection_probability(
                dataclasses.replace(APD, laser=dataclasses.replace(APD.laser, peak_power_w=power.value * factor)),
                Target(),
                table.distance_m,
            )[0]
        )
        for factor in (0.995, 1.005)
    ]
    assert power.detection_points == pytest.approx(shots[1] - shots[0], rel=1e-3)


def test_a_diode_without_holes_ionising_has_its_best_gain_in_closed_form():
    """F = 2 - 1 / M: M = 2 c / (a + b), which the search finds too."""
    diode = dataclasses.replace(APD.detector, ionisation_ratio=0.0, excess_noise_index=None)
    best = gain.best_gain(dataclasses.replace(APD, detector=diode), Target(illuminance_klux=5.0))
    assert best.closed_form == pytest.approx(best.searched, rel=1e-3)


CONVERTER_KEYS = {"ambient_window_s": "ambient_window_us", "blanking_s": "blanking_ns"}
"""Fields of the converter -> keys of [histogram], which stands in its place."""

ALIGNMENT_KEYS = {"crossing_m": "parallax_free_at_m", "focus_m": "focus_at_m", "scattered": "scattered_share"}

BOUNDED = ("laser.repetition_rate_hz", "tdc.window_s", "tdc.fraction")
"""Numbers that another key bounds or allows, so that a file with slightly more may be refused."""


def assignment(file, parameter, value):
    """Key of the file and its value there for a number in SI units; None where the file has no such key."""
    part, _, field = parameter.rpartition(".")
    if parameter in BOUNDED:
        return None
    if part == "optics.overlap":
        if field == "offset_m":
            return f"{part}.transmitter_offset_mm=[0.0, {1e3 * value!r}]"
        return f"{part}.{ALIGNMENT_KEYS[field]}={value!r}"
    table = getattr(file, part)
    if table is None and field in CONVERTER_KEYS:
        key = CONVERTER_KEYS[field]
        return f"histogram.{key}={value * (1e6 if key.endswith('us') else 1e9)!r}"
    if table is None or field not in type(table).keys:
        return None
    key, declared = type(table).keys[field]
    if getattr(table, key) is None:
        return None
    return f"{part}.{key}={round(value) if declared.whole else declared.in_file(value)!r}"


def range_m(sensor, name, file, parameter, value):
    """Range as `lidarscene range --set` has it: the file is read anew, so that all that is computed of the
    number follows. A number that is no key of the file is put in the place of what was computed.
    """
    part, _, field = parameter.rpartition(".")
    if part == "target":
        return limit_m(sensor, Target(**{field: value}))
    if (text := assignment(file, parameter, value)) is not None:
        return limit_m(load_sensor(name, overrides=[text]), Target())
    component = dataclasses.replace(getattr(sensor, part), **{field: value})
    return limit_m(dataclasses.replace(sensor, **{part: component}), Target())


BENT = {"sipm-905": ("laser.pulse_fwhm_s", "detector.dead_time_s")}
"""Where the pulse is as long as the dead time, cells that fire twice begin: the slope is the mean of both sides'."""


def sensors_with_every_parameter():
    """Sensors that together have each parameter of the catalogue once for each kind of detector, richest first.

    The others have other numbers in the same laws.
    """
    kinds = {name: load_sensor(name) for name in catalog.names("sensors")}
    rows = {
        name: {(type(s.detector), key) for key in sensitivities.parameters(s, Target())} for name, s in kinds.items()
    }
    held, names = set(), []
    for name in sorted(rows, key=lambda name: -len(rows[name])):
        if not rows[name] <= held:
            names.append(name)
            held |= rows[name]
    return names


@pytest.mark.parametrize("name", chosen(1, sensors_with_every_parameter()))
def test_every_row_is_what_two_runs_of_range_give(name):
    """Rationale: a number that is computed when the file is loaded must not be held while others vary.

    Tolerance 1e-3 of an elasticity: a step of 1e-3 is off by half of it times the elasticity's own slope, which is
    about one. Whole numbers go a step both ways, off by the square of it. A number that is 0 has no elasticity: its
    slope is held to the range that a thousand steps would change.
    """
    file, sensor = validate(SensorFile, read_toml(catalog.path_of("sensors", name)), name), load_sensor(name)
    table = sensitivities.sensitivities(sensor, Target(), method="differences")
    assert len(table.rows) > 20
    for row in table.rows:
        tolerance = 1e-3
        if row.parameter in ("detector.spads", "detector.cells"):
            low_m, high_m = (range_m(sensor, name, file, row.parameter, row.value + step) for step in (-1.0, 1.0))
            slope, scale = 0.5 * (high_m - low_m), row.value
            tolerance += row.value**-2
        else:  # many a number is never negative
            smallest = {"_s": 1e-12, "_m": 1e-7, "_a": 1e-13, "hz": 0.1, "ad": 1e-5}.get(row.parameter[-2:], 1e-7)
            if row.parameter == "optics.overlap.offset_m":
                smallest = 1e-4  # the least offset of a file that is not 0
            step = 1e-3 * row.value or smallest
            slope = (range_m(sensor, name, file, row.parameter, row.value + step) - table.range_m) / step
            if row.parameter in BENT.get(name, ()):
                below_m = range_m(sensor, name, file, row.parameter, row.value - step)
                slope = 0.5 * (slope + (table.range_m - below_m) / step)
            scale = 1e3 * step
        assert slope * scale == pytest.approx(row.range_slope * scale, abs=tolerance * table.range_m), row


def test_overlap_by_drjit(mi):
    """Both methods, the second of them held to two runs above; the overlap's own slopes are shared, and off by 1e-9."""
    sensor = load_sensor("biaxial-905", overrides=["laser.divergence_mrad=12"])
    exact, stepped = (
        {row.parameter: row for row in sensitivities.sensitivities(sensor, Target(), method=method).rows}
        for method in ("drjit", "differences")
    )
    assert exact.keys() == stepped.keys() >= {"optics.overlap.offset_m", "optics.overlap.scattered"}
    assert exact["laser.divergence_rad"].range_elasticity < -0.1
    for name, row in exact.items():
        scale = abs(row.value) or 1e-6
        assert row.range_slope * scale == pytest.approx(stepped[name].range_slope * scale, abs=rounding.limit(1e-4)), (
            name
        )
        assert row.detection_slope * scale == pytest.approx(stepped[name].detection_slope * scale, abs=1e-5), name


def test_share_near_its_centre_is_that_of_the_integral():
    """First order: a step of 1e-3 in each length is off by its square."""
    sensor = load_sensor("os1-128")
    overlap, range_m = sensor.optics.overlap, np.array([4.0])
    lenses = dataclasses.replace(sensor.optics, aperture_radius_m=1.001 * sensor.optics.aperture_radius_m)
    alignment = dataclasses.replace(overlap.geometry.alignment, scattered=0.02)
    moved = overlap_geometry(sensor.laser, lenses, sensor.detector, alignment)
    assert overlap.move(overlap.geometry).share(range_m)[0] == pytest.approx(overlap.share(range_m)[0], abs=1e-5)
    expected = Overlap.from_geometry(moved).share(range_m)[0]
    assert overlap.move(moved).share(range_m)[0] == pytest.approx(expected, abs=1e-5)
    assert abs(expected - overlap.share(range_m)[0]) > 1e-3


@pytest.mark.usefixtures("mi")
@pytest.mark.parametrize("name", chosen(1, ["mems-1550", "os1-128"]))
def test_speckle_is_part_of_the_detection(name):
    """P_d of an echo that fluctuates: value and slopes against P_d of files with other divergences and lenses.

    Tolerance: 1 % for differences of 0.2 %, and 1e-4 for the table of the overlap, which each file has anew.
    """
    speckle = ["laser.speckle={}"]
    base = {"laser.divergence_mrad": 1.0, "optics.aperture_radius_mm": 2.5}

    def sensor(**changes):
        return load_sensor(name, overrides=[*speckle, *(f"{key}={value}" for key, value in (base | changes).items())])

    lidar, target = sensor(), Target()
    distance_m = 0.9 * limit_m(lidar, target)
    table = sensitivities.sensitivities(lidar, target, distance_m=distance_m, method="drjit")
    assert table.detection_probability == pytest.approx(
        plane.detection_probability(lidar, target, distance_m)[0], rel=1e-4
    )
    rows = {row.parameter: row for row in table.rows}
    for key, parameter in (
        ("laser.divergence_mrad", "laser.divergence_rad"),
        ("optics.aperture_radius_mm", "optics.aperture_radius_m"),
    ):
        low, high = (
            plane.detection_probability(sensor(**{key: base[key] * factor}), target, distance_m)[0]
            for factor in (0.999, 1.001)
        )
        # Points of P_d for one percent: the derivative by the logarithm.
        assert rows[parameter].detection_points == pytest.approx((high - low) / 0.002, rel=0.01, abs=1e-4)


def test_counts_are_no_parameters_and_whole_numbers_of_python_are():
    numbers = sensitivities.parameters(load_sensor("vlp-16"), Target(illuminance_klux=100))
    assert numbers["target.illuminance_klux"] == 100.0
    assert numbers["sampler.rate_hz"] == 1e9
    assert not numbers.keys() & {"sampler.samples", "sampler.room", "tdc.stops"}


def test_the_page_has_table_and_chart(tmp_path: Path) -> None:
    report = sensitivities.sensitivity_report([("table1-apd", APD)], Conditions())
    report.save(tmp_path / "page")
    page = (tmp_path / "page" / "index.html").read_text(encoding="utf-8")
    assert "range [% per %]" in page
    assert re.search(r"<td[^>]*>laser\.peak_power_w</td>\s*<td[^>]*>45</td>", page)
    assert (tmp_path / "page" / "tornado_table1-apd.png").stat().st_size > 10_000
