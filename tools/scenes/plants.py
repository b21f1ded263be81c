"""A broad-leaved tree of about 6.5 m: trunk, branches, twigs and leaves in clumps."""

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
    """LEAVES leaves about a point: each a folded rhombus of two triangles, mostly facing upwards."""
    u = dice(LEAVES, 8, seed=seed)
    polar = np.stack([np.cos(2 * np.pi * u[:, 0]), np.sin(2 * np.pi * u[:, 0])], axis=1)
    height = 2 * u[:, 1:2] - 1
    ball = np.hstack([polar * np.sqrt(1 - height**2), height]) * np.cbrt(u[:, 2:3])
    place = centre_m + ball * (0.54, 0.54, 0.42)
    facing = np.hstack([u[:, 3:5] * 2 - 1, 0.35 + u[:, 5:6]])
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    turn = 2 * np.pi * u[:, 6]
    along = np.cross(facing, np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    beside = np.cross(facing, along)
    size = 0.065 + 0.045 * u[:, 7:8]
    fold = 0.25 * size * facing
    corners = [place - 1.25 * size * along, place - 0.72 * size * beside + fold]
    corners += [place + 1.25 * size * along, place + 0.72 * size * beside + fold]
    faces = np.arange(4 * LEAVES).reshape(-1, 4)[:, [0, 2, 1, 0, 3, 2]].reshape(-1, 3)
    return Mesh(np.stack(corners, axis=1).reshape(-1, 3), faces)
