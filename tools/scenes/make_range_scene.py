"""The range scene: 10 % and 80 % boards every 50 m, under exactly the conditions of the paper's Table 1.

Every board faces the sensor, and the sun stands 60 degrees off every board's normal. With the sun behind the
sensor at elevation E, a board in direction (azimuth a, elevation e) sees it at

    cos(60 deg) = cos E cos e cos a - sin E sin e,

so the boards lie on an arc of the cone of 60 degrees about the line away from the sun: high in the middle
of the field of view, low at its sides. One arc holds 20 boards without one hiding another.
"""

import math

from scenefile import header, table

RANGES_M = tuple(range(50, 501, 50))
SUN_ELEVATION_DEG = 50.0
SUN_OFF_NORMAL_DEG = 60.0
SPACING_DEG = 5.4  # between the azimuths of two neighbours
SUBTENSE_DEG = 2.5  # side of each board, seen from the sensor: 12 x 12 beams of 0.2 degrees


def board_elevation_rad(*, azimuth_rad):
    """Elevation on the arc, from C cos e - S sin e = cos(60 deg), C = cos E cos a, S = sin E."""
    sun = math.radians(SUN_ELEVATION_DEG)
    c, s = math.cos(sun) * math.cos(azimuth_rad), math.sin(sun)
    return math.acos(math.cos(math.radians(SUN_OFF_NORMAL_DEG)) / math.hypot(c, s)) - math.atan2(s, c)


def board(*, range_m, azimuth_deg, percent):
    """One board: a plane whose normal (its local +z, hence pitch 90 + e) points back at the sensor."""
    a = math.radians(azimuth_deg)
    e = board_elevation_rad(azimuth_rad=a)
    side = 2 * range_m * math.tan(math.radians(SUBTENSE_DEG / 2))
    x, y = math.cos(e) * math.cos(a), math.cos(e) * math.sin(a)
    return table(
        "[[bodies]]",
        name=f"board_{percent}_{range_m}m",
        primitive="plane",
        **{"class": f"target_{percent}"},
        material=f"board_{percent}",
        size_m=[side, side],
        position_m=[range_m * x, range_m * y, range_m * math.sin(e)],
        yaw_deg=azimuth_deg,
        pitch_deg=90.0 + math.degrees(e),
    )


def text():
    """The scene file: 10 % boards on the left, 80 % boards on the right, the farthest in the middle."""
    head = header(
        "range",
        "10 % and 80 % Lambertian boards every 50 m to 500 m, sun 60 degrees off each (Table 1)",
        made_by="make_range_scene.py",
        sun={"azimuth_deg": 180.0, "elevation_deg": SUN_ELEVATION_DEG, "illuminance_klux": 100.0},
        sky={"diffuse_share": 0.0},
        air={"transmittance": 0.98},
        sensor={"name": "table1-apd", "position_m": [0.0, 0.0, 0.0]},
        picture={"eye_m": [-260.0, 0.0, 160.0], "target_m": [200.0, 0.0, 20.0], "fov_deg": 70.0},
    )
    boards = [table(f"[materials.board_{percent}]", bsdf="diffuse", reflectivity=percent / 100) for percent in (10, 80)]
    for i, range_m in enumerate(reversed(RANGES_M)):
        azimuth_deg = SPACING_DEG * (i + 0.5)
        boards.append(board(range_m=range_m, azimuth_deg=azimuth_deg, percent=10))
        boards.append(board(range_m=range_m, azimuth_deg=-azimuth_deg, percent=80))
    return "\n".join([head, *boards])
