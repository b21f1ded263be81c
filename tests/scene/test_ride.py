"""Vehicles that ride over rough ground: against the closed form of a sum of waves, and as keys of a scene file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.roads import output_spectrum, wheel_spectrum
from helpers.scene_text import scene_of

from lidarscene.maths.pose import Pose, rotation_matrix
from lidarscene.maths.trajectory import Course, Riding, Spline, states_of
from lidarscene.physics.constants import STANDARD_GRAVITY_M_S2
from lidarscene.physics.road.roughness import RoughSurface
from lidarscene.physics.road.suspension import Suspension
from lidarscene.scene import ride as rides
from lidarscene.scene.ride import BLOCK_NODES, FOLLOW_S, STEP_S, Ride
from lidarscene.scene.scene_file import load_scene

SPEED_M_S = 13.9
BOX = '[[bodies]]\nname = "box"\nprimitive = "box"\nsize_m = [1, 2, 3]\nmaterial = "brick"\n'


def ride(seed: int = 3, *, roughness="C", **course) -> Ride:
    start = Pose.from_degrees(position_m=(60.0, -1.6, 0.0), yaw_deg=20.0)
    path = Course(start=start, **({"speed_m_s": SPEED_M_S} | course))
    return Ride(path=path, height_m=RoughSurface.draw(roughness, seed).height_m, suspension=Suspension())


def test_a_straight_ride_is_a_sum_of_waves_through_the_response() -> None:
    """Each plane wave reaches each wheel as a sinusoid of time: pitch, roll and heave in closed form.

    Straight lines between heights every 5 ms take 0.02 % at 1.5 Hz and more above, of less motion: 0.2 % of the rms.
    """
    rng = np.random.default_rng(21)
    seed = int(rng.integers(2**32))
    surface, suspension, riding = RoughSurface.draw("C", seed), Suspension(), ride(seed)
    yaw = np.radians(20.0)
    ahead, aside = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    wheels_m = suspension.wheels_m @ np.stack([ahead, aside])
    at_wheels = np.exp(2j * np.pi * (wheels_m + np.array([60.0, -1.6])) @ surface.wave_per_m.T)  # (4, waves)
    frequency_hz = SPEED_M_S * surface.wave_per_m @ ahead
    by_wheel = suspension.response(frequency_hz)[:, :3, :4]
    amplitude = surface.amplitude_m * np.exp(2j * np.pi * surface.phase)
    body = np.einsum("nbw,wn->bn", by_wheel, at_wheels) * amplitude
    time_s = np.sort(rng.uniform(-20.0, 20.0, 300))
    wave = np.exp(2j * np.pi * np.outer(frequency_hz, time_s))
    expected, rate = (body @ wave).real.T, (2j * np.pi * frequency_hz * body @ wave).real.T
    value, value_rate = riding.body_at(time_s)
    assert (np.sqrt(((value - expected) ** 2).mean(axis=0)) < 2e-3 * expected.std(axis=0)).all()
    assert (np.sqrt(((value_rate - rate) ** 2).mean(axis=0)) < 1e-2 * rate.std(axis=0)).all()


def test_figures_of_a_car_in_a_street() -> None:
    """Class A and C at 14 m/s: pitch and roll of 0.05 to 0.5 degrees rms."""
    rng = np.random.default_rng(22)
    rms = []
    for roughness in "AC":
        rides = [ride(seed, roughness=roughness) for seed in rng.integers(2**32, size=2)]
        body = np.concatenate([vehicle.body_at(np.arange(0.0, 12.0, 0.05))[0] for vehicle in rides])
        rms.append(np.sqrt((body**2).mean(axis=0)))
    heave_m, pitch_rad, roll_rad = np.transpose(rms)
    assert 0.05 < np.degrees(pitch_rad[0]) < np.degrees(pitch_rad[1]) < 0.5
    assert 0.05 < np.degrees(roll_rad[0]) < np.degrees(roll_rad[1]) < 0.5
    assert 0.002 < heave_m[0] < heave_m[1] < 0.04


def test_acceleration_of_a_roof() -> None:
    """Specific force to the side, 1.75 m above the ground on class C: T142 by the spectrum, 1.3 m/s2 rms.

    Five roads of 8 s: 300 waves of 1 to 15 Hz, sigma 2 % of the rms; 10 % is five sigmas. Lines between heights
    5 ms apart take 3 % at 20 Hz.
    """
    rng = np.random.default_rng(23)
    time_s, suspension, place_m = np.arange(0.0, 8.0, 0.004), Suspension(), np.array([0.0, 0.0, 1.75])
    squares = []
    for seed in rng.integers(2**32, size=5):
        states = ride(int(seed)).at(time_s)
        velocity = states.velocity_m_s + np.cross(states.turning_rad_s, states.rotation @ place_m)
        acceleration = np.gradient(velocity, time_s, axis=0) + np.array([0.0, 0.0, STANDARD_GRAVITY_M_S2])
        squares.append((np.einsum("ni,ni->n", states.rotation[:, :, 1], acceleration) ** 2).mean())
    frequency_hz = np.geomspace(0.15, 39.0, 2000)
    spectrum = wheel_spectrum(suspension, frequency_hz, SPEED_M_S, "C")
    arm = (2 * np.pi * frequency_hz) ** 2 * place_m[2] + STANDARD_GRAVITY_M_S2
    felt = output_spectrum(arm[:, None] * suspension.response(frequency_hz)[:, 2, :4], spectrum)
    expected = np.sqrt(np.trapezoid(felt, frequency_hz))
    assert expected == pytest.approx(1.3, abs=0.1)
    assert np.sqrt(np.mean(squares)) == pytest.approx(expected, rel=0.1)


def test_velocities_are_differences_of_the_poses() -> None:
    """The way is an arc, across the end of a block. Central differences over 0.2 ms round to 1e-9, and miss f''' h^2 /
    6.
    """
    riding = ride(yaw_rate_rad_s=0.2)
    time_s, h = BLOCK_NODES * STEP_S + np.linspace(-0.02, 0.02, 41), 1e-4
    before, here, after = (riding.at(time_s + shift) for shift in (-h, 0.0, h))
    moved = (after.position_m - before.position_m) / (2 * h)
    np.testing.assert_allclose(moved, here.velocity_m_s, atol=1e-5)
    turned = (after.rotation - before.rotation) / (2 * h) @ here.rotation.transpose(0, 2, 1)
    np.testing.assert_allclose(turned[:, [2, 0, 1], [1, 2, 0]], here.turning_rad_s, atol=1e-5)
    np.testing.assert_allclose(
        here.rotation @ here.rotation.transpose(0, 2, 1), np.tile(np.eye(3), (41, 1, 1)), atol=1e-14
    )


def test_accelerations_are_continuous() -> None:
    """Rates to the left and right of nodes and of a block's end have the same slope, to 1 % of a usual slope."""
    riding, h = ride(), 1e-5
    nodes = STEP_S * (BLOCK_NODES + np.arange(-20, 20))
    rates = [riding.body_at(nodes + shift)[1] for shift in (-h, 0.0, h)]
    left, right = (rates[1] - rates[0]) / h, (rates[2] - rates[1]) / h
    assert (np.abs(right - left).max(axis=0) < 0.01 * right.std(axis=0)).all()


@pytest.mark.parametrize("coordinate", [0, 1, 2])
def test_the_moving_body_has_the_energy_of_the_mass_matrix(coordinate: int) -> None:
    """Energy of the centre of mass, wherever heave, pitch and roll carry it, and of the turning about it (T142).

    1e-3: squares of the tilt of 0.005 rad.
    """
    suspension = Suspension()
    riding = ride(speed_m_s=0.0)
    # A node at which one coordinate moves, put in by hand.
    nodes = np.zeros((BLOCK_NODES + 1, 3, 3))
    nodes[:, :2, coordinate] = [0.005, 0.3]
    riding._nodes[0] = nodes
    states = riding.at(np.array([0.0]))
    arm_m = states.rotation[0] @ [0.0, 0.0, suspension.height_m]
    centre_m_s = states.velocity_m_s[0] + np.cross(states.turning_rad_s[0], arm_m)
    turning = states.rotation[0].T @ states.turning_rad_s[0]
    inertia = np.array([suspension.roll_inertia_kg_m2, suspension.pitch_inertia_kg_m2, 0.0])
    energy = 0.5 * suspension.sprung_kg * centre_m_s @ centre_m_s + 0.5 * inertia @ turning**2
    expected = 0.5 * suspension.matrices()[0][coordinate, coordinate] * 0.3**2
    assert energy == pytest.approx(expected, rel=1e-3)


def test_the_tilt_is_that_of_pose_angles() -> None:
    riding = ride()
    time_s = np.array([0.7])
    (_, pitch, roll), states = riding.body_at(time_s)[0][0], riding.at(time_s)
    expected = rotation_matrix(yaw_rad=np.radians(20.0), pitch_rad=pitch, roll_rad=roll)
    np.testing.assert_allclose(states.rotation[0], expected, atol=1e-14)


def test_the_order_in_which_times_are_asked_for_changes_nothing() -> None:
    time_s = np.linspace(-3.0, 9.0, 30)
    forward, backward = ride().at(time_s), ride()
    for time in time_s[::-1]:
        np.testing.assert_array_equal(
            backward.at(np.array([time])).rotation[0], forward.rotation[np.flatnonzero(time_s == time)[0]]
        )


@pytest.mark.parametrize("suspension", [Suspension(), None], ids=["car", "walker"])
def test_blocks_that_were_given_up_come_back(monkeypatch: pytest.MonkeyPatch, suspension: Suspension | None) -> None:
    """Two rows of one ride ask for a block that it has and for one that it must make room for."""
    monkeypatch.setattr(rides, "_MOST_BLOCKS", 2)
    kept, anew = (replace(ride(), suspension=suspension) for _ in range(2))
    kept.at(np.array([0.1, 1.1]))
    both = states_of([kept, kept], np.array([[0.2], [2.2]]))
    for row, time_s in enumerate((0.2, 2.2)):
        np.testing.assert_array_equal(both.position_m[row], anew.at(np.array([time_s])).position_m)


def test_legs_carry_a_body_evenly_up_a_kerb_and_a_slope() -> None:
    """A runner at 4 m/s: a kerb of 0.13 m takes 0.4 s at most, never downwards; a slope and a plane are followed."""
    time_s = np.linspace(0.0, 2.5, 2501)
    for kerb_m in (2.01, 2.1, 2.26):
        kerb = Ride(
            path=Course(speed_m_s=4.0), height_m=lambda place_m, at=kerb_m: np.where(place_m[:, 0] > at, 0.13, 0.0)
        )
        states = kerb.at(time_s)
        height_m, climbing_m_s = states.position_m[:, 2], states.velocity_m_s[:, 2]
        np.testing.assert_allclose(np.gradient(height_m, time_s), climbing_m_s, atol=1e-3)
        assert climbing_m_s.min() >= -1e-12
        assert 0.13 * 5.0 - 1e-12 <= climbing_m_s.max() <= 0.13 * 7.5 + 1e-12
        rises = time_s[(height_m > 1e-6) & (height_m < 0.13 - 1e-6)]
        assert 0.2 < np.ptp(rises) < 4.0 * FOLLOW_S
        assert rises[0] < kerb_m / 4.0 < rises[-1]
    slope = Ride(path=Course(speed_m_s=4.0), height_m=lambda place_m: 0.3 - 0.1 * place_m[:, 0])
    np.testing.assert_allclose(slope.at(time_s).position_m[:, 2], 0.3 - 0.4 * time_s, atol=1e-12)


def test_rides_on_rough_ground_are_the_same_alone_and_together() -> None:
    """Walkers and cars have the same bits, whatever is asked with them and before."""
    surface = RoughSurface.draw("C", 5)

    def rides_on_it() -> list[Ride]:
        paths = [Course(speed_m_s=0.7 * number, velocity_m_s=(0.3, 0.1 * number, 0.0)) for number in range(6)]
        suspensions = [None, Suspension()] * 3
        return [
            Ride(path=path, height_m=surface.height_m, suspension=own)
            for path, own in zip(paths, suspensions, strict=True)
        ]

    time_s = np.linspace(0.2, 3.1, 23)
    together = states_of(rides_on_it(), np.tile(time_s, (6, 1))).position_m
    alone = np.stack([[ride.at(time_s[row : row + 1]).position_m[0] for row in range(23)] for ride in rides_on_it()])
    np.testing.assert_array_equal(together, alone)


def test_standing_and_braking_on_a_plane() -> None:
    """A car that brakes from 10 m/s to rest in 2 s dips its nose and comes back; on a plane at rest it is level."""
    time_s = np.linspace(0.0, 4.0, 81)
    x_m = np.where(time_s < 2.0, 10.0 * time_s - 2.5 * time_s**2, 10.0)
    path = Spline(time_s=time_s, poses=tuple(Pose(position_m=np.array([x, 0.0, 0.0])) for x in x_m))
    suspension = Suspension()
    riding = Ride(path=path, height_m=lambda place_m: np.full(len(place_m), 0.25), suspension=suspension)
    heave, pitch, roll = riding.body_at(np.array([0.0, 1.7, 4.0]))[0].T
    np.testing.assert_allclose(heave, 0.25, atol=2e-3)
    expected = suspension.response(np.zeros(1))[0, 1, 4].real * -5.0
    assert pitch[1] == pytest.approx(expected, rel=0.1)
    assert (np.abs(pitch[[0, 2]]) < 0.01 * abs(expected)).all()
    np.testing.assert_allclose(roll, 0.0, atol=1e-12)
    np.testing.assert_array_equal(riding.at(np.array([5.0])).position_m, riding.at(np.array([4.0])).position_m)


def test_keys_of_a_scene_file(tmp_path: Path) -> None:
    text = (
        '[ground]\nroughness = "B"\nseed = 4\n[ego]\nspeed_m_s = 10\n[ego.ride]\nsprung_kg = 1200\n'
        + BOX
        + "[bodies.motion]\nspeed_m_s = 3\nride = {}\n"
    )
    scene = scene_of(tmp_path, text)
    assert isinstance(scene.ego, Ride)
    assert scene.ego.suspension.sprung_kg == 1200
    place_m = np.array([[3.0, 4.0]])
    assert scene.ego.height_m(place_m) == RoughSurface.draw("B", 4).height_m(place_m)
    assert isinstance(scene.bodies[0].motion, Ride)
    steady = load_scene(tmp_path / "scene.toml", overrides="ego.ride.active=false")
    assert isinstance(steady.ego, Course)


def test_a_ride_without_rough_ground_is_level(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, "[ego]\nspeed_m_s = 10\nride = {}\n" + BOX + "[bodies.motion]\nwith_ego = true\n")
    assert isinstance(scene.bodies[0].motion, Riding)
    assert scene.bodies[0].motion.carrier is scene.ego
    np.testing.assert_allclose(scene.bodies[0].motion.at(np.array([2.0])).position_m, [[20.0, 0.0, 0.0]], atol=1e-12)
