"""The foliage scene: a hedge, a wire fence and two trees before a low sun, people behind; one tree is opaque."""

from scenefile import header, objects, place, primitive, table

SUN = {"azimuth_deg": 8.0, "elevation_deg": 14.0, "illuminance_klux": 60.0}
HEDGE_M, LAYERS, APART_M = (9.0, 3.2, 1.6), 3, 0.2  # place and height, sheets of leaves, how far apart
FENCE_M = (9.0, -3.2, 2.0)
WIDTH_M = 5.4
LEAF = {"reflectivity": 0.458, "transmittance": 0.505}  # of the catalogue's leaf at 905 nm


def text():
    """The scene file. Hedge and left tree have leaves that the sun shines through, the right tree has not."""
    head = header(
        "foliage",
        "a hedge, a wire fence and two trees before a low sun; one tree's leaves let light through",
        made_by="make_scenes.py",
        sun=SUN,
        sky={"diffuse_share": 0.1},
        air={"transmittance": 1.0},
        sensor={"name": "table1-apd", "position_m": [0.0, 0.0, 1.7]},
        picture={"eye_m": [-4.0, 0.0, 4.5], "target_m": [10.0, 0.0, 1.6], "fov_deg": 62.0},
    )
    return "\n".join(
        [
            head,
            table("[materials.hedge]", description="one of several layers of leaves", cover=0.5, **LEAF),
            primitive("ground", "plane", "terrain", "soil", size_m=[60.0, 60.0], position_m=(25, 0, -0.02)),
            primitive("path", "plane", "sidewalk", "concrete", size_m=[2.5, 30.0], position_m=(13.6, 0, 0)),
            *_hedge(),
            *_fence(),
            objects("people", "pedestrian", [place(13.6, y, 0.0, turn) for y, turn in ((4.6, 90), (-4.2, 250))]),
            objects("tree", "tree", [place(18.5, 5.8)], foliage="leaf"),
            objects("opaque_tree", "tree", [place(18.5, -5.8)], foliage="tree_foliage"),
        ]
    )


def _hedge():
    x, y, height = HEDGE_M
    return [
        primitive(
            "hedge",
            "plane",
            "vegetation",
            "hedge",
            size_m=[height, WIDTH_M],
            instances=[place(x + number * APART_M, y, 0.5 * height) | {"pitch_deg": 90.0} for number in range(LAYERS)],
        )
    ]


def _fence():
    x, y, height = FENCE_M
    posts = [place(x, y + across, 0.5 * height) for across in (-0.5 * WIDTH_M, 0.0, 0.5 * WIDTH_M)]
    return [
        primitive(
            "fence",
            "plane",
            "fence",
            "wire_mesh",
            size_m=[height, WIDTH_M],
            position_m=(x, y, 0.5 * height),
            pitch_deg=90.0,
        ),
        primitive("posts", "cylinder", "pole", "galvanised_steel", radius_m=0.03, height_m=height, instances=posts),
    ]
