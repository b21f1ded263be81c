"""Animations of glTF 2.0 files: transforms and weights of nodes over time.

Source: glTF 2.0, Khronos Group (2021), section 3.11 and appendix C.

Symbols: n instants, k key frames.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...errors import InputError
from ...maths.arrays import Numbers
from .gltf_document import GltfDocument

AnimatedNodes = dict[int, dict[str, Numbers]]
"""Node -> its translation, rotation, scale and weights at n instants, (n, ...), as far as an animation has them."""


def animated_nodes(document: GltfDocument, name: str, shares: Numbers) -> AnimatedNodes:
    """Sample an animation at (n,) shares of its time, 0 its first key frame and 1 its last.

    Raises:
        InputError: if the file has no animation of this name, with those that it has
    """
    animation = _animation(document, name)
    first_s, last_s = _span_s(document, animation)
    times_s = first_s + shares * (last_s - first_s)
    nodes: AnimatedNodes = {}
    for channel in animation["channels"]:
        target = channel["target"]
        if "node" in target and target["path"] in ("translation", "rotation", "scale", "weights"):
            sampler = animation["samplers"][channel["sampler"]]
            values = _sampled(document, sampler, times_s, is_rotation=target["path"] == "rotation")
            nodes.setdefault(target["node"], {})[target["path"]] = values
    return nodes


def animation_duration_s(document: GltfDocument, name: str) -> float:
    """Time from the first key frame of an animation to its last.

    Raises:
        InputError: if there is none of this name, or it takes no time
    """
    first_s, last_s = _span_s(document, _animation(document, name))
    if not last_s > first_s:
        raise InputError(f"{document.path}: animation '{name}' must last some time, got one instant")
    return last_s - first_s


def _animation(document: GltfDocument, name: str) -> Mapping[str, Any]:
    animations: dict[str, Mapping[str, Any]] = {
        str(entry.get("name", number)): entry for number, entry in enumerate(document.content.get("animations", []))
    }
    if name not in animations:
        has = ", ".join(animations) or "none"
        raise InputError(f"{document.path}: no animation '{name}'; it has {has}")
    return animations[name]


def _span_s(document: GltfDocument, animation: Mapping[str, Any]) -> tuple[float, float]:
    """First and last time of an animation's key frames."""
    times_s = [document.accessor(sampler["input"]) for sampler in animation["samplers"]]
    return min(float(times.min()) for times in times_s), max(float(times.max()) for times in times_s)


def _sampled(document: GltfDocument, sampler: Mapping[str, Any], times_s: Numbers, *, is_rotation: bool) -> Numbers:
    """(n, ...) values of a sampler at n times; before its first key frame and after its last, those there."""
    key_s = document.accessor(sampler["input"])[:, 0].astype(np.float64)
    kind = sampler.get("interpolation", "LINEAR")
    values = document.accessor(sampler["output"]).astype(np.float64)
    values = values.reshape(len(key_s), 3, -1) if kind == "CUBICSPLINE" else values.reshape(len(key_s), 1, -1)
    times_s = np.clip(times_s, key_s[0], key_s[-1])
    # With one key frame, its value all the time.
    before = np.clip(np.searchsorted(key_s, times_s, side="right") - 1, 0, max(len(key_s) - 2, 0))
    after = np.minimum(before + 1, len(key_s) - 1)
    step_s = np.maximum(key_s[after] - key_s[before], 1e-12)[:, None]
    share = (times_s - key_s[before])[:, None] / step_s
    if kind == "STEP":
        return np.asarray(np.where(share >= 1.0, values[after, 0], values[before, 0]))
    if kind == "CUBICSPLINE":
        # Each key frame has its tangent before, its value, and its tangent after.
        leaving, arriving = step_s * values[before, 2], step_s * values[after, 0]
        square, cube = share**2, share**3
        mixed = (2 * cube - 3 * square + 1) * values[before, 1] + (cube - 2 * square + share) * leaving
        mixed += (3 * square - 2 * cube) * values[after, 1] + (cube - square) * arriving
        return np.asarray(mixed)
    start, end = values[before, 0], values[after, 0]
    if not is_rotation:
        return np.asarray(start + share * (end - start))
    # The shorter way on the sphere of quaternions; for one angle in ten thousand and less it is a straight line.
    cosine = (start * end).sum(axis=1, keepdims=True)
    end = np.where(cosine < 0.0, -end, end)
    angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
    sine = np.where(angle < 1e-4, 1.0, np.sin(angle))
    first = np.where(angle < 1e-4, 1.0 - share, np.sin((1.0 - share) * angle) / sine)
    second = np.where(angle < 1e-4, share, np.sin(share * angle) / sine)
    return np.asarray(first * start + second * end)
