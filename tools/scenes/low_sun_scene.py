"""The low sun scene: a road towards a sun 6 degrees up behind the crown of a tree, its shadows towards the sensor."""

import math

from scenefile import header, objects, place, primitive

SUN_DEG, EYE_M = 6.0, 1.9
TREE_AT_M = (35.0, 9.0)


def text():
    """The scene file. The sensor looks into the sun, through the crown of the tree on the left."""
    head = header(
        "low_sun",
        "a road towards a low sun: its disc between the leaves of a tree, poles, long shadows",
        made_by="make_scenes.py",
        sun={
            "azimuth_deg": round(math.degrees(math.atan2(TREE_AT_M[1], TREE_AT_M[0])), 3),
            "elevation_deg": SUN_DEG,
            "illuminance_klux": 60.0,
        },
        sky={"diffuse_share": 0.2},
        air={"transmittance": 1.0},
        sensor={"name": "table1-apd", "position_m": [0.0, 0.0, EYE_M]},
        picture={"eye_m": [-9.0, -4.0, 6.0], "target_m": [25.0, 0.0, 1.0], "fov_deg": 60.0},
    )
    poles = [place(x, y, 2.5) for x in (20.0, 30.0, 40.0) for y in (-4.5, 4.5)]
    trees = [place(*TREE_AT_M), place(TREE_AT_M[0], -TREE_AT_M[1], 0, 61)]
    return "\n".join(
        [
            head,
            primitive("road", "plane", "road", "asphalt", size_m=[100.0, 7.0], position_m=(45, 0, 0)),
            primitive("soil", "plane", "terrain", "soil", size_m=[100.0, 60.0], position_m=(45, 0, -0.05)),
            primitive("poles", "cylinder", "pole", "galvanised_steel", radius_m=0.05, height_m=5.0, instances=poles),
            objects("cars", "car", [place(15.0, 2.0, 0, 180), place(30.0, -2.0)], paint="car_paint_white"),
            objects("pedestrian", "pedestrian", [place(12.0, -3.0, 0, 180)]),
            objects("trees", "tree", trees),
        ]
    )
