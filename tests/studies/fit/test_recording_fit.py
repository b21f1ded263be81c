"""Draw a recording, forget the laws, fit: the truth is found again, and what is wrong is told."""

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from helpers.command_line import Run
from helpers.drawn_recordings import Truth, drawn_sweep, drawn_truth, two_lenses
from helpers.mistakes import told
from helpers.run_seed import chosen

from lidarscene.catalog import path_of
from lidarscene.figures.report import Report
from lidarscene.files.toml_edit import put_values
from lidarscene.recordings.recording import Recording
from lidarscene.recordings.sweep import Second, Sweep
from lidarscene.sensor.sensor_file import load_sensor
from lidarscene.sensor.sensor_model import Sensor
from lidarscene.studies.fit import recording_fit, sensor_text
from lidarscene.studies.fit.near_field import LENSES, LensCurve, fit_near_field, own_curve, share
from lidarscene.studies.fit.products import near_field_m, scatter_c_mm, white_m2
from lidarscene.studies.fit.recorded_pulses import gather_pulses
from lidarscene.studies.fit.recording_fit import RecordingFit, fit_pulses, fit_recordings, misses_of
from lidarscene.studies.fit.scatter import fit_scatter
from lidarscene.studies.fit.sensor_text import TWO_LENS_KEYS, remove_keys
from lidarscene.studies.ranging.plane import Target, echoes_of_plane
from lidarscene.studies.twin.apparent_reflectivity import ReflectivityGauge
from lidarscene.studies.twin.daylight import illuminance_klux

TRUTH = drawn_truth(0)


@pytest.fixture(scope="module")
def sweep() -> Sweep:
    return drawn_sweep(TRUTH, 0)


@pytest.fixture(scope="module")
def one_lens(tmp_path_factory: pytest.TempPathFactory) -> str:
    """An OS2 whose near field is that of one lens, focused at infinity, on the laser's axis.

    Drawn recordings follow that law. To give up all lenses of an OS1 takes a fit three times as long.
    """
    path = tmp_path_factory.mktemp("sensor") / "one-lens.toml"
    path.write_text(remove_keys(path_of("sensors", "os2-128").read_text("utf-8"), *TWO_LENS_KEYS[:3]), "utf-8")
    return str(path)


@pytest.fixture(scope="module")
def fitted(sweep: Sweep, tmp_path_factory: pytest.TempPathFactory) -> Sensor:
    """An OS1-128 fitted to the recording."""
    path = tmp_path_factory.mktemp("fitted") / "unit.toml"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recording_fit, "open_recording", drawn_opener(sweep))
        path.write_text(fit_recordings([path.with_name("drawn.pcap")], "os1-128")[0], "utf-8")
    return load_sensor(path)


def test_the_truth_is_within_two_sigma() -> None:
    """Five units, eight numbers each. benchmarks/fit_coverage.py finds 96 % of 800 within 2 sigma.

    With 95 %, fewer than 32 of 40 come by chance in one of 50 000 draws, were they independent; the eight of a fit are
    in groups of two and three, so that one in 1000 is a fair bound. The seeds are fixed.
    """
    deviations = []
    for unit in range(5):
        truth = drawn_truth(unit)
        pulses = gather_pulses([drawn_sweep(truth, 10 * unit)])
        fit = fit_pulses(pulses)
        assert len(fit.estimates) == 8
        assert fit.near_field is not None
        assert not fit.near_field.solved.at_limit
        deviations += [(estimate.value - asdict(truth)[estimate.key]) / estimate.sigma for estimate in fit.estimates]
    assert np.sum(np.abs(deviations) < 2.0) >= 32
    assert np.max(np.abs(deviations)) < 5.0


def test_a_law_that_fails_has_wider_sigmas_and_its_report_says_so(
    tmp_path: Path, without_figures: pytest.MonkeyPatch, sweep: Sweep, one_lens: str
) -> None:
    """Rationale: a scatter law fitted to ranges that follow another one claimed some per cent.

    Here returns of 120 to 340 photons scatter by 50 mm more: what all strong ones do more, the floor of the law takes,
    and one seed in ten then missed its bins by no more than 1.3 times. Of the right law chi-square of its four degrees
    of freedom is beyond 2.5^2 of them in one of 20 000 recordings.
    """
    between = np.abs(np.log2(np.asarray(sweep.signal) / 200.0)) < 0.75
    extra_m = 0.05 * np.random.default_rng(3).standard_normal(sweep.shape)
    spoilt = replace(sweep, range_m=sweep.range_m + np.where(between, extra_m, 0.0))
    histogram = load_sensor(one_lens).histogram
    right, wrong = (fit_scatter(gather_pulses([recording]), histogram) for recording in (sweep, spoilt))
    assert right is not None
    assert wrong is not None
    assert right.solved.misfit < 2.5
    assert wrong.solved.misfit > max(1.3, right.solved.misfit)
    c = wrong.estimates[0]
    assert c.sigma == pytest.approx(wrong.solved.misfit * c.scatter)
    text, _ = fit_sweep(tmp_path, without_figures, spoilt, one_lens)
    assert f"The law of the scatter misses its bins by {wrong.solved.misfit:.2g} times their sigmas" in text


@pytest.mark.parametrize("unit", chosen(1, range(3)))
def test_a_written_file_misses_no_more_than_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, unit: int
) -> None:
    """Recordings that follow other laws: strong returns scatter more, near ones are dimmer, dim ones kept by chance."""
    sweep, rng = drawn_sweep(drawn_truth(unit), unit), np.random.default_rng(unit)
    signal = np.asarray(sweep.signal)
    strong, near = signal > 400.0, sweep.range_m < 8.0
    lost = (signal < 30.0) & (rng.random(sweep.shape) < 0.3)
    range_m = sweep.range_m + np.where(strong, 0.03 * rng.standard_normal(sweep.shape), 0.0)
    spoilt = replace(
        sweep, range_m=np.where(lost, np.nan, range_m), signal=np.where(near, 0.6 * signal, signal).astype(np.float32)
    )
    monkeypatch.setattr(recording_fit, "open_recording", drawn_opener(spoilt))
    judged: list[tuple[object, ...]] = []
    own_report = recording_fit._report
    monkeypatch.setattr(recording_fit, "_report", lambda *given: judged.append(given) or own_report(*given))
    fit_recordings([tmp_path / "drawn.pcap"], "os1-128")
    ((fit, _, _, _, _, written, near_ir),) = judged
    assert isinstance(fit, RecordingFit)
    before, after = (misses_of(fit.checks(sensor, near_ir)) for sensor in (load_sensor("os1-128"), written))
    assert all(after[quantity] <= before[quantity] for quantity in after if after[quantity][0])


def test_a_note_names_the_rows_that_miss_and_the_largest_error() -> None:
    """Fits are ranked by both: alone, a fit that fails in more rows by less would look better than what is kept."""
    assert recording_fit._miss_text(3, 0.26) == "misses 3 limits, by 0.26 at most"
    assert recording_fit._miss_text(1, 0.59) == "misses 1 limit, by 0.59 at most"


def drawn_opener(sweep: Sweep) -> Callable[..., Recording]:
    """An opener in place of `open_recording`."""

    def open_drawn(path: Path, metadata: Path | None, *, sensor_index: int) -> Recording:
        return Recording(path=path, count=1, read=lambda _: sweep)

    return open_drawn


def fit_sweep(folder: Path, patch: pytest.MonkeyPatch, sweep: Sweep, sensor: str) -> tuple[str, bool]:
    patch.setattr(recording_fit, "open_recording", drawn_opener(sweep))
    sensor_text, report = fit_recordings([folder / "drawn.pcap"], sensor)
    (folder / "unit.toml").write_text(sensor_text, "utf-8")
    report.save(folder / "report")
    return str(report), report.passed is True


def missed(text: str) -> list[str]:
    """Quantities of a report that miss their limits, but scatters: their floor of some mm is in no sensor file."""
    rows = [line for line in text.splitlines() if "NOT MET" in line]
    return [row.split("  ")[0] for row in rows if not row.startswith("range, scatter")]


@pytest.fixture
def without_figures(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Figures take longest, and one test looks at them."""
    monkeypatch.setattr(Report, "add_figure", lambda *_: None)
    return monkeypatch


@pytest.mark.usefixtures("no_charts")
def test_sensor_file_and_page_have_what_was_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sweep: Sweep, one_lens: str
) -> None:
    """Rationale: the written file, read again, has the measured products, whatever way they were divided."""
    text, _ = fit_sweep(tmp_path, monkeypatch, sweep, one_lens)
    assert not missed(text)
    report = json.loads((tmp_path / "report" / "fit.json").read_text("utf-8"))
    estimates = report["estimates"]
    sensor = load_sensor(tmp_path / "unit.toml")
    assert sensor.histogram is not None
    # The file has six digits.
    assert near_field_m(sensor) == pytest.approx(estimates["near_field_m"]["value"], rel=1e-4)
    assert white_m2(sensor) == pytest.approx(estimates["white_m2"]["value"], rel=1e-3)
    assert scatter_c_mm(sensor) == pytest.approx(estimates["scatter_c"]["value"], rel=1e-4)
    counts = sensor.histogram.threshold_pedestal * sensor.histogram.shots
    assert counts == pytest.approx(estimates["threshold_pedestal"]["value"], rel=1e-4)
    assert sensor.histogram.threshold_slope == pytest.approx(estimates["threshold_slope"]["value"], rel=1e-4)
    assert sensor.histogram.threshold_spread == pytest.approx(estimates["threshold_spread"]["value"], rel=1e-4)
    # The published sensor's spot has no width; the written one must have the near field that was fitted.
    range_m = np.geomspace(1.0, 60.0, 9)
    spot = estimates["spot_over_field"]["value"]
    law = estimates["white_m2"]["value"] * share(range_m / estimates["near_field_m"]["value"], spot)
    np.testing.assert_allclose(white_over_range(sensor, range_m), law, rtol=0.01)
    for key in ("laser.peak_power_w", "optics.aperture_radius_mm", "histogram.threshold_pedestal"):
        source = sensor.sources[key]
        assert source.startswith("fitted: ")
        assert " +/- " in source
        assert "drawn.pcap" in source
    # The background stays: aperture times field of view is as before.
    before = load_sensor(one_lens)
    assert sensor.optics.aperture_radius_m / sensor.optics.focal_length_m == pytest.approx(
        before.optics.aperture_radius_m / before.optics.focal_length_m, rel=1e-5
    )
    assert "reflectivity of all targets +1 %: laser.peak_power_w -1 %" in text
    page = (tmp_path / "report" / "index.html").read_text("utf-8")
    for part in ("Pass or fail", "Estimates", "Correlations", "Undetermined directions", "not fitted"):
        assert part in page
    names = {path.stem for path in (tmp_path / "report").glob("*.png")}
    assert names == {"near-field", "near-field-residuals", "threshold", "scatter", "rows"}


@pytest.mark.usefixtures("without_figures")
def test_a_unit_that_recorded_second_returns_reports_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sweep: Sweep, fitted: Sensor, one_lens: str
) -> None:
    """Rationale: the fitted sensor had one stop, so the share of second returns was 0 for 0.064."""
    fit_sweep(tmp_path, monkeypatch, replace(sweep, second=Second(range_m=np.full(sweep.shape, np.nan))), one_lens)
    both = load_sensor(tmp_path / "unit.toml").tdc
    assert (both.stops, both.keep) == (2, "strongest")
    assert (fitted.tdc.stops, fitted.tdc.keep) == (1, load_sensor("os1-128").tdc.keep)


@pytest.mark.usefixtures("without_figures")
def test_reflectivities_stand_in_for_signals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: low-rate profiles lack SIGNAL, and their scatter was not fitted.

    The unit has the file's own power and optics, five times as strong as the catalogue's, so its scatter is found.
    Reflectivities come in steps of 1 %. Four sigma: 1 in 10 000.
    """
    text = path_of("sensors", "os1-128").read_text("utf-8")
    power_w = float(load_sensor("os1-128").laser.peak_power_w)
    file = tmp_path / "strong.toml"
    file.write_text(put_values(text, {("laser", "peak_power_w"): 5.0 * power_w}), "utf-8")
    sensor = load_sensor(file)
    curve = own_curve(sensor)
    unit = {"near_field_m": near_field_m(sensor), "white_m2": white_m2(sensor)}
    truth = replace(drawn_truth(2), **unit, scatter_c=300.0, scatter_floor=3.0)
    sweep = drawn_sweep(truth, 2, curve=curve)
    text, _ = fit_sweep(tmp_path, monkeypatch, replace(sweep, signal=None), str(file))
    estimates = json.loads((tmp_path / "report" / "fit.json").read_text("utf-8"))["estimates"]
    assert set(estimates) == {"scatter_c", "scatter_floor"}
    estimate = estimates["scatter_c"]
    assert estimate["sigma"] < 0.2 * truth.scatter_c
    assert abs(estimate["value"] - truth.scatter_c) < 4.0 * estimate["sigma"]
    fitted = load_sensor(tmp_path / "unit.toml")
    assert scatter_c_mm(fitted) == pytest.approx(estimate["value"], rel=1e-4)
    assert fitted.laser.peak_power_w == sensor.laser.peak_power_w
    assert "SIGNAL is not recorded: photons are REFLECTIVITY" in text
    assert "laser.peak_power_w is left as it was" in text  # too few patches for its noise to tell photons
    assert "histogram.threshold_slope is left as it was" in text


@pytest.mark.usefixtures("without_figures")
@pytest.mark.parametrize("klux", chosen(1, [80.0, 300.0]))
def test_no_sun_gives_more_than_130_klux(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sweep: Sweep, fitted: Sensor, klux: float
) -> None:
    """Rationale: twins said 203 to 876 klux, since their sensor files count too little background.

    NEAR_IR is scaled to about this light, but for dark counts, and the fit of the rest stays. The file has six digits.
    """
    first_klux = illuminance_klux(sweep, ReflectivityGauge.from_sweep(sweep), fitted)
    assert first_klux is not None
    brighter = replace(sweep, near_ir=np.asarray(sweep.near_ir) * klux / first_klux)
    text, _ = fit_sweep(tmp_path, monkeypatch, brighter, "os1-128")
    unit = load_sensor(tmp_path / "unit.toml")
    klux_of_base = illuminance_klux(brighter, ReflectivityGauge.from_sweep(brighter), fitted)
    klux_of_unit = illuminance_klux(brighter, ReflectivityGauge.from_sweep(brighter), unit)
    gain = unit.optics.sun_irradiance_w_m2 / fitted.optics.sun_irradiance_w_m2
    if klux > 130.0:
        assert klux_of_unit == pytest.approx(130.0, rel=1e-4)
        assert klux_of_base is not None
        assert gain == pytest.approx(klux_of_base / 130.0, rel=1e-3)
        assert "optics.sun_irradiance_w_m2 is raised" in text
        assert "130 at most" in unit.sources["optics.sun_irradiance_w_m2"]
    else:
        assert gain == 1.0
        assert "is raised" not in text


def white_over_range(sensor: Sensor, range_m: np.ndarray) -> np.ndarray:
    """Photons of a white wall times the square of its range, by the stages of `render`."""
    light = echoes_of_plane(sensor, Target(reflectivity=1e-3, illuminance_klux=0.0), range_m)
    photons = np.ravel(np.asarray(sensor.working_point(light.background_power_w).response.signal(light.peak_power_w)))
    return np.asarray(1e3 * photons * range_m**2)


def test_figures_that_cannot_be_drawn_cost_no_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sweep: Sweep, one_lens: str, run: Run, failing_charts: None
) -> None:
    monkeypatch.setattr(recording_fit, "open_recording", drawn_opener(sweep))
    ran = run("fit", "drawn.pcap", "--sensor", one_lens, "-o", "unit.toml", "--report", "report")
    assert ran.code == 1
    assert len(ran.err.splitlines()) == ran.err.count("cannot be drawn: ValueError: no chart") > 0
    assert json.loads((tmp_path / "report" / "fit.json").read_text("utf-8"))["estimates"]
    assert load_sensor(tmp_path / "unit.toml")
    names = {path.suffix for path in (tmp_path / "report").iterdir()}
    assert names == {".html", ".md", ".json", ".csv"}


@pytest.mark.usefixtures("no_charts")
def test_two_lenses_are_found_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: one lens fits where pulses are, and misses what is beyond; the written unit must do neither.

    Two numbers: the chance that one is 3 sigma off is 0.5 %; their sigma is below 0.5 %, so the curve is within 2 %.
    """
    published = load_sensor("os1-128")
    truth, curve = two_lenses(2, published)
    stretch = truth.near_field_m / near_field_m(published)
    assert abs(stretch - 1.0) > 0.1
    sweep = drawn_sweep(truth, 2, curve=curve)
    text, _ = fit_sweep(tmp_path, monkeypatch, sweep, "os1-128")
    assert not missed(text)
    estimates = json.loads((tmp_path / "report" / "fit.json").read_text("utf-8"))["estimates"]
    assert "spot_over_field" not in estimates
    for key in ("white_m2", "near_field_m"):
        assert abs(estimates[key]["value"] - asdict(truth)[key]) < 3.0 * estimates[key]["sigma"]
    sensor = load_sensor(tmp_path / "unit.toml")
    range_m = np.geomspace(4.0, 100.0, 12)
    law = truth.white_m2 * curve(range_m / truth.near_field_m)
    np.testing.assert_allclose(white_over_range(sensor, range_m), law, rtol=0.02)
    assert sensor.sources["optics.overlap.transmitter_offset_mm"].startswith("fitted: ")
    # The published curve, at its best power, is not that near, and nor is one lens.
    log_ratio = np.log(curve(range_m / near_field_m(published)) / law)
    assert np.ptp(log_ratio) > 0.1
    single_lens = fit_near_field(gather_pulses([sweep]))
    assert single_lens is not None
    assert np.max(np.abs(single_lens.law(range_m) / law - 1.0)) > 0.1


@pytest.mark.usefixtures("without_figures")
def test_lenses_that_no_stretch_reaches_are_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: offset, crossing, focus and scattered share stayed as the file has them, at any misfit.

    The unit's axes are half as far apart and meet, it is in focus near by, and its window scatters. The written file,
    read again, must have its curve: 3 % are the width of a bin and four numbers' noise, some sigmas; the stretched
    curve of the catalogue is 10 % off and more.
    """
    published = load_sensor("os1-128")
    lenses = LensCurve(published)

    def curve(ratio: np.ndarray) -> np.ndarray:
        return lenses(ratio, 1.6, 0.25, 0.3, 0.05)

    truth = replace(drawn_truth(3), near_field_m=near_field_m(published), white_m2=4e5)
    sweep = drawn_sweep(truth, 3, curve=curve)
    fit_sweep(tmp_path, monkeypatch, sweep, "os1-128")
    estimates = json.loads((tmp_path / "report" / "fit.json").read_text("utf-8"))["estimates"]
    assert set(LENSES) <= set(estimates)
    stretched = own_curve(published)
    assert stretched is not None
    ratio = np.geomspace(1.5, 20.0, 9)
    assert min(np.ptp(np.log(stretched(ratio / factor) / curve(ratio))) for factor in np.geomspace(0.25, 4.0, 41)) > 0.1
    sensor = load_sensor(tmp_path / "unit.toml")
    range_m = np.geomspace(4.0, 60.0, 12)
    law = truth.white_m2 * curve(range_m / truth.near_field_m)
    np.testing.assert_allclose(white_over_range(sensor, range_m), law, rtol=0.03)
    for key in ("transmitter_offset_mm", "scattered_share"):  # axes may be found side by side, and the focus far away
        assert "with all lenses free" in sensor.sources[f"optics.overlap.{key}"]


def test_a_law_that_does_not_hold_fails(
    tmp_path: Path, without_figures: pytest.MonkeyPatch, sweep: Sweep, one_lens: str
) -> None:
    """Rationale: the blocks that were not fitted are of another reflectivity scale, by 1.3: more than 15 % off."""
    assert sweep.reflectivity is not None
    is_darker = (np.arange(sweep.shape[1]) // 20) % 4 == 3
    changed = replace(sweep, reflectivity=np.where(is_darker, np.rint(sweep.reflectivity / 1.3), sweep.reflectivity))
    text, passed = fit_sweep(tmp_path, without_figures, changed, one_lens)
    assert not passed
    assert "it misses 'signal, mean error over the range', 0.2" in text
    assert missed(text) == ["signal, mean error over the range"]


def test_a_law_that_fails_leaves_the_file_no_worse(tmp_path: Path, without_figures: pytest.MonkeyPatch) -> None:
    """A unit that is as its file says, but the reflectivities of the blocks that are fitted are 1.6 times too low.

    Rationale: the fit of a unit whose static pair met all 13 limits left it with 11 of them.
    """
    text = path_of("sensors", "os1-128").read_text("utf-8")
    file = tmp_path / "alone.toml"
    file.write_text(remove_keys(text, "histogram.column_photons"), "utf-8")  # drawn weak returns are shared by none
    sensor = load_sensor(file)
    unit = {"near_field_m": near_field_m(sensor), "white_m2": white_m2(sensor)}
    sweep = drawn_sweep(replace(drawn_truth(2), **unit), 2, curve=own_curve(sensor))
    assert sweep.reflectivity is not None
    is_fitted = (np.arange(sweep.shape[1]) // 20) % 4 != 3
    darker = replace(sweep, reflectivity=np.where(is_fitted, np.rint(sweep.reflectivity / 1.6), sweep.reflectivity))
    without_figures.setattr(sensor_text, "MOST_MISFIT", np.inf)  # the pulse is written, whatever the law's bins draw
    text, _ = fit_sweep(tmp_path, without_figures, darker, str(file))
    fitted = load_sensor(tmp_path / "unit.toml")
    assert white_m2(fitted) == pytest.approx(white_m2(sensor), rel=1e-5)  # with another pulse, so with another power
    assert fitted.laser.pulse_fwhm_s != sensor.laser.pulse_fwhm_s
    assert fitted.optics.overlap == sensor.optics.overlap
    assert fitted.optics.aperture_radius_m == sensor.optics.aperture_radius_m
    assert "What a white target returns is left as it was: white_m2 is fitted, but with it 'signal, mean error" in text
    assert not missed(text)
    assert fitted.histogram is not None
    assert sensor.histogram is not None
    assert fitted.histogram.threshold_slope != sensor.histogram.threshold_slope  # the other laws are written


def test_the_written_file_is_judged_and_not_the_law(
    tmp_path: Path, without_figures: pytest.MonkeyPatch, sweep: Sweep
) -> None:
    """A scatter too uncertain to be written: the file's own pulse, three times as long, fails.

    Rationale: "9.3 for 10.7 mm, met", while the pulse "is left as it was" and the twin scattered by 38.8 for 18.0 mm.
    """
    text = remove_keys(path_of("sensors", "os1-128").read_text("utf-8"), *TWO_LENS_KEYS[:3])
    fwhm_ns = 1e9 * float(load_sensor("os1-128").laser.pulse_fwhm_s)
    (tmp_path / "long.toml").write_text(put_values(text, {("laser", "pulse_fwhm_ns"): 3.0 * fwhm_ns}), "utf-8")
    without_figures.setattr(sensor_text, "MOST_RELATIVE_SIGMA", 1e-6)
    without_figures.setattr(sensor_text, "CONTRADICTION", np.inf)
    text, passed = fit_sweep(tmp_path, without_figures, sweep, str(tmp_path / "long.toml"))
    assert not passed
    assert "laser.pulse_fwhm_ns is left as it was" in text
    scatters = [line for line in text.splitlines() if line.startswith("range, scatter")]
    assert scatters
    assert all("NOT MET" in line for line in scatters)


def test_what_is_not_recorded_stays_as_it_was(
    tmp_path: Path, without_figures: pytest.MonkeyPatch, sweep: Sweep, one_lens: str
) -> None:
    text, _ = fit_sweep(tmp_path, without_figures, replace(sweep, near_ir=None, reflectivity=None), one_lens)
    assert not missed(text)
    assert "histogram.threshold_slope is left as it was: threshold_slope is not recorded" in text
    sensor, before = load_sensor(tmp_path / "unit.toml"), load_sensor(one_lens)
    assert sensor.laser.peak_power_w == before.laser.peak_power_w
    assert sensor.laser.pulse_fwhm_s != before.laser.pulse_fwhm_s


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"signal": None, "near_ir": None, "reflectivity": None}, "SIGNAL, NEAR_IR or REFLECTIVITY"),
        ({"recorded": np.zeros((32, 1000), bool)}, "pulses | none"),
    ],
)
def test_a_recording_that_tells_nothing(
    tmp_path: Path, without_figures: pytest.MonkeyPatch, sweep: Sweep, change: dict[str, object], named: str
) -> None:
    with told(named):
        fit_sweep(tmp_path, without_figures, replace(sweep, **change), "os1-128")
    assert not (tmp_path / "unit.toml").exists()


def test_points_without_rows_are_refused() -> None:
    points = Sweep(range_m=np.ones(3), recorded=np.ones(3, bool), direction=np.ones((3, 3)))
    with told("rows and columns", ValueError):
        gather_pulses([points])


def test_a_unit_is_drawn_anew() -> None:
    assert isinstance(TRUTH, Truth)
    assert drawn_truth(1) != TRUTH


def test_only_the_frames_asked_for_are_fitted(
    tmp_path: Path, without_figures: pytest.MonkeyPatch, sweep: Sweep, one_lens: str
) -> None:
    """The other frame has no pulses at all, so that fitting both would change the count."""
    empty = replace(sweep, range_m=np.full(sweep.shape, np.nan))

    def open_drawn(path: Path, metadata: Path | None, *, sensor_index: int) -> Recording:
        return Recording(path=path, count=2, read=lambda number: (empty, sweep)[number])

    without_figures.setattr(recording_fit, "open_recording", open_drawn)
    recordings = [tmp_path / "drawn.pcap"]
    _, report = fit_recordings(recordings, one_lens, frames=(1,))
    assert f"{sweep.range_m.size:,} pulses of 1 frame" in str(report)
    with told("drawn.pcap | frame | 0 | 1 | 2"):
        fit_recordings(recordings, one_lens, frames=(2,))
