"""Rings: as the makers' drivers count them."""

import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.packets import random_frame
from helpers.recordings import hesai_packet

from lidarscene import catalog
from lidarscene.sensor.sensor_file import load_sensor

MAKERS = {"Velodyne": "velodyne", "Ouster": "ouster", "Hesai": "hesai", "RoboSense": "robosense", "Livox": "livox"}


@pytest.mark.parametrize("name", catalog.names("sensors"))
def test_the_catalogue_names_each_makers_driver(name: str) -> None:
    tables = tomllib.loads(catalog.path_of("sensors", name).read_text(encoding="utf-8"))
    assert tables.get("driver") == MAKERS.get(tables["description"].split()[0])


def test_rings_are_those_of_hydra4(tmp_path: Path, library: Callable[[str], Any]) -> None:
    """Reference: a decoder of Hesai's packets by others. Ring and elevation of each laser, one for one."""
    sensor = load_sensor("pandarxt-32")
    elevation_deg = np.degrees(sensor.scanner.channel_elevation_rad)
    rows = [f"{number + 1},{angle:.4f},0.0" for number, angle in enumerate(elevation_deg)]
    (tmp_path / "angles.csv").write_text("\n".join(["Laser id,Elevation,Azimuth", *rows]) + "\n")
    decoder = library("hydra4.decoders").PandarXT32(tmp_path / "angles.csv", 0.0, 1000.0)
    block = next(iter(decoder(SimpleNamespace(data=hesai_packet(4500, 12_500)))))
    x, y, z, _, ring, *_ = np.array(block.points, np.float64).T
    decoded_deg = np.degrees(np.arctan2(z, np.hypot(x, y)))[np.argsort(ring)]
    ours = np.argsort(sensor.rings(np.arange(32)))
    np.testing.assert_allclose(elevation_deg[ours], decoded_deg, atol=1e-3)


@pytest.mark.parametrize(("name", "rises"), [("vlp-16", 1), ("rs-bpearl", 1), ("table1-apd", 1), ("os1-128", -1)])
def test_rings_are_rows(name: str, rises: int) -> None:
    """Reference: elevations of the points, which rise or fall from ring to ring."""
    cloud = random_frame(load_sensor(name))
    rings = np.unique(cloud.ring)
    assert rings.tolist() == [*range(len(rings))]
    elevation = [float(np.median(cloud.elevation_rad[cloud.ring == ring])) for ring in rings]
    assert (rises * np.diff(elevation) > 0.0).all()


@pytest.mark.parametrize("name", ["vlp-16", "os1-128", "pandarxt-32", "qt128c2x"])
def test_the_fifth_column_of_nuscenes_rises(tmp_path: Path, name: str) -> None:
    """Whatever the maker's own driver does: the readers of nuScenes know the rings of an HDL-32E."""
    sensor = load_sensor(name)
    cloud = random_frame(sensor)
    rows = {} if sensor.ring_rows is None else {"ring_rows": " ".join(map(str, sensor.ring_rows))}
    replace(cloud, metadata={"frame": "sensor"} | rows).save(tmp_path / "a.pcd.bin")
    ring = np.fromfile(tmp_path / "a.pcd.bin", "<f4").reshape(-1, 5)[:, 4]
    elevation = [float(np.median(cloud.elevation_rad[ring == number])) for number in np.unique(ring)]
    assert ring.min() == 0.0
    assert (np.diff(elevation) > 0.0).all()


def test_a_table_has_rings_by_the_mean_elevation_of_its_channels(tmp_path: Path) -> None:
    rows = ["0,5,0,0", "0,-5,2,5", "0,0,3,10", "1,7,0,15", "1,-5,2,20", "1,0,3,25"]
    (tmp_path / "t.csv").write_text("\n".join(["azimuth_deg,elevation_deg,channel,time_us", *rows, ""]))
    table = f'scanner={{type="table",file="{tmp_path / "t.csv"}",frame_ms=100}}'
    sensor = load_sensor("table1-apd", overrides=[table])
    assert sensor.rings(np.array([0, 2, 3])).tolist() == [2, 0, 1]
