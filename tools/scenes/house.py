"""Houses by their numbers, the front towards +x: openings, frames, panes, balconies, shops, five kinds of roof."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from modelling import Mesh, box, closed_loft, join, tube

REVEAL_M = 0.16
COLOURS = {
    "brick": (0.50, 0.26, 0.19, 1.0),
    "glass": (0.55, 0.65, 0.70, 0.3),
    "frame": (0.85, 0.85, 0.82, 1.0),
    "concrete": (0.60, 0.59, 0.57, 1.0),
    "door": (0.30, 0.18, 0.10, 1.0),
    "railing": (0.25, 0.26, 0.27, 1.0),
    "roof": (0.35, 0.16, 0.12, 1.0),
    "interior": (0.45, 0.43, 0.40, 1.0),
}
DOOR_M = (1.10, 0.15, 2.45)
"""Width of a door, its foot and its head."""


@dataclass(frozen=True, slots=True)
class House:
    """Numbers of a house.

    Attributes:
        rise_m: from the eaves to the ridge; to the edge of the parapet of a flat roof
        columns_m: y of the middles of the windows of a storey
        door_column: whose window the door takes on the ground floor
        window_m: half width of a window, its sill and its head over the floor
        balconies: columns whose upper windows are doors to a balcony
        roof: "gable" along the street, "front" gable towards it, "hip", "mansard" or "flat"
        ground: "windows", "shop" with wide panes or "gates"
    """

    width_m: float = 10.0
    depth_m: float = 9.0
    storeys: int = 3
    storey_m: float = 3.1
    rise_m: float = 2.9
    columns_m: tuple[float, ...] = (-3.75, -1.25, 1.25, 3.75)
    door_column: int = 1
    window_m: tuple[float, float, float] = (0.60, 0.95, 2.55)
    balconies: tuple[int, ...] = (1, 2)
    roof: str = "gable"
    ground: str = "windows"

    @property
    def eaves_m(self):
        """Height of the eaves."""
        return self.storeys * self.storey_m

    @property
    def door(self):
        """(left, right, bottom, top) of the door."""
        width, foot, head = DOOR_M
        return self.columns_m[self.door_column] - width / 2, self.columns_m[self.door_column] + width / 2, foot, head


def _even(width_m, count):
    """Columns of windows, evenly over a width."""
    return tuple(float(y) for y in width_m * ((np.arange(count) + 0.5) / count - 0.5))


STYLES = {
    "house": House(),
    "house_terrace": House(
        width_m=6.2, storeys=2, storey_m=2.8, rise_m=3.2, columns_m=_even(6.2, 2), door_column=0, balconies=()
    ),
    "house_villa": House(
        width_m=12.0, depth_m=10.0, storeys=2, rise_m=3.4, columns_m=_even(12.0, 5), door_column=2, balconies=(2,),
        roof="hip",
    ),
    "house_bungalow": House(
        width_m=13.0, storeys=1, storey_m=2.9, rise_m=2.2, columns_m=_even(13.0, 4), window_m=(0.95, 0.8, 2.3),
        balconies=(), roof="hip",
    ),
    "house_gable": House(
        width_m=8.4, depth_m=10.5, storeys=2, storey_m=2.8, rise_m=4.0, columns_m=_even(8.4, 3), door_column=2,
        balconies=(), roof="front",
    ),
    "house_canal": House(
        width_m=5.8, depth_m=11.0, storeys=4, rise_m=3.2, columns_m=_even(5.8, 2), window_m=(0.7, 0.6, 2.6),
        balconies=(), roof="front",
    ),
    "house_mansard": House(
        width_m=14.0, depth_m=11.0, storeys=4, storey_m=3.3, rise_m=3.4, columns_m=_even(14.0, 6), door_column=3,
        window_m=(0.55, 0.5, 2.8), balconies=(2, 3), roof="mansard", ground="shop",
    ),
    "house_shop": House(
        width_m=9.0, depth_m=10.0, storey_m=3.2, rise_m=2.6, columns_m=_even(9.0, 3), balconies=(), ground="shop"
    ),
    "house_flats": House(
        width_m=17.0, depth_m=11.0, storeys=4, storey_m=2.9, rise_m=0.5, columns_m=_even(17.0, 6), door_column=2,
        balconies=(1, 4), roof="flat",
    ),
    "house_tower": House(
        width_m=18.0, depth_m=14.0, storeys=6, storey_m=2.8, rise_m=0.9, columns_m=_even(18.0, 6), door_column=3,
        window_m=(0.9, 0.9, 2.3), balconies=(0, 5), roof="flat",
    ),
    "house_office": House(
        width_m=20.0, depth_m=13.0, storeys=4, storey_m=3.5, rise_m=0.6, columns_m=_even(20.0, 8), door_column=4,
        window_m=(1.15, 0.9, 2.9), balconies=(), roof="flat", ground="shop",
    ),
    "house_hall": House(
        width_m=22.0, depth_m=16.0, storeys=1, storey_m=6.0, rise_m=0.7, columns_m=_even(22.0, 5), door_column=2,
        window_m=(1.6, 3.6, 4.8), balconies=(), roof="flat", ground="shop",
    ),
    "house_garages": House(
        width_m=12.0, depth_m=6.0, storeys=1, storey_m=2.6, rise_m=0.25, columns_m=_even(12.0, 4), balconies=(),
        roof="flat", ground="gates",
    ),
}  # fmt: skip
"""Name of the mesh -> numbers."""


def build(house=STYLES["house"]):
    """Part name -> Mesh. Front wall in x = +depth / 2, one storey above another."""
    front, back = _openings(house, front=True), _openings(house, front=False)
    parts = {name: [] for name in COLOURS}
    for openings, turn in ((front, 0.0), (back, np.pi)):
        for name, mesh in _facade(house, openings).items():
            parts[name].append(mesh.moved(position_m=(house.depth_m / 2, 0, 0)).moved(yaw_rad=turn))
    parts["brick"] += [_side_wall(house).moved(position_m=(0, house.width_m / 2, 0))]
    parts["brick"] += [parts["brick"][-1].moved(yaw_rad=np.pi)]
    for storey in range(1, house.storeys) if house.balconies else ():
        for columns in _neighbours(house.balconies):
            slab, rail = _balcony(house, columns, storey * house.storey_m)
            parts["concrete"].append(slab)
            parts["railing"].append(rail)
    for name, meshes in ROOFS[house.roof](house).items():
        parts[name] += meshes
    parts["railing"].append(_gutter(house))
    parts["interior"] += [_rooms(house)]
    return {name: join(*meshes) for name, meshes in parts.items() if meshes}


def _neighbours(columns):
    """Runs of columns side by side, each of which shares a balcony."""
    cuts = [i + 1 for i, (a, b) in enumerate(pairwise(columns)) if b > a + 1]
    return [columns[a:b] for a, b in pairwise([0, *cuts, len(columns)])]


def _openings(house, *, front):
    """(left, right, bottom, top) of each opening, metres along y and z."""
    found = [house.door] if front and house.ground != "gates" else []
    half_m, sill_m, head_m = house.window_m
    for storey in range(house.storeys):
        low = storey * house.storey_m
        for i, column in enumerate(house.columns_m):
            is_ground = front and storey == 0
            if is_ground and i == house.door_column and house.ground != "gates":
                continue
            tall = front and storey > 0 and i in house.balconies
            half, bottom, top = (0.55, low + 0.15, 2.55) if tall else (half_m, low + sill_m, head_m)
            if is_ground and house.ground != "windows":
                half = 0.42 * house.width_m / len(house.columns_m)
                bottom, top = (0.45, min(house.storey_m - 0.45, 3.2)) if house.ground == "shop" else (0.05, 2.15)
            found.append((column - half, column + half, bottom, low + top))
    return found


def _facade(house, openings):
    """Everything in a wall that lies in x = 0 and looks along +x."""
    door = house.door
    gates = house.ground == "gates" and openings[0][2] < 0.1
    leaves = openings if gates else [door] if door in openings else []
    panes = [o for o in openings if o not in leaves]
    bands = (0.25, *(storey * house.storey_m for storey in range(1, house.storeys)))
    return {
        "brick": _wall(house, openings),
        **({"glass": join(*(_pane(*o) for o in panes))} if panes else {}),
        "frame": join(*(_frame(*o, bars=o not in leaves) for o in openings)),
        "concrete": join(*(_sill(*o) for o in openings), *(_band(house, z) for z in bands)),
        **({"door": join(*(_gate(*o) for o in leaves)) if gates else _door(*door)} if leaves else {}),
    }


def _wall(house, openings):
    """The wall without its openings, and the four cheeks of each."""
    table = np.array(openings)
    y = np.unique(np.concatenate([[-house.width_m / 2, house.width_m / 2], table[:, :2].ravel()]))
    z = np.unique(np.concatenate([[0.0, house.eaves_m], table[:, 2:].ravel()]))
    quads = []
    for y0, y1 in pairwise(y):
        for z0, z1 in pairwise(z):
            centre = 0.5 * (y0 + y1), 0.5 * (z0 + z1)
            if not any(o[0] < centre[0] < o[1] and o[2] < centre[1] < o[3] for o in openings):
                quads.append([(0, y0, z0), (0, y1, z0), (0, y1, z1), (0, y0, z1)])
    for y0, y1, z0, z1 in openings:
        ring = [(y0, z0), (y0, z1), (y1, z1), (y1, z0)]
        for (a, b), (c, d) in zip(ring, ring[1:] + ring[:1], strict=True):
            quads.append([(0, a, b), (0, c, d), (-REVEAL_M, c, d), (-REVEAL_M, a, b)])
    return _quads(quads)


def _quads(corners):
    """Four corners each, counter-clockwise seen from outside."""
    points = np.asarray(corners, float).reshape(-1, 3)
    return Mesh(points, np.arange(len(points)).reshape(-1, 4)[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3))


def _pane(y0, y1, z0, z1):
    x = -REVEAL_M + 0.02
    return _quads([[(x, y0, z0), (x, y1, z0), (x, y1, z1), (x, y0, z1)]])


def _frame(y0, y1, z0, z1, *, bars):
    """A frame of four bars; with `bars` a mullion and a transom."""
    w, x, y, z = 0.06, -REVEAL_M + 0.03, 0.5 * (y0 + y1), 0.5 * (z0 + z1)
    upright = [box(size_m=(w, w, z1 - z0), centre_m=(x, at, z)) for at in (y0 + w / 2, y1 - w / 2)]
    level = [box(size_m=(w, y1 - y0, w), centre_m=(x, y, at)) for at in (z0 + w / 2, z1 - w / 2)]
    if bars:
        upright.append(box(size_m=(0.05, 0.05, z1 - z0), centre_m=(x, y, z)))
        level.append(box(size_m=(0.05, y1 - y0, 0.04), centre_m=(x, y, z1 - 0.42)))
    return join(*upright, *level)


def _sill(y0, y1, z0, z1):
    """A sill under the opening and a lintel over it."""
    y = 0.5 * (y0 + y1)
    sill = box(size_m=(0.20, y1 - y0 + 0.14, 0.06), centre_m=(-0.02, y, z0 - 0.03))
    return join(sill, box(size_m=(0.04, y1 - y0 + 0.30, 0.18), centre_m=(0.01, y, z1 + 0.09)))


def _band(house, z):
    """A string course across the wall."""
    return box(size_m=(0.08, house.width_m, 0.14), centre_m=(0.0, 0, z - 0.18))


def _door(y0, y1, z0, z1):
    """The leaf of the door with four raised panels, a handle, and the steps in front."""
    y, w, h = 0.5 * (y0 + y1), y1 - y0, z1 - z0
    leaf = box(size_m=(0.05, w, h), centre_m=(-REVEAL_M + 0.01, y, 0.5 * (z0 + z1)))
    panels = [
        box(size_m=(0.03, 0.36, 0.85), centre_m=(-REVEAL_M + 0.045, y + dy, z0 + dz))
        for dy in (-0.24, 0.24)
        for dz in (0.60, 1.65)
    ]
    knob = tube([(-REVEAL_M + 0.03, y0 + 0.12, 1.15), (-REVEAL_M + 0.10, y0 + 0.12, 1.15)], 0.03, segments=10)
    step = box(size_m=(0.45, 1.5, 0.14), centre_m=(0.2, y, 0.07))
    return join(leaf, *panels, knob, step)


def _gate(y0, y1, z0, z1):
    """A gate of four boards across."""
    height = (z1 - z0) / 4
    return join(
        *(
            box(
                size_m=(0.05, y1 - y0, height - 0.02),
                centre_m=(-REVEAL_M + 0.01, 0.5 * (y0 + y1), z0 + (i + 0.5) * height),
            )
            for i in range(4)
        )
    )


def _balcony(house, columns, z):
    """(slab, railing) across the windows of neighbouring columns, at height z."""
    middle = 0.5 * (house.columns_m[columns[0]] + house.columns_m[columns[-1]])
    reach, half = 1.25, 0.5 * (house.columns_m[columns[-1]] - house.columns_m[columns[0]]) + 0.90
    x0 = house.depth_m / 2
    slab = box(size_m=(reach, 2 * half, 0.16), centre_m=(x0 + reach / 2, 0, z + 0.02))
    top, foot = z + 1.10, z + 0.16
    ways = [[(x0, s * half, h), (x0 + reach - 0.05, s * half, h)] for s in (-1, 1) for h in (top, foot)]
    ways += [[(x0 + reach - 0.05, -half, h), (x0 + reach - 0.05, half, h)] for h in (top, foot)]
    count = 33 if half > 1.5 else 15
    spots = [(x0 + reach - 0.05, y) for y in np.linspace(-half, half, count)]
    spots += [(x0 + x, s * half) for s in (-1, 1) for x in np.linspace(0.1, reach - 0.15, 9)]
    bars = [box(size_m=(0.018, 0.018, top - z - 0.08), centre_m=(x, y, 0.5 * (top + z + 0.08))) for x, y in spots]
    rail = join(*(tube(way, 0.022, segments=6) for way in ways), *bars)
    place = {"position_m": (0.0, middle, 0.0)}
    return slab.moved(**place), rail.moved(**place)


def _side_wall(house):
    """A side wall in y = 0, looking along +y, with its gable if the roof has one there."""
    d, eaves = house.depth_m / 2, house.eaves_m
    if house.roof != "gable":
        return _quads([[(d, 0, 0), (-d, 0, 0), (-d, 0, eaves), (d, 0, eaves)]])
    points = np.array(
        [(d, 0, 0), (-d, 0, 0), (-d, 0, eaves), (0, 0, eaves + house.rise_m - 0.05), (d, 0, eaves)], float
    )
    return Mesh(points, np.array([[0, 1, 2], [0, 2, 4], [2, 3, 4]]))


def _gable_roof(house):
    sides = [_roof_side(house.width_m, house.depth_m, house.eaves_m, house.rise_m)]
    return {"roof": [*sides, sides[0].moved(yaw_rad=np.pi), _chimney(house)]}


def _front_roof(house):
    """A gable roof whose ridge points to the street, and the two gables with a window below it."""
    slope = _roof_side(house.depth_m, house.width_m, house.eaves_m, house.rise_m).moved(yaw_rad=np.pi / 2)
    half, d, eaves = house.width_m / 2, house.depth_m / 2, house.eaves_m
    gable = Mesh(
        np.array([(d, -half, eaves), (d, half, eaves), (d, 0, eaves + house.rise_m - 0.05)]), np.array([[0, 1, 2]])
    )
    window = box(size_m=(0.06, 0.9, 0.9), centre_m=(d + 0.01, 0, eaves + 0.3 * house.rise_m))
    return {
        "roof": [slope, slope.moved(yaw_rad=np.pi), _chimney(house)],
        "brick": [gable, gable.moved(yaw_rad=np.pi)],
        "frame": [window, window.moved(yaw_rad=np.pi)],
    }


def _loft_roof(house, steps):
    """A closed roof of rectangles: (height over the eaves, inwards along x, inwards along y) from the eaves up."""
    rings = []
    for up, in_x, in_y in steps:
        x, y = house.depth_m / 2 - in_x, house.width_m / 2 - in_y
        rings.append(
            [
                (-x, -y, house.eaves_m + up),
                (x, -y, house.eaves_m + up),
                (x, y, house.eaves_m + up),
                (-x, y, house.eaves_m + up),
            ]
        )
    return closed_loft(rings)


def _hip_roof(house):
    """Four slopes with overhang."""
    d = house.depth_m / 2
    return {
        "roof": [
            _loft_roof(house, [(-0.15, -0.45, -0.45), (0.02, -0.45, -0.45), (house.rise_m, d - 0.1, d - 0.1)]),
            _chimney(house),
        ]
    }


def _mansard_roof(house):
    """Four steep slopes with dormers in front, and a flatter one above."""
    rise = house.rise_m
    roof = _loft_roof(house, [(-0.12, -0.3, -0.3), (0.05, -0.3, -0.3), (0.8 * rise, 0.9, 0.9), (rise, 3.0, 3.0)])
    x, low = house.depth_m / 2 - 0.35, house.eaves_m + 0.35
    dormers = [box(size_m=(1.1, 1.3, 1.7), centre_m=(x - 0.3, y, low + 0.85)) for y in house.columns_m]
    lights = [box(size_m=(0.06, 0.95, 1.2), centre_m=(x + 0.25, y, low + 0.85)) for y in house.columns_m]
    return {"roof": [roof, _chimney(house)], "concrete": dormers, "frame": lights}


def _flat_roof(house):
    """A slab, a parapet of four walls, and what stands on such roofs."""
    d, w, eaves, rise = house.depth_m, house.width_m, house.eaves_m, house.rise_m
    slab = box(size_m=(d - 0.1, w - 0.1, 0.20), centre_m=(0, 0, eaves - 0.08))
    long = box(size_m=(0.25, w, rise), centre_m=(d / 2 - 0.125, 0, eaves + rise / 2))
    short = box(size_m=(d - 0.5, 0.25, rise), centre_m=(0, w / 2 - 0.125, eaves + rise / 2))
    shed = box(size_m=(2.4, 3.0, 2.2), centre_m=(-0.2 * d, 0.15 * w, eaves + 1.12))
    walls = [long, long.moved(yaw_rad=np.pi), short, short.moved(yaw_rad=np.pi)]
    return {"roof": [slab], "concrete": walls + ([shed] if house.storeys > 2 else [])}


ROOFS = {"gable": _gable_roof, "front": _front_roof, "hip": _hip_roof, "mansard": _mansard_roof, "flat": _flat_roof}


def _roof_side(width_m, depth_m, eaves_m, rise_m, *, courses=16):
    """The slope towards +x: courses of tiles, each a step above the next, with overhang."""
    half, out = width_m / 2 + 0.25, depth_m / 2 + 0.40
    ridge = eaves_m + rise_m
    drop = (ridge - eaves_m) / (depth_m / 2)
    x = np.linspace(out, 0.0, courses + 1)
    z = ridge - drop * x
    quads = []
    for i in range(courses):
        low, high = z[i] + 0.06, z[i + 1] + 0.02
        quads.append([(x[i], -half, low), (x[i], half, low), (x[i + 1], half, high), (x[i + 1], -half, high)])
        under = z[i] + (0.02 if i else -0.10)
        quads.append([(x[i], -half, under), (x[i], half, under), (x[i], half, low), (x[i], -half, low)])
        for s in (-1, 1):
            edge = [(x[i], s * half, low), (x[i + 1], s * half, high)]
            edge += [(x[i + 1], s * half, z[i + 1] - 0.1), (x[i], s * half, z[i] - 0.1)]
            quads.append(edge if s < 0 else edge[::-1])
    low, high = z[0] - 0.10, z[-1] - 0.10
    quads.append([(0, -half, high), (0, half, high), (x[0], half, low), (x[0], -half, low)])
    return _quads(quads)


def _chimney(house):
    ridge, y = house.eaves_m + house.rise_m, 0.26 * house.width_m
    stack = box(size_m=(0.6, 0.9, 2.0), centre_m=(-1.2, y, ridge - 0.2))
    return join(stack, box(size_m=(0.72, 1.02, 0.10), centre_m=(-1.2, y, ridge + 0.82)))


def _gutter(house):
    """The gutter under the front eaves and a rain pipe; a flat roof and a front gable have the pipe alone."""
    x, y, z = house.depth_m / 2 + 0.42, house.width_m / 2 - 0.25, house.eaves_m - 0.28
    if house.roof in ("flat", "front"):
        x = house.depth_m / 2 + 0.08
        return tube([(x, y, z), (x, y, 0.0)], 0.045, segments=8)
    pipe = [(x - 0.02, y, z), (x - 0.30, y, z - 0.3), (x - 0.35, y, z - 0.4), (x - 0.35, y, 0.0)]
    end = house.width_m / 2 + 0.2
    return join(tube([(x, -end, z), (x, end, z)], 0.07, segments=10), tube(pipe, 0.045, segments=8))


def _rooms(house):
    """Floors and partition walls, so that there is something behind the panes; the ground slab."""
    d, w, storey_m, storeys = house.depth_m - 2 * REVEAL_M - 0.3, house.width_m - 0.4, house.storey_m, house.storeys
    floors = [
        box(size_m=(d, w, 0.2), centre_m=(0, 0, i * storey_m + 0.1 * (i == 0)))
        for i in range(storeys + (house.roof != "flat"))
    ]
    walls = [
        box(size_m=(0.12, w, storey_m - 0.2), centre_m=(x, 0, (i + 0.5) * storey_m))
        for x in (-1.2, 1.2)
        for i in range(storeys)
    ]
    sides = [
        box(size_m=(d, 0.12, storey_m - 0.2), centre_m=(0, y, (i + 0.5) * storey_m))
        for y in (-0.25 * house.width_m, 0, 0.25 * house.width_m)
        for i in range(storeys)
    ]
    return join(*floors, *walls, *sides)
