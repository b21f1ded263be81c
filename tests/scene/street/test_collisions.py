"""Nobody and nothing on a street stands in another: all pairs of boxes, of their meshes, over a minute of its time."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import trimesh
from helpers.run_seed import chosen
from scipy.spatial import cKDTree

from lidarscene.labels.boxes import _carried
from lidarscene.scene.made_street import street
from lidarscene.scene.scene import Part, Scene

ROUND = ("trees", "bushes")

GROUND = {"road", "pavement", "kerb", "lane_marking", "terrain"}

Boxes = tuple[list[str], np.ndarray]
"""Names, and (n, 6) x, y [m], direction (x, y), half length and half width [m]."""


def standing(scene: Scene) -> Boxes:
    """Boxes of what stands, of its section 0.7 m over its foot: doorsteps and crowns are no obstacle."""
    names, rows, sections = [], [], {}
    for body in scene.bodies:
        if body.motion is not None or body.class_name in GROUND:
            continue
        if id(body.parts) not in sections:
            ends = [
                trimesh.intersections.mesh_plane(
                    trimesh.Trimesh(part.vertices_m, part.faces, process=False), body.pose.rotation[2], [0.0, 0.0, 0.7]
                )
                for part in body.parts
                if isinstance(part, Part) and part.in_box
            ]
            place_m = np.concatenate(ends).reshape(-1, 3)[:, :2]
            sections[id(body.parts)] = place_m.min(axis=0), place_m.max(axis=0)
        low_m, high_m = sections[id(body.parts)]
        # The box of what is round has corners that it does not reach, in whatever direction it is turned.
        half_m = 0.5 * (high_m - low_m) * (0.5**0.5 if body.name.startswith(ROUND) else 1.0)
        names.append(body.name)
        rows.append(row(body.pose.position_m, body.pose.rotation, 0.5 * (low_m + high_m), half_m))
    return names, np.array(rows)


def row(place_m: np.ndarray, rotation: np.ndarray, middle_m: np.ndarray, half_m: np.ndarray) -> np.ndarray:
    ahead = rotation[:2, 0] / np.hypot(*rotation[:2, 0])
    return np.concatenate([place_m[:2] + rotation[:2, :2] @ middle_m, ahead, half_m])


def moving(scene: Scene, times_s: np.ndarray) -> Iterator[Boxes]:
    """Boxes of labels of what moves, as it walks, at each of some times: six together take a third of six alone."""
    if len(times_s) > 6:
        yield from moving(scene, times_s[:6])
        yield from moving(scene, times_s[6:])
        return
    moved = [(n, body) for n, body in enumerate(scene.bodies) if body.motion is not None]
    present = np.array([[body.is_present(float(time_s)) for _, body in moved] for time_s in times_s])
    when, who = np.nonzero(present)
    boxes = _carried([moved[number] for number in who], times_s[when], times_s[when])
    rows = [row(box.pose.position_m, box.pose.rotation, np.zeros(2), 0.5 * box.size_m[:2]) for box in boxes]
    for number in range(len(times_s)):
        at = np.flatnonzero(when == number)
        yield [boxes[n].name for n in at], np.array([rows[n] for n in at]).reshape(-1, 6)


def pairs_that_meet(boxes: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(n, 2) numbers of boxes and others that overlap by more than a millimetre: shadows on the sides of both do."""
    reach_m = 0.5 + np.hypot(*boxes[:, 4:].T)[:, None]
    near = cKDTree(others[:, :2]).query_ball_point(boxes[:, :2], reach_m[:, 0] + np.hypot(*others[:, 4:].T).max())
    pair = np.array([(a, b) for a, numbers in enumerate(near) for b in numbers], dtype=int).reshape(-1, 2)
    both = np.stack([boxes[pair[:, 0]], others[pair[:, 1]]])
    sides = np.stack([both[..., 2:4], both[..., [3, 2]] * [-1.0, 1.0]], axis=2)
    apart_m, meets = both[1, :, :2] - both[0, :, :2], np.ones(len(pair), dtype=bool)
    for axis in (sides[owner, :, side] for owner in (0, 1) for side in (0, 1)):
        shadow_m = (np.abs(np.einsum("onsk,nk->ons", sides, axis)) * both[..., 4:]).sum(axis=(0, 2))
        meets &= np.abs((apart_m * axis).sum(axis=1)) < shadow_m - 1e-3
    return pair[meets]


def collisions(times_s: np.ndarray, **keys: Any) -> dict[tuple[str, str], float]:
    """Pairs of bodies of a street that overlap -> when first."""
    scene = street(**keys)
    names, still = standing(scene)
    found = {(names[a], names[b]): -1.0 for a, b in pairs_that_meet(still, still) if a < b}
    for time_s, (moved, boxes) in zip(times_s.tolist(), moving(scene, times_s), strict=True):
        for a, b in pairs_that_meet(boxes, still):
            found.setdefault((moved[a], names[b]), time_s)
        for a, b in pairs_that_meet(boxes, boxes):
            # Hands hold the pram that they push.
            if a < b and moved[b] != moved[a].replace("walkers_woman_pram", "prams"):
                found.setdefault((moved[a], moved[b]), time_s)
    return found


SPACINGS = ("walking_spacing_m", "standing_spacing_m")
LOOP = {"length_m": 900.0, "loop": True, "lanes": 2}
KEYS: dict[str, dict[str, Any]] = {
    "narrow": {"length_m": 150.0, "pavement_m": 2.8, **dict.fromkeys(SPACINGS, (10.0, 40.0))},
    "one lane": {"lanes": 1},
    "straight": {"lanes": 2, "bend_deg": (0.0, 0.0)},
    "loop": LOOP,
    "junctions": LOOP | {"corners": "junctions"},
    "queues": {"length_m": 300.0, "lanes": 3, "bend_spacing_m": (10.0, 20.0), "oncoming_gap_m": (5.0, 10.0)}
    | {"bend_radius_m": (20.0, 22.0), "bend_deg": (60.0, 60.0)},
}
CASES = [(name, seed) for name in KEYS for seed in (6, 7) if name != "queues"]


# On seed 3 the gaps of the middle line were too small for a queue on an inner lane.
@pytest.mark.parametrize(("name", "seed"), [*chosen(1, CASES), ("queues", 3)])
def test_nobody_stands_in_another(name: str, seed: int) -> None:
    """All pairs of bodies, moving ones too, every half second of a minute."""
    everyone = {"stop_share": 1.0, "zebra_share": 1.0, "shown_m": 100.0}
    assert collisions(np.arange(0.0, 60.0, 0.5), seed=seed, **everyone, **KEYS[name]) == {}
