"""Road vehicles: each body is made of its numbers in catalog/vehicles.toml and of its family's proportions."""

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import vehicle_shell as shells
from modelling import Mesh, box, ellipsoid, join, lathe, rounded_box, tube
from pedalling import KNEE_BENT, SOLE_M, pedalling
from vehicle_parts import SPOKES, WHEELS, mirrors, nearest_axle, plate, rider, ring, rolling, seat, wheel, wheels
from vehicle_shell import Shape

TABLE = Path(__file__).parents[2] / "src/lidarscene/catalog/vehicles.toml"
COLOURS = {
    "paint": (0.75, 0.76, 0.78, 1.0),
    "glass": (0.35, 0.42, 0.42, 0.35),
    "tyre": (0.03, 0.03, 0.03, 1.0),
    "rim": (0.62, 0.63, 0.65, 1.0),
    "trim": (0.06, 0.06, 0.06, 1.0),
    "headlamp": (0.85, 0.88, 0.90, 1.0),
    "taillamp": (0.55, 0.03, 0.03, 1.0),
    "plate": (0.92, 0.92, 0.88, 1.0),
    "interior": (0.10, 0.10, 0.11, 1.0),
    "cranks/trim": (0.06, 0.06, 0.06, 1.0),
    "mirrors": (0.05, 0.05, 0.05, 1.0),
    "skin": (0.80, 0.58, 0.46, 1.0),
    "clothes": (0.20, 0.28, 0.48, 1.0),
    "trousers": (0.12, 0.13, 0.20, 1.0),
    "shoes": (0.06, 0.05, 0.05, 1.0),
    "helmet": (0.10, 0.10, 0.12, 1.0),
}
MOST_STRETCH = 0.04
"""Largest relative difference of a body as modelled from its size, to which it is stretched; mirrors do not count."""


@dataclass(frozen=True, slots=True)
class Dimensions:
    """A row of the table, in metres; s counts from the front end."""

    family: str
    class_name: str
    length: float
    width: float
    height: float
    axles: tuple[float, ...]
    tyre: tuple[float, float]

    def x(self, s):
        """Place along x, whose 0 is the middle, of a station."""
        return 0.5 * self.length - s

    @property
    def arch(self):
        """Radius of the arches of the wheels."""
        return 0.5 * self.tyre[0] * 1.14 + 0.02


def bodies():
    """Name -> numbers of all bodies."""
    rows = tomllib.loads(TABLE.read_text(encoding="utf-8"))["bodies"]
    return {
        name: Dimensions(row["family"], row["class"], *row["size_m"], tuple(row["axles_m"]), tuple(row["tyre_m"]))
        for name, row in rows.items()
    }


def build(n):
    """Part name -> Mesh of a body of its stated size, its wheels `Skinned`, and the `Skeleton` by which they turn."""
    parts = FAMILIES[n.family](n)
    # Axles as modelled, and on which of them each point of the wheels turns.
    axles_m = np.array([(n.x(s), 0.0, 0.5 * n.tyre[0]) for s in n.axles])
    axle_of = {name: nearest_axle(parts[name].points_m, axles_m) for name in WHEELS}
    scale, middle = np.ones(3), np.zeros(3)

    def placed(points_m):
        return (points_m - middle) * scale

    def fitted(name, mesh):
        if name not in WHEELS:
            return Mesh(placed(mesh.points_m), mesh.faces)
        # A wheel stays round: its height says how large it is.
        on_m = axles_m[axle_of[name]]
        return Mesh(placed(on_m) + (mesh.points_m - on_m) * scale[[2, 1, 2]], mesh.faces)

    for _ in range(3):  # wheels that reach to the ends are stretched less than what is between them
        points = np.concatenate([fitted(name, mesh).points_m for name, mesh in parts.items() if name != "mirrors"])
        low, high = points.min(axis=0), points.max(axis=0)
        middle = middle + 0.5 * (low + high) / scale * (1.0, 1.0, 0.0)
        scale = scale * np.array([n.length, n.width, n.height]) / (high - low * (1.0, 1.0, 0.0))
    if np.abs(scale - 1.0).max() > MOST_STRETCH:
        raise ValueError(f"{n}: must be stretched by {scale}")
    meshes = {name: fitted(name, mesh) for name, mesh in parts.items()}
    axles_m = placed(axles_m)
    if n.class_name == "cyclist":
        crank_m, pedals_m, seat_m = (placed(np.array(place_m)) for place_m in _crankset(n))
        return pedalling(meshes, axles_m, crank_m=crank_m, pedals_m=pedals_m, seat_m=seat_m, height_m=n.height)
    return rolling(meshes, axles_m, turns=1 / (6 if n.family == "bicycle" else SPOKES))


def _merged(*groups):
    """Part name -> Mesh of several groups of parts, in the order of `COLOURS`."""
    return {
        name: join(*(group[name] for group in groups if name in group))
        for name in COLOURS
        if any(name in group for group in groups)
    }


# ---- cars, vans and buses: one skin ----


@dataclass(frozen=True, slots=True)
class Style:
    """Proportions of a family of cars: heights as shares of the body's, lengths in metres or from the axles.

    Attributes:
        nose, cowl: height of the bonnet's front edge and of its rear edge, where the windscreen begins
        cowl_m: from the front axle back to the windscreen's foot
        screen_m: length of the windscreen, along the car
        belt: height of the beltline in front and behind
        header_m: from the rear end to the rear edge of the roof
        foot_m: from the rear end to the foot of the rear window
        deck: height of the rear window's foot
        panes: number of panes of a side
    """

    nose: float = 0.47
    cowl: float = 0.65
    cowl_m: float = 0.10
    screen_m: float = 1.05
    belt: tuple[float, float] = (0.615, 0.665)
    header_m: float = 0.55
    foot_m: float = 0.13
    deck: float = 0.69
    panes: int = 2
    floor: float = 0.125
    tumble: float = 0.38
    rear_windows: bool = True


STYLES = {
    "compact": Style(cowl_m=-0.02, screen_m=0.85, header_m=0.40, foot_m=0.10, nose=0.48),
    "hatchback": Style(),
    "saloon": Style(screen_m=1.15, header_m=1.42, foot_m=0.62, deck=0.70, cowl_m=0.16),
    "estate": Style(header_m=0.42, foot_m=0.10, panes=3, screen_m=1.1, cowl_m=0.14),
    "suv": Style(
        nose=0.52, cowl=0.66, belt=(0.63, 0.67), floor=0.135, header_m=0.42, foot_m=0.10, panes=3, screen_m=0.95
    ),
    "minivan": Style(
        nose=0.47, cowl=0.61, belt=(0.58, 0.61), cowl_m=-0.12, screen_m=1.25, header_m=0.30, foot_m=0.08, panes=3
    ),
    "pickup": Style(nose=0.52, cowl=0.66, belt=(0.60, 0.62), floor=0.19, panes=2, screen_m=0.85),
    "van": Style(
        nose=0.42,
        cowl=0.56,
        belt=(0.54, 0.56),
        cowl_m=-0.28,
        screen_m=0.85,
        header_m=0.14,
        foot_m=0.03,
        deck=0.965,
        panes=1,
        tumble=0.12,
        floor=0.10,
        rear_windows=False,
    ),
}


def _car(n):
    """A passenger car, a pick-up or a van."""
    style, length, h = STYLES[n.family], n.length, n.height
    cowl = n.axles[0] + style.cowl_m
    header = cowl + style.screen_m
    rear, foot = length - style.header_m, length - style.foot_m
    bed = None
    if n.family == "pickup":
        rear, foot = n.axles[-1] - 1.02, n.axles[-1] - 0.86
        bed = (foot + 0.06, length - 0.09, 0.42 * h)
    deck = 0.60 * h if bed else style.deck * h
    tail = length - 0.02
    top = [
        (0.0, (style.nose - 0.02) * h),
        (0.12, (style.nose + 0.045) * h),
        (0.5 * cowl, (style.cowl - 0.05) * h),
        (cowl, style.cowl * h),
    ]
    top += [(header, 0.962 * h), (header + 0.25 * (rear - header), h), (header + 0.6 * (rear - header), 0.996 * h)]
    top += [(rear, 0.955 * h if n.family != "van" else 0.99 * h), (foot, deck), (tail, deck - 0.01 * h)]
    belt_front = min((style.nose - 0.06) * h, top[0][1] - 0.05)
    belt = [
        (0.0, belt_front),
        (0.5 * cowl, (style.cowl - 0.085) * h),
        (cowl, style.belt[0] * h),
        (rear, style.belt[1] * h),
    ]
    belt += [(foot, min(style.belt[1] * h, deck - 0.04)), (length, min(style.belt[1] * h, deck - 0.05))]
    first, last = cowl + 0.38 * style.screen_m, rear + 0.25 * min(foot - rear, 0.5)
    if n.family == "van":
        last = header + 0.55
    edges = np.linspace(first, last, style.panes + 1)
    if n.family == "saloon":
        edges[1] += 0.10
    windows = tuple((a + 0.05 * (i > 0), b - 0.05) for i, (a, b) in enumerate(pairwise(edges)))
    screens = [(cowl + 0.05, header - 0.05)]
    if style.rear_windows:
        screens.append((rear + 0.06, foot - 0.03) if foot - rear > 0.2 else (rear + 0.02, foot - 0.02))
    shape = Shape(
        length_m=length,
        width_m=n.width,
        floor_m=style.floor * h,
        axles_m=n.axles,
        axle_m=0.5 * n.tyre[0],
        arch_m=n.arch,
        well_m=0.5 * n.width - n.tyre[1] - 0.10,
        top=tuple(top),
        belt=tuple(belt),
        tumble=style.tumble,
        windows=windows,
        screens=tuple(screens),
        bed=bed,
        crown_m=0.045 if n.family != "van" else 0.03,
        round_m=min(0.55, n.axles[0] - n.arch - 0.03),
        bulge=0.22,
    )
    cabin = (cowl, (foot if bed else last))
    parts = _clad(shape, cabin=cabin)
    parts = _merged(
        parts,
        _wheels(n, n.axles, gap_m=0.035),
        _fittings(n, mirror_s=cowl + 0.32 * style.screen_m, belt_m=style.belt[0] * h),
    )
    rows = [
        header - 0.05 + 0.85 * row
        for row in range(2)
        if header + 0.85 * row + 0.95 < (foot if style.rear_windows else length)
    ]
    floor = shape.floor_m + 0.18
    seats = [
        seat(x_m=n.x(s + 0.35), y_m=side * 0.22 * n.width, z_m=floor + 0.14, width_m=0.27 * n.width)
        for s in rows
        for side in (-1, 1)
    ]
    dash = box(size_m=(0.40, 0.74 * n.width, 0.24), centre_m=(n.x(cowl + 0.42), 0, style.belt[0] * h - 0.16))
    tub = _tub(
        n, cowl + 0.15, (foot - 0.12) if style.rear_windows else header + 0.75, floor - 0.1, style.belt[0] * h - 0.03
    )
    return _merged(parts, {"interior": join(*seats, dash, tub)})


def _tub(n, first, last, low, high):
    """Floor, doors' insides and both bulkheads below the panes."""
    x, size = 0.5 * (n.x(first) + n.x(last)), last - first
    half = 0.5 * n.width - 0.13
    floor = box(size_m=(size, 2 * (0.5 * n.width - n.tyre[1] - 0.14), 0.03), centre_m=(x, 0, low))
    top = min(n.tyre[0] * 0.5 + n.arch + 0.03, high - 0.06)
    door = box(size_m=(size - 0.06, 0.02, high - top), centre_m=(x, half, 0.5 * (high + top))).both_sides()
    ends = [
        box(size_m=(0.02, 1.9 * half, high - low - 0.02), centre_m=(n.x(s), 0, 0.5 * (high + low)))
        for s in (first, last)
    ]
    return join(floor, door, *ends)


def _clad(shape, *, cabin):
    """Parts of a skin by the panes, screens, lamps and faces of its shape; the cabin is lined."""
    length = shape.length_m

    def within(s, spans):
        return any(first < s < last for first, last in spans)

    def tag(row, s, where, column=0):
        if row <= shells.SILL:
            return "trim"
        if where != "side":
            if where in shape.faces and row in (*SCREEN_ROWS[where],) and column >= 1:
                return "glass"
            if row in shape.lamps and column == 0:
                return "headlamp" if where == "front" else "taillamp"
            inner = where == "front" and column >= 1 and row in (6, 7)
            return "trim" if row == 5 or inner else "paint"
        if row in shape.lamps and s < 0.5 * shape.round_m:
            return "headlamp"
        if row in shape.lamps and s > length - 0.5 * shape.round_m:
            return "taillamp"
        if row == shells.PANE and within(s, shape.windows):
            return "glass"
        if row in shells.ROOF and within(s, shape.screens):
            return "glass"
        return "paint"

    def inside(row, s, where, column=0):
        lined = where == "side" and row >= shells.BELT and cabin[0] < s < cabin[1]
        return "interior" if lined and tag(row, s, where) == "paint" else "none"

    parts = shells.skin(shape, tag)
    lined = shells.skin(shape, inside)
    return parts | ({"interior": shells.lining(lined["interior"], inwards_m=0.035)} if "interior" in lined else {})


SCREEN_ROWS = {"front": (8, 9, 10), "rear": (10,)}


def _wheels(n, axles, *, twin=False, gap_m=0.04):
    """Wheels of these axles, single or twin, so far within the sides of the body."""
    width = n.tyre[1] * (2 if twin else 1)
    track = 0.5 * (n.width - width) - gap_m
    return wheels(axles_x_m=[n.x(s) for s in axles], half_track_m=track, diameter_m=n.tyre[0], width_m=width)


def _fittings(n, *, mirror_s, belt_m, mirror_m=(0.13, 0.20, 0.14)):
    """Mirrors and plates."""
    low = 0.36 * belt_m + 0.08
    return {
        "mirrors": mirrors(x_m=n.x(mirror_s), y_m=0.5 * n.width - 0.03, z_m=belt_m + 0.12, size_m=mirror_m),
        "plate": join(plate(x_m=0.5 * n.length - 0.010, z_m=low), plate(x_m=-0.5 * n.length + 0.010, z_m=low + 0.15)),
    }


def _bus(n):
    """A bus or a coach: one box with a face of glass, windows all along and rows of seats."""
    length, h, coach = n.length, n.height, n.family == "coach"
    belt = max(0.35 * h if not coach else 0.47 * h, n.tyre[0] * 0.5 + n.arch + 0.08)
    panes = np.linspace(0.45, length - 0.5, round(length / 1.5) + 1)
    shape = Shape(
        length_m=length,
        width_m=n.width,
        floor_m=0.30,
        axles_m=n.axles,
        axle_m=0.5 * n.tyre[0],
        arch_m=n.arch,
        well_m=0.5 * n.width - 2 * n.tyre[1] - 0.12,
        top=((0.0, 0.955 * h), (0.10, 0.985 * h), (0.5, h), (length - 0.4, h), (length, 0.97 * h)),
        belt=((0.0, belt - 0.12), (0.5, belt), (length - 0.3, belt), (length, belt + 0.35)),
        tumble=0.03,
        round_m=0.45,
        narrow=0.16,
        bulge=0.12 if not coach else 0.3,
        crown_m=0.09,
        faces=("front", "rear"),
        lamps=(6,),
        windows=tuple((a + 0.04, b - 0.04) for a, b in pairwise(panes)),
    )
    parts = _merged(
        _clad(shape, cabin=(0.1, length - 0.1)),
        _wheels(n, n.axles, gap_m=0.035),
        _fittings(n, mirror_s=0.15, belt_m=0.62 * h, mirror_m=(0.14, 0.22, 0.36)),
    )
    floor = 0.42 if not coach else 1.15
    rows = [s for s in np.arange(1.3, length - 1.2, 0.85) if coach or min(abs(s - a) for a in n.axles) > 0.2]
    seats = [seat(x_m=n.x(s), y_m=y * n.width, z_m=floor + 0.42, width_m=0.8) for s in rows for y in (-0.28, 0.28)]
    deck = box(size_m=(length - 0.5, 0.74 * n.width, 0.05), centre_m=(0, 0, floor))
    dash = box(size_m=(0.35, 0.8 * n.width, 0.3), centre_m=(n.x(0.65), 0, belt - 0.2))
    return _merged(parts, {"interior": join(*seats, deck, dash)})


# ---- lorries and trailers: cab, frame and what they carry ----


def _at(parts, x):
    """The parts, moved along x."""
    return {name: mesh.moved(position_m=(x, 0.0, 0.0)) for name, mesh in parts.items()}


def _cab(n, *, length, height):
    """The cab of a lorry over its front axle, and its seats."""
    width, low = 0.985 * n.width, 0.62 * n.tyre[0]
    floor = 0.34 + 0.08 * (n.tyre[0] > 0.9)
    belt = max(0.50 * height, 0.5 * n.tyre[0] + n.arch + 0.10)
    shape = Shape(
        length_m=length,
        width_m=width,
        floor_m=floor,
        axles_m=n.axles[:1],
        axle_m=0.5 * n.tyre[0],
        arch_m=n.arch,
        well_m=0.5 * n.width - n.tyre[1] - 0.14,
        top=(
            (0.0, 0.86 * height),
            (0.12, 0.90 * height),
            (0.45, 0.97 * height),
            (0.9, height),
            (length, 0.99 * height),
        ),
        belt=((0.0, belt - 0.05), (0.4, belt), (length, belt)),
        tumble=0.05,
        round_m=min(0.4, n.axles[0] - n.arch - 0.03),
        narrow=0.13,
        bulge=0.18,
        crown_m=0.06,
        faces=("front",),
        lamps=(6,),
        windows=((0.32, min(1.35, length - 0.35)),),
    )
    parts = _clad(shape, cabin=(0.1, length - 0.1))
    seats = [seat(x_m=0.5 * length - 1.05, y_m=y * width, z_m=belt - 0.12, width_m=0.55) for y in (-0.27, 0.27)]
    dash = box(size_m=(0.35, 0.8 * width, 0.25), centre_m=(0.5 * length - 0.45, 0, belt - 0.22))
    deck = box(size_m=(length - 0.3, 2 * shape.well_m - 0.1, 0.05), centre_m=(0, 0, max(low, belt - 0.55)))
    glasses = mirrors(x_m=0.5 * length - 0.28, y_m=0.5 * width - 0.03, z_m=belt + 0.42, size_m=(0.14, 0.22, 0.55))
    front = {"plate": plate(x_m=0.5 * length - 0.010, z_m=floor + 0.15), "mirrors": glasses}
    return _at(_merged(parts, front, {"interior": join(*seats, dash, deck)}), n.x(0.5 * length))


def _frame(n, first, last, *, axles, twin):
    """Beams from s = `first` to `last`, wheels of these axles, mudguards."""
    high = n.tyre[0] + 0.02
    beams = box(size_m=(last - first, 0.10, 0.24), centre_m=(n.x(0.5 * (first + last)), 0.40, high - 0.13)).both_sides()
    cross = [box(size_m=(0.12, 0.9, 0.14), centre_m=(n.x(s), 0.0, 0.5 * n.tyre[0])) for s in axles]
    guard, place = (n.tyre[0] + 0.06, n.tyre[1] + 0.1, 0.02), (0.5 * n.width - n.tyre[1] - 0.04, n.tyre[0] + 0.05)
    guards = [box(size_m=guard, centre_m=(n.x(s), *place)).both_sides() for s in axles]
    return {"trim": join(beams, *cross, *guards)} | _wheels(n, axles, twin=twin)


def _rear(n):
    """Underrun bar, lamps and plate at the rear end."""
    x = -0.5 * n.length
    bar = box(size_m=(0.10, 0.9 * n.width, 0.12), centre_m=(x + 0.09, 0, 0.52))
    posts = box(size_m=(0.10, 0.08, 0.40), centre_m=(x + 0.12, 0.38, 0.74)).both_sides()
    lamps = box(size_m=(0.05, 0.40, 0.13), centre_m=(x + 0.035, 0.36 * n.width, 0.82)).both_sides()
    return {"trim": join(bar, posts), "taillamp": lamps, "plate": plate(x_m=x + 0.014, z_m=0.72)}


def _side_guards(n, first, last):
    """Rails between two axles, on both sides."""
    rails = [
        box(size_m=(last - first, 0.03, 0.14), centre_m=(n.x(0.5 * (first + last)), 0.5 * n.width - 0.06, z))
        for z in (0.55, 0.85)
    ]
    posts = [
        box(size_m=(0.05, 0.04, 0.60), centre_m=(n.x(s), 0.5 * n.width - 0.09, 0.76))
        for s in np.linspace(first + 0.2, last - 0.2, 3)
    ]
    return join(*rails, *posts).both_sides()


def _load(n, first, last, *, low):
    """A box, with doors' bars behind; from s = `first` to `last`."""
    size = (last - first, n.width, n.height - low)
    middle = n.x(0.5 * (first + last)), 0.0, 0.5 * (n.height + low)
    bars = [
        box(size_m=(0.04, 0.04, 0.9 * size[2]), centre_m=(n.x(last) + 0.005, y * n.width, middle[2]))
        for y in (-0.2, 0.2)
    ]
    return {"paint": rounded_box(size_m=size, centre_m=middle, radius_m=0.03, corner=1), "trim": join(*bars)}


def _tank(n, first, last, *, low):
    """An oval tank from s = `first` to `last`, with its walkway."""
    radius = 0.5 * (n.height - 0.12 - low)
    s = np.array([first, first + 0.1, first + 0.35, last - 0.35, last - 0.1, last])
    way = np.column_stack([n.x(s), np.zeros(6), np.full(6, low + radius)])
    share = np.array([0.45, 0.8, 1.0, 1.0, 0.8, 0.45])
    barrel = tube(way, radius * share, segments=20)
    wide = Mesh(barrel.points_m * (1.0, 0.5 * n.width / radius, 1.0), barrel.faces)
    walk = box(size_m=(0.7 * (last - first), 0.5, 0.12), centre_m=(n.x(0.5 * (first + last)), 0, n.height - 0.07))
    return {"paint": wide, "trim": walk}


def _lorry(n):
    """A lorry with a box."""
    cab = 1.75 if n.tyre[0] < 0.9 else 2.25
    parts = _cab(n, length=cab, height=0.95 * n.height if n.height < 3.0 else 0.90 * n.height)
    body = _load(n, cab + 0.18, n.length, low=n.tyre[0] + 0.14)
    drive = n.axles[1:]
    first, last = n.axles[0] + n.arch + 0.45, drive[0] - n.arch - 0.15
    guards = {"trim": _side_guards(n, first, last)}
    frame = _frame(n, 0.35, n.length - 0.1, axles=drive, twin=True)
    return _merged(parts, _wheels(n, n.axles[:1]), body, frame, _rear(n), guards)


def _tractor(n, *, end=None):
    """The tractor of a semitrailer: cab, wind deflector, frame, tank, coupling."""
    cab, end = 2.25, end or n.length
    parts = _cab(n, length=cab, height=0.94 * n.height if end < n.length else n.height)
    frame = _frame(n, 0.35, end - 0.1, axles=n.axles[1:2], twin=True)
    z, at = n.tyre[0] + 0.02, n.axles[1] - 0.5
    coupling = lathe([(0.45, z), (0.45, z + 0.08), (0.05, z + 0.08), (0.05, z), (0.45, z)], segments=14)
    tanks = rounded_box(
        size_m=(0.9, 0.55, 0.6), centre_m=(n.x(cab + 0.7), 0.5 * n.width - 0.36, 0.75), radius_m=0.08, corner=1
    )
    more = {"trim": join(coupling.moved(position_m=(n.x(at + 0.5), 0, 0)), tanks.both_sides())}
    lamps = {} if end < n.length else _rear(n)
    return _merged(parts, _wheels(n, n.axles[:1]), frame, more, lamps)


def _semitrailer(n, *, first, axles, tank):
    """Body, axles, landing legs and rear of a semitrailer whose front is at s = `first`."""
    body = (_tank if tank else _load)(n, first, n.length, low=n.tyre[0] + 0.22)
    # Over the tractor there is no room for beams below the body.
    beams = first + 2.9
    frame = _frame(n, beams, n.length - 0.1, axles=axles, twin=False)
    legs = box(size_m=(0.14, 0.14, n.tyre[0]), centre_m=(n.x(beams + 0.35), 0.75, 0.5 * n.tyre[0] + 0.25)).both_sides()
    guards = _side_guards(n, beams + 0.8, axles[0] - n.arch - 0.1)
    return _merged(body, frame, _rear(n), {"trim": join(legs, guards)})


def _articulated(n):
    """A tractor with its semitrailer: a box, or a tank if the vehicle is shorter than the rules allow."""
    tractor = _tractor(n, end=5.95)
    return _merged(tractor, _semitrailer(n, first=2.85, axles=n.axles[2:], tank=n.length < 16.0))


def _trailer(n):
    """A semitrailer that stands by itself, or a small box trailer for cars."""
    if len(n.axles) > 1:
        return _semitrailer(n, first=0.0, axles=n.axles, tank=False)
    low = n.tyre[0] + 0.05
    bar = tube([(n.x(0.03), 0, 0.45), (n.x(1.0), 0, 0.48)], 0.05, segments=8)
    jockey = box(size_m=(0.08, 0.08, 0.45), centre_m=(n.x(0.25), 0.12, 0.225))
    body = _load(n, 1.0, n.length - 0.01, low=low)
    return _merged(
        body, _frame(n, 1.0, n.length - 0.1, axles=n.axles, twin=False), _rear(n), {"trim": join(bar, jockey)}
    )


# ---- two wheels ----


def _crankset(n):
    """(axle, (left, right) pedals, where a rider sits) of a bicycle."""
    rear_m, base_m = n.x(n.axles[1]), n.axles[1] - n.axles[0]
    x, z = rear_m + 0.43 * base_m, 0.41 * n.tyre[0]
    pedals = [(x + side * 0.16, side * 0.14, z + side * 0.05) for side in (1, -1)]
    return (x, 0.0, z), pedals, (rear_m + 0.30 * base_m - 0.02, 0.0, 0.53 * n.height + 0.03)


def _bicycle(n):
    """A bicycle, and its rider if its class is one."""
    ridden = n.class_name == "cyclist"
    radius, x_front, x_rear = 0.5 * n.tyre[0], n.x(n.axles[0]), n.x(n.axles[1])
    top = (0.61 if ridden else 1.0) * n.height
    saddle = (x_rear + 0.30 * (x_front - x_rear), 0.0, 0.92 * top if not ridden else 0.53 * n.height)
    crank, pedals_m, seat_m = _crankset(n)
    head = (x_front - 0.42 * radius, 0.0, top - 0.16)
    hub_front, hub_rear = (x_front, 0.0, radius), (x_rear, 0.0, radius)
    grip_x = head[0] - 0.10
    bars = [
        tube([crank, saddle], 0.016, segments=6),
        tube([crank, head], 0.020, segments=6),
        tube([(saddle[0] + 0.02, 0, saddle[2] - 0.14), (head[0], 0, head[2] + 0.02)], 0.016, segments=6),
        *(
            tube([(a[0], 0.05, a[2]), (b[0], 0.015, b[2])], 0.010, segments=5).both_sides()
            for a, b in ((hub_rear, saddle), (hub_rear, crank))
        ),
        tube(
            [(hub_front[0], 0.05, hub_front[2]), (head[0] + 0.01, 0.04, head[2] - 0.12)], 0.013, segments=5
        ).both_sides(),
        tube([(head[0] + 0.01, 0, head[2] - 0.14), (head[0] - 0.03, 0, top - 0.02)], 0.018, segments=6),
    ]
    bar = [
        (head[0] - 0.02, 0.0, top - 0.03),
        (head[0] + 0.01, 0.18, top - 0.014),
        (grip_x, 0.5 * n.width - 0.012, top - 0.016),
    ]
    grips = tube(bar, 0.014, segments=6).both_sides()
    saddle_top = rounded_box(size_m=(0.26, 0.15, 0.06), centre_m=saddle, radius_m=0.025, corner=1)
    pedals = [box(size_m=(0.10, 0.09, 0.025), centre_m=pedal) for pedal in pedals_m]
    cranks = [
        tube([(crank[0], side * 0.06, crank[2]), (x, side * 0.09, z)], 0.012, segments=5)
        for side, (x, _, z) in zip((1, -1), pedals_m, strict=True)
    ]
    chain = box(size_m=(0.17, 0.02, 0.17), centre_m=(crank[0], -0.045, crank[2]))
    section = 0.5 * n.tyre[1]
    tyres = [ring(section, radius - section).moved(position_m=hub) for hub in (hub_front, hub_rear)]
    rims = [ring(0.011, radius - 2 * section - 0.006).moved(position_m=hub) for hub in (hub_front, hub_rear)]
    turns, reach = 2 * np.pi * np.arange(12) / 12, radius - 0.05
    spokes = [
        tube(
            [
                (x + 0.012 * np.cos(a), 0.02 * (-1) ** i, radius + 0.012 * np.sin(a)),
                (x + reach * np.cos(a), 0.0, radius + reach * np.sin(a)),
            ],
            0.0022,
            segments=3,
        )
        for x in (x_front, x_rear)
        for i, a in enumerate(turns)
    ]
    hubs = [tube([(hub[0], -0.05, hub[2]), (hub[0], 0.05, hub[2])], 0.02, segments=6) for hub in (hub_front, hub_rear)]
    parts = {
        "paint": join(*bars),
        "tyre": join(*tyres),
        "rim": join(*rims, *spokes, *hubs),
        "trim": join(saddle_top, grips, chain),
        "cranks/trim": join(*pedals, *cranks),
        "headlamp": ellipsoid(radii_m=(0.03, 0.03, 0.03), segments=8, rows=5).moved(
            position_m=(head[0] + 0.08, 0, head[2] - 0.02)
        ),
        "taillamp": box(size_m=(0.03, 0.06, 0.05), centre_m=(x_rear - 0.5 * radius, 0, 2 * radius - 0.10)),
    }
    if not ridden:
        return _merged(parts)
    return _merged(
        parts,
        rider(
            seat_m=seat_m[::2],
            hands_m=(grip_x, 0.5 * n.width - 0.06, top),
            feet_m=[np.add(pedal, (0.0, 0.0, SOLE_M)) for pedal in pedals_m],
            height_m=n.height,
            lean_m=0.24 * n.height / 1.75,
            bent=KNEE_BENT,
        ),
    )


def _motorcycle(n):
    """A motorcycle or, with small wheels, a scooter; its rider if its class is one."""
    ridden, scooter = n.class_name == "motorcyclist", n.tyre[0] < 0.55
    radius, x_front, x_rear = 0.5 * n.tyre[0], n.x(n.axles[0]), n.x(n.axles[1])
    middle = 0.5 * (x_front + x_rear)
    top = min(n.height, 1.02 if not scooter else 1.08) if ridden else n.height
    seat_z = 0.76 if ridden and n.height > 1.5 else 0.62 if ridden else 0.72 * min(n.height, 1.1)
    head = (x_front - 0.62 * radius - 0.10, 0.0, top - 0.16)
    tyres, rims = [], []
    for x, width in ((x_front, 0.8 * n.tyre[1]), (x_rear, n.tyre[1])):
        tyre, rim = wheel(diameter_m=n.tyre[0], width_m=width, segments=20, rim_share=0.70)
        tyres.append(tyre.moved(position_m=(x, 0, 0)))
        rims.append(rim.moved(position_m=(x, 0, 0)))
    fork = tube([(x_front, 0.5 * n.tyre[1] + 0.05, radius), (head[0], 0.09, head[2])], 0.026, segments=6).both_sides()
    arm = tube([(x_rear, 0.5 * n.tyre[1] + 0.04, radius), (middle - 0.08, 0.10, 0.38)], 0.030, segments=6).both_sides()
    bar = tube(
        [
            (head[0], 0, head[2] + 0.06),
            (head[0] - 0.04, 0.16, top - 0.06),
            (head[0] - 0.16, 0.5 * n.width - 0.013, top - 0.05),
        ],
        0.015,
        segments=6,
    ).both_sides()
    stem = tube([(head[0], 0, head[2] - 0.08), (head[0], 0, top - 0.02)], 0.03, segments=6)
    end = tube([(middle - 0.15, -0.16, 0.30), (x_rear - 0.15, -0.20, 0.38)], 0.045, segments=8)
    saddle = rounded_box(size_m=(0.62, 0.26, 0.10), centre_m=(middle - 0.30, 0, seat_z), radius_m=0.04, corner=2)
    tail_x = -0.5 * n.length
    rear_guard = tube(
        [
            (middle - 0.45, 0, seat_z - 0.04),
            (x_rear, 0, max(2 * radius + 0.05, seat_z - 0.08)),
            (tail_x + 0.012, 0, 2 * radius - 0.02),
        ],
        0.05,
        segments=8,
        flatten=1.6,
    )
    front_guard = tube(
        [
            (x_front + 0.75 * radius, 0, 1.75 * radius),
            (x_front, 0, 2 * radius + 0.04),
            (x_front - 0.8 * radius, 0, 1.75 * radius),
        ],
        0.035,
        segments=8,
        flatten=1.8,
    )
    if scooter:
        shield = rounded_box(size_m=(0.10, 0.42, 0.62), centre_m=(head[0] - 0.02, 0, 0.60), radius_m=0.04, corner=2)
        deck = box(size_m=(0.46, 0.34, 0.10), centre_m=(middle + 0.10, 0, 0.27))
        hull = ellipsoid(radii_m=(0.46, 0.21, 0.24), segments=14, rows=8, power=2.6).moved(
            position_m=(middle - 0.36, 0, seat_z - 0.26)
        )
        paint, dark = [shield, hull], [deck]
    else:
        tank = ellipsoid(radii_m=(0.30, 0.17, 0.15), segments=14, rows=8, power=2.4).moved(
            position_m=(middle + 0.16, 0, seat_z + 0.08)
        )
        hull = ellipsoid(radii_m=(0.26, 0.14, 0.10), segments=12, rows=7).moved(
            position_m=(middle - 0.52, 0, seat_z - 0.06)
        )
        nose = ellipsoid(radii_m=(0.14, 0.15, 0.17), segments=12, rows=8).moved(
            position_m=(head[0] + 0.09, 0, top - 0.17)
        )
        engine = rounded_box(size_m=(0.46, 0.34, 0.36), centre_m=(middle + 0.02, 0, 0.42), radius_m=0.06, corner=2)
        paint, dark = [tank, hull, nose], [engine]
    parts = {
        "paint": join(*paint, front_guard),
        "tyre": join(*tyres),
        "rim": join(*rims),
        "trim": join(fork, arm, bar, stem, end, saddle, rear_guard, *dark),
        "headlamp": ellipsoid(radii_m=(0.06, 0.08, 0.08), segments=10, rows=6).moved(
            position_m=(head[0] + (0.10 if scooter else 0.20), 0, top - 0.20)
        ),
        "taillamp": box(size_m=(0.06, 0.16, 0.06), centre_m=(tail_x + 0.10, 0, 2 * radius + 0.06)),
        "plate": box(size_m=(0.02, 0.18, 0.20), centre_m=(tail_x + 0.012, 0, 2 * radius - 0.12)),
    }
    if not ridden:
        return _merged(parts)
    foot_x = middle - 0.02 if not scooter else middle + 0.16
    feet = [(foot_x, side * 0.20, 0.33) for side in (1, -1)]
    return _merged(
        parts,
        rider(
            seat_m=(middle - 0.28, seat_z + 0.06),
            hands_m=(head[0] - 0.14, 0.5 * n.width - 0.07, top - 0.04),
            feet_m=feet,
            height_m=n.height,
            lean_m=0.16 if scooter else 0.26,
        ),
    )


FAMILIES: dict[str, Callable[[Dimensions], dict[str, Mesh]]] = {
    **dict.fromkeys(STYLES, _car),
    **dict.fromkeys(("bus", "coach"), _bus),
    "lorry": _lorry,
    "articulated": _articulated,
    "tractor": _tractor,
    "trailer": _trailer,
    "bicycle": _bicycle,
    "motorcycle": _motorcycle,
}
"""Family -> function that makes its bodies."""
