"""What is bolted to the car: mirrors, plates, handles, grille bars, seats."""

import numpy as np
from cutting import split
from modelling import box, ellipsoid, join, rounded_box, tube


def outside_parts():
    """Part name -> list of meshes on the outside of the skin."""
    housing, arm, glass = _mirror()
    handles = [
        rounded_box(size_m=(0.20, 0.035, 0.034), centre_m=(x, 0.897, z), radius_m=0.014, corner=2)
        for x, z in ((-0.06, 0.80), (-1.03, 0.82))
    ]
    bars = [_bar(half_m=0.40, nose_m=2.168, z=z) for z in (0.585, 0.605, 0.625)]
    bars += [_bar(half_m=0.50, nose_m=2.140, z=z) for z in (0.295, 0.335)]
    wipers = [_wiper(foot_y=0.52), _wiper(foot_y=-0.08)]
    fin = ellipsoid(radii_m=(0.09, 0.018, 0.05), segments=10, rows=6).moved(position_m=(-1.45, 0, 1.435))
    return {
        "paint": [join(*handles).both_sides()],
        "trim": [*bars, *wipers, fin, _plate_frame(x=2.212), _plate_frame(x=-2.165)],
        "mirrors/paint": [housing.both_sides()],
        "mirrors/trim": [arm.both_sides()],
        "mirrors/chrome": [glass.both_sides()],
        "taillamp": [box(size_m=(0.012, 0.30, 0.022), centre_m=(-1.79, 0, 1.345))],
        "plate": [_plate(x=2.226, z=0.47), _plate(x=-2.190, z=0.60)],
    }


def _mirror():
    """(housing, arm, glass) of the mirror on the left."""
    place = (0.63, 0.945, 1.005)
    ball = ellipsoid(radii_m=(0.065, 0.115, 0.072), segments=20, rows=10, power=2.8)
    _, housing = split(ball, ball.points_m[:, 0] + 0.028)
    glass = ellipsoid(radii_m=(0.006, 0.108, 0.067), segments=20, rows=4, power=2.6)
    arm = tube([(0.66, 0.80, 0.955), (0.65, 0.86, 0.965), (0.64, 0.90, 0.975)], 0.022, segments=8)
    glass = glass.moved(position_m=np.add(place, (-0.026, 0, 0)))
    return housing.moved(position_m=place), arm, glass


def _plate(*, x, z):
    """A number plate of 520 x 110 mm, 8 mm thick."""
    return box(size_m=(0.008, 0.520, 0.110), centre_m=(x, 0, z))


def _plate_frame(*, x):
    """The holder behind a plate."""
    z, half = (0.47, 0.018) if x > 0 else (0.60, 0.040)
    centre = (x - np.sign(x) * half, 0, z)
    return box(size_m=(2 * half + 0.012, 0.54, 0.13), centre_m=centre)


def _bar(*, half_m, nose_m, z):
    """A bar across the grille, bent as the nose is."""
    y = half_m * np.linspace(-1, 1, 7)
    x = nose_m - 2.18 * (1 - (1 - (np.abs(y) / 0.88) ** 2.9) ** 0.125)
    return tube(np.column_stack([x, y, np.full(7, z)]), 0.007, segments=4)


def _wiper(*, foot_y):
    """A wiper at rest along the foot of the windscreen."""
    y = foot_y - np.array([0.0, 0.15, 0.35, 0.55])
    x = 1.165 - 0.20 * np.abs(y) ** 2.6 + np.array([0.02, 0.0, -0.03, -0.05])
    return tube(np.column_stack([x, y, 0.965 + np.array([0.0, 0.006, 0.012, 0.018])]), 0.008, segments=5)


def inside_parts():
    """Seats, dashboard, steering wheel and floor: what the glass lets one see."""
    seats = [_seat(x=0.05, y=y, width_m=0.50) for y in (-0.37, 0.37)] + [_seat(x=-0.88, y=0, width_m=1.25)]
    rests = [ellipsoid(radii_m=(0.05, 0.13, 0.09), segments=12, rows=7, power=2.6)]
    spots = [(-0.38, -0.37), (-0.38, 0.37), (-1.31, -0.37), (-1.31, 0.37)]
    heads = [rests[0].moved(position_m=(x, y, 1.17)) for x, y in spots]
    dash = rounded_box(size_m=(0.42, 1.42, 0.30), centre_m=(0.86, 0, 0.80), radius_m=0.08)
    turn = np.linspace(0, 2 * np.pi, 25)
    ring = np.column_stack([0.52 + 0.07 * np.sin(turn), 0.37 + 0.18 * np.cos(turn), 0.90 + 0.17 * np.sin(turn)])
    shelf = box(size_m=(0.42, 1.40, 0.02), centre_m=(-1.72, 0, 0.92))
    pan = box(size_m=(3.0, 1.08, 0.02), centre_m=(-0.15, 0, 0.27))
    bulkhead = box(size_m=(0.02, 1.5, 0.5), centre_m=(1.10, 0, 0.60))
    panels = box(size_m=(1.83, 0.02, 0.62), centre_m=(0.015, 0.75, 0.62))
    rail = box(size_m=(2.90, 0.02, 0.22), centre_m=(-0.35, 0.77, 0.81))
    doors = join(panels, rail).both_sides()
    return {"interior": [doors, *seats, *heads, dash, tube(ring, 0.014, segments=6), shelf, pan, bulkhead]}


def _seat(*, x, y, width_m):
    """Cushion and leaning backrest."""
    cushion = rounded_box(size_m=(0.52, width_m, 0.20), centre_m=(x, y, 0.50), radius_m=0.06)
    rest = rounded_box(size_m=(0.14, width_m, 0.64), radius_m=0.05)
    lean = np.array([[0.94, 0, 0.34], [0, 1, 0], [-0.34, 0, 0.94]]) / np.hypot(0.94, 0.34)
    return join(cushion, rest.turned(lean).moved(position_m=(x - 0.31, y, 0.80)))
