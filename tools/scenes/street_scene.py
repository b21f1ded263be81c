"""The street scene: a canyon of town houses with parked cars, trees and people, seen from a driving car."""

from scenefile import header, in_row, objects, paint, place, sheet

KERB_M, FRONT_M = 5.475, 8.7  # |y| of the kerb stones and of the house fronts
WEST_M, EAST_M = -40.0, 112.0
HOUSE_CENTRE_M = FRONT_M + 4.5
PAINTED = {
    "white": [(8.5, -1), (34.0, 1), (58.5, -1), (81.0, 1), (-9.0, 1)],
    "grey": [(14.2, -1), (21.5, 1), (46.0, -1), (70.5, 1), (-15.5, -1)],
    "black": [(27.3, 1), (39.5, -1), (64.8, -1), (92.0, 1)],
    "red": [(15.4, 1), (52.0, 1), (87.0, -1)],
}
DRIVING = {"grey": [(24.0, -1.6, 0)], "red": [(43.0, 1.7, 180)]}
GROUND = {"roughness": "C"}
LIGHT = {
    "sun": {"azimuth_deg": 215.0, "elevation_deg": 48.0, "illuminance_klux": 80.0},
    "sky": {"diffuse_share": 0.15},
    "air": {"visibility_km": 15.0, "model": "kruse"},
}


def text():
    """The scene file. The street runs along x; traffic keeps to the right."""
    head = header(
        "street",
        "a street canyon: houses, parked cars, trees, lamp posts, signs, pedestrians",
        made_by="make_scenes.py",
        **LIGHT,
        ground=GROUND,
        sensor={"name": "table1-apd", "position_m": [0.0, -1.6, 1.9]},
        picture={"eye_m": [-6.0, -1.6, 4.5], "target_m": [12.0, -1.6, 1.8], "fov_deg": 75.0},
    )
    return "\n".join([head, *bodies(DRIVING)])


def bodies(driving):
    """All of the street, with these cars on the road: (x, y, yaw) by colour."""
    return [*_ground(), *_markings(), *_houses(), *_cars(driving), *_furniture()]


def _both(xs, y, z=0.0, *, yaw_deg):
    """Places on both sides of the street; `yaw_deg` is meant for the left (+y) side."""
    return [place(x, s * y, z, yaw_deg if s > 0 else yaw_deg + 180) for x in xs for s in (1, -1)]


def _ground():
    length, middle = EAST_M - WEST_M, 0.5 * (EAST_M + WEST_M)
    pavements = [place(middle, s * 7.125, 0.12) for s in (1, -1)]
    kerbs = [place(middle, s * KERB_M, 0.12) for s in (1, -1)]
    return [
        sheet("road", "road", "asphalt", [length, 10.8], (middle, 0, 0), crown_m=0.08, kerb_m=0.1, spacing_m=0.4),
        sheet("cross_road", "road", "asphalt", [10.0, 60.0], (EAST_M + 5, 0, 0), spacing_m=0.4),
        sheet("pavements", "pavement", "concrete", [length, 3.15], kerb_m=0.2, instances=pavements),
        sheet("soil", "terrain", "soil", [260.0, 120.0], (middle, 0, -0.05), spacing_m=2.0),
        sheet("kerbs", "kerb", "concrete", [length, 0.15], kerb_m=0.2, instances=kerbs),
    ]


def _markings():
    dashes = [place(x, 0, 0.003) for x in range(int(WEST_M) + 2, int(EAST_M) - 2, 6)]
    bays = [place(x, s * 4.35, 0.003) for x in range(-35, 105, 6) for s in (1, -1)]
    zebra = [place(30.0, y, 0.003) for y in (-2.75, -1.75, -0.75, 0.25, 1.25, 2.25)]
    return [
        paint("dashes", [3.0, 0.12], dashes),
        paint("bay_lines", [0.1, 2.0], bays),
        paint("zebra", [4.0, 0.5], zebra),
    ]


def _houses():
    rows = [x for x in range(-35, 110, 10) if x != 45]  # a gap lets the sun into the street
    homes = []
    for number, x in enumerate(rows):
        along, back, up = in_row(number)
        homes += _both([x + along], HOUSE_CENTRE_M + back, up, yaw_deg=-90)
    for number, y in enumerate((-10, 0, 10)):
        along, back, up = in_row(number)
        homes.append(place(EAST_M + 14.5 + back, y + along, up, 180))
    return [objects("houses", "house", homes)]


def _cars(driving):
    cars = []
    for colour, places in PAINTED.items():
        there = [place(x, s * 4.35, 0, 180 if s > 0 else 0) for x, s in places]
        there += [place(x, y, 0, yaw) for x, y, yaw in driving.get(colour, [])]
        cars.append(objects(f"cars_{colour}", "car", there, on_ground=True, paint=f"car_paint_{colour}"))
    return cars


def _furniture():
    walkers = [(6.5, 7.0, 0), (12.0, -7.4, 180), (19.5, 6.4, 200), (31.0, -5.9, 90), (29.2, 0.9, 92)]
    walkers += [(48.0, -7.2, 10), (49.0, -6.6, 15), (66.0, 7.5, 180)]
    signs = [place(28.0, -5.9, 0, 180), place(33.0, 5.9), place(76.0, -5.9, 0, 180)]
    posts = [place(x, s * 5.95, 0, -90 * s) for x in range(-20, 105, 25) for s in (1, -1)]
    trees = [place(x, s * 6.4, 0, 47 * i) for i, (x, s) in enumerate(_tree_spots())]
    bollards = [place(x, s * 5.8) for x in (26.5, 27.25, 32.75, 33.5) for s in (1, -1)]
    return [
        objects("trees", "tree", trees, on_ground=True),
        objects("pedestrians", "pedestrian", [place(x, y, 0, a) for x, y, a in walkers], on_ground=True),
        objects("signs", "sign", signs, on_ground=True),
        objects("lamp_posts", "lamp_post", posts, on_ground=True),
        objects("bollards", "bollard", bollards, on_ground=True),
    ]


def _tree_spots():
    return [(-12, 1), (11, 1), (18, -1), (38, 1), (43.5, -1), (56, 1), (61, -1), (78, 1), (83, -1), (97, 1)]
