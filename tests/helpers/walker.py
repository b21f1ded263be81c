"""A walker of two legs as a glTF file of our own, and where linear blend skinning in NumPy puts it."""

from pathlib import Path
from typing import Any

import numpy as np

from helpers.gltf import Gltf

LEG_M, HIP_M, PERIOD_S = 0.9, 0.15, 1.2
"""Length of a leg, half the distance between the hips, time of a stride."""
RINGS, AROUND, KEYS = 13, 8, 25
SWING_RAD, BEND_RAD = 0.45, 0.5


def _leg(side: float) -> tuple[np.ndarray, np.ndarray]:
    """(v, 3) vertices of a leg, x ahead and y up, and (v,) share of its lower half."""
    height, turn = np.linspace(0.0, LEG_M, RINGS), 2 * np.pi * np.arange(AROUND) / AROUND
    points = np.zeros((RINGS, AROUND, 3))
    points[..., 0], points[..., 2] = 0.06 * np.cos(turn), side * HIP_M + 0.06 * np.sin(turn)
    points[..., 1] = height[:, None]
    lower = np.clip((0.55 - height / LEG_M) / 0.2, 0.0, 1.0)
    return points.reshape(-1, 3), np.repeat(lower, AROUND)


def _faces() -> np.ndarray:
    """(f, 3) triangles of a leg, open at its ends."""
    here = np.arange((RINGS - 1) * AROUND)
    beside = here - here % AROUND + (here + 1) % AROUND
    return np.concatenate(
        [np.stack([here, here + AROUND, beside], 1), np.stack([beside, here + AROUND, beside + AROUND], 1)]
    )


POINTS, LOWER = (np.concatenate(arrays) for arrays in zip(_leg(-1.0), _leg(1.0), strict=True))
FACES = np.concatenate([_faces(), _faces() + RINGS * AROUND])


def angles(phase: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Angles of hip and knee about z [rad] at places of the stride."""
    turn = 2 * np.pi * (phase + 0.5 * side)
    return SWING_RAD * np.cos(turn), -BEND_RAD * (0.5 - 0.5 * np.cos(turn - 2.0))


def write_walker(path: Path) -> Path:
    """Write the walker with the animations "walk", of `KEYS` key frames, and "stand"."""
    file = Gltf()
    joints = np.zeros((len(POINTS), 4), int)
    joints[:, :2] = np.repeat([[0, 1], [2, 3]], RINGS * AROUND, axis=0)
    weights = np.zeros((len(POINTS), 4))
    weights[:, 0], weights[:, 1] = 1.0 - LOWER, LOWER
    attributes = {"JOINTS_0": file.numbers(joints, "u1"), "WEIGHTS_0": file.numbers(weights)}
    file.add("materials", name="skin", pbrMetallicRoughness={"baseColorFactor": [0.5, 0.5, 0.5, 1.0]})
    file.mesh(POINTS, FACES.ravel(), attributes=attributes, material=0)
    file.content["scenes"] = [{"nodes": [0, 1, 3]}]
    file.add("nodes", mesh=0, skin=0, name="walker")
    bound = np.tile(np.eye(4), (4, 1, 1))
    for side in (0, 1):
        z = HIP_M * (2 * side - 1)
        file.add("nodes", translation=[0, LEG_M, z], children=[2 + 2 * side])
        file.add("nodes", translation=[0, -0.5 * LEG_M, 0])
        bound[2 * side, :3, 3], bound[2 * side + 1, :3, 3] = [0, -LEG_M, -z], [0, -0.5 * LEG_M, -z]
    file.add("skins", joints=[1, 2, 3, 4], inverseBindMatrices=file.numbers(bound.transpose(0, 2, 1)))
    times = np.linspace(0.0, PERIOD_S, KEYS)
    for name, amount in (("walk", 1.0), ("stand", 0.0)):
        samplers: list[dict[str, Any]] = []
        channels: list[dict[str, Any]] = []
        clock = file.numbers(times)
        for side in (0, 1):
            for below, angle in enumerate(angles(times / PERIOD_S, side)):
                half = 0.5 * amount * angle
                turns = np.stack([0 * half, 0 * half, np.sin(half), np.cos(half)], axis=1)
                channels.append(
                    {"sampler": len(samplers), "target": {"node": 1 + 2 * side + below, "path": "rotation"}}
                )
                samplers.append({"input": clock, "output": file.numbers(turns)})
        file.add("animations", name=name, samplers=samplers, channels=channels)
    return file.save(path)


def skinned(phase: float, amount: float = 1.0) -> np.ndarray:
    """(v, 3) vertices at a place of the stride, z up: angles, so much of them, are straight between the key frames."""
    keys = np.arange(KEYS) / (KEYS - 1)
    placed = []
    for side in (0, 1):
        hip, knee = (amount * np.interp(phase % 1.0, keys, angle) for angle in angles(keys, side))
        own = POINTS[side * RINGS * AROUND :][: RINGS * AROUND]
        share = LOWER[: RINGS * AROUND, None]
        pivot = np.array([0.0, LEG_M, HIP_M * (2 * side - 1)])
        middle = pivot - [0.0, 0.5 * LEG_M, 0.0]
        upper = (own - pivot) @ _about_z(hip).T + pivot
        lower = ((own - middle) @ _about_z(knee).T + middle - pivot) @ _about_z(hip).T + pivot
        placed.append((1.0 - share) * upper + share * lower)
    x, y, z = np.concatenate(placed).T
    return np.stack([x, -z, y], axis=1)


def _about_z(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
