"""Plants: a broad-leaved tree, a conifer, a poplar, a birch, two bushes and a hedge, of wood and leaves."""

import numpy as np
from modelling import Mesh, join, tube

COLOURS = {"bark": (0.28, 0.20, 0.14, 1.0), "foliage": (0.16, 0.34, 0.10, 1.0)}
BRANCHES, TWIGS, LEAVES = 15, 5, 62


def dice(*shape, seed):
    """Uniform numbers in [0, 1), the same for ever: splitmix64 of the counter, free of numpy's generators."""
    index = np.arange(np.prod(shape), dtype=np.uint64) + np.uint64(seed * 1_000_003)
    index = index * np.uint64(0x9E3779B97F4A7C15)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        index = (index ^ (index >> np.uint64(shift))) * np.uint64(factor)
    return ((index ^ (index >> np.uint64(31))) >> np.uint64(11)).reshape(shape) * 2.0**-53


def build():
    """Part name -> Mesh."""
    trunk = _wander([0, 0, 0], [0.10, -0.06, 4.9], sway_m=0.09, count=12, seed=1)
    height = trunk[:, 2] / trunk[-1, 2]
    wood = [tube(trunk, 0.145 * (1 - 0.78 * height) + 0.07 * np.exp(-trunk[:, 2] / 0.18), segments=14)]
    clumps = []
    for i in range(BRANCHES):
        branch = _branch(i, trunk)
        wood.append(tube(branch, np.linspace(0.055 - 0.0015 * i, 0.012, len(branch)), segments=7))
        for j in range(TWIGS):
            twig = _twig(i, j, branch)
            wood.append(tube(twig, np.linspace(0.014, 0.004, len(twig)), segments=4))
            clumps.append(_clump(twig[-1], seed=1000 + 10 * i + j))
    clumps.append(_clump(trunk[-1] + (0, 0, 0.4), seed=999))
    return {"bark": join(*wood), "foliage": join(*clumps)}


def _wander(start_m, end_m, *, sway_m, count, seed):
    """(count, 3) a way from start to end that sways a little between."""
    t = np.linspace(0, 1, count)[:, None]
    phase = 2 * np.pi * dice(2, 3, seed=seed)
    sway = sway_m * (np.sin(2.2 * np.pi * t + phase[0]) - np.sin(phase[0]) * (1 - t))
    sway = sway - t * sway[-1]
    return np.asarray(start_m, float) * (1 - t) + np.asarray(end_m, float) * t + sway * (1, 1, 0.3)


def _branch(i, trunk):
    """The way of branch i, from the trunk outwards and upwards, by the golden angle."""
    share = 0.36 + 0.60 * i / (BRANCHES - 1)
    at = share * (len(trunk) - 1)
    low = min(int(at), len(trunk) - 2)
    start = trunk[low] + (at - low) * (trunk[low + 1] - trunk[low])
    angle = 2.39996 * i + 0.5 * dice(1, seed=50 + i)[0]
    reach = 1.85 - 0.85 * abs(share - 0.52) / 0.48 + 0.25 * dice(1, seed=80 + i)[0]
    rise = 0.35 + 0.95 * share
    end = start + np.array([reach * np.cos(angle), reach * np.sin(angle), rise])
    return _wander(start, end, sway_m=0.07, count=7, seed=100 + i)


def _twig(i, j, branch):
    start = branch[2 + (j * 4) // (TWIGS - 1)]
    outward = branch[-1] - branch[0]
    outward = outward / np.linalg.norm(outward)
    spread = 2 * dice(3, seed=300 + 10 * i + j) - 1
    end = start + (0.40 * outward + 0.55 * spread + (0, 0, 0.18)) * (0.75 if j < TWIGS - 1 else 0.5)
    return _wander(start, end, sway_m=0.02, count=4, seed=600 + 10 * i + j)


def _clump(centre_m, *, seed):
    """LEAVES leaves in a flat ball about a point."""
    u = dice(LEAVES, 8, seed=seed)
    return _leaves(centre_m + _ball(u[:, :3]) * (0.54, 0.54, 0.42), u[:, 3:], size_m=(0.065, 0.045))


def _ball(u):
    """(n, 3) points of the unit ball for (n, 3) numbers of [0, 1)."""
    polar = np.stack([np.cos(2 * np.pi * u[:, 0]), np.sin(2 * np.pi * u[:, 0])], axis=1)
    height = 2 * u[:, 1:2] - 1
    return np.hstack([polar * np.sqrt(1 - height**2), height]) * np.cbrt(u[:, 2:3])


def _leaves(place, u, *, size_m, halves=2):
    """A leaf at each (n, 3) place: a folded rhombus of two triangles, mostly facing upwards.

    Args:
        u: (n, 5) numbers of [0, 1)
        size_m: least half width of a leaf, and by how much it may be larger
        halves: 1: one triangle in the plane of one half of the rhombus, the one or the other in turn, of the same area
            and length: as many normals and gaps for half of the triangles
    """
    facing = np.hstack([u[:, 0:2] * 2 - 1, 0.35 + u[:, 2:3]])
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    turn = 2 * np.pi * u[:, 3]
    along = np.cross(facing, np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    beside = np.cross(facing, along)
    size = size_m[0] + size_m[1] * u[:, 4:5]
    fold = 0.25 * size * facing
    if halves == 1:
        side = 0.72 * size * beside * (-1.0) ** np.arange(len(place))[:, None] + fold
        tip = 1.25 * size * along
        corners, faces = [place + tip, place - tip + side, place - tip - side], np.arange(3 * len(place))
        return Mesh(np.stack(corners, axis=1).reshape(-1, 3), faces.reshape(-1, 3))
    corners = [place - 1.25 * size * along, place - 0.72 * size * beside + fold]
    corners += [place + 1.25 * size * along, place + 0.72 * size * beside + fold]
    faces = np.arange(4 * len(place)).reshape(-1, 4)[:, [0, 2, 1, 0, 3, 2]].reshape(-1, 3)
    return Mesh(np.stack(corners, axis=1).reshape(-1, 3), faces)


def conifer(*, height_m=10.5, foot_m=1.0, reach_m=2.3, whorls=15, seed=5000):
    """Part name -> Mesh of a spruce: whorls of branches that droop, twigs of needles hanging from them."""
    trunk = np.column_stack([np.zeros(6), np.zeros(6), np.linspace(0, height_m, 6)])
    wood, needles = [tube(trunk, np.linspace(0.16, 0.02, 6), segments=10)], []
    for i, z in enumerate(np.linspace(foot_m, height_m - 0.5, whorls)):
        length = reach_m * (1 - (z - foot_m) / (height_m - foot_m)) ** 0.85 + 0.12
        for j, shift in enumerate(dice(6, seed=seed + i)):
            angle = 2 * np.pi * (j + 0.4 * shift) / 6 + 1.1 * i
            way = np.array([np.cos(angle), np.sin(angle), 0.0])
            end = np.add(way * length * (0.85 + 0.15 * shift), (0, 0, z - 0.22 * length))
            wood.append(
                tube([(0, 0, z), (*(0.5 * end[:2]), 0.5 * (end[2] + z) + 0.05), end], [0.03, 0.02, 0.008], segments=4)
            )
            count = int(6 + 16 * length)
            u = dice(count, 8, seed=seed + 100 + 10 * i + j)
            share = 0.15 + 0.85 * np.sqrt(u[:, :1])
            spread = (2 * u[:, 1:4] - 1) * (0.25, 0.25, 0.16) * (0.4 + share)
            needles.append(_leaves((0, 0, z) + share * (end - (0, 0, z)) + spread, u[:, 3:], size_m=(0.075, 0.05)))
    return {"bark": join(*wood), "foliage": join(*needles)}


def _crown(*, height_m, foot_m, radii_m, leaves, size_m, seed, stem_m=0.11, branches=14):
    """Part name -> Mesh of a tree with a crown of even leaves: half its radii and its height are given."""
    trunk = _wander([0, 0, 0], [0.05, 0.03, height_m - 0.4], sway_m=0.05, count=9, seed=seed)
    wood = [tube(trunk, np.linspace(stem_m, 0.015, 9), segments=10)]
    middle = np.array([0.0, 0.0, 0.5 * (foot_m + height_m)])
    half = np.array([*radii_m, 0.5 * (height_m - foot_m)])
    for i, u in enumerate(dice(branches, 3, seed=seed + 1)):
        z = foot_m + 0.15 + (height_m - foot_m - 1.0) * i / branches
        angle = 2.39996 * i
        width = radii_m[0] * np.sqrt(max(1.0 - ((z + 0.8 - middle[2]) / half[2]) ** 2, 0.05)) * (0.6 + 0.25 * u[0])
        end = [width * np.cos(angle), width * np.sin(angle), min(z + 0.5 + 0.5 * u[1], height_m - 0.2)]
        wood.append(
            tube(
                _wander([0, 0, z], end, sway_m=0.03, count=4, seed=seed + 10 + i),
                [0.03, 0.02, 0.012, 0.005],
                segments=4,
            )
        )
    u = dice(leaves, 9, seed=seed + 50)
    shell = np.cbrt(0.25 + 0.75 * u[:, 8:9])  # few in the middle
    place = middle + _ball(np.column_stack([u[:, :2], np.ones(leaves)])) * shell * half
    return {"bark": join(*wood), "foliage": _leaves(place, u[:, 3:8], size_m=size_m)}


def poplar():
    """Part name -> Mesh of a column of 11 m."""
    return _crown(height_m=11.0, foot_m=0.9, radii_m=(0.95, 0.95), leaves=2600, size_m=(0.075, 0.05), seed=7000)


def birch():
    """Part name -> Mesh of a light tree of 8 m with a thin crown."""
    return _crown(
        height_m=8.2, foot_m=2.1, radii_m=(1.55, 1.55), leaves=1900, size_m=(0.06, 0.045), seed=8000, stem_m=0.09
    )


def bush():
    """Part name -> Mesh of a round bush of 1.5 m."""
    return _bush(height_m=1.5, radius_m=0.75, size_m=(0.045, 0.03), seed=9000, branches=6)


def juniper():
    """Part name -> Mesh of a bush like a column, of 1.9 m."""
    return _bush(height_m=1.9, radius_m=0.32, size_m=(0.035, 0.02), seed=9200, branches=8)


def _bush(*, height_m, radius_m, **crown):
    """Part name -> Mesh of a bush whose leaves begin at the ground; other arguments as of `_crown`."""
    return _crown(height_m=height_m, foot_m=0.05, radii_m=(radius_m, radius_m), leaves=900, stem_m=0.025, **crown)


def hedge(*, length_m=2.0, width_m=0.6, height_m=1.3, seed=9500):
    """Part name -> Mesh of 2 m of a clipped hedge along y: stems, and leaves that are dense at its faces."""
    stems = [
        tube(
            _wander([0.08 * (-1) ** i, y, 0], [0, y, height_m - 0.1], sway_m=0.05, count=4, seed=seed + i),
            0.015,
            segments=4,
        )
        for i, y in enumerate(np.linspace(-0.42, 0.42, 7) * length_m)
    ]
    u = dice(2200, 9, seed=seed + 50)
    inside = 2 * u[:, :3] - 1
    outermost = np.argmax(np.abs(inside) ** (1.0, 4.0, 1.0), axis=1)
    pushed = np.take_along_axis(inside, outermost[:, None], axis=1)
    np.put_along_axis(inside, outermost[:, None], np.sign(pushed) * (1 - 0.3 * u[:, 8:9] ** 2), axis=1)
    half = 0.5 * np.array([width_m, length_m, height_m - 0.1]) - 0.05
    place = np.add(inside * half, (0, 0, 0.5 * height_m + 0.05))
    return {"bark": join(*stems), "foliage": _leaves(place, u[:, 3:8], size_m=(0.042, 0.025), halves=1)}
