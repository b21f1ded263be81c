"""Stray light of channels that fire together, through whole frames."""

import dataclasses

import numpy as np
import pytest
from helpers import chain, launches, panes, volley
from helpers.clouds import assert_same_columns
from helpers.run_seed import chosen

from lidarscene.detection.outcomes import Outcome, Status
from lidarscene.rendering.simulator import Simulator
from lidarscene.scene.scene import Air
from lidarscene.scene.weather import Weather

pytestmark = pytest.mark.usefixtures("mi")

ROWS, COLUMNS = volley.LASERS, volley.COLUMNS
STRONG = ["optics.stray.share=0.03", "optics.stray.half_angle_deg=3"]
CLEAR = {"klux": 0.0}


def board(**options):
    """White, 2 m wide at 30 m: rows 6 to 9 of the column at azimuth 0; nothing else anywhere."""
    return chain.facing(range_m=30.0, size_m=2.0, at=(0.0, 0.0, 3.95), material="white", **options)


def scene(*bodies):
    return chain.scene(board(), *bodies, materials=(chain.diffuse("white", 0.8), *panes.MATERIALS), **CLEAR)


def points_of(simulator, **options):
    """Column in the turn, row, status and range of each point."""
    cloud = simulator.render(seed=1, **options)
    column = np.rint(np.degrees(np.asarray(cloud.azimuth_rad, float)) / (360.0 / COLUMNS)).astype(int) % COLUMNS
    return column, np.asarray(cloud.channel, int), np.asarray(cloud.status), np.asarray(cloud.range_m)


def test_a_board_among_dark_channels():
    """The four rows on the board have echoes; the twelve others of its column a point of stray light at its range, and
    no other column has any. Their light, from `Simulator.light`, is the sum of the four with (T122) typed out.
    """
    simulator, missed = Simulator(scene(), volley.sensor(*STRONG)), []
    column, row, status, range_m = points_of(simulator)
    assert (column == 0).all()
    assert sorted(row[status == Status.ECHO]) == [6, 7, 8, 9]
    assert sorted(row[status == Status.STRAY]) == [r for r in range(ROWS) if r not in (6, 7, 8, 9)]
    np.testing.assert_allclose(range_m, 30.3, atol=0.3)  # 30 m straight ahead, 10 degrees up at most
    # Truth is the range of what sent the light; pulses into the sky have no surface, also where they have a point.
    cloud = simulator.render(seed=1, missed=lambda pulse, outcome: missed.append((pulse, outcome)))
    stray = cloud.status == Status.STRAY
    assert np.abs(cloud.true_range_m[stray] - 30.2).max() < 0.3
    assert {*cloud.body[stray], *cloud.class_id[stray]} == {-1}
    ((pulse, outcome),) = missed
    assert len(pulse) == ROWS * COLUMNS - 4
    assert (outcome == Outcome.NO_SURFACE).all()
    light = simulator.light()
    own, leaked = (part.peak_power_w.reshape(COLUMNS, ROWS) for part in light.parts)
    assert (np.flatnonzero(own[0]) == [6, 7, 8, 9]).all()
    assert not own[1:].any()
    assert not leaked[1:].any()
    apart = np.abs(np.arange(ROWS)[:, None] - np.arange(ROWS))
    share = np.where(apart > 0, 1e-4 + 0.03 / (1.0 + (apart / 3.0) ** 2), 0.0)
    # The four are at 30.15 to 30.38 m, 0.9 sigma of the pulse apart: all add up to 40 % of 0.81 at most.
    expected = share @ own[0]
    assert (leaked[0] <= expected * (1.0 + 1e-5)).all()
    assert (leaked[0] > 0.8 * expected).all()


@pytest.mark.parametrize("rays", chosen(1, [1, 9]))
def test_chunks_change_nothing_and_frames_compile_nothing(rays):
    """Chunks hold whole scan lines, however few rays they may have: the same points, bit by bit."""
    keys = [*STRONG, "laser.divergence_mrad=2"]
    wall = chain.facing(range_m=60.0, size_m=200.0, material="white")
    simulator = Simulator(scene(wall), volley.sensor(*keys), rays=rays)
    with launches.launched() as before:
        whole, _ = simulator.render(seed=1), simulator.render(seed=2)
    with launches.launched(after=before):
        simulator.render(seed=3)
    assert (whole.status == Status.STRAY).any()
    assert_same_columns(simulator.render(seed=1, chunk=100), whole)


def test_glass_in_the_same_lines():
    """A pane at 10 m before the lowest four rows of the board's column, with a wall behind it: lines are traced in
    full, so its channels still see the board, and the others the wall, whose light passes the pane twice.
    """
    pane = panes.pane(10.0, 30.0, size_m=1.1)  # leaning: its own glint goes elsewhere
    lit = chain.facing(range_m=20.0, size_m=2.2, material="white")
    simulator = Simulator(scene(pane, lit), volley.sensor(*STRONG, "tdc.stops=3"))
    column, row, status, range_m = points_of(simulator)
    light = simulator.light()
    assert light.surfaces == 2  # two paths of each beam
    stray = light.parts[-1].peak_power_w.reshape(COLUMNS, ROWS)
    assert ((stray > 0.0).sum(axis=1) == [ROWS] + [0] * (COLUMNS - 1)).all()
    on_wall = sorted(row[(status == Status.ECHO) & (np.abs(range_m - 20.05) < 0.3)])
    assert on_wall == [0, 1, 2, 3]
    assert sorted(row[(status == Status.ECHO) & (range_m > 29.0)]) == [6, 7, 8, 9]
    # The strongest source of each dark channel is what it has a point of: the wall's are four times as bright.
    dark = status == Status.STRAY
    assert {4, 5, 10, 11, 12} <= set(row[dark])
    assert set(np.rint(range_m[dark])) <= {20.0, 30.0}
    assert (column == 0).all()


def test_light_from_behind_a_pane_leaks():
    """The board's light is known when the pane's pulses are traced again; then its whole line is, once more."""
    simulator = Simulator(scene(panes.pane(10.0, 30.0, size_m=6.0)), volley.sensor(*STRONG))
    column, row, status, _ = points_of(simulator)
    assert (column == 0).all()
    assert sorted(row[status == Status.ECHO]) == [6, 7, 8, 9]
    assert sorted(row[status == Status.STRAY]) == [r for r in range(ROWS) if r not in (6, 7, 8, 9)]


def test_second_frame_compiles_nothing():
    """Panes behind which light leaks, and panes in quiet lines: some pulses are traced three times."""
    simulator = Simulator(
        scene(panes.pane(10.0, 30.0, size_m=6.0), panes.pane(-10.0, size_m=6.0)), volley.sensor(*STRONG)
    )
    with launches.launched() as before:
        simulator.render(seed=1)
    with launches.launched(after=before):
        simulator.render(seed=2)


def test_panes_in_quiet_lines():
    """Where no light leaks, pulses that meet panes are traced alone, with the same points as without stray light."""
    pane, wall = panes.pane(10.0, 30.0, size_m=1.1), chain.facing(range_m=60.0, size_m=200.0, material="white")
    quiet = volley.sensor("optics.stray.share=0", "optics.stray.veil=0", "tdc.stops=3")
    sensors = quiet, dataclasses.replace(quiet, optics=dataclasses.replace(quiet.optics, stray=None))
    assert_same_columns(*(Simulator(scene(pane, wall), sensor).render(seed=1) for sensor in sensors))


def test_waveforms_of_single_pulses_have_the_light_of_their_line():
    """Chosen pulses are traced with their whole lines: row 0 has the peak of the board that it does not look at."""
    simulator = Simulator(scene(), volley.sensor(*STRONG))
    line = simulator.light().parts[-1].peak_power_w.reshape(COLUMNS, ROWS)
    pulses = [3, 5, ROWS + 2]
    sampled = simulator.waveforms(pulses)
    expected = line.ravel()[pulses]
    assert expected[2] == 0.0
    np.testing.assert_allclose(sampled.power_w.max(axis=1), expected, rtol=5e-3)  # samples of a Gaussian
    assert sampled.range_m[sampled.power_w[0].argmax()] == pytest.approx(30.2, abs=0.3)


def test_fog_and_stray_light():
    """Each pulse has a point of the fog before the lens, of the weather; those at the board's range are echoes on it
    and stray light in its dark neighbours, as without fog.
    """
    described = scene()
    foggy = dataclasses.replace(described, air=Air(weather=Weather(fog_visibility_m=200.0)))
    simulator = Simulator(foggy, volley.sensor(*STRONG))
    _, row, status, range_m = points_of(simulator)
    assert sorted(row[status == Status.ECHO]) == [6, 7, 8, 9]
    stray = status == Status.STRAY
    assert sorted(row[stray]) == [r for r in range(ROWS) if r not in (6, 7, 8, 9)]
    np.testing.assert_allclose(range_m[stray], 30.2, atol=0.5)
    weather = status == Status.WEATHER
    assert (range_m[weather] < 1.0).all()
    assert weather.sum() == ROWS * COLUMNS
