"""The parallax scene: posts from 0.3 to 10 m around a bumper, for a sensor whose laser stands beside its receiver."""

import math

from scenefile import header, objects, place, primitive

POSTS_M = (0.3, 0.6, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 10.0)
POST_RADIUS_M, EYE_M, WALL_M = 0.04, 0.6, 14.0
GAP_DEG, LEFT_DEG = 3.8, 55.0


def directions_deg():
    """Azimuth of each post, from the left to the right with equal gaps between them: none hides another."""
    left, found = LEFT_DEG, []
    for range_m in POSTS_M:
        half = math.degrees(math.asin(POST_RADIUS_M / range_m))
        found.append(left - half)
        left -= 2.0 * half + GAP_DEG
    return found


def text():
    """The scene file."""
    head = header(
        "parallax",
        "posts from 0.3 to 10 m around a bumper: what a sensor with two lenses does not see of them",
        made_by="make_scenes.py",
        sun={"azimuth_deg": 150.0, "elevation_deg": 40.0, "illuminance_klux": 50.0},
        sky={"diffuse_share": 0.2},
        air={"transmittance": 1.0},
        sensor={"name": "biaxial-905", "position_m": [0.0, 0.0, EYE_M]},
        picture={"eye_m": [-3.5, -2.0, 3.5], "target_m": [4.0, 0.0, 0.3], "fov_deg": 70.0},
    )
    posts = [
        place(range_m * math.cos(math.radians(at)), range_m * math.sin(math.radians(at)), 0.5)
        for range_m, at in zip(POSTS_M, directions_deg(), strict=True)
    ]
    return "\n".join(
        [
            head,
            primitive("ground", "plane", "road", "asphalt", size_m=[40.0, 40.0], position_m=(10, 0, 0)),
            primitive(
                "wall", "box", "building", "concrete", size_m=[0.3, 30.0, 3.0], position_m=(WALL_M + 0.15, 0, 1.5)
            ),
            primitive(
                "posts", "cylinder", "pole", "plaster_white", radius_m=POST_RADIUS_M, height_m=1.0, instances=posts
            ),
            objects("car", "car", [place(7.5, -9.5, 0, 60)], paint="car_paint_grey"),
        ]
    )
