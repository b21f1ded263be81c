"""Design studies of real sensors: the shipped ones, their files, what goes wrong."""

import json
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.mistakes import mistakes, told
from helpers.run_seed import chosen, run_seed

from lidarscene import catalog, load_sensor
from lidarscene.files.toml import read_toml
from lidarscene.studies.design.design_study import EVALUATIONS, load_study, run_study
from lidarscene.studies.design.quantities import range_of_units_m
from lidarscene.studies.design.search import alone
from lidarscene.studies.design.workers import on_workers
from lidarscene.studies.eye_safety.eye_safety_report import eye_safety_report
from lidarscene.studies.ranging import plane, sensitivities
from lidarscene.studies.ranging.gain import best_gain

APERTURE = """
sensor = "table1-apd"
evaluations = 60
[free]
"laser.peak_power_w" = { low = 5, high = 75, log = true }
"optics.aperture_radius_mm" = { low = 5, high = 50, log = true }
"detector.gain" = { low = 5, high = 150, log = true }
[objectives]
area = { minimize = "aperture_area_mm2" }
power = { minimize = "mean_power_mw" }
[constraints]
pd = { quantity = "detection_probability", at_least = 0.9, distance = 200 }
eye = { quantity = "class_1_margin", at_least = 1 }
"""


@pytest.fixture(autouse=True)
def without_charts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Charts are the tests of figures; each takes a second."""
    monkeypatch.setattr("lidarscene.figures.lines.save", lambda chart, paths: None)


@pytest.fixture(scope="module")
def front(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Front of `APERTURE` from one search in this process."""
    pytest.importorskip("pymoo")
    folder = tmp_path_factory.mktemp("front")
    return json.loads(run_study(write(folder, APERTURE), folder / "out").as_json())["front"]


def write(folder: Path, text: str) -> Path:
    path = folder / "study.toml"
    path.write_text(text, encoding="utf-8")
    return path


def numbers_of(path: Path, folder: Path, **options: Any) -> dict[str, Any]:
    report = run_study(path, folder, **options)
    report.save(folder)
    numbers: dict[str, Any] = json.loads(report.as_json())
    return numbers


def test_gain_of_an_apd_in_closed_form(tmp_path: Path) -> None:
    """The shipped study against the search over the exact SNR and the closed form, 0.1 %."""
    numbers = numbers_of(catalog.path_of("designs", "gain"), tmp_path / "out")
    best = best_gain(load_sensor("apd-905"), plane.Target(), range_m=150.0)
    gain = numbers["chosen"]["values"]["detector.gain"]
    assert gain == pytest.approx(best.searched, rel=1e-3)
    assert gain == pytest.approx(best.closed_form, rel=1e-3)


@pytest.mark.parametrize("probability", chosen(1, [0.9, 0.5]))
def test_the_front_is_that_of_a_grid(tmp_path: Path, probability: float) -> None:
    """The front has at least 97 % of the hypervolume of all 60^3 designs; each design file is class 1 and detects at
    200 m. Rationale: from this seed, steps by the slope of P_d itself, which is flat near 1, ended at 60 %. Of 28 seeds
    one ended at 96 % after 300 evaluations, with gaps in its front, and after 450 none of eight below 99.8 %.
    """
    indicator = pytest.importorskip("pymoo.indicators.hv")
    path = write(tmp_path, APERTURE.replace("60", "450\nseed = 1").replace("0.9", str(probability)))
    numbers = numbers_of(path, tmp_path / "out")
    points = [[design["quantities"][name] for name in ("area", "power")] for design in numbers["front"]]
    grid = grid_points(probability)
    reference = grid.max(axis=0)
    grid = grid[np.lexsort(grid.T[::-1])]
    grid = grid[np.flatnonzero(np.diff(np.minimum.accumulate(grid[:, 1]), prepend=np.inf) < 0.0)]  # its front
    volume = indicator.HV(ref_point=reference)
    assert volume(np.array(points)) >= 0.97 * volume(grid)
    for name in numbers["files"][:: max(len(numbers["files"]) // 4, 1)]:
        sensor = load_sensor(tmp_path / "out" / name)
        assert eye_safety_report(sensor, scanned=True).is_class_1
        assert float(plane.detection_probability(sensor, plane.Target(), 200.0)[0]) >= probability - 1e-9


def grid_points(probability: float) -> np.ndarray:
    """(n, 2) area in mm2 and mean power in mW of all feasible designs of a grid of 60^3, in closed form."""
    sensor = load_sensor("table1-apd")
    power, radius, gain = np.meshgrid(
        np.geomspace(5, 75, 60), np.geomspace(5, 50, 60) * 1e-3, np.geomspace(5, 150, 60), indexing="ij"
    )
    designs = replace(
        sensor,
        laser=replace(sensor.laser, peak_power_w=power),
        optics=replace(sensor.optics, aperture_radius_m=radius),
        detector=replace(sensor.detector, gain=gain),
    )
    detected = plane.detection_probability(designs, plane.Target(), 200.0) >= probability
    report = eye_safety_report(sensor, scanned=True)
    feasible = detected & (power <= report.class_1_peak_power_w)
    area_mm2 = np.pi * radius**2 * 1e6
    mean_mw = report.pulse_energy_j * power / report.peak_power_w * float(sensor.laser.repetition_rate_hz) * 1e3
    return np.stack([area_mm2[feasible], mean_mw[feasible]], axis=1)


def test_a_search_that_was_killed_goes_on_with_the_same_front(tmp_path: Path, front: Any) -> None:
    """Killed after 25 of 60 designs, with half a line written: the second run asks for the other 35 only."""
    path = write(tmp_path, APERTURE)
    _, evaluator = load_study(path)
    asked = 0

    def killed(designs: Sequence[Any]) -> Any:
        nonlocal asked
        for answer in alone(evaluator)(designs):
            asked += 1
            if asked > 25:
                raise KeyboardInterrupt
            yield answer

    with pytest.raises(KeyboardInterrupt):
        run_study(path, tmp_path / "out", evaluate=killed)
    with (tmp_path / "out" / EVALUATIONS).open("a", encoding="utf-8") as record:
        record.write('{"values": {"laser.peak')
    asked = -1_000_000
    again = numbers_of(path, tmp_path / "out", evaluate=killed)
    assert asked + 1_000_000 == 35
    assert again["front"] == front


def test_workers_give_the_same_front(tmp_path: Path, front: Any) -> None:
    """The functions run here that run in the processes of a client; the client itself is Dask's."""

    class Client:
        def map(self, function: Any, designs: Sequence[Any], *, pure: bool, **options: Any) -> list[Any]:
            class Answer:
                def __init__(self, design: Any) -> None:
                    self.result = lambda: function(design, **options)

            assert not pure
            return [Answer(design) for design in designs]

    path = write(tmp_path, APERTURE)
    evaluate = on_workers(Client(), path, threads=1)
    assert numbers_of(path, tmp_path / "workers", evaluate=evaluate)["front"] == front


def test_a_folder_of_another_study_is_refused(tmp_path: Path) -> None:
    gain = catalog.path_of("designs", "gain")
    text = gain.read_text(encoding="utf-8").replace("evaluations = 120", "evaluations = 10")
    run_study(write(tmp_path, text), tmp_path / "out")
    before = (tmp_path / "out" / EVALUATIONS).read_bytes()
    other = write(tmp_path, text.replace("150, illuminance_klux", "100, illuminance_klux"))
    with told("evaluations.jsonl"):
        run_study(other, tmp_path / "out")
    assert (tmp_path / "out" / EVALUATIONS).read_bytes() == before


def test_eye_safety_of_another_power_is_that_of_its_own_report() -> None:
    """All criteria are linear in the power: the report that is scaled equals the report that is made."""
    sensor = load_sensor("table1-apd")
    report = eye_safety_report(sensor, scanned=True)
    laser = replace(sensor.laser, peak_power_w=7.0)
    made, scaled = eye_safety_report(replace(sensor, laser=laser), scanned=True), report.at_power_w(7.0)
    assert scaled.verdict == made.verdict == "class 1"
    for ours, theirs in zip(scaled.criteria, made.criteria, strict=True):
        assert ours.value == pytest.approx(theirs.value, rel=1e-12)
        assert ours.simulated == pytest.approx(theirs.simulated, rel=1e-12)


@pytest.mark.parametrize("name", ["table1-apd", "os1-128", "mems-1550"])
def test_range_at_a_probability(name: str) -> None:
    """P_d at the range is the one that was asked for, or the window ends first."""
    sensor = load_sensor(name)
    for probability in (0.5, 0.9):
        range_m = plane.range_at_probability_m(sensor, plane.Target(), probability)
        assert range_m > 10.0
        if range_m < float(plane.window_m(sensor)):
            at_range = float(plane.detection_probability(sensor, plane.Target(), range_m)[0])
            assert at_range == pytest.approx(probability, abs=1e-6)


def test_a_range_of_nothing_and_of_a_window() -> None:
    sensor = load_sensor("table1-apd")
    assert plane.range_at_probability_m(sensor, plane.Target(reflectivity=0.0), 0.5) == 0.0
    bright = replace(sensor, laser=replace(sensor.laser, peak_power_w=1e6))
    assert plane.range_at_probability_m(bright, plane.Target(), 0.9) == float(plane.window_m(sensor))


STUDY = """
sensor = {sensor}
evaluations = 6
{more}
[free]
{free}
[objectives]
{objectives}
{last}
"""

GAIN = '"detector.gain" = {low = 5, high = 150}'
SNR = 'snr = {maximize = "snr"}'
OFF = 'eye_safety = "off"'


@mistakes(
    r"""
    free: "detector.gane" = {low = 5, high = 9} | free.detector.gane | detector.gain
    free: "detector.gain" = {low = 9, high = 5} | low | high | 9 and 5
    free: "detector.gain" = {low = 0, high = 5, log = true} | low | more than 0 | log
    free: "detector.gain" = {low = 5} | low and high | choices
    free: "detector.gain" = {choices = [5]} | choices | two or more | 1
    free: "tdc.stops" = {low = 1.5, high = 3} | whole numbers | low 1.5
    free: "other:detector.gain" = {low = 5, high = 9} | table1-apd | 'other'
    free: "scanner.azimuth_fov_deg[3]" = {low = 5, high = 9} | scanner.azimuth_fov_deg[3] | table1-apd
    free: "gain" = {low = 5, high = 9} | free.gain | detector.gain?
    free: "detector.gain" = {low = 5, high = 6, step = 2} | step | two values or more | 2 from 5
    sensor: "os9" | sensor | 'os9'
    sensor: ["table1-apd", "table1-apd"] | sensor | different | table1-apd, table1-apd
    objectives: a = {maximize = "snr", minimize = "snr"} | objectives.a | maximize or minimize
    objectives: a = {maximize = "snr", time_s = 3} | time_s | snr
    objectives: a = {maximize = "snr", illuminance_klux = 100000} | illuminance_klux 100000 | 0 or more
    objectives: a = {maximize = "rang"} | objectives.a: | table1-apd | 'rang' | range?
    objectives: a = {maximize = "body_points"} | body_points | scene
    objectives: "a/b" = {maximize = "snr"} | objectives | letters | 'a/b'
    objectives: a = {maximize = "body_points"} more: scene = "streat" | scene 'streat'
    objectives: a = {maximize = "body_points", class = "lorry"} more: scene = "range" | objectives.a.class | 'lorry'
    more: set = {"detector.gane" = 5} | : set: | unknown key 'detector.gane'
    objectives: a = {maximize = "snr", sensor = "front"} | objectives.a.sensor | [sensors] | front
    more: cost = {sensor = [["table1-apd", 3]]} | cost | objective or a constraint
    more: tolerance = {"detector.gane" = 5} | tolerance | objective or a constraint | range_of_units
    objectives: | objectives
    last: B = {quantity = "snr"} | constraints.b | at_least or at_most
    last: B = {quantity = "snr", at_least = 2, at_most = 1} | constraints.b | at_least | <= at_most | 2 and 1
    last: B = {quantity = "snr", at_least = 1e9} OFF | no design of 6
    last: B = {quantity = "aperture_area_mm2", at_most = 1900} OFF | constraints.b | 1963 mm² | at most 1900 mm²
    last: | constraints.class 1 | class_1 is 0.4997 | at least 1 | eye_safety = "off"
    more: evaluation = 3 | 'evaluation' | evaluations
    """,
    OFF=f"more: {OFF}",
    B="[constraints]\nb",
)
def test_mistakes(tmp_path: Path, given: str, named: str) -> None:
    parts = {"sensor": '"table1-apd"', "more": "", "free": GAIN, "objectives": SNR, "last": ""}
    _, *changes = re.split(r"(?:^| )(sensor|more|free|objectives|last):", given)
    parts |= zip(changes[::2], map(str.strip, changes[1::2]), strict=True)
    with told(f"study.toml | {named}"):
        run_study(write(tmp_path, STUDY.format(**parts)), tmp_path / "out")
    assert not (tmp_path / "out" / "index.html").exists()


def test_class_1_holds_a_power_unless_it_is_off(tmp_path: Path) -> None:
    """The best power is the limit of class 1; off, the end of its range; a bound of one's own counts."""
    powers = {}
    own = '[constraints]\neye = {quantity = "class_1_margin", at_least = 2}'
    for name, more, last in (("default", "", ""), ("off", OFF, ""), ("own", "", own)):
        text = STUDY.format(
            sensor='"table1-apd"',
            more=more,
            free='"laser.peak_power_w" = {low = 5, high = 90}',
            objectives=SNR,
            last=last,
        )
        numbers = numbers_of(write(tmp_path, text.replace("evaluations = 6", "evaluations = 40")), tmp_path / name)
        powers[name] = numbers["chosen"]["values"]["laser.peak_power_w"]
    limit_w = eye_safety_report(load_sensor("table1-apd"), scanned=True).class_1_peak_power_w
    assert powers == pytest.approx({"default": limit_w, "off": 90.0, "own": limit_w / 2.0}, rel=1e-4)


def test_a_constraint_that_no_key_moves_is_said(tmp_path: Path) -> None:
    """The warning comes first; false points are those in the light of the plane, which a threshold moves."""
    last = '[constraints]\narea = {quantity = "aperture_area_mm2", at_most = 2000}'
    text = STUDY.format(sensor='"apd-905"', more="", free=GAIN, objectives=SNR, last=last)
    with pytest.warns(UserWarning, match=r"constraints\.area: no free key moves it: aperture_area_mm2 is 1963 mm²"):
        run_study(write(tmp_path, text), tmp_path / "out")
    noise = '[constraints]\nnoise = {quantity = "false_points", at_most = 20}'
    free = '"tdc.threshold_to_noise" = {low = 3, high = 9}'
    text = STUDY.format(sensor='"sipm-905"', more="", free=free, objectives='range = {maximize = "range"}', last=noise)
    numbers = numbers_of(write(tmp_path, text.replace("evaluations = 6", "evaluations = 60")), tmp_path / "sipm")
    # Between 5.98 (21.8) and 6 (11.9) times the noise the threshold passes a step of the counts: no slope leads there.
    assert numbers["chosen"]["quantities"]["noise"] <= 20.0
    reached_m = plane.range_at_probability_m(
        load_sensor("sipm-905", overrides={"tdc.threshold_to_noise": 6.0}), plane.Target(), 0.9
    )
    assert numbers["chosen"]["quantities"]["range"] == pytest.approx(reached_m, rel=1e-2)


def test_the_share_of_built_units_reaches_its_range() -> None:
    """20,000 drawn units: 95 % and 80 % of them detect at the range of these shares, within four sigma and 0.5 %."""
    sensor, target = load_sensor("apd-905"), plane.Target()
    tolerances = {"laser.peak_power_w": 2.0, "optics.aperture_radius_m": 5e-4, "tdc.threshold_to_noise": 0.3}
    values = sensitivities.parameters(sensor, target)
    random = np.random.default_rng(run_seed())
    drawn = {name: random.normal(values[name], half / 1.96, 20_000) for name, half in tolerances.items()}
    units, _ = sensitivities.with_parameters(sensor, target, drawn)
    for share in (0.95, 0.8):
        range_m = range_of_units_m(sensor, target, tolerances, units=share, probability=0.9)
        reached = np.mean(plane.detection_probability(units, target, range_m) >= 0.9)
        assert abs(reached - share) < 4.0 * math.sqrt(share * (1.0 - share) / 20_000) + 0.005


RESERVE = """
sensor = "apd-905"
evaluations = 20
[free]
"optics.aperture_radius_mm" = {low = 5, high = 50}
[tolerance]
"laser.peak_power_w" = 1.5
"tdc.threshold_to_noise" = 0.3
[objectives]
area = {minimize = "aperture_area_mm2"}
[constraints]
reach = {quantity = "range_of_units", at_least = 150}
range = {quantity = "range", at_least = 1}
"""


def test_a_design_has_a_reserve_and_an_interval(tmp_path: Path) -> None:
    """Half of the units would reach more than the 150 m that 95 % do; the page has the interval of the file."""
    numbers = numbers_of(write(tmp_path, RESERVE), tmp_path / "out")
    quantities = numbers["chosen"]["quantities"]
    assert quantities["reach"] == pytest.approx(150.0, rel=1e-4)
    assert quantities["range"] > 152.0
    low, high = numbers["chosen"]["intervals"]["range"]
    assert low < quantities["range"] < high
    assert "range over the stated uncertainties, m" in (tmp_path / "out" / "index.md").read_text(encoding="utf-8")
    wrong = write(tmp_path, RESERVE.replace('"tdc.threshold_to_noise" = 0.3', '"tdc.stops" = 1'))
    with told("tolerance.tdc.stops | range of apd-905"):
        run_study(wrong, tmp_path / "wrong")


TABLES = """
sensor = ["apd-905", "sipm-905"]
evaluations = 24
[free]
mounting = {choices = [{position_m = [0, 0, 1.8]}, {position_m = [0, 0, 2.2], pitch_deg = -3}]}
"optics.aperture_radius_mm" = {low = 5, high = 20, step = 5}
[cost]
sensor = [["apd-905", 10], ["sipm-905", 30]]
"optics.aperture_radius_mm" = [[5, 1], [20, 7]]
[objectives]
cost = {minimize = "cost"}
range = {maximize = "range"}
[constraints]
height = {quantity = "mounting.position_m[2]", at_least = 2}
rate = {quantity = "data_rate_mbit_s", at_most = 1000, bits_per_point = 64}
"""


@pytest.mark.filterwarnings("ignore:.*rate. no free key moves it")
def test_tables_are_choices_and_parts_have_costs(tmp_path: Path) -> None:
    """All 16 designs; the mounting is replaced as a whole, and a cost is that of the sensor and of its lens."""
    numbers = numbers_of(write(tmp_path, TABLES), tmp_path / "out")
    assert numbers["ending"] == "all 16 designs of the study were tried"
    for design, file in zip(numbers["front"], numbers["files"], strict=True):
        values, quantities = design["values"], design["quantities"]
        assert values["mounting"] == {"position_m": [0, 0, 2.2], "pitch_deg": -3}
        parts = {"apd-905": 10, "sipm-905": 30}[values["sensor"]]
        assert quantities["cost"] == pytest.approx(parts + 1 + 0.4 * (values["optics.aperture_radius_mm"] - 5))
        sensor = load_sensor(tmp_path / "out" / file)
        assert sensor.mounting.position_m.tolist() == [0.0, 0.0, 2.2]
        assert sensor.optics.aperture_radius_m == pytest.approx(1e-3 * values["optics.aperture_radius_mm"])
        pulses_per_s = sensor.scanner.pulses / sensor.scanner.frame_s
        assert quantities["rate"] == pytest.approx(pulses_per_s * sensor.tdc.stops * 64e-6)
    missing = write(tmp_path, TABLES.replace("[20, 7]", "[12, 7]").replace("low = 5", "low = 15"))
    with told("cost.optics.aperture_radius_mm | 15.0 | 5.0, 12.0"):
        run_study(missing, tmp_path / "missing")
    twice = write(tmp_path, TABLES.replace("[20, 7]", "[5, 7]"))
    with told("cost | optics.aperture_radius_mm | one cost of 5.0 | 2"):
        run_study(twice, tmp_path / "twice")


def test_designs_that_cannot_be_are_told(tmp_path: Path) -> None:
    """A sensor without a cost is on no front, and the verdict says why."""
    text = """
    sensor = ["apd-905", "sipm-905"]
    evaluations = 4
    [free]
    "optics.aperture_radius_mm" = {choices = [5, 10]}
    [cost]
    sensor = [["apd-905", 20]]
    [objectives]
    cost = {minimize = "cost"}
    """
    numbers = numbers_of(write(tmp_path, text), tmp_path / "out")
    assert numbers["impossible"] == 2
    told = " 2 of them cannot be built or judged; the first: cost.sensor: must have a cost of 'sipm-905', got apd-905."
    assert told in numbers["verdict"]


PARTS = """
sensor = "apd-905"
evaluations = 8
[free]
detector = {choices = ["apd-905", "theirs.toml"]}
"laser.peak_power_w" = {choices = [10, 20]}
[cost]
detector = [["apd-905", 30], ["theirs.toml", 10]]
[objectives]
cost = {minimize = "cost"}
range = {maximize = "range"}
"""


def test_a_detector_of_another_file_is_a_choice(tmp_path: Path) -> None:
    """A text in place of a table means that file's part, found beside the study; designs are files by themselves."""
    theirs = catalog.path_of("sensors", "sipm-905").read_text(encoding="utf-8")
    (tmp_path / "theirs.toml").write_text(theirs, encoding="utf-8")
    numbers = numbers_of(write(tmp_path, PARTS), tmp_path / "out")
    assert numbers["ending"] == "all 4 designs of the study were tried"
    for design, file in zip(numbers["front"], numbers["files"], strict=True):
        values, quantities = design["values"], design["quantities"]
        name = {"apd-905": "apd-905", "theirs.toml": "sipm-905"}[values["detector"]]
        power = {"laser.peak_power_w": values["laser.peak_power_w"]}
        expected = load_sensor("apd-905").with_detector(name).replace(power)
        sensor = load_sensor(tmp_path / "out" / file)
        for field in ("detector", "tdc", "laser", "optics", "receiver"):
            assert getattr(sensor, field) == getattr(expected, field)
        assert sensor.source_of("tdc.window_us") == expected.source_of("tdc.window_us")
        assert sensor.source_of("laser.peak_power_w") == "chosen by the design study"
        assert "laser.peak_power_w" not in sensor.uncertainty
        assert sensor.uncertainty == expected.uncertainty
        assert quantities["cost"] == {"apd-905": 30, "sipm-905": 10}[name]
        range_m = plane.range_at_probability_m(expected, plane.Target(), 0.9)
        assert quantities["range"] == pytest.approx(range_m, rel=1e-9)
    assert {design["values"]["detector"] for design in numbers["front"]} == {"apd-905", "theirs.toml"}
    files = [(tmp_path / "out" / file).read_text(encoding="utf-8") for file in numbers["files"]]
    assert any("# Hamamatsu" in text for text in files)  # what no part replaces keeps its comments


def test_the_page_begins_with_the_question(tmp_path: Path) -> None:
    """Question, verdict, what differs at both ends, and what would change it, of a front whose ends are known."""
    text = STUDY.format(
        sensor='"apd-905"',
        more="",
        free='"optics.aperture_radius_mm" = {low = 10, high = 30, step = 10}',
        objectives='reach = {maximize = "range", probability = 0.5}\narea = {minimize = "aperture_area_mm2"}',
        last='[constraints]\nrate = {quantity = "points_per_s", at_most = 1e6}',
    )
    with pytest.warns(UserWarning, match="no free key moves it"):
        numbers = numbers_of(write(tmp_path, text), tmp_path / "out")
    question = (
        "Which apd-905 has the highest reach (range, P_d 0.5, reflectivity 0.1, 100 klux) and the lowest area "
        "(aperture_area_mm2), with optics.aperture_radius_mm from 10 to 30 in steps of 10? Allowed: rate "
        "(points_per_s) at most 1e+06 1/s; class 1."
    )
    assert numbers["question"] == question
    page = (tmp_path / "out" / "index.md").read_text(encoding="utf-8")
    leads = ["Question", "Verdict", "What it rests on", "What differs", "What would change it"]
    places = [page.index(f"**{lead}.** ") for lead in leads]
    assert places == sorted(places)
    assert places[-1] < page.index("![front-area]") < page.index("## The designs")
    reached_m = plane.range_at_probability_m(
        load_sensor("apd-905", overrides={"optics.aperture_radius_mm": 30}), plane.Target(), 0.5
    )
    assert f"The best reach: reach {reached_m:.4g} m, area 2827 mm²" in page
    assert "The best area: reach " in page
    header = (tmp_path / "out" / "front.csv").read_text(encoding="utf-8").splitlines()[0]
    assert header.startswith("reach range_pd50_m,area,rate,class 1,")


def test_a_dotted_key_needs_no_quotes(tmp_path: Path) -> None:
    """A search in which nothing changes says so, and its progress has the front so far."""
    text = STUDY.format(
        sensor='"table1-apd"',
        more=OFF,
        free="detector.gain = {low = 5, high = 9}",
        objectives='area = {minimize = "aperture_area_mm2"}',
        last="",
    )
    said: list[str] = []
    numbers = numbers_of(
        write(tmp_path, text), tmp_path / "out", progress=lambda count, total, words: said.append(words)
    )
    assert list(numbers["chosen"]["values"]) == ["detector.gain"]
    assert numbers["verdict"].endswith("No design changes area: are pose, class and keys as meant?")
    assert said[0] == "1 on the front, best area 1963"


def test_a_sensor_is_a_choice_and_keys_belong_to_one(tmp_path: Path) -> None:
    """Keys of the sensor that is not chosen are not tried in vain, and cells stay whole."""
    pytest.importorskip("pymoo")
    text = """
    sensor = ["table1-apd", "table1-sipm"]
    evaluations = 30
    eye_safety = "off"
    [set]
    "table1-sipm:detector.statistics" = "time_domain"
    [free]
    "table1-apd:detector.gain" = {low = 10, high = 90}
    "table1-sipm:detector.cells" = {low = 100, high = 1600, step = 100}
    [objectives]
    range = {maximize = "range"}
    """
    numbers = numbers_of(write(tmp_path, text), tmp_path / "out")
    chosen = numbers["chosen"]["values"]
    assert chosen["sensor"] == "table1-sipm"
    assert isinstance(chosen["table1-sipm:detector.cells"], int)
    assert "table1-apd:detector.gain" not in chosen
    sensor = load_sensor(tmp_path / "out" / numbers["files"][0])
    reached_m = plane.range_at_probability_m(sensor, plane.Target(), 0.9)
    assert reached_m == pytest.approx(numbers["chosen"]["quantities"]["range"], rel=1e-8)


def test_coverage_of_wedges_depends_on_their_speeds(tmp_path: Path) -> None:
    """Entries of lists of tables are free keys; the best of twelve pairs covers more than the worst by a fifth."""
    text = catalog.path_of("designs", "coverage").read_text(encoding="utf-8")
    text = text.replace("evaluations = 200", "evaluations = 12").replace("time_s = 0.1", "time_s = 0.02")
    text = text.replace("{ maximize", "{ cell_deg = 1, maximize")
    numbers = numbers_of(write(tmp_path, text), tmp_path / "out")
    lines = (tmp_path / "out" / EVALUATIONS).read_text(encoding="utf-8").splitlines()[1:]
    shares = [json.loads(line)["quantities"]["coverage"] for line in lines]
    assert numbers["chosen"]["quantities"]["coverage"] == max(shares) > 1.2 * min(shares)
    written = read_toml(tmp_path / "out" / numbers["files"][0])
    speeds = [wedge["rotation_hz"] for wedge in written["scanner"]["wedges"]]
    assert speeds == pytest.approx(list(numbers["chosen"]["values"].values()))


@pytest.mark.parametrize("name", catalog.names("designs"))
def test_shipped_studies_load(name: str) -> None:
    study, evaluator = load_study(catalog.path_of("designs", name))
    assert study.name
    sensors = evaluator.space.sensors(evaluator.space.values(np.full(len(evaluator.space.free), 0.5)))
    assert all(math.isfinite(float(sensor.laser.peak_power_w)) for sensor in sensors.values())


CELLS = """
sensor = "sipm-905"
evaluations = 8
[set]
"detector.cell_gap_um" = 2
"power.driver_efficiency" = 0.1
"power.electronics_w" = 6
"power.scanner_w" = 1.5
[free]
"detector.cells" = {choices = [100, 400, 1600]}
[objectives]
range = {maximize = "range"}
[constraints]
power = {quantity = "electrical_power_w", at_most = 9}
fill = {quantity = "fill_factor", at_least = 0.1}
efficiency = {quantity = "detection_efficiency", at_least = 0.01}
dark = {quantity = "dark_counts_hz", at_most = 1e9}
"""


def test_cells_and_watts_are_quantities(tmp_path: Path) -> None:
    """Numbers of the sensor by hand: a tenth of the driver's power is light, and dark counts are those of all cells."""
    with pytest.warns(UserWarning, match=r"constraints\.power: no free key moves it"):
        numbers = numbers_of(write(tmp_path, CELLS), tmp_path / "out")
    quantities, cells = numbers["chosen"]["quantities"], numbers["chosen"]["values"]["detector.cells"]
    sensor = load_sensor("sipm-905", overrides={"detector.cells": cells, "detector.cell_gap_um": 2})
    energy_j = math.sqrt(math.pi / (4.0 * math.log(2.0))) * sensor.laser.peak_power_w * sensor.laser.pulse_fwhm_s
    light_w = energy_j * sensor.laser.repetition_rate_hz
    assert quantities["power"] == pytest.approx(10.0 * light_w + 7.5, rel=1e-3)
    assert quantities["dark"] == pytest.approx(cells * 2007.0)
    assert quantities["efficiency"] == pytest.approx(0.22 * quantities["fill"])
    page = (tmp_path / "out" / "index.md").read_text(encoding="utf-8")
    assert f"Power of the chosen design: {1e3 * light_w:.3g} mW of light, driver {10.0 * light_w:.3g} W" in page
    diode = CELLS.replace("sipm-905", "apd-905").replace('"detector.cell_gap_um" = 2', "").replace("cells", "gain")
    with told("sipm or spad | cells | apd-905"):
        run_study(write(tmp_path, diode), tmp_path / "diode")
    lone = "\n".join(line for line in CELLS.splitlines() if not line.startswith('"power.'))
    with told("power | sipm-905 | electrical_power_w | none"):
        run_study(write(tmp_path, lone), tmp_path / "lone")
