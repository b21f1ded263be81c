"""A new detector is one file and its name in the list: a PIN diode goes through every command that knows detectors."""

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.newcomer import changed_sources, command_lines

PIN = Path(__file__).parents[2] / "helpers" / "pin_detector.py"

# No avalanche, F = 1, no noise of the load: an APD of gain 1 whose bulk is all that is dark.
AS_APD = 'type = "apd"\ngain = 1\nexcess_noise_index = 0\nsurface_dark_current_na = 0\nbulk_dark_current_na = 5\n'
AS_APD += "load_resistance_ohm = 1e12\n"
AS_PIN = 'type = "pin"\ndark_current_na = 5\n'
SENSOR = """
name = "{kind}"
laser = {{wavelength_nm = 905, peak_power_w = 450, pulse_fwhm_ns = 6, repetition_rate_khz = 50}}
optics = {{aperture_radius_mm = 25, focal_length_mm = 30, efficiency_laser = 0.7, efficiency_sun = 0.8, \
sun_irradiance_w_m2 = 29.4}}
tdc = {{window_us = 4, bandwidth_mhz = 167, threshold_to_noise = 5}}
[scanner]
type = "raster"
azimuth_fov_deg = 120
elevation_fov_deg = 25
azimuth_step_deg = 2
elevation_step_deg = 1
[detector]
radius_mm = 0.1
quantum_efficiency = 0.7
circuit_noise_na = 20
{detector}
"""


RENDER = (
    "render car -o {0}.npz --sensor {0}.toml --seed 3 --waveforms {0}_waveforms.npz --pulses 500-505 "
    "--ambient {0}_ambient.npz"
)


VIEW = """
import lidarscene
from lidarscene.view.controls import Equipment
equipment = Equipment(lidarscene.load_scene("car"), "pin.toml")
print(list(equipment.detectors), [control.key for control in equipment._controls("")])
print(lidarscene.Simulator("car", "pin.toml").render(seed=1).metadata["intensity_unit"])
"""


@pytest.fixture(scope="module")
def newcomer(tmp_path_factory):
    """Sources that have the new file and its name: their folder, and what commands print there."""
    folder = tmp_path_factory.mktemp("newcomer")
    names = "ApdFile | SipmFile | SpadFile"
    added = f"from .pin_detector import PinFile\n\nAnyDetectorFile = PinFile | {names}"
    command = changed_sources(
        folder,
        new={"sensor/detectors/pin_detector.py": PIN.read_text(encoding="utf-8")},
        lines=[("sensor/detectors/__init__.py", f"AnyDetectorFile = {names}", added)],
    )
    for kind, detector in (("pin", AS_PIN), ("apd", AS_APD)):
        (folder / f"{kind}.toml").write_text(SENSOR.format(kind=kind, detector=detector), encoding="utf-8")
    printed = command_lines(
        command,
        RENDER.format("pin"),
        RENDER.format("apd"),
        "range pin.toml apd.toml --json",
        "range pin.toml",
        "range pin.toml --sensitivities",
        "range pin.toml --eye-safety",
        "compare car --sensors pin.toml,apd.toml -o compared",
        "fov pin.toml -o fov",
        "schema sensor",
        "check pin.toml",
        VIEW,
    )
    return folder, printed


def test_it_renders_the_points_of_an_apd_without_gain(newcomer):
    folder, _ = newcomer
    for name in ("{}.npz", "{}_waveforms.npz", "{}_ambient.npz"):
        with np.load(folder / name.format("pin")) as pin, np.load(folder / name.format("apd")) as diode:
            assert set(pin.files) == set(diode.files)
            assert len(pin.files) > 3
            for column in set(pin.files) - {"lidarscene"}:  # names of scene and sensor
                if pin[column].dtype.kind == "f":  # sums in another order: float32 rounding
                    np.testing.assert_allclose(pin[column], diode[column], rtol=2e-4, atol=1e-6, err_msg=column)
                else:
                    np.testing.assert_array_equal(pin[column], diode[column], err_msg=column)


def test_studies_know_it(newcomer):
    folder, (_, _, ranges, table, sensitivities, *_, checked, _) = newcomer
    pin, diode = (json.loads(ranges)[name] for name in ("pin", "apd"))
    # The APD's load of 1e12 ohm adds 3e-9 of the variance.
    assert pin["range_m"] == pytest.approx(diode["range_m"], rel=1e-8)
    assert pin["closed_form_m"] is None
    assert "-" in table
    assert "detector.quantum_efficiency" in sensitivities
    assert (folder / "compared" / "index.html").is_file()
    assert "pin" in checked


def test_the_view_has_its_slider_and_its_unit(newcomer):
    _, (*_, printed) = newcomer
    assert "PIN diode, its own" in printed
    assert "detector.quantum_efficiency" in printed
    assert printed.splitlines()[-1] == "A"
