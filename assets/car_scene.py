"""The car scene: one car on a road in the sun, seen at three quarters from the roadside 22 m off."""

import math

from scenefile import header, objects, place, primitive

CAR_AT_M, SENSOR_AT_M = (0.0, 1.75), (-18.5, -10.5)


def text():
    """The scene file. The road runs along x; the car comes towards the sensor, on the far lane."""
    towards = math.atan2(CAR_AT_M[1] - SENSOR_AT_M[1], CAR_AT_M[0] - SENSOR_AT_M[0])
    head = header(
        "car",
        "one car on a sunlit road with kerb, pavement, grass, tree, pedestrian and sign",
        made_by="make_scenes.py",
        sun={"azimuth_deg": 140.0, "elevation_deg": 40.0, "illuminance_klux": 100.0},
        sky={"diffuse_share": 0.1},
        air={"visibility_km": 23.0, "model": "kruse"},
        sensor={
            "name": "table1-apd",
            "position_m": [*SENSOR_AT_M, 1.8],
            "yaw_deg": round(math.degrees(towards), 2),
            "pitch_deg": -2.0,
        },
        picture={"eye_m": [-15.5, -7.5, 3.2], "target_m": [2.0, 3.2, 1.3], "fov_deg": 44.0},
    )
    return "\n".join([head, *_ground(), *_markings(), *_things()])


def _ground():
    east, kerbs = 20.0, []
    for x in range(-39, 80, 2):
        kerbs.append(place(x, 3.575))
        if not -24 < x < -13:  # the mouth of the side road in which the sensor stands
            kerbs.append(place(x, -3.575, yaw_deg=180))
    return [
        primitive("road", "plane", "road", "asphalt", size_m=[120.0, 7.0], position_m=(east, 0, 0)),
        primitive("side_road", "plane", "road", "asphalt", size_m=[10.0, 26.5], position_m=(-18, -16.75, 0)),
        primitive("pavement", "box", "pavement", "concrete", size_m=[120.0, 2.5, 0.12], position_m=(east, 4.9, 0.06)),
        primitive("lawn", "box", "terrain", "grass", size_m=[120.0, 40.0, 0.1], position_m=(east, 26.15, 0.05)),
        primitive(
            "verge_west", "box", "terrain", "grass", size_m=[17.0, 26.35, 0.1], position_m=(-31.5, -16.825, 0.05)
        ),
        primitive("verge_east", "box", "terrain", "grass", size_m=[93.0, 26.35, 0.1], position_m=(33.5, -16.825, 0.05)),
        objects("kerb", "kerb", kerbs),
    ]


def _markings():
    dashes = [place(x, 0, 0.003) for x in range(-34, 80, 6)]
    edges = [place(20, y, 0.003) for y in (3.3, -3.3)]
    return [
        primitive("dashes", "plane", "lane_marking", "lane_marking", size_m=[3.0, 0.12], instances=dashes),
        primitive("edge_lines", "plane", "lane_marking", "lane_marking", size_m=[120.0, 0.12], instances=edges),
    ]


def _things():
    return [
        objects("car", "car", [place(*CAR_AT_M, yaw_deg=180)], paint="car_paint_white"),
        objects("pedestrian", "pedestrian", [place(-2.6, 5.0, 0.12, 180)]),
        objects(
            "tree",
            "tree",
            [
                place(-0.5, 9.5, 0.1),
                place(20.0, 8.0, 0.1, 130),
                place(-11.0, 9.0, 0.1, 250),
                place(4.0, -12.5, 0.1, 20),
            ],
        ),
        objects("sign", "sign", [place(-7.5, 4.0, 0.12, 180)]),
        objects("lamp_post", "lamp_post", [place(9.5, 3.95, 0.12, -90)]),
        objects("house", "house", [place(22.0, 19.0, 0.05, -90), place(32.0, 19.0, 0.05, -90)]),
    ]
