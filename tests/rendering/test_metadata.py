"""What a cloud says of its numbers."""

import pytest

from lidarscene.rendering.metadata import _intensity_unit
from lidarscene.sensor.catalogue import load_sensor

CORRECTED = ('intensity={"kind"="range_corrected","reference_m"=10}',)


@pytest.mark.parametrize(
    ("name", "sets", "unit"),
    [
        ("table1-apd", (), "A"),
        ("table1-sipm", (), "cells"),
        ("sony-spad-189x600", (), "photons"),
        ("vlp-16", (), "of 255"),
        ("vlp-16", CORRECTED, "W"),
    ],
)
def test_the_unit_of_the_intensity(name: str, sets: tuple[str, ...], unit: str) -> None:
    """Of a peak at a comparator that of the detector; else what the sensor file asks for."""
    assert _intensity_unit(load_sensor(name, overrides=sets)) == unit
