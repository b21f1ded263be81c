"""What stands along a road: kerb, traffic sign, lamp post, bollard."""

import numpy as np
from modelling import box, cap, circle, closed_loft, join, lathe, rounded_box, tube

COLOURS = {
    "pole": (0.60, 0.61, 0.62, 1.0),
    "sign_face": (0.85, 0.12, 0.10, 1.0),
    "sign_back": (0.45, 0.46, 0.47, 1.0),
    "head": (0.30, 0.31, 0.32, 1.0),
    "lens": (0.90, 0.90, 0.85, 1.0),
    "bollard": (0.10, 0.10, 0.11, 1.0),
    "band": (0.90, 0.90, 0.90, 1.0),
}
KERB_LENGTH_M = 2.0


def kerb():
    """A kerb stone of 2 m along x, 0.15 m wide, 0.12 m high; the rounded edge is at -y, towards the road."""
    turn = 0.5 * np.pi * np.arange(9) / 8
    arc = np.stack([-0.035 - 0.04 * np.sin(turn), 0.08 + 0.04 * np.cos(turn)], axis=1)
    profile = np.vstack([[0.075, 0.0], [0.075, 0.114], [0.069, 0.12], arc, [-0.075, 0.0]])
    along = np.array([-1.0, -0.996, -0.5, 0.0, 0.5, 0.996, 1.0]) * KERB_LENGTH_M / 2
    rings = np.zeros((len(along), len(profile), 3))
    rings[:, :, 0] = along[:, None]
    rings[:, :, 1:] = profile
    rings[[0, -1], :, 1:] = profile * 0.98 + (0, 0.0012)  # a small joint between two stones
    return {"kerb": closed_loft(rings)}


def sign():
    """A round sign of 0.6 m on a pole, facing +x."""
    pole = lathe([(0.002, 0.0), (0.030, 0.0), (0.030, 2.86), (0.024, 2.875), (0.010, 2.88)], segments=16)
    top = cap(np.column_stack([circle(16, radius_m=0.010), np.full(16, 2.88)]))
    clamps = [box(size_m=(0.050, 0.10, 0.035), centre_m=(0.022, 0, z)) for z in (2.38, 2.72)]
    upright = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]  # local z looks along +x
    place = {"position_m": (0.045, 0, 2.55)}
    back = lathe([(0.292, 0.0), (0.300, 0.0), (0.300, 0.006), (0.292, 0.006)], segments=48)
    plate = cap(np.column_stack([circle(48, radius_m=0.295), np.full(48, 0.0005)])).flipped()
    face = cap(np.column_stack([circle(48, radius_m=0.293), np.full(48, 0.005)]))
    return {
        "pole": join(pole, top, *clamps),
        "sign_face": face.turned(upright).moved(**place),
        "sign_back": join(back, plate).turned(upright).moved(**place),
    }


def lamp_post():
    """A street lamp of 8 m whose arm reaches 1.5 m along +x."""
    shaft = lathe(
        [(0.002, 0), (0.16, 0), (0.16, 0.03), (0.095, 0.05), (0.095, 1.2), (0.075, 1.25), (0.045, 7.2)], segments=20
    )
    bend = np.linspace(0, 0.5 * np.pi, 9)
    arm = np.column_stack([0.7 * (1 - np.cos(bend)), np.zeros(9), 7.19 + 0.7 * np.sin(bend)])
    arm = np.vstack([arm, [1.2, 0, 7.90]])
    head = rounded_box(size_m=(0.70, 0.28, 0.11), centre_m=(1.35, 0, 7.905), radius_m=0.05)
    lens = rounded_box(size_m=(0.45, 0.20, 0.05), centre_m=(1.40, 0, 7.85), radius_m=0.022)
    door = box(size_m=(0.012, 0.09, 0.40), centre_m=(-0.094, 0, 0.75))
    pole = join(shaft, tube(arm, np.linspace(0.045, 0.035, 10), segments=14), door)
    return {"pole": pole, "head": head, "lens": lens}


def bollard():
    """A bollard of 0.9 m with a reflecting band."""
    turn = 0.5 * np.pi * np.arange(7) / 6
    dome = [(0.055 * np.cos(a), 0.84 + 0.055 * np.sin(a)) for a in turn[:-1]]
    body = lathe([(0.002, 0.0), (0.075, 0.0), (0.075, 0.05), (0.055, 0.08), *dome, (0.004, 0.8952)], segments=24)
    tip = cap(np.column_stack([circle(24, radius_m=0.004), np.full(24, 0.8952)]))
    band = lathe([(0.055, 0.678), (0.057, 0.68), (0.057, 0.76), (0.055, 0.762)], segments=24)
    return {"bollard": join(body, tip), "band": band}
