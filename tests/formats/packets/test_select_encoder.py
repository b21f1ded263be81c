"""Makers: the packets of a sensor follow from how it is built; one that has none is told."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from helpers.mistakes import mistakes, told

from lidarscene.formats.packets.select_encoder import select_encoder
from lidarscene.sensor.sensor_file import load_sensor


@pytest.mark.parametrize(
    ("name", "port"),
    [
        ("vlp-16", 2368),
        ("hdl-32e", 2368),
        ("vls-128", 2368),
        ("os0-128", 7502),
        ("os1-128", 7502),
        ("os2-128", 7502),
        ("pandar64", 2368),
    ],
)
def test_sensors_of_the_catalogue_have_their_packets(library: Callable[[str], Any], name: str, port: int) -> None:
    """Rationale: who changes when a catalogue sensor fires is told here that its packets say otherwise."""
    library("ouster.sdk.core")
    assert select_encoder(load_sensor(name)).port == port


@mistakes(
    """
    table1-apd | sensor 'table1-apd' | format of packets | vlp-16, hdl-32e, vls-128
    hdl-64e | sensor 'hdl-64e' | format of packets
    vlp-16 scanner.cycle_us=60 | sensor 'vlp-16' | format of packets
    vlp-16 scanner.firing_time_us=SLOW | sensor 'vlp-16' | format of packets
    pandar64 scanner.columns_per_turn=1500 | sensor 'pandar64' | format of packets
    vlp-16 legacy | sensor 'vlp-16' | Ouster | 'legacy'
    vlp-16 scanner.rotation_hz=10 | scanner.rotation_hz | negative
    vlp-16 intensity={"kind"="range_corrected","reference_m"=10} | intensity.kind
    """,
    SLOW=str([0.2 * laser for laser in range(16)]).replace(" ", ""),
)
def test_sensors_without_packets(given: str, named: str) -> None:
    name, *sets = given.removesuffix(" legacy").split()
    with told(named):
        select_encoder(load_sensor(name, overrides=sets), "legacy" if given.endswith("legacy") else "default")


@pytest.mark.parametrize(("later_us", "slower", "is_one"), [(4.0, 1.0, True), (0.0, 0.97, False)])
def test_a_pandar64_is_known_by_the_time_from_its_first_laser_to_its_last(later_us, slower, is_one):
    """The time is 51.05 us, whenever in the cycle the first of them fires; lasers that take 1.5 us less are others."""
    scanner = load_sensor("pandar64").scanner
    times_us = slower * 1e6 * scanner.firing_s[np.argsort(scanner.lasers_by_place.values)] + later_us
    sensor = load_sensor("pandar64", overrides={"scanner.firing_time_us": times_us.round(6)})
    if is_one:
        assert select_encoder(sensor).port == 2368
    else:
        with told("packets"):
            select_encoder(sensor)
