"""The rain scene: the road of the fog scene in a cloudburst, 50 mm/h."""

from fog_scene import ground, roadside
from scenefile import header


def text():
    """The scene file."""
    head = header(
        "rain",
        "a road in heavy rain: drops before the sensor that look like points, and dimmer things behind them",
        made_by="make_scenes.py",
        sun={"azimuth_deg": 140.0, "elevation_deg": 25.0, "illuminance_klux": 10.0},
        sky={"diffuse_share": 0.8},
        air={"transmittance": 1.0},
        weather={"rain_mm_h": 50.0},
        sensor={"name": "biaxial-905", "position_m": [0.0, -1.7, 1.9]},
        picture={"eye_m": [-9.0, -1.7, 5.0], "target_m": [30.0, 0.0, 0.5], "fov_deg": 60.0},
    )
    return "\n".join([head, *ground(), *roadside((20, 40, 60))])
