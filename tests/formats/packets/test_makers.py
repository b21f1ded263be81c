"""Makers: the packets of a sensor follow from how it is built; one that has none is told."""

from collections.abc import Callable
from typing import Any

import pytest

from lidarscene.errors import InputError
from lidarscene.formats.packets.makers import maker_of
from lidarscene.sensor.catalogue import load_sensor


@pytest.mark.parametrize(
    ("name", "port"),
    [
        ("vlp-16", 2368), ("hdl-32e", 2368), ("vls-128", 2368), ("os0-128", 7502), ("os1-128", 7502),
        ("os2-128", 7502), ("pandar64", 2368),
    ],
)  # fmt: skip
def test_sensors_of_the_catalogue_have_their_packets(
    library: Callable[[str], Any], name: str, port: int
) -> None:
    """Rationale: who changes when a catalogue sensor fires is told here that its packets say otherwise."""
    library("ouster.sdk.core")
    assert maker_of(load_sensor(name)).port == port


@pytest.mark.parametrize(
    ("name", "sets", "profile", "told"),
    [
        ("table1-apd", (), "default", "sensor 'table1-apd': has no format of packets; .* vlp-16, hdl-32e, vls-128"),
        ("hdl-64e", (), "default", "sensor 'hdl-64e': has no format of packets"),
        ("vlp-16", ("scanner.cycle_us=60",), "default", "has no format of packets"),
        ("vlp-16", (), "legacy", "sensor 'vlp-16': must be an Ouster for packets of the profile 'legacy'"),
        ("vlp-16", ("scanner.rotation_hz=10",), "default", "scanner.rotation_hz: must be negative"),
        ("vlp-16", ('intensity={"kind"="range_corrected","reference_m"=10}',), "default", "intensity.kind: must be"),
    ],
)  # fmt: skip
def test_a_sensor_without_packets_is_told_in_one_line(
    name: str, sets: tuple[str, ...], profile: str, told: str
) -> None:
    with pytest.raises(InputError, match=told) as error:
        maker_of(load_sensor(name, overrides=sets), profile)
    assert "\n" not in str(error.value)
