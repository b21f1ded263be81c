"""The fog scene: a country road in fog of 120 m visibility, with the same three things every 15 m."""

from scenefile import header, objects, place, primitive

ROAD_M, HALF_WIDTH_M = 160.0, 3.5
STEPS_M = range(15, 121, 15)


def text():
    """The scene file. The road runs along x; traffic keeps to the right."""
    head = header(
        "fog",
        "a road in fog: cars, pedestrians and signs from 15 to 120 m, of which fewer and fewer are seen",
        made_by="make_scenes.py",
        sun={"azimuth_deg": 140.0, "elevation_deg": 25.0, "illuminance_klux": 10.0},
        sky={"diffuse_share": 0.5},
        air={"transmittance": 1.0},
        weather={"fog": "moderate_advection", "fog_visibility_km": 0.12},
        sensor={"name": "biaxial-905", "position_m": [0.0, -1.7, 1.9]},
        picture={"eye_m": [-9.0, -1.7, 5.0], "target_m": [30.0, 0.0, 0.5], "fov_deg": 60.0},
    )
    return "\n".join([head, *ground(), *roadside(STEPS_M)])


def ground():
    """The road and the soil beside it."""
    middle = 0.5 * ROAD_M - 10.0
    dashes = [place(x, 0, 0.003) for x in range(0, int(ROAD_M) - 20, 6)]
    edges = [place(middle, s * (HALF_WIDTH_M - 0.2), 0.003) for s in (1, -1)]
    return [
        primitive("road", "plane", "road", "asphalt", size_m=[ROAD_M, 2 * HALF_WIDTH_M], position_m=(middle, 0, 0)),
        primitive("soil", "plane", "terrain", "soil", size_m=[ROAD_M, 60.0], position_m=(middle, 0, -0.05)),
        primitive("dashes", "plane", "lane_marking", "lane_marking", size_m=[3.0, 0.12], instances=dashes),
        primitive("edges", "plane", "lane_marking", "lane_marking", size_m=[ROAD_M, 0.15], instances=edges),
    ]


def roadside(steps_m):
    """A car, a pedestrian and a sign at each distance, and trees."""
    cars = [place(x, 1.8, 0, 180) for x in steps_m]
    walkers = [place(x, -4.2, 0, 180) for x in steps_m]
    signs = [place(x, -5.5, 0, 180) for x in steps_m]
    trees = [place(x + 7, s * 9.0, 0, 61 * x) for x in steps_m for s in (1, -1)]
    return [
        objects("cars", "car", cars, paint="car_paint_white"),
        objects("pedestrians", "pedestrian", walkers),
        objects("signs", "sign", signs),
        objects("trees", "tree", trees),
    ]
