"""Intensity on the makers' scales: boards of known reflectivity through the whole chain, and the published tables."""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import chain, trains
from helpers.trains import detect

from lidarscene import Simulator, load_sensor
from lidarscene.materials.material import Material, Spectrum
from lidarscene.physics.electronics import intensity
from lidarscene.scene.scene import Air
from lidarscene.studies.ranging import plane as ranging
from lidarscene.studies.ranging.plane import Target

SHOTS = 4000
REFLECTIVITY = ["intensity.kind='reflectivity'"]


def reported(sensor, range_m, **target):
    """Mean of what shots at a plane report, in clear air."""
    plane = Target(**{"transmittance": 1.0} | target)
    light = ranging.echoes_of_plane(sensor, plane, np.full(SHOTS, float(range_m)))
    stop = detect(light, sensor, seed=1).stops[0]
    return stop.intensity[stop.reported & (stop.status == 0)]


@pytest.mark.parametrize("name", ["table1-apd", "vlp-16", "livox-mid-40"])
@pytest.mark.parametrize("rho", [0.1, 0.5, 0.9])
def test_boards_read_their_reflectivity(name, rho):
    """Rationale: what calibration is for. 20 m, strong echoes: noise averages out over 4000 shots; the walk
    correction and whole numbers leave some tenths.
    """
    sensor = load_sensor(name, overrides=REFLECTIVITY if name == "table1-apd" else [])
    values = reported(sensor, 20.0, reflectivity=rho)
    assert values.mean() == pytest.approx(sensor.intensity.white_value * rho, rel=0.01, abs=0.3)
    assert (values == np.rint(values)).all()


def test_angle_and_air_are_not_known():
    """60 degrees read half, a one-way transmittance of 0.7 reads 0.49."""
    sensor = chain.sensor("table1-apd", *REFLECTIVITY)
    assert reported(sensor, 20.0, reflectivity=0.8, cos_incidence=0.5).mean() == pytest.approx(40.0, abs=0.5)
    assert reported(sensor, 20.0, reflectivity=0.8, transmittance=0.7).mean() == pytest.approx(39.2, abs=0.5)


def test_the_overlap_is_known():
    """A coaxial sensor sees, at 4 m, a quarter of the spot, and still reads the board right."""
    sensor = chain.sensor("table1-apd", *REFLECTIVITY, "optics.overlap.transmitter_offset_mm=[0, 0]")
    assert sensor.optics.overlap.share(np.array([4.0]))[0] < 0.3
    assert reported(sensor, 4.0, reflectivity=0.5).mean() == pytest.approx(50.0, abs=0.5)


def test_range_corrected():
    """Reference: (5) at the reference range, typed out. The same from 10 and 40 m."""
    sensor = chain.sensor("table1-apd", "intensity.kind='range_corrected'", "intensity.reference_m=10")
    optics = sensor.optics
    expected = 45.0 * 0.3 / math.pi * optics.efficiency_laser * optics.aperture_m2 / 10.0**2
    for range_m in (10.0, 40.0):
        assert reported(sensor, range_m, reflectivity=0.3).mean() == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize("name", ["table1-apd", "table1-sipm"])
def test_raw_is_the_amplitude(name):
    sensor = chain.sensor(name)
    light = ranging.echoes_of_plane(sensor, Target(), np.full(50, 100.0))
    stop = detect(light, sensor, seed=1).stops[0]
    assert stop.intensity is stop.amplitude


def test_a_sipm_knows_its_cells():
    """Half of the cells fired are not half of full scale: the response is inverted, under the pulse's background.

    The median, because the inverse is curved and lifts the mean; 4000 shots leave 0.4 of it.
    """
    sensor = chain.sensor("table1-sipm", "detector.statistics='time_domain'", *REFLECTIVITY)
    assert np.median(reported(sensor, 150.0, reflectivity=0.5)) == pytest.approx(50.0, abs=1.5)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        # reflectivity: value, as the makers' tables have it
        ("vlp-16", {0.0: 0, 0.5: 50, 1.0: 100, 1000.0: 255, 1e5: 255}),
        ("hdl-32e", {0.25: 25, 1.0: 100}),
        ("vls-128", {0.5: 55, 1.0: 110, 1000.0: 255}),
        ("os1-128", {0.5: 50, 1.0: 100, 1000.0: 255}),
        ("pandar64", {0.5: 50, 1.0: 100, 2.0: 200, 2.55: 255, 9.0: 255}),
        ("livox-avia", {0.5: 75, 1.0: 150, 1000.0: 255}),
    ],
)
def test_scales_of_the_makers(name, values):
    scale = load_sensor(name).intensity
    reported = intensity.on_scale(
        reflectivity=np.array(list(values)),
        white_value=scale.white_value,
        retro=scale.retro,
        retro_reflectivity=scale.retro_reflectivity,
    )
    np.testing.assert_array_equal(reported, list(values.values()))


def test_retro_range_is_logarithmic():
    """The same ratio of reflectivities is the same number of steps, and 101 comes right above white."""
    rho = np.geomspace(1.0, 1000.0, 4)
    reported = intensity.on_scale(reflectivity=rho, white_value=105.0, retro="logarithmic", retro_reflectivity=1000.0)
    np.testing.assert_array_equal(np.diff(reported), 50.0)


def test_scale_with_a_power():
    """(T46a) typed out, from black to white, and 255 above; a linear scale is that of the exponent 1."""
    rho = np.array([0.0, 0.01, 0.09, 0.25, 1.0, 7.0])
    scale = {"white_value": 254.0, "retro": "linear", "retro_reflectivity": 1000.0}
    reported = intensity.on_scale(reflectivity=rho, exponent=0.5, **scale)
    np.testing.assert_array_equal(reported, [0, 25, 76, 127, 254, 255])
    linear, first_power = (intensity.on_scale(reflectivity=rho, exponent=power, **scale) for power in (None, 1.0))
    np.testing.assert_array_equal(linear, first_power)


def test_traced_boards(mi):
    """A grey board and a sheet on the device: 40, and pi R_A on the retro range."""
    lobe = {"retro_coefficient_cd_per_lx_m2": 70.0, "retro_half_angle_deg": 0.5}
    sheet = Material(name="sheet", bsdf="retroreflector", reflectivity=Spectrum.constant(0.1), parameters=lobe)
    sensor = chain.sensor("table1-apd", *chain.NARROW, *REFLECTIVITY)
    board = chain.scene(
        chain.facing(range_m=20.0, material="board"),
        materials=[chain.diffuse("board", 0.4)],
        air=Air(transmittance=1.0),
    )
    grey = chain.run_stages(board, sensor).detection.stops[0].intensity
    np.testing.assert_allclose(grey, 40.0, atol=2.0)
    shining = chain.scene(chain.facing(range_m=20.0, material="sheet"), materials=[sheet], air=Air(transmittance=1.0))
    lanes = chain.run_stages(shining, sensor)
    rho = math.pi * lanes.hits.backscatter_per_sr
    assert (rho > 100.0).all()
    expected = 100.0 + 155.0 * np.log(rho) / math.log(1000.0)
    np.testing.assert_allclose(lanes.detection.stops[0].intensity, np.minimum(expected, 255.0), atol=2.0)


def test_where_the_overlap_vanishes_a_board_reads_dark():
    """A share of the spot below 1e-3 counts as that: the reading is P R^2 over 1e-3 of a white board's, and no more."""
    sensor = chain.sensor(
        "table1-apd",
        *REFLECTIVITY,
        "optics.overlap.transmitter_offset_mm=[60, 0]",
        "laser.exit_diameter_mm=5 laser.divergence_mrad=1",
    )
    assert float(sensor.optics.overlap.share(np.array([6.0]))[0]) < 2e-4
    light = ranging.echoes_of_plane(sensor, Target(transmittance=1.0), np.full(SHOTS, 6.0))
    power = trains.power_at_snr(sensor, 50.0)
    light = replace(light, peak_power_w=np.full(SHOTS, power))
    stop = detect(light, sensor, seed=1).stops[0]
    values = stop.intensity[stop.reported & (stop.status == 0)]
    white_w_m2 = 45.0 * sensor.optics.aperture_m2 * sensor.optics.efficiency_laser / math.pi
    rho = power * 6.0**2 / (1e-3 * white_w_m2)
    expected = 100.0 * rho if rho < 1.0 else 100.0 + 155.0 * math.log(rho) / math.log(1000.0)
    assert 5.0 < expected < 250.0
    assert np.median(values) == pytest.approx(expected, rel=0.03, abs=0.5)


def test_a_clipped_echo_behind_a_low_pass_reads_by_its_width():
    """Twenty times the clipping level, of a pulse that the amplifier widens: its width tells the power, to 2 %."""
    sensor = chain.sensor(
        "table1-apd",
        "detector.circuit_noise_na=1e4 tdc.threshold_to_noise=100 detector.saturation_ua=5e3",
        "receiver.response='gaussian' tdc.bandwidth_mhz=60 intensity.kind='range_corrected'",
        "intensity.reference_m=50 tdc.edges='both'",
    )
    assert sensor.peak_share < 0.9
    point = sensor.working_point(np.array([trains.BACKGROUND_W]))
    power = float(np.ravel(point.response.power_w(np.array([0.1])))[0])
    light = trains.train(np.full((200, 1), 50.0), np.full((200, 1), power))
    stop = trains.detect(light, sensor).stops[0]
    assert np.median(stop.intensity) == pytest.approx(power, rel=0.02)


def test_the_scale_above_white_is_the_sensors():
    """Boards that shine, read on both scales: linear up to its end, or by the logarithm."""
    values = {}
    for retro in ("linear", "logarithmic"):
        sensor = chain.sensor("table1-apd", *REFLECTIVITY, f"intensity.retro='{retro}'")
        light = ranging.echoes_of_plane(sensor, Target(transmittance=1.0, reflectivity=0.5), np.full(400, 50.0))
        light = replace(light, peak_power_w=4.0 * light.peak_power_w)
        stop = detect(light, sensor, seed=1).stops[0]
        values[retro] = np.median(stop.intensity)
    assert values["linear"] == pytest.approx(200.0, abs=3.0)
    assert values["logarithmic"] == pytest.approx(100.0 + 155.0 * math.log(2.0) / math.log(1000.0), abs=2.0)


RECORDED_E1 = """93 95 98 100 103 106 108 111 113 116 118 121 124 126 129 131 134 136 139 142 144 147 149 152 154
157 160 162 165 167 170 173 175 178 180 183 185 188 191 193 196 198 201 203 206 209 211 214 216 219
222 224 227 229 232 234 237 240 242 245 247 250"""
"""All values from 91 to 250 that are frequent in 14 frames of tier4/nebula at c60082d5, data/robosense/e1."""


@pytest.mark.parametrize(
    ("name", "recorded"),
    [("rs-e1", [int(value) for value in RECORDED_E1.split()]), ("pandarqt", list(range(52, 251, 3)))],
)
def test_coarse_values_are_those_recorded(name: str, recorded: list[int]) -> None:
    """Only some values above one are sent, of a PandarQT every third (same repository at 606ac41f,
    decoder_ground_truth); below it all are. No value is off by more than half a step, and the half of rounding to whole
    numbers.
    """
    scale = load_sensor(name).intensity
    assert scale is not None
    above, step = scale.coarse_above, scale.coarse_step
    assert above is not None
    fine = np.arange(0.0, 250.01, 0.01)
    coarse = intensity.on_scale(
        reflectivity=fine / 100.0,
        white_value=100.0,
        retro="linear",
        retro_reflectivity=1000.0,
        coarse_above=above,
        coarse_step=step,
    )
    sent = np.unique(coarse)
    assert sent[sent > above].tolist() == recorded
    np.testing.assert_array_equal(sent[sent <= above], np.arange(int(above) + 1))
    assert np.abs(coarse - fine).max() <= 0.5 * step + 0.5


def test_rows_read_as_their_calibration_leaves_them(mi):
    """Means of a grey ball by laser go with the list, to half of the scale's step over 50, and to no one's noise: 4
    standard errors of 200 shots are below it. Without the list all rows are alike to the same. Points and ranges stay.
    """
    del mi
    gains = [0.9, 1.0, 1.1, 1.2] * 4
    overrides = ["scanner.columns_per_turn=200", "laser.repetition_rate_khz=32"]
    scene = chain.scene(
        chain.ball(at=(0.0, 0.0, 0.0), radius_m=20.0, material="board"),
        materials=[chain.diffuse("board", 0.5)],
        klux=0.0,
    )
    clouds = [
        Simulator(scene, load_sensor("pandarxt-16", overrides=[*overrides, f"scanner.intensity_gain={values}"])).render(
            seed=1
        )
        for values in ([1.0] * 16, gains)
    ]
    alike, graded = ([np.mean(cloud.intensity[cloud.channel == row]) for row in range(16)] for cloud in clouds)
    np.testing.assert_allclose(np.divide(graded, alike), gains, rtol=0.01)
    assert np.ptp(alike) < 0.5
    np.testing.assert_array_equal(clouds[0].range_m, clouds[1].range_m)
