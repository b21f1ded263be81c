"""A laser and a detector that do not go together: one line each; no sensor of the catalogue has one."""

import pytest

from lidarscene import catalog, load_sensor

BLIND, ALIKE = "of silicon and sees nothing at", "a SiPM or SPAD is"


@pytest.mark.parametrize(
    ("name", "override", "line"),
    [
        ("table1-apd", "laser.wavelength_nm=1550", f"a diode with a gain of 80 is {BLIND} 1550 nm: change"),
        ("table1-sipm", "laser.wavelength_nm=1550", f"{ALIKE} {BLIND} 1550 nm: change"),
        ("os1-128", "laser.wavelength_nm=1310", f"{ALIKE} {BLIND} 1310 nm: change"),
        # 2 x 0.1 mm / 30 mm = 6.667 mrad.
        (
            "table1-apd",
            "laser.divergence_mrad=13.4",
            "a beam of 13.4 mrad is far wider than the field of view of 6.667 mrad (2 detector.radius_mm / ",
        ),
    ],
)
def test_a_fault_is_one_line(name, override, line):
    doubts = load_sensor(name, overrides=override).doubts
    assert [doubt.startswith(f"'{name}': {line}") for doubt in doubts] == [True]


@pytest.mark.parametrize(
    ("name", "override"),
    [
        ("table1-apd", "laser.divergence_mrad=13.3"),
        ("table1-apd", "laser.wavelength_nm=1064"),
        ("biaxial-905", "laser.divergence_mrad=40"),  # its overlap says what is lost
    ],
)
def test_what_goes_together(name, override):
    assert load_sensor(name, overrides=override).doubts == ()


@pytest.mark.parametrize("name", catalog.names("sensors"))
def test_no_sensor_of_the_catalogue_has_one(name):
    assert load_sensor(name).doubts == ()
