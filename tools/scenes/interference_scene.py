"""The interference scene: a road at night, and a car that comes with its headlights and a lidar of its own."""

from fog_scene import ground, roadside
from scenefile import header, objects, place, table

LAMPS_W_M2 = 0.01  # halogen headlights, in the band of 905 nm
PULSES_HZ, PEAK_W_M2 = 2.5e4, 5e-6
"""Of 500 000 pulses a second one in 20 finds its way to us, off some surface, and three of four of these are seen."""


def text():
    """The scene file."""
    head = header(
        "interference",
        "a road at night, and an oncoming car with headlights and its own lidar, whose pulses become points of ours",
        made_by="make_scenes.py",
        sun={"azimuth_deg": 140.0, "elevation_deg": 25.0, "illuminance_klux": 0.0},
        sky={"diffuse_share": 0.0},
        air={"transmittance": 1.0},
        sensor={"name": "table1-apd", "position_m": [0.0, -1.7, 1.9]},
        picture={"eye_m": [-9.0, -1.7, 5.0], "target_m": [30.0, 0.0, 0.5], "fov_deg": 60.0},
    )
    sources = [
        table("[[interference]]", kind="lamps", irradiance_w_m2=LAMPS_W_M2),
        table("[[interference]]", kind="lidar", rate_hz=PULSES_HZ, irradiance_w_m2=PEAK_W_M2, spread_db=6.0),
    ]
    oncoming = objects("oncoming", "car", [place(25.0, 1.8, 0, 180)], paint="car_paint_red")
    return "\n".join([head, *sources, *ground(), oncoming, *roadside((40, 60))])
