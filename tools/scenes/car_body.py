"""The car's skin: the two shells in, cut into paint, glass, lamps, trim and wheel wells."""

import numpy as np
from car_shape import (
    ARCH_RADIUS_M,
    AXLE_HEIGHT_M,
    AXLES_M,
    WELL_M,
    axle_distance_m,
    beltline_m,
    cabin_shell,
    cabin_station,
    lower_shell,
)
from cutting import band, border, offset, rounded_and, skirt, split
from modelling import Mesh, circle, join

SEAM_M = 0.005


def body_parts():
    """Part name -> list of meshes, for everything cut from the two shells."""
    parts = {name: [] for name in ("paint", "trim", "glass", "headlamp", "taillamp", "interior")}
    _lower(parts)
    _cabin(parts)
    return parts


def _xyz(mesh):
    x, y, z = mesh.points_m.T
    return x, np.abs(y), z


def _take(mesh, field, part, *, push_m=0.0, edge_m=0.006):
    """Cut `field`'s inside out of the mesh into `part`, pushed in by `push_m`; what is left."""
    inside, rest = split(mesh, field(mesh))
    if push_m:
        depth = np.clip(-field(inside) / edge_m, 0, 1) * push_m
        inside = offset(inside, -depth)
    part.append(inside)
    return rest


def _lower(parts):
    shell = lower_shell()
    _, shell = split(shell, _cabin_hole(shell))
    _, shell = split(shell, _arch(shell))
    parts["trim"] += _wells(shell)
    for field, part, push_m in (
        (_headlamp, "headlamp", 0.0),
        (_taillamp, "taillamp", -0.006),
        (_grille, "trim", 0.03),
        (_intake, "trim", 0.05),
        (_rear_bumper, "trim", 0.004),
        (_sill, "trim", 0.0),
    ):
        shell = _take(shell, field, parts[part], push_m=push_m)
    for line in (_front_door, _rear_door, _bonnet, _tailgate, _front_bumper_line, _fuel_flap):
        shell = _seam(shell, line, parts["trim"])
    parts["paint"].append(shell)


def _seam(shell, line, part):
    """A dark gap of 2 `SEAM_M` along the zero line of `line`, in its zone only."""
    zone = line(shell)[1][shell.faces].all(axis=1)
    rest, shell = shell.kept(~zone), shell.kept(zone)
    inner, outer = split(shell, line(shell)[0] + SEAM_M, snap=0.02)
    gap, outer = split(outer, line(outer)[0] - SEAM_M, snap=0.02)
    part.append(gap)
    return join(inner, outer, rest)


def _cabin_hole(mesh):
    x, y, z = _xyz(mesh)
    screen, rear, width = cabin_station(z)
    inside = rounded_and(x - screen + 0.14, rear + 0.20 - x, y - width + 0.08, radius_m=0.25)
    return np.maximum(inside, 0.82 - z)


def _arch(mesh):
    x, y, z = _xyz(mesh)
    return np.maximum(axle_distance_m(x, z) - ARCH_RADIUS_M, WELL_M - y)


def _wells(shell):
    """The lining of the four wheel wells: a strip inwards from each cut edge, and a wall."""
    edges = border(shell)
    x, _, z = _xyz(shell)
    on_arch = np.abs(axle_distance_m(x, z) - ARCH_RADIUS_M) < 0.012
    chosen = on_arch[edges].all(axis=1) & (z[edges] < 0.75).all(axis=1)
    target = shell.points_m.copy()
    target[:, 1] = np.sign(target[:, 1]) * (WELL_M - 0.002)
    lining = skirt(shell, chosen=chosen, target_m=target)
    return [lining] + [_wall(axle_m=axle).both_sides() for axle in AXLES_M]


def _wall(*, axle_m):
    """The inner wall of the wheel well on the left: a disc cut off at the floor, looking outwards."""
    ring = circle(48, radius_m=ARCH_RADIUS_M + 0.004) + np.array([axle_m, AXLE_HEIGHT_M])
    ring[:, 1] = np.maximum(ring[:, 1], 0.185)
    points = np.column_stack([ring[:, 0], np.full(48, WELL_M), ring[:, 1]])
    points = np.vstack([points, [axle_m, WELL_M, AXLE_HEIGHT_M]])
    here = np.arange(48)
    return Mesh(points, np.stack([np.roll(here, -1), here, np.full(48, 48)], axis=1))


def _around_nose(mesh, end_m):
    """(way around the corner from the middle, z, x): metres, for things on the nose or the tail."""
    x, y, z = _xyz(mesh)
    return y + 0.75 * np.maximum(abs(end_m) - np.abs(x), 0), z, x * np.sign(end_m)


def _headlamp(mesh):
    way, z, x = _around_nose(mesh, 2.16)
    low = 0.575 + 0.055 * (way - 0.5)
    high = 0.665 + 0.125 * (way - 0.5)
    inside = rounded_and(0.47 - way, way - 1.10, low - z, z - high, radius_m=0.035)
    return np.maximum(inside, 1.2 - x)


def _taillamp(mesh):
    way, z, x = _around_nose(mesh, -2.13)
    low = 0.735 - 0.02 * (way - 0.5)
    high = 0.875 + 0.03 * (way - 0.5)
    inside = rounded_and(0.47 - way, way - 1.08, low - z, z - high, radius_m=0.03)
    return np.maximum(inside, 1.2 - x)


def _grille(mesh):
    way, z, x = _around_nose(mesh, 2.18)
    inside = rounded_and(way - 0.46 - 0.4 * (z - 0.6), 0.555 - z, z - 0.655, radius_m=0.03)
    return np.maximum(inside, 1.5 - x)


def _intake(mesh):
    way, z, x = _around_nose(mesh, 2.18)
    middle = rounded_and(way - 0.62 + 0.5 * (z - 0.3), 0.255 - z, z - 0.375, radius_m=0.03)
    side = rounded_and(0.70 - way, way - 0.86, 0.27 - z, z - 0.43, radius_m=0.03)
    return np.maximum(np.minimum(middle, side), 1.5 - x)


def _rear_bumper(mesh):
    way, z, x = _around_nose(mesh, -2.13)
    inside = rounded_and(way - 0.80, z - 0.40, 0.10 - z, radius_m=0.06)
    return np.maximum(inside, 1.6 - x)


def _sill(mesh):
    x, y, z = _xyz(mesh)
    arch = axle_distance_m(x, z) - ARCH_RADIUS_M - 0.028
    low = z - 0.245
    return np.where(y > WELL_M + 0.03, np.minimum(arch, low), np.maximum(low, 0.0) + 0.004 - 0.02 * (z < 0.235))


def _front_door(mesh):
    x, y, z = _xyz(mesh)
    inside = rounded_and(x - 0.93 + 0.12 * (z - 0.6), -0.20 - x, 0.27 - z, radius_m=0.05)
    return inside, y > 0.74


def _rear_door(mesh):
    x, y, z = _xyz(mesh)
    away = ARCH_RADIUS_M + 0.07 - axle_distance_m(x, z)
    inside = rounded_and(x + 0.21, -1.22 - x - 0.1 * (z - 0.6), 0.27 - z, away, radius_m=0.05)
    return inside, y > 0.74


def _bonnet(mesh):
    x, y, z = _xyz(mesh)
    edge = 0.70 + 0.10 * (1.9 - x) - 0.25 * np.maximum(x - 1.75, 0)
    inside = rounded_and(y - edge, x - 2.045 + 0.11 * y**2, radius_m=0.10)
    return inside, (z > beltline_m(x) - 0.12) & (x > 0.8)


def _tailgate(mesh):
    x, y, z = _xyz(mesh)
    return rounded_and(y - 0.60, 0.475 - z, radius_m=0.08), x < -1.75


def _front_bumper_line(mesh):
    x, y, z = _xyz(mesh)
    return 1.735 - x + 0.1 * (0.6 - z), (y > 0.7) & (x > 1.5) & (z < 0.66)


def _fuel_flap(mesh):
    x, _, z = _xyz(mesh)
    return np.hypot(x + 1.62, z - 0.80) - 0.075, mesh.points_m[:, 1] < -0.5


def _cabin(parts):
    shell = cabin_shell()
    for field, frame_m in ((_windscreen, 0.014), (_rear_window, 0.022), (_side_windows, 0.016)):
        opening, shell = split(shell, field(shell) - frame_m)
        pane, frame = split(opening, field(opening), snap=0.05)
        parts["trim"].append(frame)
        if field is _side_windows:
            for pillar in (_b_pillar, _c_bar):
                bar, pane = split(pane, pillar(pane))
                parts["trim"].append(bar)
        parts["glass"].append(offset(pane, -0.004))
    parts["paint"].append(shell)
    parts["interior"].append(_lining())


def _lining():
    """Headliner and pillar covers: a coarser cabin, inside the skin and seen from inside."""
    shell = cabin_shell(around=52, levels=6, lid=2)
    for field in (_windscreen, _rear_window, _side_windows):
        _, shell = split(shell, field(shell) - 0.02)
    shell, _ = split(shell, 0.94 - shell.points_m[:, 2])
    return offset(shell, -0.035).flipped()


def _windscreen(mesh):
    x, y, z = _xyz(mesh)
    _, _, width = cabin_station(z)
    inside = rounded_and(y - width + 0.105, 0.80 - z, z - 1.352, radius_m=0.06)
    return np.maximum(inside, -0.05 - x)


def _rear_window(mesh):
    x, y, z = _xyz(mesh)
    _, _, width = cabin_station(z)
    inside = rounded_and(y - width + 0.16, 1.045 - z, z - 1.322, radius_m=0.06)
    return np.maximum(inside, x + 1.45)


def _side_windows(mesh):
    x, y, z = _xyz(mesh)
    screen, rear, _ = cabin_station(z)
    bottom = beltline_m(x) + 0.025 - z
    top = z - 1.325 + 0.035 * (x + 0.4) ** 2
    front, back = x - screen + 0.30, rear + 0.31 + 0.25 * (1.3 - z) - x
    return np.maximum(rounded_and(bottom, top, front, back, radius_m=0.045), 0.5 - y)


def _b_pillar(mesh):
    return band(mesh.points_m[:, 0] + 0.05 * mesh.points_m[:, 2], -0.205, -0.115)


def _c_bar(mesh):
    return band(mesh.points_m[:, 0] + 0.18 * mesh.points_m[:, 2], -1.035, -0.99)
