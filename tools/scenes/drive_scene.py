"""The drive scene: our street as a car drives along it, with other cars and people that move."""

import street_scene
from scenefile import header, mover, place

EGO_AT_M, EGO_M_S = (60.0, -1.6), 13.9
RUN = {"speed_m_s": 3.0, "yaw_rate_deg_s": 20.0}
# A car that turns from the cross road into the street, to the right: (time, x, y, yaw).
TURNING = [
    (0.0, 114.6, 8.0, -90.0),
    (0.7, 113.5, 4.2, -122.0),
    (1.4, 109.9, 2.1, -168.0),
    (2.1, 105.0, 1.7, 180.0),
    (3.1, 96.5, 1.7, 180.0),
]


def text():
    """The scene file. 50 km/h make a turn of the sensor 1.4 m long."""
    head = header(
        "drive",
        "the street as a car drives along it: crossing, oncoming and turning cars, people on foot",
        made_by="make_scenes.py",
        **street_scene.LIGHT,
        ground=street_scene.GROUND,
        ego={"position_m": [*EGO_AT_M, 0.0], "on_ground": True, "speed_m_s": EGO_M_S, "ride": {}},
        sensor={"name": "os1-128", "position_m": [0.0, 0.0, 1.75]},
        picture={"eye_m": [-9.0, 0.0, 7.0], "target_m": [14.0, 0.6, 0.5], "fov_deg": 70.0},
    )
    return "\n".join([head, *street_scene.bodies({}), *_traffic()])


def _traffic():
    turning = [{"time_s": t} | place(x, y, 0.0, yaw) for t, x, y, yaw in TURNING]
    return [
        mover("own_car", "car", {}, {"with_ego": True}, paint="car_paint_white"),
        mover("crossing_car", "car", place(119.5, -9.0, 0, 90), {"speed_m_s": 12.0, "ride": {}}, paint="car_paint_red"),
        mover("oncoming_car", "car", place(84.0, 1.7, 0, 180), {"speed_m_s": 12.0, "ride": {}}, paint="car_paint_grey"),
        mover("turning_car", "car", {}, {"poses": turning, "at_end": "leave", "ride": {}}, paint="car_paint_white"),
        mover("walker", "pedestrian", place(74.0, -6.9, 0, 172), {"speed_m_s": 1.4}, on_ground=True),
        mover("runner", "pedestrian", place(88.0, 5.0, 0, -90), RUN, on_ground=True),
    ]
