"""Pictures of several panels side by side, and that of a scene: what stands where, from above and from the sensor.

Bodies are drawn by their outlines (convex hulls), the farthest first, so nothing is traced and no back end is needed.
"""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..files.facts import Picture
from ..maths.arrays import Numbers
from ..maths.pose import Pose
from ..maths.trajectory import pose_at
from ..maths.vectors import convex_hull
from ..scene.scene import Body, Part, Scene
from .lines import DPI, GREY, INK, colour_of, empty_figure, literal, plain_axes, write_figure
from .maps import NO_DATA_COLOUR

Panel = Callable[[Any], None]
"""Function that draws on axes."""

PANEL_INCHES = 4.6
"""Choice: width and height of a panel."""

MOST_VERTICES = 2000
"""Accuracy bought: vertices of a part from which its outline is found, spread over all of them."""

LEAST_HEIGHT_M = 0.3
"""Choice: height from which a body stands, and is no ground nor marking."""

NEAREST_M, FARTHEST_M = 15.0, 80.0
"""Choice: bounds of the distance from the sensor that the plan shows."""

LABEL_SHARE = 0.3, 0.07
"""Choice: width and height that the name of a body has to itself, over half of the plan's."""


def draw_panels(panels: Sequence[Panel], title: str) -> Picture:
    """Draw panels side by side, under a title."""
    return Picture.drawn(functools.partial(_draw, panels, title))


def _draw(panels: Sequence[Panel], title: str, path: Path) -> None:
    size = PANEL_INCHES * len(panels), PANEL_INCHES
    figure = empty_figure(size, dpi=DPI // 2, layout="constrained")
    for axes, panel in zip(np.ravel(figure.subplots(1, len(panels))), panels, strict=True):
        panel(axes)
        plain_axes(axes, grid="both")
    figure.suptitle(literal(title), x=0.012, ha="left", fontsize=9.5, color=GREY)
    write_figure(figure, path)


def draw_scene(scene: Scene) -> Picture:
    """See `Scene.plot`."""
    place = (pose_at(scene.ego, 0.0) if scene.ego else Pose()) @ scene.sensor_pose
    own = set(scene.own_bodies)
    seen = [
        (body, corners_m)
        for number, body in enumerate(scene.bodies)
        if number not in own and body.is_present(0.0) and len(corners_m := _corners_m(body))
    ]
    seen.sort(key=lambda entry: -float(np.linalg.norm(_middle_m(entry[1]) - place.position_m)))
    standing = [body.class_name for body, corners_m in seen if np.ptp(corners_m[:, 2]) > LEAST_HEIGHT_M]
    colours = {name: colour_of(i) for i, (name, _) in enumerate(Counter(standing).most_common())}
    panels = [
        functools.partial(_from_above, seen=seen, colours=colours, place=place),
        functools.partial(_from_sensor, seen=seen, colours=colours, place=place),
    ]
    return draw_panels(panels, f"{scene.name}: {len(scene.bodies):,} bodies; outlines, the sensor is the cross")


def _corners_m(body: Body) -> Numbers:
    """(n, 3) vertices of a body at time 0, in the world."""
    pose = body.pose if body.motion is None else pose_at(body.motion, 0.0)
    corners = [np.zeros((0, 3))]
    for part in body.parts:
        if isinstance(part, Part):
            corners.append(part.vertices_m[:: max(len(part.vertices_m) // MOST_VERTICES, 1)])
        else:
            turn = np.linspace(0.0, 2.0 * math.pi, 24)
            ring = part.radius_m * np.stack([np.cos(turn), np.sin(turn), np.zeros(24)], axis=1)
            corners += [np.roll(ring, shift, axis=1) for shift in range(3)]
    return pose.apply(np.concatenate(corners))


def _middle_m(corners_m: Numbers) -> Numbers:
    return np.asarray(0.5 * (corners_m.min(axis=0) + corners_m.max(axis=0)))


def _fill(axes: Any, outline: Numbers, colour: str | None) -> None:
    """Fill an outline; without a colour it is ground."""
    shade = {"facecolor": NO_DATA_COLOUR, "edgecolor": "white"} if colour is None else {"facecolor": colour}
    axes.fill(
        *outline.T, **({"edgecolor": INK, "alpha": 0.85} | shade), linewidth=0.5, zorder=1 if colour is None else 2
    )


def _from_above(axes: Any, *, seen: Sequence[tuple[Body, Numbers]], colours: dict[str, str], place: Pose) -> None:
    x, y, _ = place.position_m
    farthest_m = 0.0
    names = []
    for body, corners_m in seen:
        stands = np.ptp(corners_m[:, 2]) > LEAST_HEIGHT_M
        _fill(axes, convex_hull(corners_m[:, :2]), colours[body.class_name] if stands else None)
        if stands:
            distance_m = float(np.linalg.norm(_middle_m(corners_m)[:2] - (x, y)))
            farthest_m = max(farthest_m, distance_m)
            names.append((distance_m, body.name, _middle_m(corners_m)))
    half_m = 1.15 * min(max(farthest_m, NEAREST_M), FARTHEST_M)
    axes.set(xlim=(x - half_m, x + half_m), ylim=(y - half_m, y + half_m), aspect="equal")
    written: list[Numbers] = []
    for _, name, middle_m in sorted(names, key=lambda entry: entry[0]):
        free = [(np.abs(middle_m - other) > half_m * np.array([*LABEL_SHARE, np.inf])).any() for other in written]
        if all(free):
            written.append(middle_m)
            axes.annotate(name, middle_m[:2], fontsize=6.5, color=INK, ha="center", va="center", clip_on=True, zorder=4)
    ahead = place.rotation[:, 0]
    axes.plot(x, y, marker="P", color=INK, markersize=7, zorder=5)
    axes.annotate(
        "",
        (x + 0.15 * half_m * ahead[0], y + 0.15 * half_m * ahead[1]),
        (x, y),
        arrowprops={"arrowstyle": "->"},
        zorder=5,
    )
    plain_axes(axes, "x [m], from above", "y [m]")


def _from_sensor(axes: Any, *, seen: Sequence[tuple[Body, Numbers]], colours: dict[str, str], place: Pose) -> None:
    from matplotlib.patches import Patch

    widest_deg = 10.0
    for body, corners_m in seen:
        if np.ptp(corners_m[:, 2]) <= LEAST_HEIGHT_M:
            continue
        x, y, z = place.inverse_apply(corners_m).T
        middle = math.atan2(float(np.mean(y)), float(np.mean(x)))
        azimuth = middle + (np.arctan2(y, x) - middle + math.pi) % (2.0 * math.pi) - math.pi
        if np.ptp(azimuth) > math.pi:  # all around the sensor
            continue
        angles_deg = np.degrees(np.stack([azimuth, np.arctan2(z, np.hypot(x, y))], axis=1))
        widest_deg = max(widest_deg, float(np.abs(angles_deg[:, 0]).max()))
        for turns in (-360.0, 0.0, 360.0):  # what lies behind the sensor is on both edges
            _fill(axes, convex_hull(angles_deg + np.array([turns, 0.0])), colours[body.class_name])
    axes.set(xlim=(min(1.2 * widest_deg, 180.0), -min(1.2 * widest_deg, 180.0)), ylim=(-45.0, 45.0))
    axes.axhline(0.0, color=GREY, linewidth=0.7)
    plain_axes(axes, "azimuth from the sensor, to the left [deg]", "elevation [deg]")
    handles = [Patch(facecolor=colour, edgecolor=INK, label=name) for name, colour in list(colours.items())[:12]]
    if handles:
        axes.legend(handles=handles, fontsize=7, ncols=3, loc="lower left", frameon=False)
