"""The garage scene: one storey of a car park, 50 lux, two rows of bays along an aisle."""

from scenefile import header, objects, place, primitive

WEST_M, EAST_M, HALF_M, CLEAR_M = -22.0, 38.0, 8.6, 2.7
BAY_M, PARKED_M = 2.5, 5.75  # width of a bay, |y| of a parked car
PARKED = {  # bay number along x from the west wall, side, nose towards the aisle
    "white": [(5, 1, True), (9, -1, False), (14, 1, False), (19, -1, True)],
    "grey": [(6, -1, False), (11, 1, True), (16, -1, False), (22, 1, False)],
    "black": [(8, 1, False), (12, -1, True), (20, 1, True)],
    "red": [(7, 1, True), (13, -1, False), (18, 1, False)],
}


def text():
    """The scene file. The aisle runs along x; the light is even, and the ceiling keeps the sun out."""
    head = header(
        "garage",
        "an indoor car park at 50 lux: pillars, beams, parked cars, a pedestrian",
        made_by="make_scenes.py",
        sun={"azimuth_deg": 180.0, "elevation_deg": 60.0, "illuminance_klux": 0.05},
        sky={"diffuse_share": 1.0},
        air={"visibility_km": 20.0, "model": "kruse"},
        sensor={"name": "table1-apd", "position_m": [-14.0, -1.4, 1.7]},
        picture={"eye_m": [-15.0, -1.4, 2.0], "target_m": [-4.0, -1.4, 1.7], "fov_deg": 75.0},
    )
    return "\n".join([head, *_hall(), *_structure(), *_markings(), *_contents()])


def _hall():
    length, middle = EAST_M - WEST_M, 0.5 * (EAST_M + WEST_M)
    height, half = CLEAR_M / 2, CLEAR_M / 2 + 0.3
    slab = [length + 1.0, 2 * HALF_M + 1.0, 0.3]
    ends = [place(x, 0, height) for x in (WEST_M - 0.15, EAST_M + 0.15)]
    sides = [place(middle, s * (HALF_M + 0.15), height) for s in (1, -1)]
    return [
        primitive("floor", "box", "road", "concrete", size_m=slab, position_m=(middle, 0, -0.15)),
        primitive("ceiling", "box", "building", "concrete", size_m=slab, position_m=(middle, 0, CLEAR_M + 0.15)),
        primitive("end_walls", "box", "building", "plaster_white", size_m=[0.3, slab[1], 2 * half], instances=ends),
        primitive("side_walls", "box", "building", "concrete", size_m=[slab[0], 0.3, 2 * half], instances=sides),
        primitive(
            "door", "box", "building", "galvanised_steel", size_m=[0.06, 1.2, 2.1], position_m=(EAST_M - 0.03, 5, 1.05)
        ),
    ]


def _structure():
    rows = [WEST_M + 3 * BAY_M * i for i in range(1, 8)]
    pillars = [place(x, s * 3.35, CLEAR_M / 2) for x in rows for s in (1, -1)]
    beams = [place(x, 0, CLEAR_M - 0.15) for x in rows]
    pipe = {"pitch_deg": 90.0}
    pipes = [place(8, y, z) | pipe for y, z in ((3.9, 2.32), (-4.1, 2.32))]
    lamps = [place(x + 3.75, y, CLEAR_M - 0.06) for x in rows for y in (-1.6, 1.6)]
    stops = [place(_bay_m(i), s * 8.0, 0.05) for i in range(24) for s in (1, -1)]
    return [
        primitive("pillars", "box", "building", "concrete", size_m=[0.45, 0.45, CLEAR_M], instances=pillars),
        primitive("beams", "box", "building", "concrete", size_m=[0.35, 2 * HALF_M, 0.3], instances=beams),
        primitive("pipes", "cylinder", "building", "galvanised_steel", radius_m=0.07, height_m=59.0, instances=pipes),
        primitive("lamps", "box", "building", "plaster_white", size_m=[1.3, 0.16, 0.08], instances=lamps),
        primitive("wheel_stops", "box", "building", "concrete", size_m=[1.7, 0.14, 0.1], instances=stops),
    ]


def _bay_m(i):
    """Middle of bay i along x."""
    return WEST_M + BAY_M * (i + 0.5)


def _markings():
    lines = [place(WEST_M + BAY_M * i, s * 5.9, 0.003) for i in range(25) for s in (1, -1)]
    arrows = [place(x, -1.4, 0.003) for x in range(-8, 36, 8)]
    return [
        primitive("bay_lines", "plane", "lane_marking", "lane_marking", size_m=[0.1, 4.9], instances=lines),
        primitive("arrows", "plane", "lane_marking", "lane_marking", size_m=[1.6, 0.2], instances=arrows),
    ]


def _contents():
    bodies = []
    for colour, places in PARKED.items():
        cars = [place(_bay_m(i), s * PARKED_M, 0, -90 * s if nose_out else 90 * s) for i, s, nose_out in places]
        bodies.append(objects(f"cars_{colour}", "car", cars, paint=f"car_paint_{colour}"))
    driving = objects("car_driving", "car", [place(17.0, 1.5, 0, 180)], paint="car_paint_grey")
    walkers = objects("pedestrians", "pedestrian", [place(-1.0, 1.9, 0, 200), place(11.0, -2.6, 0, 20)])
    bollards = objects("bollards", "bollard", [place(EAST_M - 1.0, y) for y in (4.0, 6.0)])
    return [*bodies, driving, walkers, bollards]
