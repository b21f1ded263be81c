"""Silent physical mistakes: each one line that says what to do, and none about what comes with the package."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.command_line import Run
from helpers.mistakes import assert_names
from helpers.run_seed import chosen
from helpers.scene_text import scene_of

from lidarscene import Scene, Sun, load_scene, load_sensor, render, render_frames
from lidarscene.errors import OptionWarning
from lidarscene.maths.pose import Pose
from lidarscene.rendering.surroundings import Surroundings, warn_of_scene
from lidarscene.scene.clearance import Clearance
from lidarscene.scene.meshes.primitives import box_mesh, plane_mesh
from lidarscene.scene.ride import STEP_S, Ride
from lidarscene.scene.scene import Air, Ball, Body, Part, Sky


def body(name, mesh, position_m=(0.0, 0.0, 0.0), **turns):
    parts = (mesh,) if isinstance(mesh, Ball) else (Part(vertices_m=mesh[0], faces=mesh[1], material="grey"),)
    return Body(name=name, class_name=name, parts=parts, pose=Pose.from_degrees(position_m=position_m, **turns))


GROUND = body("ground", plane_mesh(size_m=(60.0, 40.0)))
CAR = body("car", box_mesh(size_m=(4.5, 1.8, 1.5)), (10.0, 0.0, 0.75), yaw_deg=30.0)
POST = body("post", Ball(radius_m=1.0, material="grey"), (-3.0, 17.0, 3.0))
SCENE = Scene(name="yard", bodies=(GROUND, CAR))


def inspect_place(scene=SCENE, place_m=(0.0, 0.0, 1.8), sensor="table1-apd"):
    clearance = Clearance.of_scene(scene)
    return Surroundings.inspect(scene, load_sensor(sensor), np.array(place_m), time_s=0.0, clearance=clearance)


def test_the_line_says_what_is_there():
    """Reference: by hand; the box is cut into 12 triangles, the plane into 4 x 3 squares of at most 16 m."""
    surroundings = inspect_place()
    assert surroundings.doubts == ()
    assert surroundings.line() == (
        "yard: 60 x 40 x 1.5 m, 2 bodies, 36 triangles; sensor 1.8 m above 'ground', the nearest surface"
    )
    high = inspect_place(place_m=(10.0, 0.0, 2.5))
    assert high.line().endswith("sensor 1 m above 'car', the nearest surface")
    near_post = inspect_place(place_m=(-3.0, 19.0, 3.0), scene=replace(SCENE, bodies=(GROUND, POST)))
    assert near_post.line().endswith("sensor 3 m above 'ground', 1 m off 'post', the nearest surface")
    assert near_post.as_dict() == {
        "name": "yard",
        "extent_m": [60.0, 40.0, 4.0],
        "bodies": 2,
        "triangles": 24,
        "height_m": 3.0,
        "above": "ground",
        "nearest_m": 1.0,
        "nearest": "post",
    }


def car_in_unit(factor):
    """The car in another unit, which stands clear of the sensor."""
    return body("car", box_mesh(size_m=(4.5 * factor, 1.8 * factor, 1.5 * factor)), (10.0, -2e3, 0.75))


def scene_with(**changes):
    return {"scene": replace(SCENE, **changes)}


SMALL = (car_in_unit(0.001), replace(car_in_unit(0.001), name="two"))
WRONG = {
    "inside": ({"place_m": (10.0, 0.0, 0.75)}, "inside 'car' | pose or position_m"),
    "below": ({"place_m": (0.0, 0.0, -1.2)}, "1.2 m below 'ground' | pose or position_m | z above 0"),
    "far": ({"place_m": (0.0, 0.0, 1800.0)}, "1,799 m | 'car' | 600 m | position_m | bodies.*.scale"),
    "millimetres": (
        scene_with(bodies=(GROUND, car_in_unit(1000.0))),
        "'car' | 4,500 x 1,800 x 1,500 m | millimetre | 0.001 | scene_overrides bodies.car.scale=",
    ),
    "kilometres": (
        scene_with(bodies=(GROUND, *SMALL)),
        "'car' | 1 more | 0.0045 x 0.0018 x 0.0015 m | kilometre | 1000",
    ),
    "lux": (scene_with(sun=Sun(illuminance_klux=500.0)), "illuminance_klux is 500 | 140 | sun.illuminance_klux=0.5"),
    "low": (scene_with(sun=Sun(elevation_rad=-0.1)), "sun.elevation_deg is -5.73 | 100 klux | illuminance_klux=0"),
    "metres": (scene_with(air=Air(visibility_m=500e3)), "air.visibility_km is 500 | 300 | air.visibility_km=0.5"),
}
"""What is changed, and what the line names."""


def test_a_sky_may_light_a_scene_alone():
    assert inspect_place(**scene_with(sun=Sun(elevation_rad=-1.5), sky=Sky(diffuse_share=1.0))).doubts == ()


@pytest.mark.parametrize("fault", WRONG)
def test_a_fault_is_one_line_that_says_what_to_do(fault):
    changes, named = WRONG[fault]
    (line,) = (str(doubt) for doubt in inspect_place(**changes).doubts)
    assert_names(line, named)


def test_what_is_meant_so_is_no_fault():
    """A night, an open hall, a lonely board below a bridge over it, and a place above everything."""
    hall = [body(f"wall {x}", plane_mesh(size_m=(9.0, 9.0)), (x, 0.0, 1.0), pitch_deg=90.0) for x in (-4.0, 4.0)]
    roof = body("roof", plane_mesh(size_m=(9.0, 9.0)), (0.0, 0.0, 4.0))
    night = Sun(illuminance_klux=0.0, elevation_rad=-0.3)
    assert inspect_place(replace(SCENE, bodies=(GROUND, roof, *hall), sun=night)).doubts == ()
    assert inspect_place(replace(SCENE, bodies=())).doubts == ()
    assert inspect_place(replace(SCENE, bodies=()), place_m=(1.0, 2.0, 3.0)).line() == "yard: 0 bodies, 0 triangles"
    assert inspect_place(place_m=(0.0, 0.0, 500.0)).doubts == ()


def test_distances_against_every_triangle():
    """Reference: points spread over each triangle of a turned box and a ball of 0.4 m; none is nearer than found.

    Tolerance: the points of a triangle are 1/40 of its longest side of 2.7 m apart.
    """
    rng = np.random.default_rng(3)
    box = body("box", box_mesh(size_m=(2.0, 1.0, 1.5)), (3.0, -1.0, 2.0), yaw_deg=20.0, pitch_deg=35.0, roll_deg=50.0)
    ball = body("ball", Ball(radius_m=0.4, material="grey"), (1.0, 2.0, 1.0))
    clearance = Clearance.of_scene(Scene(name="", bodies=(box, ball)))
    grid = np.array([(i, j, 40 - i - j) for i in range(41) for j in range(41 - i)]) / 40.0
    corners = box.pose.apply(box.parts[0].vertices_m)[box.parts[0].faces]
    points = np.concatenate([grid @ triangle for triangle in corners])
    for place_m in rng.uniform(-5.0, 8.0, (40, 3)):
        near = clearance.around_place(place_m, time_s=0.0).nearest
        to_box = np.linalg.norm(points - place_m, axis=1).min()
        to_ball = abs(np.linalg.norm(place_m - ball.pose.position_m) - 0.4)
        assert near.body == ("box" if to_box < to_ball - 0.07 else near.body)
        assert -1e-9 <= min(to_box, to_ball) - near.distance_m < 0.07


def test_straight_up_and_down_by_hand():
    """A tilted plane: 1 m of height for each 2 m along x."""
    slope = body("slope", plane_mesh(size_m=(40.0, 40.0)), pitch_deg=-np.degrees(np.arctan(0.5)))
    ball = body("ball", Ball(radius_m=0.5, material="grey"), (4.0, 0.0, 9.0))
    clearances = Clearance.of_scene(Scene(name="", bodies=(slope, ball))).around_place(
        np.array([4.0, 0.3, 6.0]), time_s=0.0
    )
    z = 2.0 * np.sign(slope.pose.rotation[2, 0])
    assert clearances.below.body == "slope"
    assert clearances.below.distance_m == pytest.approx(6.0 - z, rel=1e-9)
    assert clearances.above.distance_m == pytest.approx(3.0 - 0.4, rel=1e-9)  # sqrt(0.5^2 - 0.3^2) below its middle


def test_render_says_it(run: Run, tmp_path: Path) -> None:
    """The command line says it by its names of options, Python by a warning."""
    scene = tmp_path / "s.toml"
    scene.write_text(
        '[sun]\nilluminance_klux = 300.0\n[[bodies]]\nname = "wall"\nprimitive = "plane"\n'
        'size_m = [4, 4]\nmaterial = "concrete"\nposition_m = [10, 0, 0]\npitch_deg = 90\n'
    )
    options = ("--set=scanner.azimuth_step_deg=5", "--set=scanner.elevation_step_deg=5")
    ran = run("render", str(scene), "-o", str(tmp_path / "o.ply"), *options)
    assert "note: sun.illuminance_klux is 300" in ran.err
    assert "set sun.illuminance_klux=0.3" in ran.err
    with pytest.warns(OptionWarning, match="sun.illuminance_klux is 300"):
        render(scene, overrides=[option.removeprefix("--set=") for option in options])
    line = "scene         s: 0 x 4 x 4 m, 1 body, 2 triangles; sensor 10 m off 'wall', the nearest surface"
    assert ran.out.splitlines()[0] == line


YARD = """
[ego]
position_m = [20.0, 0.0, 0.0]
speed_m_s = 10.0
[sensor]
name = "table1-apd"
position_m = [0.0, 0.0, 1.8]
[[bodies]]
name = "ground"
primitive = "plane"
size_m = [60.0, 40.0]
material = "asphalt"
[[bodies]]
name = "lorry"
primitive = "box"
size_m = [8.0, 2.5, 3.0]
material = "car_paint_white"
position_m = [60.0, 0.0, 1.5]
[bodies.motion]
speed_m_s = 10.0
"""
LEAVES = "the ego vehicle leaves the ground 1.1 s after 0 s: from there on nothing is below it"


def test_an_ego_that_leaves_the_ground_is_named_with_the_time(mi, run: Run, tmp_path: Path) -> None:
    """It is over the end of the plane after 1 s; a lorry that moves along is no ground. Nothing is said of less than
    1 s, of a beginning off the ground, or of a vehicle at rest.
    """
    path = tmp_path / "yard.toml"
    path.write_text(YARD)
    coarse = ["scanner.azimuth_step_deg=1", "scanner.elevation_step_deg=1"]
    frame_s = load_sensor("table1-apd", overrides=coarse).scanner.frame_s
    longer, shorter = (round(length_s / frame_s) for length_s in (1.25, 0.95))
    with pytest.warns(OptionWarning, match=LEAVES):
        render_frames(path, frames=longer, overrides=coarse)
    render_frames(path, frames=shorter, overrides=coarse)
    with pytest.warns(OptionWarning, match=r"leaves the ground 0\.2 s after 0\.85 s"):
        render_frames(path, frames=longer, begin_s=0.85, overrides=coarse)
    options = [word for value in coarse for word in ("--set", value)]
    assert LEAVES in run("render", "yard.toml", "-o", "out", "--frames", str(longer), *options).err
    ran = run("check", "yard.toml")
    assert (ran.code, ran.out) == (0, "yard.toml: no mistake found\n")
    assert ran.err.startswith(f"lidarscene: note: {LEAVES}")
    for ego in ("position_m = [40.0, 0.0, 0.0]\nspeed_m_s = 10.0", "position_m = [20.0, 0.0, 0.0]"):
        path.write_text(YARD.replace("position_m = [20.0, 0.0, 0.0]\nspeed_m_s = 10.0", ego))
        assert run("check", "yard.toml").err == ""


def test_the_way_of_a_vehicle_is_followed_without_its_springs(tmp_path: Path) -> None:
    """The ground below the wheels is asked for where the vehicle begins to ride, not for all of the two minutes."""
    riding = YARD.replace("speed_m_s = 10.0\n[sensor]", "speed_m_s = 10.0\nride = {}\n[sensor]")
    scene, asked = scene_of(tmp_path, riding), []

    def height_m(place_m: np.ndarray) -> np.ndarray:
        asked.append(len(place_m))
        return np.zeros(len(place_m))

    assert isinstance(scene.ego, Ride)
    scene = replace(scene, ego=replace(scene.ego, height_m=height_m))
    with pytest.warns(OptionWarning, match=LEAVES):
        warn_of_scene(scene)
    assert 0.0 < sum(asked) * STEP_S / 4 < 10.0


@pytest.mark.parametrize("name", chosen(1, ["drive", "town"]))
def test_shipped_drives_go_on_for_minutes(name: str) -> None:
    """They go on a street, or behind it: `drive` left its own after 7 s, through a house."""
    scene = load_scene(name)
    warn_of_scene(scene)
    roads = Clearance.of_scene(replace(scene, bodies=[b for b in scene.bodies if b.class_name == "road"]))
    houses = Clearance.of_scene(replace(scene, bodies=[b for b in scene.bodies if b.class_name == "building"]))
    assert isinstance(scene.ego, Ride)
    way_m = scene.ego.path.at(np.linspace(0.0, 120.0, 400)).position_m
    assert roads.over_ground(way_m).all()
    # In the frame of each house: in the world the box of one that stands askew reaches over the road.
    for house, box_m in zip(houses.bodies, houses.boxes, strict=True):
        within_m = house.pose.inverse_apply(way_m)[:, :2]
        assert not ((box_m[0, :2] <= within_m) & (within_m <= box_m[1, :2])).all(axis=1).any(), house.name
