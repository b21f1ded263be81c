"""The retro scene: boards of known reflectivity beside plates, signs, posts and vests that shine back, at known ranges.

Each row is an arc around the sensor: every board and plate is at the row's range and faces the sensor.
"""

import math

from scenefile import header, objects, place, primitive, table

HEIGHT_M = 1.5  # of the sensor
ROWS = {10: 13.0, 20: -18.0, 40: -44.0}  # range to the azimuth of a row's right end, in degrees
SPACING_DEG = {10: 6.5, 20: 4.0, 40: 3.2}  # from one thing to the next
BOARDS = (10, 50, 80)  # percent
VEST_SOURCE = "chinareflective.com/de/faqs/what_is_the_requirements_of_ansi/isea_107.html"
SOURCE = "angelfire.com/trek/cityton/american.htm, a copy of ASTM D4956-01; not read in the standard itself"


def text():
    """The scene file."""
    head = header(
        "retro",
        "boards of 10, 50 and 80 % beside number plates, signs, posts and vests, at 10, 20 and 40 m",
        made_by="make_scenes.py",
        sun={"azimuth_deg": 160.0, "elevation_deg": 40.0, "illuminance_klux": 50.0},
        sky={"diffuse_share": 0.2},
        air={"transmittance": 1.0},
        sensor={"name": "table1-apd", "position_m": [0.0, 0.0, HEIGHT_M]},
        picture={"eye_m": [-8.0, -1.0, 5.5], "target_m": [15.0, 0.5, 0.3], "fov_deg": 72.0},
    )
    ground = primitive("road", "plane", "road", "asphalt", size_m=[70.0, 90.0], position_m=(25, -8, 0))
    rows = [body for range_m in ROWS for body in _row(range_m)]
    return "\n".join([head, *_materials(), ground, *rows])


def _materials():
    boards = [table(f"[materials.board_{percent}]", bsdf="diffuse", reflectivity=percent / 100) for percent in BOARDS]
    plate = {
        "description": "white enclosed-lens sheeting, type I, in place of a number plate's own, which was not found",
        "bsdf": "retroreflector",
        "reflectivity": 0.3,
        "retro_coefficient_cd_per_lx_m2": 70.0,
        "retro_source": f"type I white, 0.2 deg observation, -4 deg entrance: {SOURCE}",
        "retro_half_angle_deg": 0.41,
        "retro_half_angle_source": "computed: Gaussian lobe through 70 at 0.2 deg and 30 at 0.5 deg of the same table",
    }
    tape = {
        "description": "silver tape of a vest, level 2",
        "bsdf": "retroreflector",
        "reflectivity": 0.3,
        "retro_coefficient_cd_per_lx_m2": 330.0,
        "retro_source": f"least of level 2 of ANSI/ISEA 107 at 12 min and 5 deg: {VEST_SOURCE}",
        "retro_half_angle_deg": 0.39,
        "retro_half_angle_source": "estimate: as type III sheeting",
    }
    return [*boards, table("[materials.plate]", **plate), table("[materials.vest_tape]", **tape)]


def _row(range_m):
    """Three boards, a number plate, a sign, a post and a vest, from the left to the right."""
    spots = [ROWS[range_m] + SPACING_DEG[range_m] * number for number in reversed(range(7))]
    boards = [
        part
        for percent, azimuth_deg in zip(BOARDS, spots, strict=False)
        for part in _facing(
            f"board_{percent}_{range_m}m",
            f"target_{percent}",
            f"board_{percent}",
            range_m=range_m,
            azimuth_deg=azimuth_deg,
            size_m=[1.0, 1.0],
            height_m=1.2,
        )
    ]
    plate, sign, post, vest = spots[3:]
    return [
        *boards,
        *_facing(
            f"plate_{range_m}m", "plate", "plate", range_m=range_m, azimuth_deg=plate, size_m=[0.11, 0.52], height_m=0.8
        ),
        objects(f"sign_{range_m}m", "sign", [_at(range_m, sign)]),
        objects(f"post_{range_m}m", "bollard", [_at(range_m, post)]),
        *_vest(range_m, vest),
    ]


def _at(range_m, azimuth_deg, height_m=0.0):
    a = math.radians(azimuth_deg)
    return place(range_m * math.cos(a), range_m * math.sin(a), height_m, azimuth_deg + 180.0)


def _facing(name, kind, material, *, range_m, azimuth_deg, size_m, height_m):
    """A plate whose middle is at the range, square to the beam, on a leg."""
    a, e = math.radians(azimuth_deg), math.asin((height_m - HEIGHT_M) / range_m)
    x, y = math.cos(e) * math.cos(a), math.cos(e) * math.sin(a)
    leg_m = height_m - 0.5 * size_m[0]
    behind = 1.0 + 0.03 / range_m
    return [
        primitive(
            name,
            "plane",
            kind,
            material,
            size_m=size_m,
            position_m=(range_m * x, range_m * y, height_m),
            yaw_deg=azimuth_deg,
            pitch_deg=90.0 + math.degrees(e),
        ),
        primitive(
            f"{name}_leg",
            "cylinder",
            "pole",
            "galvanised_steel",
            radius_m=0.02,
            height_m=leg_m,
            position_m=(behind * range_m * x, behind * range_m * y, 0.5 * leg_m),
        ),
    ]


def _vest(range_m, azimuth_deg):
    """Somebody who looks at the sensor, with two bands of tape on the chest."""
    a = math.radians(azimuth_deg)
    chest_m = range_m - 0.2
    bands = [
        {"position_m": [chest_m * math.cos(a), chest_m * math.sin(a), z], "yaw_deg": azimuth_deg} for z in (1.05, 1.25)
    ]
    return [
        objects(f"worker_{range_m}m", "pedestrian", [_at(range_m, azimuth_deg)]),
        primitive(f"vest_{range_m}m", "box", "vest", "vest_tape", size_m=[0.01, 0.36, 0.05], instances=bands),
    ]
