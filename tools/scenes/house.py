"""A town house of three storeys, its front towards +x: openings, frames, panes, balconies, tiled roof."""

from itertools import pairwise

import numpy as np
from modelling import Mesh, box, join, tube

WIDTH_M, DEPTH_M, EAVES_M, RIDGE_M = 10.0, 9.0, 9.3, 12.2
STOREY_M, REVEAL_M = 3.1, 0.16
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
COLUMNS_M = (-3.75, -1.25, 1.25, 3.75)
DOOR = (-1.80, -0.70, 0.15, 2.45)
BALCONY_COLUMNS = (1, 2)


def build():
    """Part name -> Mesh. Front wall in x = +DEPTH / 2, one storey above another."""
    front, back = _openings(door=True), _openings(door=False)
    parts = {name: [] for name in COLOURS}
    for openings, turn in ((front, 0.0), (back, np.pi)):
        for name, mesh in _facade(openings).items():
            parts[name].append(mesh.moved(position_m=(DEPTH_M / 2, 0, 0)).moved(yaw_rad=turn))
    parts["brick"] += [_gable().moved(position_m=(0, WIDTH_M / 2, 0))]
    parts["brick"] += [parts["brick"][-1].moved(yaw_rad=np.pi)]
    for storey in (1, 2):
        slab, rail = _balcony(storey * STOREY_M)
        parts["concrete"].append(slab)
        parts["railing"].append(rail)
    parts["roof"] += [_roof_side(), _roof_side().moved(yaw_rad=np.pi), _chimney()]
    parts["railing"].append(_gutter())
    parts["interior"] += [_rooms()]
    return {name: join(*meshes) for name, meshes in parts.items()}


def _openings(*, door):
    """(left, right, bottom, top) of each opening, metres along y and z."""
    found = [DOOR] if door else []
    for storey in range(3):
        low = storey * STOREY_M
        for i, column in enumerate(COLUMNS_M):
            if door and storey == 0 and i == 1:
                continue
            tall = door and storey > 0 and i in BALCONY_COLUMNS
            half, bottom = (0.55, low + 0.15) if tall else (0.60, low + 0.95)
            found.append((column - half, column + half, bottom, low + 2.55))
    return found


def _facade(openings):
    """Everything in a wall that lies in x = 0 and looks along +x."""
    return {
        "brick": _wall(openings),
        "glass": join(*(_pane(*o) for o in openings if o != DOOR)),
        "frame": join(*(_frame(*o) for o in openings)),
        "concrete": join(*(_sill(*o) for o in openings), *(_band(z) for z in (0.25, STOREY_M, 2 * STOREY_M))),
        **({"door": _door()} if DOOR in openings else {}),
    }


def _wall(openings):
    """The wall without its openings, and the four cheeks of each."""
    table = np.array(openings)
    y = np.unique(np.concatenate([[-WIDTH_M / 2, WIDTH_M / 2], table[:, :2].ravel()]))
    z = np.unique(np.concatenate([[0.0, EAVES_M], table[:, 2:].ravel()]))
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


def _frame(y0, y1, z0, z1):
    """A frame of four bars, a mullion and a transom."""
    w, x, y, z = 0.06, -REVEAL_M + 0.03, 0.5 * (y0 + y1), 0.5 * (z0 + z1)
    upright = [box(size_m=(w, w, z1 - z0), centre_m=(x, at, z)) for at in (y0 + w / 2, y1 - w / 2)]
    level = [box(size_m=(w, y1 - y0, w), centre_m=(x, y, at)) for at in (z0 + w / 2, z1 - w / 2)]
    if (y0, y1, z0, z1) != DOOR:
        upright.append(box(size_m=(0.05, 0.05, z1 - z0), centre_m=(x, y, z)))
        level.append(box(size_m=(0.05, y1 - y0, 0.04), centre_m=(x, y, z1 - 0.42)))
    return join(*upright, *level)


def _sill(y0, y1, z0, z1):
    """A sill under the opening and a lintel over it."""
    y = 0.5 * (y0 + y1)
    sill = box(size_m=(0.20, y1 - y0 + 0.14, 0.06), centre_m=(-0.02, y, z0 - 0.03))
    return join(sill, box(size_m=(0.04, y1 - y0 + 0.30, 0.18), centre_m=(0.01, y, z1 + 0.09)))


def _band(z):
    """A string course across the wall."""
    return box(size_m=(0.08, WIDTH_M, 0.14), centre_m=(0.0, 0, z - 0.18))


def _door():
    """The leaf of the door with four raised panels, a handle, and the steps in front."""
    y0, y1, z0, z1 = DOOR
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


def _balcony(z):
    """(slab, railing) across the two middle windows, at height z."""
    reach, half = 1.25, 2.15
    x0 = DEPTH_M / 2
    slab = box(size_m=(reach, 2 * half, 0.16), centre_m=(x0 + reach / 2, 0, z + 0.02))
    top, foot = z + 1.10, z + 0.16
    ways = [[(x0, s * half, h), (x0 + reach - 0.05, s * half, h)] for s in (-1, 1) for h in (top, foot)]
    ways += [[(x0 + reach - 0.05, -half, h), (x0 + reach - 0.05, half, h)] for h in (top, foot)]
    spots = [(x0 + reach - 0.05, y) for y in np.linspace(-half, half, 33)]
    spots += [(x0 + x, s * half) for s in (-1, 1) for x in np.linspace(0.1, reach - 0.15, 9)]
    bars = [box(size_m=(0.018, 0.018, top - z - 0.08), centre_m=(x, y, 0.5 * (top + z + 0.08))) for x, y in spots]
    return slab, join(*(tube(way, 0.022, segments=6) for way in ways), *bars)


def _gable():
    """A side wall with its gable, in y = 0, looking along +y."""
    d = DEPTH_M / 2
    points = np.array([(d, 0, 0), (-d, 0, 0), (-d, 0, EAVES_M), (0, 0, RIDGE_M - 0.05), (d, 0, EAVES_M)], float)
    return Mesh(points, np.array([[0, 1, 2], [0, 2, 4], [2, 3, 4]]))


def _roof_side(*, courses=16):
    """The slope towards +x: courses of tiles, each a step above the next, with overhang."""
    half, out = WIDTH_M / 2 + 0.25, DEPTH_M / 2 + 0.40
    drop = (RIDGE_M - EAVES_M) / (DEPTH_M / 2)
    x = np.linspace(out, 0.0, courses + 1)
    z = RIDGE_M - drop * x
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


def _chimney():
    stack = box(size_m=(0.6, 0.9, 2.0), centre_m=(-1.2, 2.6, RIDGE_M - 0.2))
    return join(stack, box(size_m=(0.72, 1.02, 0.10), centre_m=(-1.2, 2.6, RIDGE_M + 0.82)))


def _gutter():
    """The gutter under the front eaves and a rain pipe."""
    x, z = DEPTH_M / 2 + 0.42, EAVES_M - 0.28
    pipe = [(x - 0.02, 4.75, z), (x - 0.30, 4.75, z - 0.3), (x - 0.35, 4.75, z - 0.4), (x - 0.35, 4.75, 0.0)]
    return join(tube([(x, -5.2, z), (x, 5.2, z)], 0.07, segments=10), tube(pipe, 0.045, segments=8))


def _rooms():
    """Floors and partition walls, so that there is something behind the panes; the ground slab."""
    d, w = DEPTH_M - 2 * REVEAL_M - 0.3, WIDTH_M - 0.4
    floors = [box(size_m=(d, w, 0.2), centre_m=(0, 0, i * STOREY_M + 0.1 * (i == 0))) for i in range(4)]
    walls = [
        box(size_m=(0.12, w, STOREY_M - 0.2), centre_m=(x, 0, (i + 0.5) * STOREY_M))
        for x in (-1.2, 1.2)
        for i in range(3)
    ]
    sides = [
        box(size_m=(d, 0.12, STOREY_M - 0.2), centre_m=(0, y, (i + 0.5) * STOREY_M))
        for y in (-2.5, 0, 2.5)
        for i in range(3)
    ]
    return join(*floors, *walls, *sides)
