"""The lines of the car: a height or a station in, a length out. Metres; x forward, z up."""

import numpy as np
from modelling import curve, grid

AXLES_M = (1.33, -1.30)
AXLE_HEIGHT_M = 0.315
ARCH_RADIUS_M = 0.372
WELL_M = 0.56  # the wheel wells reach in to this |y|
HALF_WIDTH_M = 0.895

# Share of the height between underside and beltline: where the sides stand and how far nose and tail reach.
_LEVELS = (0.0, 0.05, 0.12, 0.22, 0.35, 0.50, 0.62, 0.72, 0.82, 0.90, 0.945, 0.975, 0.993, 1.0)
_INSET_M = (0.085, 0.048, 0.022, 0.012, 0.014, 0.010, 0.002, 0.0, 0.008, 0.020, 0.034, 0.053, 0.078, 0.10)
_NOSE_M = (2.08, 2.13, 2.17, 2.195, 2.21, 2.20, 2.185, 2.17, 2.145, 2.115, 2.09, 2.06, 2.025, 1.98)
_TAIL_M = (2.05, 2.09, 2.13, 2.16, 2.175, 2.17, 2.145, 2.135, 2.13, 2.12, 2.11, 2.095, 2.075, 2.05)


def beltline_m(x):
    """Top of the lower body at the outline: bonnet, shoulder, rear deck."""
    knots = (-2.2, -2.05, -1.5, -0.5, 0.5, 1.05, 1.5, 1.85, 2.05, 2.2)
    return curve(x, knots, (1.00, 1.02, 1.00, 0.955, 0.925, 0.905, 0.865, 0.80, 0.74, 0.67))


def underside_m(x):
    """Bottom of the lower body: higher under both overhangs."""
    return curve(x, (-2.2, -1.75, -1.2, 1.2, 1.8, 2.2), (0.30, 0.24, 0.19, 0.18, 0.19, 0.21))


def outline(count, *, length_m, width_m, powers):
    """(count, 2) a superellipse of unit half axes, evenly spaced once stretched to the given half axes."""
    turn = np.linspace(0, np.pi, 4001)
    cos, sin = np.cos(turn), np.sin(turn)
    unit = np.stack([np.sign(cos) * np.abs(cos) ** (2 / powers[0]), sin ** (2 / powers[1])], axis=1)
    step = np.hypot(*(np.diff(unit, axis=0) * (length_m, width_m)).T)
    along = np.concatenate([[0], np.cumsum(step)])
    at = np.linspace(0, along[-1], count // 2 + 1)
    half = np.stack([np.interp(at, along, unit[:, 0]), np.interp(at, along, unit[:, 1])], axis=1)
    return np.vstack([half, half[-2:0:-1] * (1, -1)])


def lower_shell(*, around=128, levels=17, lid=7, floor=2):
    """The closed lower body: floor, sides with nose and tail, bonnet and deck."""
    ring = outline(around, length_m=2.18, width_m=HALF_WIDTH_M, powers=(8.0, 2.9))
    even = np.linspace(0, 1, levels)
    share = np.unique(np.concatenate([even * 0.90, [0.925, 0.945, 0.962, 0.977, 0.988, 0.996, 1.0]]))
    rows = [_lower_row(ring, 0.0, inward=t, top=False) for t in np.linspace(1, 0, floor, endpoint=False)]
    rows += [_lower_row(ring, v, inward=0.0, top=False) for v in share]
    rows += [_lower_row(ring, 1.0, inward=t, top=True) for t in np.linspace(0, 1, lid + 1)[1:]]
    return grid(rows, closed=True)


def _lower_row(ring, share, *, inward, top):
    reach = np.where(ring[:, 0] > 0, curve(share, _LEVELS, _NOSE_M), curve(share, _LEVELS, _TAIL_M))
    x = ring[:, 0] * reach * (1 - 0.25 * inward)
    y = ring[:, 1] * (HALF_WIDTH_M - curve(share, _LEVELS, _INSET_M)) * (1 - inward)
    low, high = underside_m(x), beltline_m(x)
    z = low + share * (high - low)
    if top:
        z = z + 0.045 * (1 - (1 - inward) ** 2) + _bonnet_crease_m(x, y)
    y = y + np.sign(y) * (_flare_m(x, z) + _flank_m(x, z)) * np.clip((np.abs(y) - 0.7) / 0.15, 0, 1)
    return np.stack([x, y, z], axis=1)


def _bonnet_crease_m(x, y):
    ridge = np.exp(-(((np.abs(y) - 0.30 - 0.13 * (2.0 - x)) / 0.07) ** 2))
    return 0.013 * ridge * np.clip((x - 0.9) / 0.3, 0, 1) * np.clip((1.95 - x) / 0.3, 0, 1)


def axle_distance_m(x, z):
    """Distance in the side view to the nearer wheel centre."""
    return np.minimum(*(np.hypot(x - axle, z - AXLE_HEIGHT_M) for axle in AXLES_M))


def _flare_m(x, z):
    return 0.020 * np.exp(-(((axle_distance_m(x, z) - ARCH_RADIUS_M) / 0.085) ** 2))


def _flank_m(x, z):
    """A character line below the windows, a hollow under it and a swelling at the sill."""
    line = 0.70 + 0.035 * (0.6 - x)
    above = np.clip((line + 0.10 - z) / 0.10, 0, 1) * (z > line)
    below = np.exp(-(((line - z) / 0.055) ** 2)) * (z <= line)
    hollow = np.exp(-(((z - 0.49) / 0.12) ** 2)) * np.clip((0.95 - np.abs(x)) / 0.25, 0, 1)
    return 0.014 * (above + below) - 0.022 * hollow


# The cabin: stations by share of the height between its foot and the edge of the roof.
CABIN_FOOT_M = 0.88
_CABIN_LEVELS = (0.0, 0.25, 0.50, 0.75, 0.88, 0.94, 0.975, 0.993, 1.0)
_CABIN_WIDTH_M = (0.825, 0.795, 0.748, 0.688, 0.650, 0.628, 0.606, 0.582, 0.555)
_SCREEN_M = (1.26, 1.01, 0.75, 0.48, 0.335, 0.262, 0.21, 0.165, 0.12)
_REAR_M = (2.08, 2.02, 1.945, 1.865, 1.815, 1.785, 1.755, 1.72, 1.68)


def roof_edge_m(x):
    """Height of the edge of the roof."""
    return curve(x, (-1.85, -1.2, -0.5, 0.1, 0.4), (1.330, 1.375, 1.395, 1.385, 1.365))


def cabin_station(z):
    """(screen x, rear x, half width) of the cabin's outline at height z."""
    share = np.clip((z - CABIN_FOOT_M) / (1.37 - CABIN_FOOT_M), 0, 1)
    return (
        curve(share, _CABIN_LEVELS, _SCREEN_M),
        -curve(share, _CABIN_LEVELS, _REAR_M),
        curve(share, _CABIN_LEVELS, _CABIN_WIDTH_M),
    )


def cabin_shell(*, around=88, levels=9, lid=5):
    """Windscreen, sides, rear window and roof: open at the foot, which stands inside the lower body."""
    ring = outline(around, length_m=1.5, width_m=0.75, powers=(7.0, 2.8))
    share = np.concatenate([np.linspace(0, 0.88, levels), [0.92, 0.95, 0.972, 0.988, 0.997, 1.0]])
    rows = [_cabin_row(ring, v, inward=0.0) for v in share]
    rows += [_cabin_row(ring, 1.0, inward=t) for t in np.linspace(0, 1, lid + 1)[1:]]
    return grid(rows, closed=True)


def _cabin_row(ring, share, *, inward):
    screen, rear, width = (curve(share, _CABIN_LEVELS, v) for v in (_SCREEN_M, _REAR_M, _CABIN_WIDTH_M))
    middle, half = 0.5 * (screen - rear), 0.5 * (screen + rear)
    x = middle + ring[:, 0] * half * (1 - 0.42 * inward)
    y = ring[:, 1] * width * (1 - inward)
    z = CABIN_FOOT_M + share * (roof_edge_m(x) - CABIN_FOOT_M) + 0.062 * (1 - (1 - inward) ** 2)
    return np.stack([x, y, z], axis=1)
