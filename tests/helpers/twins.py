"""A room that a lidar stands in, known in closed form, as a sweep and as a recording; pulses of a twin."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lidarscene.maths.pose import Pose
from lidarscene.recordings.recording import Recording
from lidarscene.recordings.sweep import Sweep
from lidarscene.studies.fit.on_scene import scene_fit
from lidarscene.studies.twin import told_apart
from lidarscene.studies.twin.matched_pulses import MatchedPulses
from lidarscene.studies.twin.surfels import SMOOTH

HALF_M = (10.0, 8.0)
"""Walls at plus and minus x and y; no ceiling."""

HEIGHT_M = 1.8
REFLECTIVITY = (0.4, 0.2, 0.3)
"""Of the walls across x, those across y, and the ground."""

RINGS, COLUMNS = 24, 360
ELEVATION_DEG = np.linspace(8.0, -22.5, RINGS)
WHITE_M2 = 20_000.0
"""Photons of a white board square to the beam, times the square of its range."""


def use_few_trees(monkeypatch: pytest.MonkeyPatch) -> None:
    """A classifier of 10 trees for 100, whose accuracy is told as well to some hundredths, in a tenth of the time."""
    monkeypatch.setattr(told_apart, "TREES", 10)


def use_few_evaluations(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fit on a scene that ends early, for who does not look at its numbers."""
    monkeypatch.setattr(scene_fit, "MOST_EVALUATIONS", 4)


def towards(azimuth: Any, elevation: Any) -> Any:
    """(..., 3) unit vectors."""
    parts = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


def directions(columns: int = COLUMNS, shear_deg: float = 0.0) -> Any:
    """(rings, columns, 3), clockwise from behind; every second ring's azimuth is ahead by the shear."""
    azimuth = np.pi - 2.0 * np.pi * np.arange(columns) / columns
    azimuth = azimuth[None, :] + np.radians(shear_deg) * (np.arange(RINGS)[:, None] % 2)
    return towards(azimuth, np.radians(ELEVATION_DEG)[:, None])


def room(direction: Any, pose: Pose | None = None) -> tuple[Any, Any, Any]:
    """Range, cosine of incidence and reflectivity of what each beam meets first, from this pose."""
    pose = pose or Pose()
    along, start = direction @ pose.rotation.T, pose.position_m
    planes = [(0, HALF_M[0], 0), (0, -HALF_M[0], 0), (1, HALF_M[1], 1), (1, -HALF_M[1], 1), (2, -HEIGHT_M, 2)]
    with np.errstate(divide="ignore"):
        ways = [(offset_m - start[axis]) / along[..., axis] for axis, offset_m, _ in planes]
    ways = [np.where(way > 0.0, way, np.inf) for way in ways]
    nearest = np.argmin(ways, axis=0)
    cos = np.abs(np.take_along_axis(along, np.array([axis for axis, _, _ in planes])[nearest][..., None], axis=-1))[
        ..., 0
    ]
    return np.min(ways, axis=0), cos, np.array([REFLECTIVITY[kind] for _, _, kind in planes])[nearest]


def room_sweep(
    *, pose: Pose | None = None, noise_m: float = 0.0, seed: int = 0, shear_deg: float = 0.0, **changed: Any
) -> Sweep:
    """What a perfect sensor records of the room: Lambert's law, signals as the square of the range."""
    direction = directions(shear_deg=shear_deg)
    range_m, cos, reflectivity = room(direction, pose)
    apparent = reflectivity * cos
    noise = np.random.default_rng(seed).normal(0.0, 1.0, range_m.shape)
    fields: dict[str, Any] = {
        "range_m": range_m + noise_m * noise,
        "recorded": np.ones_like(range_m, bool),
        "direction": direction,
        "signal": WHITE_M2 * apparent / range_m**2,
        "reflectivity": 100.0 * apparent,
        "includes_lost": True,
        "ring": np.broadcast_to(np.arange(RINGS)[:, None], range_m.shape),
    }
    return Sweep(**fields | changed)


def recording_of(path: Path, *sweeps: Sweep) -> Recording:
    """These sweeps as the frames of a file of this name."""
    return Recording(path=path, count=len(sweeps), read=lambda number: sweeps[number])


def unit_json(path: Path) -> Path:
    """Metadata of an Ouster with the rings of the room, 512 columns."""
    unit = {
        "prod_line": "OS-0-24",
        "prod_sn": "1",
        "lidar_mode": "512x10",
        "beam_altitude_angles": ELEVATION_DEG.tolist(),
        "beam_azimuth_angles": [0.0] * RINGS,
    }
    path.write_text(json.dumps(unit), encoding="utf-8")
    return path


N = 4000


def pulses(seed: int = 5, **changed: Any) -> MatchedPulses:
    """20 mm of scatter, the same changes on both sides, signals from 20 to 300 over 5 to 40 m."""
    rng = np.random.default_rng(seed)
    change_m = rng.normal(0.0, 0.02, N)
    true_m = np.linspace(5.0, 40.0, N)
    signal = 8000.0 / true_m**2 + 15.0
    range_m = changed.get("range_m", true_m + rng.normal(0.0, 0.02, N))
    fields: dict[str, Any] = {
        "angle_rad": np.zeros(N),
        "pulse": np.arange(N),
        "ring": np.arange(N) % 8,
        "column": np.arange(N) // 8,
        "signal": signal,
        "strength": signal,
        "range_m": range_m,
        "aimed_range_m": range_m,
        "xyz_m": np.zeros((N, 3)),
        "change_m": change_m,
        "gap_m": np.full(N, np.nan),
        "withheld": np.zeros(N, bool),
        "simulated_range_m": true_m + rng.normal(0.0, 0.02, N),
        "simulated_signal": signal,
        "simulated_strength": signal,
        "simulated_xyz_m": np.zeros((N, 3)),
        "simulated_change_m": change_m,
        "simulated_gap_m": np.full(N, np.nan),
        "true_range_m": true_m,
        "reflectivity": np.full(N, 0.2),
        "kind": np.full(N, SMOOTH),
    }
    return MatchedPulses(**fields | changed)
