"""The drive scene: our street as a car drives along it and around the block, with other cars and people that move.

The car goes round for ever, and the cars of the cross road come again with each of its laps.
"""

import cmath
import math

import street_scene
from scenefile import header, mover, place, sheet

EGO_AT_M, EGO_M_S = (60.0, -1.6), 13.9
# It turns right four times: into the cross road, the road behind the houses, the one in the west, and the street.
EAST_M, SOUTH_M, WEST_M = 115.4, -23.4, -43.4
BEND_M, BEND_M_S, SPEEDS_UP_M_S2, BRAKES_M_S2 = 8.0, 5.0, 2.0, 3.0
STEP_S, TICK_S = 0.5, 1e-4  # between poses in the file, and of the sums that they are taken from
# Small rounds on the parking lane.
RUN = {"speed_m_s": 3.0, "yaw_rate_deg_s": -90.0}
WALK = [(0.0, 74.0, -6.9, 172.0), (6.0, 65.682, -5.731, 172.0)]
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
    way = _way()
    head = header(
        "drive",
        "a street as a car drives along it and around the block: crossing, oncoming and turning cars, people on foot",
        made_by="make_scenes.py",
        **street_scene.LIGHT,
        ground=street_scene.GROUND,
        ego={"on_ground": True, "poses": _poses(way), "at_end": "repeat", "ride": {}},
        sensor={"name": "os1-128", "position_m": [0.0, 0.0, 1.75]},
        picture={"eye_m": [-9.0, 0.0, 7.0], "target_m": [14.0, 0.6, 0.5], "fov_deg": 70.0},
    )
    lap_s = way[-1][0]
    return "\n".join([head, *street_scene.bodies({}), *_back_roads(), *_traffic(lap_s)])


def _back_roads():
    west_m, length_m = street_scene.WEST_M, street_scene.EAST_M - street_scene.WEST_M
    behind = (west_m + 0.5 * length_m, SOUTH_M - 1.6, 0)
    return [
        sheet("back_road", "road", "asphalt", [length_m, 8.0], behind, spacing_m=0.4),
        sheet("west_road", "road", "asphalt", [10.0, 60.0], (west_m - 5, 0, 0), spacing_m=0.4),
    ]


def _way():
    """(time, x, y, yaw) along a lap that begins and ends where the car is at time 0, slower around its bends."""
    x, y = EGO_AT_M
    across_m, along_m = y - SOUTH_M - 2 * BEND_M, EAST_M - WEST_M - 2 * BEND_M
    straights_m = [EAST_M - x - BEND_M, across_m, along_m, across_m, x - WEST_M - BEND_M]
    at, ahead, states = complex(x, y), 1 + 0j, []
    for number, length_m in enumerate(straights_m):
        # The first straight goes on from the last one.
        before_m = straights_m[-1] if number == 0 else 0.0
        after_m = straights_m[0] if number == 4 else 0.0
        done_m = 0.0
        while done_m < length_m:
            states.append((at + ahead * done_m, ahead))
            speeding_up = BEND_M_S**2 + 2.0 * SPEEDS_UP_M_S2 * (before_m + done_m)
            braking = BEND_M_S**2 + 2.0 * BRAKES_M_S2 * (length_m - done_m + after_m)
            done_m += TICK_S * min(EGO_M_S, math.sqrt(speeding_up), math.sqrt(braking))
        at += ahead * length_m
        if number == 4:
            break
        middle, angle = at - 1j * BEND_M * ahead, 0.0
        while angle < 0.5 * math.pi:
            turned = cmath.exp(-1j * angle)
            states.append((middle + (at - middle) * turned, ahead * turned))
            angle += TICK_S * BEND_M_S / BEND_M
        at, ahead = middle - 1j * (at - middle), -1j * ahead
    count = round(TICK_S * len(states) / STEP_S)
    way = []
    for tick in (round(number * len(states) / count) for number in range(count + 1)):
        at, ahead = states[tick % len(states)]
        yaw_deg = round(math.degrees(cmath.phase(ahead)), 3)
        way.append((round(TICK_S * tick, 4), round(at.real, 4), round(at.imag, 4), yaw_deg))
    return way


def _poses(way):
    return [{"time_s": time_s} | place(x, y, 0.0, yaw) for time_s, x, y, yaw in way]


def _traffic(lap_s):
    def lap(way, m_s):
        # It goes on at this speed until it comes again.
        t, x, y, yaw = way[-1]
        on_m = m_s * (lap_s - t)
        end = lap_s, x + on_m * math.cos(math.radians(yaw)), y + on_m * math.sin(math.radians(yaw)), yaw
        return {"poses": _poses([*way, tuple(round(number, 4) for number in end)]), "at_end": "repeat", "ride": {}}

    crossing, turning = lap([(0.0, 119.5, -9.0, 90.0)], 12.0), lap(TURNING, 8.5)
    return [
        mover("own_car", "car", {}, {"with_ego": True}, paint="car_paint_white"),
        mover("crossing_car", "car", {}, crossing, paint="car_paint_red"),
        mover("oncoming_car", "car", place(84.0, 1.7, 0, 180), {"speed_m_s": 12.0, "ride": {}}, paint="car_paint_grey"),
        mover("turning_car", "car", {}, turning, paint="car_paint_white"),
        mover("walker", "pedestrian", {}, {"poses": _poses(WALK), "at_end": "hold"}, on_ground=True),
        mover("runner", "pedestrian", place(88.0, 5.0, 0, -90), RUN, on_ground=True),
    ]
