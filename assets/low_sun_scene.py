"""The low sun scene: a road towards a sun 5 degrees high, with poles before its disc and shadows towards the sensor."""

import math

from scenefile import header, objects, place, primitive

SUN_DEG, EYE_M = 5.0, 1.9


def text():
    """The scene file. The sensor looks into the sun."""
    head = header(
        "low_sun",
        "a road towards a low sun: its disc in the field of view, thin poles before it, long shadows",
        made_by="make_scenes.py",
        sun={"azimuth_deg": 0.0, "elevation_deg": SUN_DEG, "illuminance_klux": 60.0},
        sky={"diffuse_share": 0.2},
        air={"transmittance": 1.0},
        sensor={"name": "table1-apd", "position_m": [0.0, 0.0, EYE_M]},
        picture={"eye_m": [-9.0, -4.0, 6.0], "target_m": [25.0, 0.0, 1.0], "fov_deg": 60.0},
    )
    # Thin signs on the way to the sun: narrower than the receiver's field of view, or than the disc.
    height = EYE_M + 25.0 * math.tan(math.radians(SUN_DEG))
    poles = [place(25.0, y, 2.5) for y in (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0)]
    return "\n".join(
        [
            head,
            primitive("road", "plane", "road", "asphalt", size_m=[100.0, 7.0], position_m=(45, 0, 0)),
            primitive("soil", "plane", "terrain", "soil", size_m=[100.0, 60.0], position_m=(45, 0, -0.05)),
            primitive(
                "poles", "cylinder", "pole", "galvanised_steel", radius_m=0.05, height_m=5.0, instances=poles
            ),
            primitive(
                "beam", "box", "pole", "galvanised_steel", size_m=[0.05, 6.0, 0.1], position_m=(25.0, 0, height)
            ),
            objects("cars", "car", [place(15.0, 3.0, 0, 180), place(30.0, -3.5)], paint="car_paint_white"),
            objects("pedestrian", "pedestrian", [place(12.0, -3.0, 0, 180)]),
            objects("trees", "tree", [place(35.0, s * 9.0, 0, 61 * s) for s in (1, -1)]),
        ]
    )
