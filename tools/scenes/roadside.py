"""What stands along a road: kerb, signs, lamp post, bollard, fence, bins, boxes, posts, and what closes a lane."""

import numpy as np
from modelling import box, cap, circle, closed_loft, join, lathe, rounded_box, tube

COLOURS = {
    "pole": (0.60, 0.61, 0.62, 1.0),
    "sign_face": (0.85, 0.12, 0.10, 1.0),
    "sign_back": (0.45, 0.46, 0.47, 1.0),
    "head": (0.30, 0.31, 0.32, 1.0),
    "lens": (0.90, 0.90, 0.85, 1.0),
    "bollard": (0.10, 0.10, 0.11, 1.0),
    "band": (0.90, 0.90, 0.90, 1.0),
    "fence": (0.55, 0.42, 0.28, 1.0),
    "bin": (0.10, 0.16, 0.10, 1.0),
    "wheel": (0.05, 0.05, 0.05, 1.0),
    "cone": (0.90, 0.30, 0.05, 1.0),
    "board": (0.90, 0.30, 0.20, 1.0),
    "foot": (0.12, 0.12, 0.12, 1.0),
    "cabinet": (0.60, 0.62, 0.58, 1.0),
    "rail": (0.62, 0.63, 0.64, 1.0),
    "wood": (0.40, 0.30, 0.22, 1.0),
    "box": (0.10, 0.18, 0.45, 1.0),
    "brick": (0.55, 0.27, 0.20, 1.0),
    "stone": (0.62, 0.61, 0.58, 1.0),
}
SIGNS = {
    "sign": (0.300, 48, 0.0),
    "sign_triangle": (0.9 / np.sqrt(3.0), 3, 0.0),
    "sign_yield": (0.9 / np.sqrt(3.0), 3, np.pi),
    "sign_stop": (0.45 / np.cos(np.pi / 8), 8, np.pi / 8),
    "sign_square": (0.30 * np.sqrt(2.0), 4, np.pi / 4),
    "sign_diamond": (0.30 * np.sqrt(2.0), 4, 0.0),
}
"""Name -> radius of the corners, their number, and the turn of the first from the top. Sizes are those of the German
rules (VwV-StVO to sections 39 to 43, size 2): 600 mm round and square, 900 mm triangles and the stop sign's octagon."""
KERB_LENGTH_M = 2.0


def kerb():
    """A kerb stone of 2 m along x, 0.15 m wide, 0.12 m high; the rounded edge is at -y, towards the road."""
    turn = 0.5 * np.pi * np.arange(9) / 8
    arc = np.stack([-0.035 - 0.04 * np.sin(turn), 0.08 + 0.04 * np.cos(turn)], axis=1)
    profile = np.vstack([[0.075, 0.0], [0.075, 0.114], [0.069, 0.12], arc, [-0.075, 0.0]])
    along = np.array([-1.0, -0.996, -0.5, 0.0, 0.5, 0.996, 1.0]) * KERB_LENGTH_M / 2
    rings = np.zeros((len(along), len(profile), 3))
    rings[:, :, 0] = along[:, None]
    rings[:, :, 1:] = profile
    rings[[0, -1], :, 1:] = profile * 0.98 + (0, 0.0012)  # a small joint between two stones
    return {"kerb": closed_loft(rings)}


def sign(radius_m=0.300, corners=48, turn=0.0):
    """A sign with so many corners on a pole, facing +x."""
    pole = lathe([(0.002, 0.0), (0.030, 0.0), (0.030, 2.86), (0.024, 2.875), (0.010, 2.88)], segments=16)
    top = cap(np.column_stack([circle(16, radius_m=0.010), np.full(16, 2.88)]))
    clamps = [box(size_m=(0.050, 0.10, 0.035), centre_m=(0.022, 0, z)) for z in (2.38, 2.72)]
    upright = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]  # local z looks along +x
    place = {"position_m": (0.045, 0, 2.55)}
    rim, inner = radius_m - 0.008, radius_m - 0.007
    back = lathe([(rim, 0.0), (radius_m, 0.0), (radius_m, 0.006), (rim, 0.006)], segments=corners)
    plate = cap(np.column_stack([circle(corners, radius_m=radius_m - 0.005), np.full(corners, 0.0005)])).flipped()
    face = cap(np.column_stack([circle(corners, radius_m=inner), np.full(corners, 0.005)]))
    # The first corner of a circle is along +y of the sign's face, a quarter turn from its top.
    turned = {"yaw_rad": turn + np.pi / 2 if corners < 48 else 0.0}
    return {
        "pole": join(pole, top, *clamps),
        "sign_face": face.moved(**turned).turned(upright).moved(**place),
        "sign_back": join(back, plate).moved(**turned).turned(upright).moved(**place),
    }


def lamp_post():
    """A street lamp of 8 m whose arm reaches 1.5 m along +x."""
    shaft = lathe(
        [(0.002, 0), (0.16, 0), (0.16, 0.03), (0.095, 0.05), (0.095, 1.2), (0.075, 1.25), (0.045, 7.2)], segments=20
    )
    bend = np.linspace(0, 0.5 * np.pi, 9)
    arm = np.column_stack([0.7 * (1 - np.cos(bend)), np.zeros(9), 7.19 + 0.7 * np.sin(bend)])
    arm = np.vstack([arm, [1.2, 0, 7.90]])
    head = rounded_box(size_m=(0.70, 0.28, 0.11), centre_m=(1.35, 0, 7.905), radius_m=0.05)
    lens = rounded_box(size_m=(0.45, 0.20, 0.05), centre_m=(1.40, 0, 7.85), radius_m=0.022)
    door = box(size_m=(0.012, 0.09, 0.40), centre_m=(-0.094, 0, 0.75))
    pole = join(shaft, tube(arm, np.linspace(0.045, 0.035, 10), segments=14), door)
    return {"pole": pole, "head": head, "lens": lens}


def bollard():
    """A bollard of 0.9 m with a reflecting band."""
    turn = 0.5 * np.pi * np.arange(7) / 6
    dome = [(0.055 * np.cos(a), 0.84 + 0.055 * np.sin(a)) for a in turn[:-1]]
    body = lathe([(0.002, 0.0), (0.075, 0.0), (0.075, 0.05), (0.055, 0.08), *dome, (0.004, 0.8952)], segments=24)
    tip = cap(np.column_stack([circle(24, radius_m=0.004), np.full(24, 0.8952)]))
    band = lathe([(0.055, 0.678), (0.057, 0.68), (0.057, 0.76), (0.055, 0.762)], segments=24)
    return {"bollard": join(body, tip), "band": band}


def fence():
    """A garden fence of 2 m along y: two posts, two rails, pickets."""
    posts = [box(size_m=(0.09, 0.09, 1.10), centre_m=(0, y, 0.55)) for y in (-0.955, 0.955)]
    rails = [box(size_m=(0.04, 1.82, 0.07), centre_m=(0.001, 0, z)) for z in (0.32, 0.82)]
    pickets = [box(size_m=(0.02, 0.07, 0.92), centre_m=(0.034, y, 0.56)) for y in np.linspace(-0.84, 0.84, 15)]
    return {"fence": join(*posts, *rails, *pickets)}


def dustbin():
    """A wheeled bin of 240 l, 0.58 by 0.74 by 1.07 m (EN 840-1), its front towards +x."""
    rings = [(0.44, 0.52, 0.06), (0.46, 0.53, 0.10), (0.64, 0.57, 0.98)]
    body = closed_loft([[(x * dx, y * dy, z) for dx, dy in _CORNERS] for x, y, z in rings])
    lid = rounded_box(size_m=(0.74, 0.58, 0.09), centre_m=(0.0, 0, 1.025), radius_m=0.03, corner=1)
    handle = tube([(-0.39, -0.22, 0.99), (-0.39, 0.22, 0.99)], 0.016, segments=6)
    axle = lathe([(0.002, -0.04), (0.10, -0.04), (0.10, 0.04), (0.002, 0.04), (0.002, -0.04)], segments=12)
    rolled = axle.turned([[1, 0, 0], [0, 0, -1], [0, 1, 0]]).moved(position_m=(-0.24, 0.23, 0.10))
    return {"bin": join(body, lid, handle), "wheel": rolled.both_sides()}


_CORNERS = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]


def container():
    """A container of 1,100 l on four castors, 1.37 by 1.07 by 1.45 m (EN 840-2)."""
    body = closed_loft(
        [[(x * dx, y * dy, z) for dx, dy in _CORNERS] for x, y, z in ((0.80, 1.16, 0.16), (0.98, 1.34, 1.18))]
    )
    lid = rounded_box(size_m=(1.07, 1.37, 0.22), centre_m=(0, 0, 1.30), radius_m=0.10, corner=2)
    wheels = [box(size_m=(0.16, 0.05, 0.19), centre_m=(x, y, 0.095)) for x in (-0.32, 0.32) for y in (-0.48, 0.48)]
    return {"bin": join(body, lid), "wheel": join(*wheels)}


def cone():
    """A traffic cone of 0.75 m with two bands."""
    body = lathe([(0.002, 0.0), (0.155, 0.0), (0.155, 0.03), (0.115, 0.04), (0.028, 0.75), (0.002, 0.75)], segments=20)

    def band(low, high):
        at = [(0.115 - 0.1226 * (z - 0.04), z) for z in (low, high)]
        return lathe([at[0], (at[0][0] + 0.002, low), (at[1][0] + 0.002, high), at[1]], segments=20)

    return {"cone": body, "band": join(band(0.30, 0.42), band(0.52, 0.62))}


def barrier():
    """A board of 2 m by 0.25 m across a closed lane, on two feet, facing +x and -x."""
    posts = [box(size_m=(0.05, 0.05, 1.15), centre_m=(0, y, 0.60)) for y in (-0.8, 0.8)]
    feet = [box(size_m=(0.80, 0.40, 0.11), centre_m=(0, y, 0.055)) for y in (-0.8, 0.8)]
    board = box(size_m=(0.03, 2.0, 0.25), centre_m=(0.041, 0, 1.02))
    return {"pole": join(*posts), "foot": join(*feet), "board": board}


def cabinet():
    """A street cabinet of 1.0 by 0.35 by 1.2 m with its foot."""
    body = rounded_box(size_m=(0.35, 1.0, 1.10), centre_m=(0, 0, 0.66), radius_m=0.02, corner=1)
    return {"cabinet": join(body, box(size_m=(0.30, 0.94, 0.20), centre_m=(0, 0, 0.10)))}


def parking_meter():
    """A parking meter of 1.45 m, its display towards +x."""
    post = lathe([(0.002, 0.0), (0.090, 0.0), (0.090, 0.02), (0.032, 0.03), (0.032, 1.10), (0.002, 1.11)], segments=14)
    head = rounded_box(size_m=(0.15, 0.20, 0.37), centre_m=(0, 0, 1.265), radius_m=0.05, corner=2)
    return {"pole": post, "head": head}


def letter_box():
    """A letter box of 0.53 by 0.51 by 1.27 m on four feet with a round top, like those of the United States."""
    turn = np.pi * np.arange(13) / 12
    arch = np.column_stack([0.255 * np.cos(turn), 1.015 + 0.255 * np.sin(turn)])
    outline = np.vstack([[0.255, 0.15], arch, [-0.255, 0.15]])
    rings = [np.column_stack([np.full(len(outline), x), outline]) for x in (-0.265, 0.265)]
    feet = [box(size_m=(0.05, 0.05, 0.15), centre_m=(x, y, 0.075)) for x in (-0.22, 0.22) for y in (-0.21, 0.21)]
    return {"box": join(closed_loft(np.stack(rings)), *feet)}


def gatepost():
    """A pillar of brick by a gate, 0.36 m wide, with a slab and a low pyramid on top, 1.46 m in all."""
    pillar = box(size_m=(0.36, 0.36, 1.30), centre_m=(0, 0, 0.65))
    square = np.array(_CORNERS)
    top = [np.column_stack([side * square, np.full(4, z)]) for side, z in ((0.46, 1.30), (0.46, 1.36), (0.06, 1.46))]
    return {"brick": pillar, "stone": closed_loft(np.stack(top))}


def power_pole():
    """A wooden pole of 8.5 m with a cross arm and insulators."""
    pole = lathe([(0.002, 0), (0.13, 0), (0.09, 8.5), (0.002, 8.52)], segments=14)
    arm = box(size_m=(0.10, 1.8, 0.10), centre_m=(0.11, 0, 8.1))
    pins = [
        lathe([(0.002, 8.14), (0.035, 8.14), (0.025, 8.30), (0.002, 8.32)], segments=8).moved(position_m=(0.11, y, 0))
        for y in (-0.8, 0, 0.8)
    ]
    return {"wood": join(pole, arm), "foot": join(*pins)}


def traffic_light():
    """A traffic light of 3.3 m that faces +x: three lamps of 200 mm (EN 12368) below visors, from 2.2 m up."""
    pole = lathe([(0.002, 0), (0.052, 0), (0.052, 3.26), (0.002, 3.27)], segments=16)
    arms = [box(size_m=(0.07, 0.04, 0.04), centre_m=(0.08, 0, z)) for z in (2.35, 3.05)]
    housing = rounded_box(size_m=(0.16, 0.30, 0.96), centre_m=(0.19, 0, 2.70), radius_m=0.03, corner=2)
    turn = np.linspace(0.0, np.pi, 9)
    ring = np.column_stack([np.cos(turn), np.sin(turn)])
    arch = np.vstack([0.125 * ring, 0.119 * ring[::-1]])
    visors, lenses = [], []
    for z in (2.40, 2.70, 3.00):
        rings = [np.column_stack([np.full(len(arch), x), arch[:, 0], z + arch[:, 1]]) for x in (0.268, 0.45)]
        visors.append(closed_loft(np.stack(rings)))
        dome = lathe([(0.100, 0.0), (0.085, 0.010), (0.050, 0.018), (0.002, 0.020)], segments=20)
        lenses.append(dome.turned([[0, 1, 0], [0, 0, 1], [1, 0, 0]]).moved(position_m=(0.271, 0, z)))
    return {"pole": join(pole, *arms), "head": join(housing, *visors), "lens": join(*lenses)}


def guard_rail():
    """Four metres of a guard rail along y, its beam of two waves towards +x, 0.75 m high, on posts 2 m apart."""
    wave = np.array([0.0, 0.081, 0.081, 0.0, 0.0, 0.081, 0.081, 0.0])
    height = np.array([0.440, 0.482, 0.530, 0.572, 0.618, 0.660, 0.708, 0.750])
    outline = np.vstack([np.column_stack([wave, height]), np.column_stack([wave - 0.004, height])[::-1]])
    rings = [np.column_stack([outline[:, 0], np.full(len(outline), y), outline[:, 1]]) for y in (1.995, -1.995)]
    posts = [box(size_m=(0.055, 0.10, 0.70), centre_m=(-0.035, y, 0.35)) for y in (-1.0, 1.0)]
    return {"rail": join(closed_loft(np.stack(rings)), *posts)}


FURNITURE = (
    bollard,
    fence,
    dustbin,
    container,
    cone,
    barrier,
    cabinet,
    parking_meter,
    letter_box,
    gatepost,
    power_pole,
    traffic_light,
    guard_rail,
)
"""Functions that make what stands along a road, under the names of its meshes."""
