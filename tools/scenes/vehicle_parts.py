"""What is fixed to vehicles: wheels, mirrors, plates, seats, and the people who ride on two wheels."""

import numpy as np
from glb import Clip, Skeleton, Skinned
from modelling import box, cap, circle, curve, ellipsoid, grid, join, lathe, rounded_box, tube

UPRIGHT = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # local z becomes the axle, to the left

WHEELS = ("tyre", "rim")
"""Parts that turn."""
SPOKES = 5
"""Of a wheel, which is the same again after so many parts of a turn."""
FLAT_M = 0.005
"""Most by which a tyre is flat where it bears."""


def wheel(*, diameter_m, width_m, segments=4 * SPOKES, rim_share=0.66):
    """(tyre, rim) of a wheel that stands on the ground, its outside to the left; both closed."""
    r, w = 0.5 * diameter_m, 0.5 * width_m
    inner = rim_share * r
    profile = [(inner, -0.8 * w), (0.5 * (r + inner), -w), (r, -0.75 * w), (r, 0.75 * w)]
    profile += [(0.5 * (r + inner), w), (inner, 0.8 * w), (inner, -0.8 * w)]
    disc = inner - 0.003
    dish = [
        (disc, -0.7 * w),
        (disc, 0.72 * w),
        (0.86 * inner, 0.72 * w),
        (0.80 * inner, 0.2 * w),
        (0.25 * inner, 0.3 * w),
    ]
    rim = lathe(dish, segments=segments)
    ends = [
        cap(np.column_stack([circle(segments, radius_m=0.25 * inner), np.full(segments, 0.3 * w)])),
        cap(np.column_stack([circle(segments, radius_m=disc), np.full(segments, -0.7 * w)])).flipped(),
    ]
    spoke = box(size_m=(0.62 * inner, 0.16 * inner, 0.3 * w), centre_m=(0.55 * inner, 0, 0.42 * w))
    spokes = [spoke.moved(yaw_rad=2 * np.pi * (turn + 0.25) / SPOKES) for turn in range(SPOKES)]
    meshes = lathe(profile, segments=segments), join(rim, *ends, *spokes)
    return tuple(mesh.turned(UPRIGHT).moved(position_m=(0.0, 0.0, r)) for mesh in meshes)


def wheels(*, axles_x_m, half_track_m, **keys):
    """Tyres and rims of all axles of a vehicle with wheels on both sides."""
    return {
        name: join(*(mesh.moved(position_m=(x, half_track_m, 0.0)) for x in axles_x_m)).both_sides()
        for name, mesh in zip(("tyre", "rim"), wheel(**keys), strict=True)
    }


def ring(path, radius, segments=24):
    """A closed ring of `radius` about the y axis through the origin; `path` is the radius of its own section."""
    turn = 2 * np.pi * np.arange(segments) / segments
    around = circle(6)
    rings = np.zeros((segments, 6, 3))
    rings[..., 0] = (radius + path * around[:, 0]) * np.cos(turn)[:, None]
    rings[..., 2] = (radius + path * around[:, 0]) * np.sin(turn)[:, None]
    rings[..., 1] = path * around[:, 1]
    return grid(np.concatenate([rings, rings[:1]]), closed=True)


def nearest_axle(points_m, axles_m):
    """(v,) number of the axle on which each point of wheels turns; (axles, 3) are as high as their wheels are large."""
    off_m = np.linalg.norm((points_m[:, None] - axles_m)[:, :, [0, 2]], axis=2) - axles_m[:, 2]
    if off_m.min(axis=1).max() > FLAT_M:
        raise ValueError("a part of a wheel is on no axle")
    return off_m.argmin(axis=1)


def rolling(parts, axles_m, *, turns, keys=0):
    """Parts with their wheels `Skinned`, and the `Skeleton` by which they roll.

    Args:
        turns: of the largest wheel in a stride, as from one spoke to the next; smaller ones turn faster
        keys: key frames of the stride, if more than the wheels need
    """
    axles_m = np.asarray(axles_m)
    joints = [f"axle_{number}" for number in range(len(axles_m))]
    carried = {name: np.eye(len(joints))[nearest_axle(parts[name].points_m, axles_m)] for name in WHEELS}
    parts = {name: Skinned(mesh, carried[name]) if name in carried else mesh for name, mesh in parts.items()}
    most_rad = 2.0 * np.pi * turns * axles_m[:, 2].max() / axles_m[:, 2]
    # From one key frame to the next a turn goes the shorter way.
    shares = np.linspace(0.0, 1.0, 1 + max(keys, int(np.ceil(most_rad.max() / (0.5 * np.pi)))))
    angles = {joint: np.outer(shares, (0.0, -angle, 0.0)) for joint, angle in zip(joints, most_rad, strict=True)}
    places_m = dict(zip(joints, axles_m, strict=True))
    return parts, Skeleton(places_m, dict.fromkeys(joints, ""), {"roll": Clip(turns, angles)})


def mirrors(*, x_m, y_m, z_m, size_m):
    """Both outside mirrors, on arms from |y| of the body."""
    depth, width, height = size_m
    housing = rounded_box(size_m=size_m, centre_m=(x_m, y_m + 0.06 + 0.5 * width, z_m), radius_m=0.3 * depth, corner=2)
    arm = box(size_m=(0.4 * depth, 0.14, 0.25 * height), centre_m=(x_m + 0.01, y_m + 0.03, z_m - 0.3 * height))
    return join(housing, arm).both_sides()


def plate(*, x_m, z_m, size_m=(0.52, 0.11)):
    """A number plate, 20 mm thick, most of it in the body."""
    return box(size_m=(0.020, *size_m), centre_m=(x_m, 0.0, z_m))


def seat(*, x_m, y_m, z_m, width_m):
    """Cushion, leaning backrest and its top."""
    cushion = box(size_m=(0.50, width_m, 0.18), centre_m=(x_m, y_m, z_m))
    lean = np.array([[0.94, 0, 0.34], [0, 1, 0], [-0.34, 0, 0.94]]) / np.hypot(0.94, 0.34)
    rest = box(size_m=(0.13, 0.96 * width_m, 0.72)).turned(lean).moved(position_m=(x_m - 0.33, y_m, z_m + 0.36))
    return join(cushion, rest)


def sitting_leg(*, seat_m, foot_m, height_m, side, bent=0.19):
    """(hip, knee, ankle) of a leg of a `rider`, whose foot is at `foot_m`; `side` is 1 to the left."""
    size = (height_m - seat_m[1]) / 0.80
    hip = np.array([seat_m[0] + 0.03, side * 0.09 * size, seat_m[1] + 0.02])
    ankle = np.add(foot_m, (-0.03, 0.0, 0.09))
    return hip, np.add(0.5 * (hip + ankle), (bent * size, side * 0.03, 0.05 * size)), ankle


def rider(*, seat_m, hands_m, feet_m, height_m, lean_m, bent=0.19):
    """Someone who sits on a bicycle or a motorcycle: part name -> Mesh.

    Args:
        seat_m: (x, z) of the saddle
        hands_m, feet_m: (x, y, z) on the left; the right foot of (3, 2) `feet_m` is the second
        height_m: of the helmet's top
        lean_m: how far the shoulders are before the hips
        bent: how far knees are before the middle between hip and foot, times 1.75 m over the stature
    """
    size = (height_m - seat_m[1]) / 0.80
    hip, shoulder = (
        np.array([seat_m[0], 0.0, seat_m[1] + 0.04]),
        np.array([seat_m[0] + lean_m, 0.0, height_m - 0.37 * size]),
    )
    middle = np.add(0.5 * (hip + shoulder), (-0.04 * size, 0.0, 0.02))
    path = np.stack(
        [curve(np.linspace(0, 1, 6), (0, 0.5, 1), axis) for axis in np.transpose([hip, middle, shoulder])], 1
    )
    torso = tube(path, np.array([0.13, 0.14, 0.135, 0.13, 0.125, 0.07]) * size, segments=10, flatten=1.35)
    arms, legs, shoes, hands = [], [], [], []
    for side, foot in zip((1, -1), feet_m, strict=True):
        grip = np.array(hands_m) * (1, side, 1)
        from_m = np.add(shoulder, (0.0, side * 0.17 * size, -0.03))
        elbow = np.add(0.5 * (from_m + grip), (-0.04, side * 0.02 * size, -0.06 * size))
        arms.append(tube([from_m, elbow, grip], np.array([0.055, 0.048, 0.036]) * size, segments=8))
        hands.append(
            ellipsoid(radii_m=(0.05, 0.04, 0.035), segments=8, rows=5).moved(position_m=np.add(grip, (0.02, 0, 0)))
        )
        joints = sitting_leg(seat_m=seat_m, foot_m=foot, height_m=height_m, side=side, bent=bent)
        legs.append(tube(joints, np.array([0.085, 0.062, 0.048]) * size, segments=8))
        shoes.append(
            ellipsoid(radii_m=(0.14, 0.047, 0.05), segments=10, rows=6).moved(position_m=np.add(foot, (0.03, 0, 0.045)))
        )
    head = np.add(shoulder, (0.05 * size, 0.0, 0.22 * size))
    helmet = ellipsoid(radii_m=(0.125, 0.105, 0.13), segments=12, rows=8)
    crown = np.array([head[0], 0.0, height_m - 0.13])
    face = ellipsoid(radii_m=(0.10, 0.075, 0.115), segments=10, rows=7).moved(
        position_m=np.add(crown, (0.03, 0.0, -0.075))
    )
    neck = tube([np.add(shoulder, (0, 0, -0.02)), np.add(crown, (0.0, 0.0, -0.08))], 0.052 * size, segments=8)
    return {
        "clothes": join(torso, *arms),
        "trousers": join(*legs),
        "shoes": join(*shoes),
        "skin": join(face, neck, *hands),
        "helmet": helmet.moved(position_m=crown),
    }
