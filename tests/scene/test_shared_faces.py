"""Faces that two bodies share: found by their planes and outlines, reported by `check` and `render`."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lidarscene.maths.pose import Pose
from lidarscene.scene.meshes.primitives import box_mesh, plane_mesh
from lidarscene.scene.scene import Body, Part, Scene
from lidarscene.scene.shared_faces import shared_faces

SENSOR_M = np.array([0.0, 0.0, 1.8])
TURN = Pose.from_degrees(position_m=(1200.0, -3400.0, 25.0), yaw_deg=33.0, pitch_deg=4.0, roll_deg=-7.0)


def body(name: str, mesh: tuple[np.ndarray, np.ndarray], position_m: tuple[float, ...], material: str = "grey") -> Body:
    part = Part(vertices_m=mesh[0], faces=mesh[1], material=material)
    return Body(name=name, class_name=name, parts=(part,), pose=Pose.from_degrees(position_m=position_m))


ROAD = body("road", plane_mesh(size_m=(60.0, 40.0)), (0.0, 0.0, 0.0))
LINE = body("line", plane_mesh(size_m=(3.0, 0.2)), (12.0, 2.0, 0.0))
SHED = body("shed", box_mesh(size_m=(4.0, 4.0, 3.0)), (10.0, 0.0, 1.5))


def moved(scene: Scene) -> Scene:
    """The scene elsewhere, in no direction of the axes."""
    return replace(scene, bodies=tuple(replace(each, pose=TURN @ each.pose) for each in scene.bodies))


@pytest.mark.parametrize("elsewhere", [False, True])
@pytest.mark.parametrize(
    ("second", "shares"),
    [
        (LINE, True),
        (body("line", plane_mesh(size_m=(3.0, 0.2)), (12.0, 2.0, 1e-3)), False),  # 1 mm above
        (SHED, False),  # it stands on the road
        (body("line", plane_mesh(size_m=(3.0, 0.2)), (31.5, 2.0, 0.0)), False),  # they touch along an edge
        (body("line", plane_mesh(size_m=(3.0, 0.2)), (31.4, 2.0, 0.0)), True),
        (body("porch", box_mesh(size_m=(1.0, 2.0, 2.0)), (7.5, 0.0, 1.0)), False),  # against the shed
    ],
)
def test_faces_that_look_the_same_way_are_shared(second: Body, shares: bool, elsewhere: bool) -> None:
    """Reference: by hand."""
    scene = Scene(name="yard", bodies=(ROAD, SHED, second) if second is not SHED else (ROAD, SHED))
    place_m, sensor_m = second.pose.position_m, SENSOR_M
    if elsewhere:
        scene, place_m, sensor_m = moved(scene), TURN.apply(place_m), TURN.apply(sensor_m)
    found = shared_faces(scene, sensor_m)
    assert [pair.names for pair in found] == ([("road", second.name)] if shares else [])
    for pair in found:
        assert np.linalg.norm(pair.place_m - place_m) < 2.0


def test_only_faces_that_the_sensor_may_see_and_tell_apart_count() -> None:
    """Nothing is told from below the road, nor of two markings of one class and material."""
    assert not shared_faces(Scene(name="yard", bodies=(ROAD, LINE)), np.array([0.0, 0.0, -2.0]))
    crossing = replace(LINE, name="crossing", pose=Pose.from_degrees(position_m=(12.5, 2.0, 0.0)))
    assert not shared_faces(Scene(name="yard", bodies=(LINE, crossing)), SENSOR_M)
    assert shared_faces(Scene(name="yard", bodies=(LINE, replace(crossing, class_name="other"))), SENSOR_M)


def test_slopes_that_meet_elsewhere_share_nothing() -> None:
    """Two sheets 3 mm apart, of which one is turned by so little that both planes pass the middle of the scene."""
    far = (100.0, 0.0, 0.0)
    sheet, stone = (body(name, plane_mesh(size_m=(3.0, 3.0)), at) for name, at in (("a", far), ("b", (-200.0, 0, 0.5))))
    slope = Pose.from_degrees(position_m=(100.0, 0.0, 3e-3), pitch_deg=np.degrees(3e-5))
    assert not shared_faces(Scene(name="yard", bodies=(sheet, stone, replace(LINE, pose=slope))), SENSOR_M)
    level = replace(LINE, pose=Pose.from_degrees(position_m=far))
    assert shared_faces(Scene(name="yard", bodies=(sheet, stone, level)), SENSOR_M)


YARD = """
[sensor]
position_m = [0, 0, 1.8]
[[bodies]]
name = "road"
primitive = "plane"
material = "asphalt"
size_m = [60, 40]
[[bodies]]
name = "line"
primitive = "plane"
material = "plaster_white"
size_m = [3, 0.2]
instances = [{ position_m = [12, 2, 0] }, { position_m = [12, -2, 0] }]
"""


def test_check_tells_of_each_pair_and_render_of_the_first(run, tmp_path, monkeypatch):
    """Notes, no mistakes: the scene can be rendered."""
    monkeypatch.chdir(tmp_path)
    Path("yard.toml").write_text(YARD)
    checked = run("check", "yard.toml")
    assert (checked.code, checked.out) == (0, "yard.toml: no mistake found\n")
    assert [line.partition(" share faces at")[0] for line in checked.err.splitlines()] == [
        "lidarscene: note: 'road' and 'line.0'",
        "lidarscene: note: 'road' and 'line.1'",
    ]
    steps = ("--set", "scanner.azimuth_step_deg=5", "--set", "scanner.elevation_step_deg=5")
    rendered = run("render", "yard.toml", "-o", "yard.ply", *steps)
    assert rendered.err.count("'road' and 'line.0' (1 of 2 pairs, which lidarscene check lists) share faces at") == 1
