"""The table of road vehicles: distinct bodies, classes that labels know, axles under them, shares that add up."""

import tomllib
from pathlib import Path

import pytest

from lidarscene import catalog
from lidarscene.labels.kinds import KINDS

TABLE = tomllib.loads((Path(catalog.__file__).parent / "vehicles.toml").read_text(encoding="utf-8"))


def test_families_have_distinct_bodies_of_classes_that_labels_know() -> None:
    bodies = catalog.vehicles().values()
    assert len({body.size_m for body in bodies}) >= 40
    assert {body.class_name for body in bodies} <= set(KINDS)
    families = "compact hatchback saloon estate suv minivan pickup van lorry articulated trailer bus coach"
    assert {body.family for body in bodies} >= {*families.split(), "motorcycle", "bicycle"}
    assert {"motorcyclist", "cyclist", "motorcycle", "bicycle"} <= {body.class_name for body in bodies}


@pytest.mark.parametrize("name", TABLE["bodies"])
def test_axles_are_under_the_body_and_its_name_says_its_length(name: str) -> None:
    body = TABLE["bodies"][name]
    length_m, width_m, height_m = body["size_m"]
    radius_m = body["tyre_m"][0] / 2
    assert length_m > width_m
    assert body["axles_m"] == sorted(body["axles_m"])
    assert body["axles_m"][0] > radius_m - 0.01
    assert body["axles_m"][-1] < length_m - radius_m + 0.01
    assert name == f"{name.split('_')[0]}_{int(100 * length_m + 1e-6)}"
    assert 2 * radius_m < height_m
    assert body["source"]


def test_shares_of_paints_are_of_all_cars() -> None:
    assert sum(catalog.paint_shares().values()) == pytest.approx(1.0)
    assert set(catalog.paint_shares()) <= set(catalog.names("materials"))
