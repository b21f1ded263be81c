"""The car scene: one car on a road in the sun, seen at three quarters from the roadside 22 m off."""

import math

from scenefile import header, in_row, objects, paint, place, sheet

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
        ground={"roughness": "C"},
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
    """Sheets, with kerbs on both sides but for the mouth of the side road in which the sensor stands."""
    kerbs = {
        "kerb_north": (-40.0, 80.0, 3.575),
        "kerb_south_west": (-40.0, -24.0, -3.575),
        "kerb_south_east": (-14.0, 80.0, -3.575),
    }
    return [
        sheet("road", "road", "asphalt", [120.0, 7.0], (20, 0, 0), crown_m=0.06),
        sheet("side_road", "road", "asphalt", [10.0, 26.5], (-18, -16.75, 0)),
        sheet("pavement", "pavement", "concrete", [120.0, 2.5], (20, 4.9, 0.12), kerb_m=0.2),
        sheet("lawn", "terrain", "grass", [120.0, 40.0], (20, 26.15, 0.1), kerb_m=0.2, spacing_m=2.0),
        sheet("verge_west", "terrain", "grass", [17.0, 26.35], (-31.5, -16.825, 0.1), kerb_m=0.2, spacing_m=2.0),
        sheet("verge_east", "terrain", "grass", [93.0, 26.35], (33.5, -16.825, 0.1), kerb_m=0.2, spacing_m=2.0),
        *(
            sheet(name, "kerb", "concrete", [end - start, 0.15], ((start + end) / 2, y, 0.12), kerb_m=0.2)
            for name, (start, end, y) in kerbs.items()
        ),
    ]


def _markings():
    dashes = [place(x, 0, 0.003) for x in range(-34, 80, 6)]
    edges = [place(20, y, 0.003) for y in (3.3, -3.3)]
    return [paint("dashes", [3.0, 0.12], dashes), paint("edge_lines", [120.0, 0.12], edges)]


def _things():
    along, back, up = in_row(1)
    return [
        objects("car", "car", [place(*CAR_AT_M, yaw_deg=180)], on_ground=True, paint="car_paint_white"),
        objects("pedestrian", "pedestrian", [place(-2.6, 5.0, 0, 180)], on_ground=True),
        objects(
            "tree",
            "tree",
            [place(-0.5, 9.5), place(20.0, 8.0, 0, 130), place(-11.0, 9.0, 0, 250), place(4.0, -12.5, 0, 20)],
            on_ground=True,
        ),
        objects("sign", "sign", [place(-7.5, 4.0, 0, 180)], on_ground=True),
        objects("lamp_post", "lamp_post", [place(9.5, 3.95, 0, -90)], on_ground=True),
        objects("house", "house", [place(22.0, 19.0, 0, -90), place(32.0 + along, 19.0 + back, up, -90)]),
    ]
