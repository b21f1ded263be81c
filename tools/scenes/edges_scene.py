"""The edges scene: boards and posts at different distances before a wall, for beams that are wider than an edge."""

from scenefile import header, place, primitive

WALL_M = 20.0
AHEAD_M = (0.2, 0.4, 0.6, 0.8, 1.2, 2.0)  # of the wall, from the right to the left


def text():
    """The scene file. The wall stands across x; from 0.8 m on a 6 ns pulse has room for two echoes."""
    head = header(
        "edges",
        "boards and posts 0.2 to 2 m before a wall at 20 m: beams that an edge splits, with --rays",
        made_by="make_scenes.py",
        sun={"azimuth_deg": 150.0, "elevation_deg": 40.0, "illuminance_klux": 50.0},
        sky={"diffuse_share": 0.2},
        air={"transmittance": 1.0},
        sensor={"name": "table1-apd", "position_m": [0.0, 0.0, 1.5]},
        picture={"eye_m": [6.0, -9.0, 5.0], "target_m": [18.5, 0.0, 1.0], "fov_deg": 60.0},
    )
    boards, posts = [], []
    for number, ahead in enumerate(AHEAD_M):
        y = 2.0 * number - 5.0
        boards.append(place(WALL_M - ahead, y, 1.25))
        posts.append(place(WALL_M - ahead, y + 1.0, 1.5))
    return "\n".join(
        [
            head,
            primitive("ground", "plane", "road", "asphalt", size_m=[30.0, 20.0], position_m=(10, 0, 0)),
            primitive(
                "wall", "box", "building", "concrete", size_m=[0.3, 16.0, 3.5], position_m=(WALL_M + 0.15, 0, 1.75)
            ),
            primitive("boards", "box", "board", "wood", size_m=[0.02, 0.8, 1.5], instances=boards),
            primitive("posts", "cylinder", "pole", "galvanised_steel", radius_m=0.05, height_m=3.0, instances=posts),
        ]
    )
