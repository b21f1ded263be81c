"""Polarised beams through panes: against electric fields that are followed through every passage between the faces."""

import dataclasses
import math

import drjit as dr
import numpy as np
import pytest
from helpers import chain
from helpers.panes import INDEX, MATERIALS, MIDDLE, mirror_material, pane
from helpers.run_seed import chosen

from lidarscene.kernel.device import transfer
from lidarscene.kernel.rays.trace import Firing
from lidarscene.light import beams
from lidarscene.light.footprint import polarisation
from lidarscene.materials.material_file import catalogue_material
from lidarscene.maths.pose import Pose
from lidarscene.physics.optics.dielectrics import fresnel_amplitudes

pytestmark = pytest.mark.usefixtures("mi")

# Single precision through some fifty operations.
CLOSE = {"rel": 5e-5, "abs": 1e-7}


def turned_pane(range_m, yaw_deg, roll_deg, **more):
    """A pane whose normal is yaw away from the x axis, in a plane that is rolled about it."""
    body = pane(range_m, yaw_deg, size_m=20.0, **more)
    roll = Pose.from_degrees(roll_deg=roll_deg)
    turn = Pose(position_m=body.pose.position_m, rotation=roll.rotation @ body.pose.rotation)
    return dataclasses.replace(body, name=f"pane {range_m}", pose=turn)


def trace(*bodies, angle_deg=None, share=1.0, materials=MATERIALS, **scene):
    """`chain.run_stages` with polarised beams; without an angle as the sensor's file leaves them."""
    overrides = [] if angle_deg is None else [f"laser.polarisation={{ angle_deg = {angle_deg}, share = {share} }}"]
    sensor = chain.sensor("table1-apd", *chain.NARROW, *overrides)
    described = chain.scene(*bodies, materials=materials, **scene)
    on_device = transfer.opaque(sensor)
    rotation = transfer.opaque(tuple(float(x) for x in np.eye(3).ravel()))
    axes = beams.fire(
        on_device, pulse=transfer.counter(0, 9), origin_m=transfer.opaque((0.0, 0.0, 0.0)), rotation=rotation
    )
    firing = Firing(polarisation=polarisation(axes, on_device.laser, rotation=rotation))
    return chain.run_stages(described, sensor, firing=firing)


def partial_waves(direction, normal, index, passage, *, reflected):
    """Amplitudes (2, 2) of the partial waves of a pane, by Snell's angles: 30 passages to and fro."""
    cosine = abs(float(direction @ normal))
    theta = max(math.acos(cosine), 1e-9)
    inside = math.asin(math.sin(theta) / index)
    r = {
        "s": -math.sin(theta - inside) / math.sin(theta + inside),
        "p": math.tan(theta - inside) / math.tan(theta + inside),
    }
    waves = []
    for k in range(30):
        wave = {}
        for name in "sp":
            through = 1.0 - r[name] ** 2
            if reflected:
                wave[name] = r[name] if k == 0 else through * (-r[name]) ** (2 * k - 1) * passage**k
            else:
                wave[name] = through * (-r[name]) ** (2 * k) * passage ** (k + 0.5)
        waves.append(np.diag([wave["s"], wave["p"]]))
    return waves


def frame(direction, normal):
    """Directions of s and p before a surface."""
    s = np.cross(direction, normal)
    s /= np.linalg.norm(s)
    return s, np.cross(direction, s)


def follow(density, direction, steps):
    """Density matrix of the field, 3 x 3, and its direction, through (normal, index, passage, reflected) of panes."""
    for normal, index, passage, reflected in steps:
        onward = direction - 2.0 * (direction @ normal) * normal if reflected else direction
        before = np.stack(frame(direction, normal))
        after = np.stack([before[0], np.cross(onward, before[0])])
        local = before @ density @ before.T
        waves = partial_waves(direction, normal, index, passage, reflected=reflected)
        density, direction = after.T @ sum(w @ local @ w.T for w in waves) @ after, onward
    return density, direction


def linear(angle_deg, share=1.0):
    """Density matrix of light along +x that swings at this angle from the left (y) to the top (z)."""
    swing = np.array([0.0, math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))])
    return share * np.outer(swing, swing) + (1.0 - share) * UNPOLARISED


UNPOLARISED = 0.5 * np.diag([0.0, 1.0, 1.0])
AHEAD = np.array([1.0, 0.0, 0.0])


def normal_of(yaw_deg, roll_deg):
    turn = Pose.from_degrees(roll_deg=roll_deg).rotation @ Pose.from_degrees(yaw_deg=yaw_deg).rotation
    return -turn[:, 0]


@pytest.mark.parametrize("material", ["grey", "retroreflective_sheeting"])
@pytest.mark.parametrize(("angle_deg", "share"), chosen(2, [(0.0, 1.0), (25.0, 1.0), (110.0, 0.6), (0.0, 0.0)]))
def test_three_panes_by_their_fields(material, angle_deg, share):
    """Planes of incidence at all angles to each other, one pane absorbing. There and back, pane by pane.

    The board returns unpolarised light; the sheet the field that it was lit by.
    """
    tinted, sheet = catalogue_material("tinted_glass"), catalogue_material("retroreflective_sheeting")
    values = tinted.at(905e-9)
    placed = [(10.0, 62.0, 10.0, "pane"), (18.0, 50.0, 75.0, tinted.name), (26.0, 70.0, 200.0, "pane")]
    panes = [turned_pane(r, yaw, roll, material=m) for r, yaw, roll, m in placed]
    board = chain.facing(range_m=50.0, material=material)
    materials = (*MATERIALS, tinted, sheet)
    lanes = trace(board, *panes, angle_deg=angle_deg, share=share, materials=materials)
    free = trace(board, materials=materials)
    steps = []
    for _, yaw, roll, name in placed:
        normal = normal_of(yaw, roll)
        index, passage = INDEX, 1.0
        if name == tinted.name:
            index = values["index_n"]
            inside = math.cos(math.asin(math.sin(math.acos(abs(normal[0]))) / index))
            passage = math.exp(-4 * math.pi * values["index_k"] * values["thickness_m"] / inside / 905e-9)
        steps.append((normal, index, passage, False))
    lit, _ = follow(linear(angle_deg, share), AHEAD, steps)
    returned = lit if material == "retroreflective_sheeting" else np.trace(lit) * UNPOLARISED
    back, _ = follow(returned, -AHEAD, steps[::-1])
    ratio = lanes.light.peak_power_w[MIDDLE] / free.light.peak_power_w[MIDDLE]
    assert ratio == pytest.approx(np.trace(back), **CLOSE)
    # Sunlight comes back unpolarised, whatever the laser's light does.
    unpolarised, _ = follow(UNPOLARISED, -AHEAD, steps[::-1])
    assert lanes.hits.throughput[MIDDLE] == pytest.approx(np.trace(unpolarised), **CLOSE)


@pytest.mark.parametrize("angle_deg", [0.0, 90.0, 30.0])
def test_the_way_that_a_pane_mirrors(angle_deg):
    """A pane near Brewster's angle throws the beam aside, through a second pane that is rolled, onto a board."""
    first = normal_of(56.0, 0.0)
    aside = AHEAD - 2.0 * (AHEAD @ first) * first
    centre = np.array([10.0, 0.0, 0.0])
    # Second pane and board stand across the mirrored ray, the former turned out of it.
    second_at, board_at = centre + 6.0 * aside, centre + 15.0 * aside
    yaw = math.degrees(math.atan2(aside[1], aside[0]))
    along = Pose.from_degrees(yaw_deg=yaw).rotation @ Pose.from_degrees(roll_deg=65.0).rotation
    second_turn = along @ Pose.from_degrees(yaw_deg=55.0).rotation
    plane = chain.facing(range_m=0.0, size_m=8.0, material="pane")
    second = dataclasses.replace(
        plane, name="second", pose=Pose(position_m=second_at, rotation=second_turn @ plane.pose.rotation)
    )
    board = chain.facing(range_m=0.0, size_m=8.0)
    turn = Pose.from_degrees(yaw_deg=yaw).rotation @ board.pose.rotation
    board = dataclasses.replace(board, name="board", pose=Pose(position_m=board_at, rotation=turn))
    lanes = trace(turned_pane(10.0, 56.0, 0.0), second, board, angle_deg=angle_deg)
    steps = [(first, INDEX, 1.0, True), (-second_turn[:, 0], INDEX, 1.0, False)]
    lit, onward = follow(linear(angle_deg), AHEAD, steps)
    back, _ = follow(np.trace(lit) * (np.eye(3) - np.outer(onward, onward)) / 2.0, -onward, steps[::-1])
    direct = trace(chain.facing(range_m=25.0)).light.peak_power_w[MIDDLE]
    assert lanes.light_of_ways[1].peak_power_w[MIDDLE] / direct == pytest.approx(np.trace(back), **CLOSE)


def test_a_mirror_before_a_pane_turns_the_plane_of_the_swing():
    """Light goes off a mirror that leans out of two axes, then through a pane; an ideal mirror reverses the field."""
    mirror = turned_pane(10.0, 45.0, 30.0, material="mirror")
    normal = normal_of(45.0, 30.0)
    aside = AHEAD - 2.0 * (AHEAD @ normal) * normal
    upright = np.array([0.0, 0.0, 1.0])
    left = np.cross(upright, aside) / np.linalg.norm(np.cross(upright, aside))
    frame_of_way = np.stack([aside, left, np.cross(aside, left)], axis=1)
    # Rolled, or both planes of incidence would be one, in which the sign of U does not matter.
    turn = frame_of_way @ Pose.from_degrees(roll_deg=50.0).rotation @ Pose.from_degrees(yaw_deg=60.0).rotation
    plane = chain.facing(range_m=0.0, size_m=8.0, material="pane")
    glass = dataclasses.replace(
        plane, name="glass", pose=Pose(position_m=(10.0, 0.0, 0.0) + 5.0 * aside, rotation=turn @ plane.pose.rotation)
    )
    board = chain.facing(range_m=0.0, size_m=8.0)
    board = dataclasses.replace(
        board,
        name="board",
        pose=Pose(position_m=(10.0, 0.0, 0.0) + 10.0 * aside, rotation=frame_of_way @ board.pose.rotation),
    )
    steps = [(-turn[:, 0], INDEX, 1.0, False)]
    direct = trace(chain.facing(range_m=20.0)).light.peak_power_w[MIDDLE]
    for angle_deg in (0.0, 40.0, 90.0):
        lanes = trace(mirror, glass, board, angle_deg=angle_deg, materials=(*MATERIALS[:1], mirror_material()))
        field = linear(angle_deg)
        # E' = -(E - 2 (E n) n): the field across an ideal mirror vanishes.
        house = np.eye(3) - 2.0 * np.outer(normal, normal)
        lit, onward = follow(0.9 * house @ field @ house.T, aside, steps)
        back, _ = follow(np.trace(lit) * (np.eye(3) - np.outer(onward, onward)) / 2.0, -onward, steps)
        assert lanes.light.peak_power_w[MIDDLE] / direct == pytest.approx(0.9 * np.trace(back), **CLOSE)


def test_light_of_a_laser_of_which_nothing_is_said_is_unpolarised():
    """Rationale: behind a raked pane it is no longer, and a second pane passes more of it than the first.
    Reference: the mean over s and p of both panes, there and back, where the mean of each alone has 1 % less.
    """
    theta = math.radians(70.0)
    inside = math.asin(math.sin(theta) / INDEX)
    faces = np.array([math.sin(theta - inside) / math.sin(theta + inside), math.tan(theta - inside)])
    faces[1] /= math.tan(theta + inside)
    passed = (1.0 - faces**2) / (1.0 + faces**2)
    board, panes = chain.facing(range_m=50.0), [turned_pane(10.0 + 8.0 * k, 70.0, 0.0) for k in range(2)]
    free = trace(board).light.peak_power_w[MIDDLE]
    for count in (1, 2):
        expected = np.mean(passed**count) ** 2
        assert trace(board, *panes[:count]).light.peak_power_w[MIDDLE] / free == pytest.approx(expected, **CLOSE)
    assert np.mean(passed**2) > 1.01 * np.mean(passed) ** 2


def test_faces_are_those_of_mitsuba(mi):
    """Fresnel's amplitudes against Mitsuba's own for polarised light. Tolerance: single precision."""
    for degrees in (0.0, 30.0, 56.0, 62.0, 85.0):
        cosine = math.cos(math.radians(degrees))
        r_s, r_p = fresnel_amplitudes(cos_incidence=np.float64(cosine), index=1.52)
        s, p, *_ = mi.fresnel_polarized(mi.Float(cosine), mi.Complex2f(1.52, 0.0))
        assert r_s**2 == pytest.approx(float(dr.squared_norm(s)[0]), rel=1e-4, abs=1e-7)
        assert r_p**2 == pytest.approx(float(dr.squared_norm(p)[0]), rel=1e-4, abs=1e-7)
