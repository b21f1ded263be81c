"""Mistakes in sensor files: one line each, with file and key, what came and what was expected."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from helpers import photons
from helpers.mistakes import calls, given_file, mistakes, told

from lidarscene import catalog, load_sensor
from lidarscene.files.toml import validate
from lidarscene.sensor.optics import read_transmittance
from lidarscene.sensor.readout import PublishedFile

APD = catalog.path_of("sensors", "table1-apd").read_text(encoding="utf-8")
SUN = "sun_irradiance_w_m2 = 29.4"


@pytest.fixture(autouse=True)
def _in_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@mistakes(
    """
    apd-905 detector=60 | apd-905.toml | overrides detector=60 | a table | 60
    apd-905 laser= | overrides laser= | name or file of a sensor | ""
    apd-905 optics={a=b} | overrides optics={a=b} | name or file of a sensor | "{a=b}"
    apd-905 scanner=apd | overrides scanner=apd | sensor 'apd' | apd-905
    apd-905 detector=car | overrides detector=car | sensor 'car' | a scene
    apd-905 detector=no.toml | overrides detector=no.toml | no.toml | no such file
    apd-905 scanner=mems-1550 | apd-905.toml | overrides scanner=mems-1550 | tdc.window_us | <= 2 | 4
    livox-avia detector=os1-128 | livox-avia.toml | overrides detector=os1-128 | histogram.column_weights | left out
    apd-905 detector=sipm-905 detector.gain=60 | overrides detector=sipm-905 | overrides detector.gain=60 | unknown key
    livox-mid-40 WEDGE | scanner | wedges | 2 or 3 | mirror | 1
    mems-1550 laser.speckle={} | laser.speckle | laser.divergence_mrad
    os1-128 laser.slope_broadening=true | laser.slope_broadening | left out
    pandar64 intensity.coarse_step=3 | coarse_above and coarse_step
    pandar64 scanner.sweep_deg=120 | sweep_deg and frame_hz
    pandar64 scanner.sweep_deg=120 scanner.frame_hz=40 | frame_hz | <= 30 | 0.0333333 s | 40
    pandarxt-16 scanner.intensity_gain=[1.0,1.1] | intensity_gain | 16 entries | elevation_deg | 2
    sony-spad-189x600 scanner.row_step_us=10 | row_step_us | rows_at_once
    sony-spad-189x600 scanner.rows_at_once=1 scanner.row_step_us=1000 | 63 groups | 50000 us
    table1-apd intensity.kind=calibrated | intensity.kind | "calibrated"
    table1-apd intensity.kind=reflectivity intensity.retro_reflectivity=1 | intensity | retro_reflectivity
    table1-apd laser.polarisation={share=0.5} | laser.polarisation.angle_deg
    table1-apd laser.polarisation={angle_deg=0,share=2} | laser.polarisation.share | <= 1 | 2
    table1-apd sampler.type=adc | 'sampler.rate_mhz'
    table1-apd ADC sampler.rate_mhz=100 | sampler.rate_mhz | >= 166.667 | 100
    table1-apd ADC sampler.rate_mhz=43000 | sampler.rate_mhz | <= 42625 | 1024 samples | 43000
    table1-apd LEVELS=[4,2] | levels | rising | [4.0, 2.0]
    table1-apd LEVELS=[1] | sampler.levels[0] | > 1 | 1
    table1-apd tdc.blanking_ns=4000 | blanking_ns | < 4000 | window | 4000
    table1-apd tdc.fraction=0.5 | fraction | timing = "constant_fraction"
    table1-apd tdc.keep=all tdc.stops=2 | stops | keep
    table1-apd tdc.keep=strongest_and_last tdc.stops=3 | stops | 2 | "strongest_and_last" | 3
    table1-apd tdc.strong_spread=0.3 | tdc.strong_spread | tdc.strong_above | none
    table1-apd tdc.timing=constant_fraction tdc.fraction=1 | tdc.fraction | < 1 | 1
    table1-apd tdc.timing=peak LEVELS=[2] | timing | "peak" | [sampler]
    table1-sipm tdc.timing=matched_filter detector.counting=binomial | "gaussian" | matched filter | "binomial"
    vlp-16 imu.model=bmi08 | imu.model | imu 'bmi08' | bmi088?
    vlp-16 scanner.cycle_us=110.592 laser.repetition_rate_khz=300 | laser.repetition_rate_khz | 300
    vlp-16 ONE=[88] scanner.elevation_shift_deg=4 | elevations | -90 to 90 degrees | 92
    table1-apd laser.repetition_rate_khz=100 tdc.window_us=10.5 | tdc.window_us | <= 10 | 10.5
    table1-apd laser.exit_diameter_mm=5 laser.divergence_mrad=0.229 | laser | divergence_mrad | >= 0.23 | 0.229
    table1-apd laser.exit_diameter_mm=5 laser.divergence_mrad=3 NARROW=0.22 | divergence_elevation_mrad | >= 0.23 | 0.22
    table1-apd receiver.ac_coupling_khz=2e4 | receiver.ac_coupling_khz | <= 6246 | 20000
    table1-apd histogram.bin_ns=1 histogram.threshold_floor=4 histogram.threshold_slope=0.3 | histogram | left out
    table1-sipm receiver.response=gaussian detector.counting=binomial | detector.counting | "gaussian" | "binomial"
    vlp-16 STRAY | optics.stray | left out | one by one
    table1-apd STRAY | optics.stray | left out | one by one
    livox-mid-40 STRAY | optics.stray | left out | without lines
    sony-spad-189x600 STRAY | optics.stray | left out | all leave at once
    os1-128 STRAY optics.stray.veil=0.01 | optics.stray | <= 0.5 | 1.27
    vlp-16 wear.drops_per_cm2=1 | wear | window_radius_mm | drops_per_cm2 | none
    vlp-16 wear.drops_per_cm2=900 wear.window_radius_mm=200 | wear.drops_per_cm2 | <=
    vlp-16 DROPS WIDE wear.drop_diameter_mm=0.1 laser.exit_diameter_mm=0.06 | wear.window_radius_mm | less
    vlp-16 wear.laser_power=[[16,0.5]] | wear.laser_power | < 16 | 16
    GEIGER detector.temperature_k=300 | temperature_k, rated_temperature_k | given together
    GEIGER detector.overvoltage_v=3 | overvoltage_v | given together
    GEIGER detector.dark_doubling_k=8 | dark_doubling_k | temperature_k | none
    GEIGER WARM | temperature_k | dark_doubling_k or breakdown_drift_v_k | none
    GEIGER WARM detector.breakdown_drift_v_k=0.05 | breakdown_drift_v_k | overvoltage_v | none
    GEIGER detector.cell_gap_um=500 | cell_gap_um | less than the pitch
    GEIGER ABOVE WARM detector.breakdown_drift_v_k=0.1 detector.temperature_k=400 | overvoltage_v | above the breakdown
    photons histogram.bin_ns=5 | histogram.bin_ns | <= 3.34 | width | 5
    photons histogram.bin_ns=0.05 | histogram.bin_ns | >= 0.26 | 64 bins | 0.05
    photons detector.dead_time_ns=2 | detector.dead_time_ns | >= 4 | 2
    photons histogram.pulse_period_us=3 | histogram.shots | <= 33 | 50
    photons detector.coincidence=40 | detector.coincidence | 40
    photons detector.spads=2 detector.coincidence=3 | coincidence | <= 2 | spads | 3
    photons histogram.keep=all histogram.stops=2 | stops | keep = "all"
    photons histogram.keep=strongest_and_last histogram.stops=3 | stops | 2 | keep | 3
    photons detector.afterpulse=0.1 | afterpulse, afterpulse_ns | given together
    photons detector.afterpulse=0.1 detector.afterpulse_ns=30 detector.stamps=first | afterpulse | stamps = "first"
    """,
    ONE="scanner.firing_time_us=[0] scanner.height_mm=[0] scanner.elevation_deg",
    WEDGE="scanner.wedges=[{angle_deg=18,index=1.5,rotation_hz=1,inclined_face='in'}]",
    ADC="sampler.type=adc sampler.bits=8 sampler.full_scale=1",
    LEVELS="sampler.type=multi_level_tdc sampler.levels",
    NARROW="laser.divergence_elevation_mrad",
    STRAY="optics.stray.share=1e-4 optics.stray.half_angle_deg=1",
    DROPS="wear.drops_per_cm2=0.5 wear.window_radius_mm=50",
    WIDE="laser.divergence_mrad=20 laser.divergence_elevation_mrad=20",
    WARM="detector.temperature_k=318.15 detector.rated_temperature_k=298.15",
    ABOVE="detector.overvoltage_v=3 detector.rated_overvoltage_v=3 detector.trigger_voltage_v=2.5",
)
def test_overrides(given: str, named: str) -> None:
    name, *overrides = given.split()
    for sensor in ("sipm-905", "os1-128") if name == "GEIGER" else (name,):
        with told(named, echoed=overrides):
            photons.sensor(*overrides) if sensor == "photons" else load_sensor(sensor, overrides=overrides)


@mistakes(
    r"""
    | optics | sun_irradiance_w_m2 | filter | none
    SUN\nfilter = { csv = "a.csv" } | optics | sun_irradiance_w_m2 | filter | both
    filter = { centre_nm = 905 } | optics.filter | centre_nm and width_nm | csv
    filter = { width_nm = 9, csv = "a.csv" } | optics.filter | csv | alone | width_nm
    filter = { centre_nm = 905, width_nm = -9 } | optics.filter.width_nm | >= 0.01 | -9
    filter = { csv = "none.csv" } | optics.filter.csv | none.csv | no such file
    SUN [laser] drift_nm = 17 | laser.drift_nm | optics.filter
    filter = { centre_nm = 800, width_nm = 9 } [laser] drift_nm = 5 | optics.filter | none at 905 nm
    filter = { centre_nm = 905, width_nm = 30 } [laser] drift_nm = 16 | optics.filter | none at 921 nm
    SUN [laser] a = 1 | 'laser.a'
    SUN [laser] repetition_rate_khz = | TOML | line
    """,
    SUN=SUN,
)
def test_files(given: str, named: str) -> None:
    """Table 1's sensor with other light, and more keys of its laser."""
    if "centre_nm" in given:
        pytest.importorskip("pvlib")
    light, _, laser = given.partition("[laser]")
    text = APD.replace('"optics.sun_irradiance_w_m2" = 0.05\n', "").replace(SUN, light)
    with told(f"own.toml | {named}"):
        load_sensor(given_file("own.toml", text.replace("[laser]", f"[laser]\n{laser}")))


@mistakes(
    r"""
    | two lines of wavelength_nm,transmittance
    wavelength_nm,transmittance\n900,1 | two lines of wavelength_nm,transmittance
    900,1\n900,1 | line 2 | > 900 nm | 900
    900,1\n910,x | line 2 | wavelength_nm,transmittance | 910,x
    900,1\n910 | line 2 | wavelength_nm,transmittance | 910
    900,0\n905,90 | line 2 | 0 to 1 | 905,90
    900,nan\n905,1 | line 1 | 0 to 1 | 900,nan
    """
)
def test_tables_of_filters(given: str, named: str) -> None:
    with told(f"filter.csv | {named}"):
        read_transmittance(given_file("filter.csv", given))


def published(**tables: Any) -> PublishedFile:
    return validate(PublishedFile, {"source": "x"} | tables, "file")


RATELESS = re.sub("repetition_rate_khz.*\n", "", APD)
FIVE = f"laser = 5\n{APD.replace('[laser]', '[nothing]')}"
MODES = {"settings": [["a=1"], ["a=2"]], "multiplier": [1.0, 2.0], "source": "x"}
SIGMA = {"sigma_m": 0.02, "source": "x"}

test_calls = calls(
    (lambda: read_transmittance(given_file("a.csv", b"\xff\xfe\x00")), "a.csv | UTF-8"),
    (lambda: read_transmittance(Path()), "CSV file | a folder"),
    (lambda: load_sensor(given_file("a.toml", RATELESS)), "laser.repetition_rate_khz | raster | none"),
    (lambda: load_sensor(given_file("a.toml", FIVE)), "a.toml: laser | a table | 5"),
    (
        lambda: load_sensor("apd-905").with_laser(given_file("rig.toml", 'name = "a"')),
        "rig.toml | sensor file | [laser]",
    ),
    (lambda: replace(load_sensor("apd-905"), name="other").save("b.toml"), "load_sensor"),
    (lambda: load_sensor("vlp-16", overrides={"weather.x": 1}), "'weather' | scene | render | scene_overrides"),
    (lambda: load_sensor("vlp-16").replace({"sun.x": 1}), "'sun' | scene | render | scene_overrides"),
    (lambda: published(range_m=90.0), "range_m | reflectivity and illuminance_klux"),
    (lambda: published(false_points=1e-4), "false_points | illuminance_klux"),
    (lambda: published(repeatability=[SIGMA]), "one of snr and at_m"),
    (lambda: published(repeatability=[SIGMA | {"snr": 5.0, "at_m": 5.0}]), "one of snr and at_m"),
    (lambda: published(repeatability=[SIGMA | {"at_m": 5.0}]), "at_m needs reflectivity"),
    (lambda: published(repeatability=[SIGMA | {"snr": 5.0, "assumed": ["reflectivity"]}]), "assumed | reflectivity"),
    (lambda: published(assumed=["reflectivity"]), "assumed | reflectivity"),
    (lambda: published(assumed=["colour"]), "assumed | colour"),
    (lambda: published(also=[[0.2, 130.0]]), "also | illuminance_klux"),
    (lambda: published(source=None, points_per_second=1000.0), "source"),
    (lambda: published(modes=MODES | {"range_factors": [[1.0, 1.2], [1.0]]}), "range_factors | 2 rows of 2 | [2, 1]"),
)
