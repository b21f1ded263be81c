"""What stands and drives along streets: the name of a body gives its mesh, its materials and its scale.

Vehicles are drawn by shares of their classes and of paints, houses and plants by the district of a block.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ... import catalog
from .pieces import Tables

PAINT = "car_paint_"

LANE_ROOM_M = 0.1
"""Choice: least width of a lane that a vehicle leaves free, where its ends swing out in a bend, too."""

TREE_SCALES = (0.7, 0.85, 1.0)
"""Choice: scales of a tree's mesh, of which each tree draws one."""

BUSHES = {
    f"{name}_{number}": (mesh, scale)
    for name, mesh in (("bushes", "bush"), ("junipers", "juniper"))
    for number, scale in enumerate(TREE_SCALES)
}
"""Choice: name of a body -> mesh and scale of bushes, of which each is as likely."""

BUSH_SPACING_M, BUSH_ASIDE_M = (4.0, 20.0), (1.5, 6.0)
"""Choice: distance from bush to bush along a street, and of bushes from the edge of a pavement or road."""

PEOPLE: Sequence[str] = catalog.street_parts()["people"]
"""Meshes of people, of which the ones on a street are one after the other."""

WALKERS = (*PEOPLE, *PEOPLE[:-1], "wheelchair_user")
"""Choice: meshes of those who move all the time, likewise: one of 24 rolls in a wheelchair."""

SIGNS = ("sign", "sign_triangle", "sign_yield", "sign_stop", "sign_diamond", "sign_square")
FURNITURE = ("dustbin", "container", "cabinet", "power_pole", "parking_meter", "letter_box")
"""What stands by the kerb besides lamps and signs."""


class District(NamedTuple):
    """Look of a part of a town.

    Attributes:
        houses, walls: meshes and materials, of which each house draws one
        trees: meshes, of which each tree draws one
        garden_m: from the pavement to the houses, besides the street's own setback
        border: mesh of what a garden has towards the pavement; "" for none
    """

    houses: Sequence[str]
    walls: Sequence[str]
    trees: Sequence[str]
    garden_m: float = 0.0
    border: str = ""


DISTRICTS = tuple(District(**row) for row in catalog.street_parts()["districts"])

MAIN_SHARE = 0.7
"""Choice: share of a street's blocks in its main district."""


def draw_district(random: np.random.Generator, main: District | None = None) -> District:
    """Draw a district; of a street whose main one is given, of a block."""
    if main is not None and random.random() < MAIN_SHARE:
        return main
    return DISTRICTS[random.integers(len(DISTRICTS))]


class StreetBody(NamedTuple):
    """Mesh, materials other than those of `catalog.shipped_meshes`, scale."""

    mesh: str
    materials: Mapping[str, str]
    scale: float = 1.0


@functools.cache
def shapes() -> dict[str, StreetBody]:
    """Name of a body -> its shape."""
    paints = [paint.removeprefix(PAINT) for paint in catalog.paint_shares()]
    walls = dict.fromkeys(wall for district in DISTRICTS for wall in district.walls)
    houses = dict.fromkeys(house for district in DISTRICTS for house in district.houses)
    trees = dict.fromkeys(tree for district in DISTRICTS for tree in district.trees)
    return {
        **{f"houses_{house}_{wall}": StreetBody(house, {"brick": wall}) for house in houses for wall in walls},
        **{
            f"{group}_{vehicle}_{paint}": StreetBody(vehicle, {"paint": f"{PAINT}{paint}"})
            for group in ("parked", "traffic")
            for vehicle in catalog.vehicles()
            for paint in paints
        },
        "own_car": StreetBody("car", {"paint": f"{PAINT}white"}),
        **{
            f"trees_{tree}_{number}": StreetBody(tree, {}, scale)
            for tree in trees
            for number, scale in enumerate(TREE_SCALES)
        },
        **{f"{mesh}s": StreetBody(mesh, {}) for mesh in ("hedge", "fence", "guard_rail", *FURNITURE, *SIGNS)},
        **{name: StreetBody(mesh, {}, scale) for name, (mesh, scale) in BUSHES.items()},
        **{f"{mesh}s": StreetBody(mesh, {}) for mesh in ("lamp_post", "bollard", "cone", "barrier", "gatepost")},
        **{f"pedestrians_{person}": StreetBody(person, {}) for person in PEOPLE},
        **{f"walkers_{person}": StreetBody(person, {}) for person in WALKERS},
        "lights": StreetBody("traffic_light", {}),
    }


def body_table(name: str, shape: StreetBody, *, moves: bool = False) -> Tables:
    """Table of a body of a shipped mesh; people stand if they do not move, and wheels have no animation."""
    kind = catalog.shipped_meshes()[shape.mesh]
    path = catalog.folder("scenes").parent / "assets" / "meshes" / f"{shape.mesh}.glb"
    others = {part: material for part, material in kind["materials"].items() if part not in shape.materials}
    body = {"name": name, "mesh": str(path), "class": kind["class"], "materials": {**shape.materials, **others}}
    if moves or "standing" in kind:
        body |= {key: kind[key] for key in ("animation", "standing") if key in kind}
    return body | ({"scale": shape.scale} if shape.scale != 1.0 else {})


def own_table(name: str) -> Tables:
    """Table of the vehicle that carries the sensor."""
    return body_table(name, shapes()[name], moves=True) | {"motion": {"with_ego": True}}


def moving_tables(name: str, motions: Sequence[Tables]) -> list[Tables]:
    """Tables of what moves along roads, and of what it pushes, whose origin is its own: an instance for each motion."""
    shape = shapes()[name]
    pushed = catalog.shipped_meshes()[shape.mesh].get("pushes")
    bodies = {name: shape} | ({f"{pushed}s": StreetBody(pushed, {})} if pushed else {})
    return [
        body_table(each, its_shape, moves=True)
        | {"on_ground": True, "instances": [{"motion": dict(motion)} for motion in motions]}
        for each, its_shape in bodies.items()
    ]


def standing_table(name: str, places: Sequence[Tables]) -> Tables:
    """Table of what stands along a street; houses are level, all others on the ground."""
    body = body_table(name, shapes()[name])
    return body | ({} if body["class"] == "building" else {"on_ground": True}) | {"instances": list(places)}


def vehicle_length_m(name: str) -> float:
    """Length of a vehicle, by the name of its body."""
    return catalog.vehicles()[shapes()[name].mesh].size_m[0]


def draw_vehicle(
    group: str,
    number: float,
    paint: float,
    *,
    longest_m: float,
    widest_m: float,
    curvature_per_m: float = 0.0,
    without: tuple[str, ...] = (),
) -> str:
    """Name of the body of a vehicle.

    Args:
        group: "parked" or "traffic"
        number, paint: from 0 to 1, which choose body and paint
        longest_m: length that it has at most
        widest_m: width that it takes up at most
        curvature_per_m: of the sharpest bend of its path, which makes it take up more width
        without: classes that are not drawn
    """
    names, sums = _fleet(group, longest_m, widest_m, curvature_per_m, without)
    return f"{group}_{names[int(np.searchsorted(sums, number, side='right'))]}_{paint_at(paint)}"


def paint_at(number: float) -> str:
    """Paint that a number from 0 to 1 chooses, by the shares of paints."""
    paints = catalog.paint_shares()
    place = np.searchsorted(np.cumsum(list(paints.values())), number, side="right")
    return list(paints)[min(int(place), len(paints) - 1)].removeprefix(PAINT)


@functools.cache
def _fleet(
    group: str, longest_m: float, widest_m: float, curvature_per_m: float, without: tuple[str, ...]
) -> tuple[list[str], Sequence[float]]:
    """Bodies that are no longer and no wider, and the sums of their shares up to each; those of a class are equal."""
    shares = catalog.street_parts()[group]
    fitting = [
        body
        for body in catalog.vehicles().values()
        if body.class_name in shares and body.class_name not in without
        if body.size_m[0] <= longest_m and _width_in_bend_m(body.size_m, curvature_per_m) <= widest_m
    ]
    classes = [body.class_name for body in fitting]
    weights = np.array([shares[name] / classes.count(name) for name in classes])
    return [body.name for body in fitting], (np.cumsum(weights) / weights.sum()).tolist()


def _width_in_bend_m(size_m: Sequence[float], curvature_per_m: float) -> float:
    """Width that a vehicle takes up along its path: its ends swing out by L^2 / (8 r), the rise of a chord."""
    return size_m[1] + 0.25 * curvature_per_m * size_m[0] ** 2
