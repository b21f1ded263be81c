"""Who walks: the foot that bears stands still, at any speed and on any motion; and clips as glTF means them."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from helpers.gltf import WALL, Gltf
from helpers.run_seed import chosen
from helpers.scene_text import scene_of
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial import KDTree

from lidarscene import catalog, load_scene
from lidarscene.maths.pose import Pose
from lidarscene.maths.trajectory import Course, GoingOn, HeldAtEnds, Motion, Repeated, Riding, Spline
from lidarscene.physics.road.suspension import Suspension
from lidarscene.scene.meshes import gltf
from lidarscene.scene.meshes.mesh_cache import WalkingClips
from lidarscene.scene.meshes.reading import read_mesh
from lidarscene.scene.ride import Ride
from lidarscene.scene.scene import Body, Part
from lidarscene.scene.street.street_tables import PEOPLE
from lidarscene.scene.walking import Gait

TURN = 0.5**0.5


def person(folder: Path, name: str, motion: str) -> Body:
    """A person or vehicle of the catalogue on level ground."""
    kind = catalog.shipped_meshes()[name]
    materials = ", ".join(f'{part} = "{value}"' for part, value in kind["materials"].items())
    text = f'[[bodies]]\nname = "{name}"\nmesh = "{catalog.path_of("meshes", name)}"\nmaterials = {{ {materials} }}\n'
    text += "".join(f'{key} = "{kind[key]}"\n' for key in ("animation", "standing") if key in kind)
    (body,) = scene_of(folder, f'{text}material = "denim"\nmotion = {{ {motion} }}\n').bodies
    return body


def in_world(body: Body, time_s: float) -> np.ndarray:
    """(v, 3) vertices of what walks."""
    assert body.motion is not None
    walks = [number for number, part in enumerate(body.parts) if isinstance(part, Part) and part.stride_m is not None]
    posed = body.posed(time_s, 0.0)
    pose = body.motion.at(np.array([time_s])).pose()
    return pose.apply(np.concatenate([posed.parts[number].vertices_m for number in walks]))


def test_the_list_of_people_is_that_of_the_catalogue() -> None:
    assert sorted(PEOPLE) == sorted(name for name, kind in catalog.shipped_meshes().items() if "standing" in kind)


@pytest.mark.parametrize(("name", "share"), chosen(4, [(name, share) for name in PEOPLE for share in (0.7, 1.0, 1.15)]))
def test_a_foot_that_bears_stands_still(tmp_path: Path, name: str, share: float) -> None:
    """What is on the ground at two instants 10 ms apart has gone less than a millimetre in between; the body 14."""
    body = person(tmp_path, name, f"speed_m_s = {share * 1.3}")
    assert body.gait is not None
    period_s = body.gait.stride_m / body.gait.speed_m_s
    stood, went_m = 0, []
    for time_s in np.arange(0.0, period_s / share, 0.035):
        before, after = in_world(body, time_s), in_world(body, time_s + 0.01)
        bears = (before[:, 2] < 5e-4) & (after[:, 2] < 5e-4)
        stood += bears.any()
        went_m += np.linalg.norm((after - before)[bears], axis=1).tolist()
        assert before[:, 2].min() > -4e-3  # in the ground
        assert before[:, 2].min() < 12e-3  # in the air
    assert stood > 15
    assert np.quantile(went_m, 0.99) < 1e-3


@pytest.mark.parametrize("name", ["compact_269", "articulated_1650", "motorcycle_208", "cyclist_182", "pram"])
@pytest.mark.parametrize("speed_m_s", [7.0, -2.0])
def test_wheels_roll_without_slip(tmp_path: Path, name: str, speed_m_s: float) -> None:
    """Tyres and rims are where a turn by the way over their radius has them, to 0.1 % of the way, any spoke for any."""
    body = person(tmp_path, name, f"speed_m_s = {speed_m_s}")
    turns = {part.name for part in body.parts if isinstance(part, Part) and part.stride_m is not None}
    assert turns == {"tyre", "rim"} | ({"trim", "trousers", "shoes"} if name.startswith("cyclist") else set())
    wheels = [part for part in body.parts if isinstance(part, Part) and part.name in ("tyre", "rim")]
    tyres = next(part.vertices_m for part in wheels if part.name == "tyre")
    radius_m = 0.5 * tyres[:, 2].max()
    # Hubs are where the highest vertices of the tyres are.
    hubs_m = np.unique(np.round(tyres[tyres[:, 2] > 1.9999 * radius_m][:, 0], 3))
    for time_s in (0.013, 0.31):
        angle = speed_m_s * time_s / radius_m
        posed = body.posed(time_s, 0.0)
        for part, at_rest in zip(posed.parts, body.parts, strict=True):
            if not isinstance(at_rest, Part) or at_rest.stride_m is None:
                assert part is at_rest
            if not isinstance(at_rest, Part) or at_rest.name not in ("tyre", "rim"):
                continue
            x, y, z = at_rest.vertices_m.T
            hub_m = hubs_m[np.abs(x[:, None] - hubs_m).argmin(axis=1)]
            dx, dz = x - hub_m, z - radius_m
            turned = np.stack(
                [
                    hub_m + np.cos(angle) * dx + np.sin(angle) * dz,
                    y,
                    radius_m + np.cos(angle) * dz - np.sin(angle) * dx,
                ],
                axis=1,
            )
            assert isinstance(part, Part)
            off_m, _ = KDTree(turned).query(part.vertices_m)
            assert off_m.max() < 1.5e-3 + 1e-3 * abs(speed_m_s) * time_s
    # Seen in the world, what is lowest hardly moves while the body goes on by a fiftieth of the radius; vertices take
    # turns at the end of a stride.
    step_s = 0.02 * radius_m / abs(speed_m_s)
    for time_s in np.linspace(0.0, 0.4, 7):
        before, after = in_world(body, time_s), in_world(body, time_s + step_s)
        gone_m, _ = KDTree(after).query(before[before[:, 2].argmin()])
        assert gone_m < 0.25 * abs(speed_m_s) * step_s


@pytest.mark.parametrize("name", chosen(1, ["own_car", "crossing_car", "oncoming_car"]))
def test_wheels_of_the_cars_of_the_scene_drive_roll(name: str) -> None:
    """What is lowest hardly moves while the car goes on, late in its lap too; what stands by the road is rigid."""
    scene = load_scene("drive")
    body = scene.bodies[name]
    assert body.gait is not None
    assert body.gait.stride_m == pytest.approx(2 * np.pi * 0.3185 / 5, rel=2e-3)
    assert all(parked.gait is None for parked in scene.bodies if parked.name.startswith("cars_"))
    for time_s in 20.0 + np.linspace(0.0, 0.4, 7):
        assert body.motion is not None
        way_m = np.ptp([body.motion.at(np.array([at_s])).position_m[0] for at_s in (time_s, time_s + 5e-4)], axis=0)
        before, after = in_world(body, time_s), in_world(body, time_s + 5e-4)
        gone_m, _ = KDTree(after).query(before[before[:, 2].argmin()])
        assert gone_m < 0.3 * np.linalg.norm(way_m)


@pytest.mark.parametrize("yaw_deg", [0, 180])
def test_wheels_of_what_the_ego_vehicle_carries_roll(tmp_path: Path, yaw_deg: int) -> None:
    """What is lowest hardly moves while the body goes on, whether it looks ahead or back."""
    text = f'[[bodies]]\nname = "car"\nmesh = "{catalog.path_of("meshes", "car")}"\nmaterial = "asphalt"\n'
    text += f'animation = "roll"\nyaw_deg = {yaw_deg}\nmotion = {{ with_ego = true }}\n[ego]\nspeed_m_s = 5\n'
    (body,) = scene_of(tmp_path, text).bodies
    for time_s in np.linspace(0.05, 0.35, 7):
        before, after = in_world(body, time_s), in_world(body, time_s + 1e-3)
        gone_m, _ = KDTree(after).query(before[before[:, 2].argmin()])
        assert gone_m < 0.25 * 5e-3


def test_a_cyclist_turns_the_cranks_and_keeps_the_feet_level_on_the_pedals(tmp_path: Path) -> None:
    """One turn of the cranks in two of the wheels; soles stay level, and as far from pedals and ends of legs as before.

    The left pedal is the cranks' part farthest to the left, the end of the left leg is its lowest.
    """
    body = person(tmp_path, "cyclist_182", "speed_m_s = 5")
    assert body.gait is not None
    assert body.gait.stride_m == pytest.approx(2 * np.pi * 0.71, rel=5e-3)
    moving = [number for number, part in enumerate(body.parts) if isinstance(part, Part) and part.stride_m is not None]
    soles_m, pedals_m, ankles_m = [], [], []
    for time_s in np.linspace(0.0, body.gait.stride_m / 5.0, 13):
        posed = body.posed(time_s, 0.0).parts
        of = {part.name: part.vertices_m for part in (posed[number] for number in moving) if isinstance(part, Part)}
        shoe, leg = of["shoes"][of["shoes"][:, 1] > 0.0], of["trousers"][of["trousers"][:, 1] > 0.0]
        foot_m = shoe.mean(axis=0)
        soles_m.append(np.ptp(shoe[:, 2]))
        pedals_m.append(of["trim"][of["trim"][:, 1] > 0.15].mean(axis=0))
        ankles_m.append(np.linalg.norm(leg - foot_m, axis=1).min())
        pedals_m[-1] -= foot_m
    assert np.ptp(soles_m) < 1e-3
    assert np.ptp(pedals_m, axis=0).max() < 3e-3
    assert np.ptp(ankles_m) < 0.02
    turned_m = np.array(
        [body.posed(t, 0.0).parts[moving[-1]].extent_m[0, 2] for t in (0.0, 0.25 * body.gait.stride_m / 5.0)]
    )
    assert turned_m[0] - turned_m[1] > 0.1


def test_castors_of_a_wheelchair_turn_four_times_as_fast_as_its_wheels(tmp_path: Path) -> None:
    """The lowest points of both stand nearly still while the chair goes on by a tenth of the castors' radius."""
    body = person(tmp_path, "wheelchair_user", "speed_m_s = 1.2")
    assert body.gait is not None
    assert body.gait.stride_m == pytest.approx(2 * np.pi * 0.305 / 5, rel=5e-3)
    step_s = 0.1 * 0.305 / 4 / 1.2
    for time_s in np.linspace(0.0, 0.7, 9):
        before, after = in_world(body, time_s), in_world(body, time_s + step_s)
        ahead = before[:, 0] - 1.2 * time_s > 0.2
        for wheel in (before[ahead], before[~ahead]):
            gone_m, _ = KDTree(after).query(wheel[wheel[:, 2].argmin()])
            assert gone_m < 0.25 * 1.2 * step_s


@pytest.mark.parametrize(
    ("name", "clip"), chosen(1, [("pedestrian", "walk"), ("man_tall", "walk"), ("lorry_850", "roll")])
)
def test_between_its_instants_a_stride_is_straight(monkeypatch: pytest.MonkeyPatch, name: str, clip: str) -> None:
    """The skin at many more instants is off by 1 mm at most; the last of them begins the next stride."""
    path, clips = catalog.path_of("meshes", name), WalkingClips(walk=clip)
    strides = []
    for many in (None, 1024):
        if many is not None:
            monkeypatch.setattr(gltf, "FEWEST_INSTANTS", many)
        pieces = gltf.read_gltf(path, None, clips)
        strides.append(np.concatenate([piece.stride.vertices_m for piece in pieces if piece.stride], axis=1))
    coarse, fine = strides
    factor = 1024 // (len(coarse) - 1)
    for part in range(factor):
        expected = fine[part:-1:factor]
        off_m = np.linalg.norm(coarse[:-1] + part / factor * np.diff(coarse, axis=0) - expected, axis=2)
        assert off_m.max() < 1.05e-3
    if clip == "walk":
        np.testing.assert_allclose(coarse[-1], coarse[0], atol=1e-4)


@pytest.mark.parametrize("phase", [-1e-17, -1e-18 - 3.0, 4.0])
def test_just_below_a_whole_stride_is_its_end(phase: float) -> None:
    """What rounding makes of a phase of -1e-17 is 1, where a stride is as at its begin."""
    stride_m = np.array([0.0, 1.0, 2.0, 0.0])[:, None, None] + np.zeros((4, 3, 3))
    part = Part(
        name="foot", vertices_m=np.ones((3, 3)), faces=np.array([[0, 1, 2]]), material="skin", stride_m=stride_m
    )
    np.testing.assert_array_equal(part.posed(phase, 1.0).vertices_m, part.posed(0.0, 1.0).vertices_m)


def test_a_smaller_walker_has_fewer_instants() -> None:
    """A millimetre is one of the scene: a file in centimetres is not held to a hundredth of it."""
    path = catalog.path_of("meshes", "man_tall")
    counts = []
    for unit_m in (1.0, 0.01):
        pieces = gltf.read_gltf(path, None, WalkingClips(walk="walk", unit_m=unit_m))
        counts += {len(piece.stride.vertices_m) for piece in pieces if piece.stride}
    assert counts == [257, 65]


def spline(*places: float) -> Spline:
    """A way along x with a place each second."""
    poses = tuple(Pose(position_m=np.array([x, 0.0, 0.0])) for x in places)
    return Spline(time_s=100.0 + np.arange(len(places)), poses=poses)


LOOP = Spline(
    time_s=np.arange(5.0),
    poses=tuple(
        Pose.from_degrees(position_m=(x, y, 0), yaw_deg=yaw)
        for x, y, yaw in ((0, 0, 0), (1, 1, 90), (0, 2, 180), (-1, 1, 270), (0, 0, 0))
    ),
    closed=True,
)


@pytest.mark.parametrize(
    "motion",
    [
        Course(speed_m_s=1.1, yaw_rate_rad_s=0.5),
        spline(0.0, 0.2, 1.0, 2.5, 4.0, 4.3),
        HeldAtEnds(motion=spline(0.0, 1.0, 2.5, 4.0), delay_s=3.0),
        Ride(
            path=GoingOn(motion=Riding(carrier=spline(0.0, 1.0, 2.5, 4.0), pose=Pose())),
            height_m=lambda x: 0.0 * x[:, 0],
        ),
        Repeated(motion=LOOP),
        Riding(carrier=Repeated(motion=LOOP), pose=Pose.from_degrees(position_m=(0, 0, 1))),
        Ride(path=Course(speed_m_s=1.1), height_m=lambda x: 0.02 * np.sin(0.7 * x[:, 0]), suspension=Suspension()),
    ],
)
def test_strides_pass_as_the_way_does(motion: Motion) -> None:
    """The way of a time is its strides times their length: within and beyond the ends, round after round."""
    gait = Gait(stride_m=1.4, speed_m_s=1.3)
    first_s, last_s = motion.span_s
    time_s = np.linspace(max(99.0, first_s), min(107.0, last_s), 1601)
    phase, level = gait.at(motion, time_s).T
    speed = np.linalg.norm(motion.at(time_s).velocity_m_s, axis=1)
    steps = np.diff(phase) * gait.stride_m * 0.5 * (level[1:] + level[:-1])
    ways = np.diff(time_s) * 0.5 * (speed[1:] + speed[:-1])
    assert np.mean(np.abs(steps - ways) < 2e-4) > 0.998  # all but where the speed jumps
    assert steps.sum() == pytest.approx(ways.sum(), rel=2e-3)
    assert steps.sum() > 3.0


def test_a_way_grows_by_what_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """The strides of all times are those of each alone, in any order, from a few nodes at a time."""
    time_s = np.linspace(100.0, 104.0, 161)
    for motion in (spline(0.0, 1.0, 2.5, 4.0, 4.3), Repeated(motion=spline(0.0, 1.0, 2.5))):
        whole = Gait(stride_m=1.4, speed_m_s=1.3).at(motion, time_s)
        monkeypatch.setattr("lidarscene.scene.walking.NODES", 3)
        gait, order = Gait(stride_m=1.4, speed_m_s=1.3), np.random.default_rng(5).permutation(len(time_s))
        alone = np.concatenate([gait.at(motion, time_s[[number]]) for number in [0, 7, *order]])[2:]
        np.testing.assert_array_equal(alone[np.argsort(order)], whole)


@pytest.mark.parametrize("carrier", [Course(speed_m_s=1.1), HeldAtEnds(motion=spline(0.0, 1.0, 2.5, 4.0))])
def test_a_carried_body_that_looks_back_has_its_strides_backwards(carrier: Motion) -> None:
    gait, time_s = Gait(stride_m=1.4, speed_m_s=1.3), np.linspace(100.0, 104.0, 17)
    ahead, back = (
        gait.at(Riding(carrier=carrier, pose=Pose.from_degrees(yaw_deg=yaw_deg)), time_s)[:, 0]
        for yaw_deg in (0.0, 180.0)
    )
    assert np.ptp(ahead) > 2.0
    np.testing.assert_allclose(back, -ahead, atol=1e-12)


def walls(folder, key_s=(0.0, 1.0, 2.0), **animations):
    """A wall whose node is animated: name -> (path, interpolation, values) at its key frames."""
    file = Gltf()
    file.add("materials", name="skin", pbrMetallicRoughness={"baseColorFactor": [0.5, 0.5, 0.5, 1.0]})
    file.mesh(material=0)
    file.add("nodes", mesh=0)
    clock = file.numbers(key_s)
    for name, channels in animations.items():
        samplers = [
            {"input": clock, "output": file.numbers(values), "interpolation": kind} for _, kind, values in channels
        ]
        targets = [{"sampler": n, "target": {"node": 0, "path": path}} for n, (path, *_) in enumerate(channels)]
        file.add("animations", name=name, samplers=samplers, channels=targets)
    return file.save(folder / "a.glb")


@pytest.mark.parametrize(
    ("channel", "shares", "expected"),
    [
        (("translation", "LINEAR", [[0, 0, 0], [0, 4, 0], [0, 0, 0]]), (0.25, 0.5), (2.0, 4.0)),
        (("translation", "STEP", [[0, 0, 0], [0, 4, 0], [0, 0, 0]]), (0.25, 0.5), (0.0, 4.0)),
        # Values 0, 4, 0 with slopes 0: half way it is 2, and after a quarter 4 (3/16 - 2/64).
        (
            ("translation", "CUBICSPLINE", [[0, 0, 0]] * 4 + [[0, 4, 0]] + [[0, 0, 0]] * 4),
            (0.25, 0.125),
            (2.0, 4 * (3 / 16 - 2 / 64)),
        ),
        # A turn by 90 degrees about x lifts the corner at z = -2 to y = 2 (1 + ...): half of it by the shorter way.
        (("scale", "LINEAR", [[1, 1, 1], [1, 3, 1], [1, 1, 1]]), (0.5,), (4.0,)),
    ],
)
def test_clips_have_the_values_between_their_key_frames(tmp_path, channel, shares, expected):
    """Height of the upper edge of the wall over where it is at rest."""
    (piece,) = read_mesh(walls(tmp_path, walk=[channel]), None, WalkingClips(walk="walk"))
    assert piece.stride is not None
    assert piece.stride.period_s == 2.0
    count = len(piece.stride.vertices_m)
    found = [piece.stride.vertices_m[int(share * count), :, 1].max() - WALL[:, 1].max() for share in shares]
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_splines_have_the_slopes_of_their_key_frames(tmp_path: Path) -> None:
    """Reference: SciPy. Uneven steps, and a slope before each key frame that is not the one after it."""
    key_s, height_m = np.array([0.0, 0.5, 2.0]), np.array([0.0, 1.0, 0.0])
    before, after = np.array([0.0, 1.5, -2.0]), np.array([3.0, -1.0, 0.0])
    rows = np.stack([before, height_m, after], axis=1).ravel()
    values = np.column_stack([0 * rows, rows, 0 * rows]).tolist()
    path = walls(tmp_path, tuple(key_s), walk=[("translation", "CUBICSPLINE", values)])
    (piece,) = read_mesh(path, None, WalkingClips(walk="walk"))
    assert piece.stride is not None
    lifted = piece.stride.vertices_m[:, :, 1] - WALL[:, 1]
    time_s = np.linspace(0.0, 2.0, len(lifted))
    pieces = [
        CubicHermiteSpline(key_s[k : k + 2], height_m[k : k + 2], [after[k], before[k + 1]])(time_s) for k in range(2)
    ]
    expected = np.where(time_s < key_s[1], *pieces)
    np.testing.assert_allclose(lifted, np.repeat(expected[:, None], 4, axis=1), atol=1e-5)


def test_turns_go_the_shorter_way(tmp_path: Path) -> None:
    """90 degrees about x, given by the quaternion of the other sign: half of it is 45."""
    turned = [[0, 0, 0, 1], [-TURN, 0, 0, -TURN], [0, 0, 0, 1]]
    (piece,) = read_mesh(walls(tmp_path, walk=[("rotation", "LINEAR", turned)]), None, WalkingClips(walk="walk"))
    assert piece.stride is not None
    quarter = piece.stride.vertices_m[len(piece.stride.vertices_m) // 4]
    _, y, z = WALL.T
    np.testing.assert_allclose(quarter[:, 1], TURN * (y - z), atol=1e-5)
    np.testing.assert_allclose(quarter[:, 2], TURN * (y + z), atol=1e-5)


def test_a_stride_that_leads_away_is_brought_back(tmp_path: Path) -> None:
    """Root motion of 3 m a stride is taken off, step by step; what is left of it is the bob."""
    way = [[0, 0, 0], [1.5, 0.2, 0], [3.0, 0, 0]]
    (piece,) = read_mesh(walls(tmp_path, walk=[("translation", "LINEAR", way)]), None, WalkingClips(walk="walk"))
    assert piece.stride is not None
    shifts = piece.stride.vertices_m - WALL
    np.testing.assert_allclose(shifts[:, :, 0], 0.0, atol=1e-5)
    assert shifts[:, :, 1].max() == pytest.approx(0.2)


@pytest.mark.parametrize(("back_m", "warns"), [(2.0, False), (50.0, True)])
def test_an_animation_that_is_more_than_a_stride_is_named(tmp_path: Path, back_m: float, warns: bool) -> None:
    """A wall of 4 m goes back on the ground for an eighth of its time, and in the air to where it began."""
    way = [[0, 0, 0], [-back_m, 0, 0], [-back_m, 1, 0], [0, 1, 0], [0, 0, 0]]
    mesh = walls(tmp_path, (0.0, 1.0, 2.0, 7.0, 8.0), dance=[("translation", "LINEAR", way)])
    path = tmp_path / "scene.toml"
    path.write_text(
        f'[[bodies]]\nname = "dancer"\nmesh = "{mesh}"\nanimation = "dance"\nmotion = {{ speed_m_s = 1.0 }}\n'
    )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        (body,) = load_scene(path).bodies
    assert body.gait is not None
    assert body.gait.stride_m == pytest.approx(8.0 * back_m)
    expected = ["animation: 'dance' leads 400 m in 8 s, and what moves has 4 m: it must be one stride"] if warns else []
    assert len(caught) == len(expected)
    assert all(text in str(each.message) for text, each in zip(expected, caught, strict=True))


def test_what_does_not_move_is_rigid_and_what_stands_stands(tmp_path: Path) -> None:
    path = walls(
        tmp_path, walk=[("translation", "LINEAR", [[0, 0, 0]] * 3)], stand=[("translation", "LINEAR", [[0, 1, 0]] * 3)]
    )
    (still,) = read_mesh(path, None, WalkingClips(walk="walk"))
    (stands,) = read_mesh(path, None, WalkingClips(walk="walk", standing="stand"))
    assert still.stride is None
    assert stands.stride is not None
    np.testing.assert_allclose(stands.vertices_m, WALL + np.array([0, 1, 0]))


def test_a_vertex_that_no_joint_carries_goes_with_its_first(tmp_path: Path) -> None:
    """It does not fall to the origin: three.js has it so."""
    file = Gltf()
    file.skinned_wall(file.numbers([[1, 0, 0, 0]] * 4, "u1"), file.numbers([[0, 0, 0, 0]] * 4))
    (piece,) = read_mesh(file.save(tmp_path / "a.glb"))
    np.testing.assert_allclose(piece.vertices_m, WALL + np.array([0, 1, 0]), atol=1e-6)
