"""The glass scene: a shop front with things behind its window, a wall mirror, and a parked car to look through."""

from scenefile import header, objects, place, primitive

FRONT_M, DEPTH_M, HEIGHT_M = 12.0, 4.5, 3.0  # x of the shop's front, its depth, its height
LEFT_M, RIGHT_M = 6.4, -1.0  # y of its outer walls
WINDOW = {"sill_m": 0.4, "top_m": 2.7, "left_m": 5.6, "right_m": -0.2}


def text():
    """The scene file. The shop is ahead to the left, the mirror between shop and car, the car to the right."""
    head = header(
        "glass",
        "a shop window with figures behind it, a mirror that shows a man who stands elsewhere, a car's windows",
        made_by="make_scenes.py",
        sun={"azimuth_deg": 150.0, "elevation_deg": 35.0, "illuminance_klux": 60.0},
        sky={"diffuse_share": 0.2},
        air={"visibility_km": 20.0, "model": "kruse"},
        sensor={"name": "table1-apd", "position_m": [0.0, 0.0, 1.7]},
        picture={"eye_m": [-3.0, -1.0, 4.2], "target_m": [11.0, -0.8, 1.0], "fov_deg": 64.0},
    )
    return "\n".join([head, *_ground(), *_shop(), *_inside(), *_mirror(), *_street()])


def _ground():
    return [
        primitive("road", "plane", "road", "asphalt", size_m=[60.0, 60.0], position_m=(15, 0, 0)),
        primitive("pavement", "box", "sidewalk", "concrete", size_m=[4.0, 12.0, 0.1], position_m=(10.4, 2.7, 0.05)),
    ]


def _shop():
    middle, width = 0.5 * (LEFT_M + RIGHT_M), LEFT_M - RIGHT_M
    back = FRONT_M + DEPTH_M
    across = WINDOW["left_m"] - WINDOW["right_m"]
    centre = 0.5 * (WINDOW["left_m"] + WINDOW["right_m"])
    sides = [(LEFT_M, WINDOW["left_m"]), (WINDOW["right_m"], RIGHT_M)]
    front = [  # y, z, width, height of the masonry around the window
        *((0.5 * (a + b), 0.5 * HEIGHT_M, a - b, HEIGHT_M) for a, b in sides),
        (centre, 0.5 * WINDOW["sill_m"], across, WINDOW["sill_m"]),
        (centre, 0.5 * (WINDOW["top_m"] + HEIGHT_M), across, HEIGHT_M - WINDOW["top_m"]),
    ]
    parts = [
        primitive(f"front_{number}", "box", "building", "brick", size_m=[0.3, w, h], position_m=(FRONT_M, y, z))
        for number, (y, z, w, h) in enumerate(front)
    ]
    inside = FRONT_M + 0.5 * DEPTH_M
    walls = [place(inside, y, 0.5 * HEIGHT_M) for y in (LEFT_M, RIGHT_M)]
    return [
        *parts,
        primitive(
            "window",
            "plane",
            "window",
            "shop_window",
            size_m=[WINDOW["top_m"] - WINDOW["sill_m"], across],
            position_m=(FRONT_M, centre, 0.5 * (WINDOW["top_m"] + WINDOW["sill_m"])),
            pitch_deg=90.0,
        ),
        primitive("side_walls", "box", "building", "plaster_white", size_m=[DEPTH_M, 0.2, HEIGHT_M], instances=walls),
        primitive(
            "back_wall",
            "box",
            "building",
            "plaster_white",
            size_m=[0.2, width, HEIGHT_M],
            position_m=(back, middle, 0.5 * HEIGHT_M),
        ),
        primitive(
            "ceiling",
            "box",
            "building",
            "concrete",
            size_m=[DEPTH_M + 0.3, width + 0.2, 0.2],
            position_m=(inside, middle, HEIGHT_M + 0.1),
        ),
        primitive(
            "floor", "box", "building", "wood", size_m=[DEPTH_M, width - 0.2, 0.1], position_m=(inside, middle, 0.1)
        ),
    ]


def _inside():
    figures = [place(FRONT_M + 1.4, y, 0.15, 180 + turn) for y, turn in ((4.3, 20), (2.6, -10), (1.0, -30))]
    return [
        objects("figures", "pedestrian", figures),
        primitive("counter", "box", "furniture", "wood", size_m=[0.6, 3.0, 1.0], position_m=(FRONT_M + 3.0, 3.6, 0.65)),
    ]


def _mirror():
    """It turns beams at 22 degrees to the right by 82 degrees, towards the man who stands there."""
    return [
        primitive(
            "mirror",
            "plane",
            "mirror",
            "mirror_aluminium",
            size_m=[2.2, 2.0],
            position_m=(11.0, -3.2, 1.3),
            yaw_deg=33.0,
            pitch_deg=90.0,
        ),
        primitive(
            "mirror_back",
            "plane",
            "furniture",
            "wood",
            size_m=[2.3, 2.1],
            position_m=(11.02, -3.187, 1.3),
            yaw_deg=33.0,
            pitch_deg=90.0,
        ),
        objects("mirrored_man", "pedestrian", [place(10.3, -8.2, 0.0, 90)]),
    ]


def _street():
    return [
        objects("car", "car", [place(14.5, -8.0, 0, 90)], paint="car_paint_red"),
        primitive("wall", "box", "building", "brick", size_m=[0.3, 16.0, 3.2], position_m=(20.5, -9.0, 1.6)),
        objects("tree", "tree", [place(17.8, -3.4, 0)]),
    ]
