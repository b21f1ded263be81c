"""A cloud beside a recording: what is counted on each side."""

import html
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.clouds import small_cloud

from lidarscene.recordings.sweep import Second, Sweep
from lidarscene.studies.compare.recording_comparison import (
    Side,
    _row,
    compare_with_recording,
    compared_quantities,
    measure_ground,
    side_of_cloud,
    side_of_sweep,
    verdict,
)

HEIGHT_M = 1.8
RINGS = 24


def ground_sweep(height_m: float = HEIGHT_M, tilt: float = 0.02, seed: int = 1) -> Sweep:
    """A sensor over a tilted plane with a wall around it at 30 m: 24 rings from -25 to -2 degrees."""
    rng = np.random.default_rng(seed)
    elevation = np.radians(np.linspace(-25.0, -2.0, RINGS))[:, None]
    azimuth = np.linspace(0.0, 2.0 * np.pi, 300, endpoint=False)[None, :]
    direction = np.stack(
        np.broadcast_arrays(
            np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)
        ),
        axis=-1,
    )
    down = tilt * direction[..., 0] - direction[..., 2]
    range_m = np.minimum(height_m / np.maximum(down, 1e-9), 30.0 / np.cos(elevation))
    range_m = range_m + rng.normal(0.0, 0.01, range_m.shape)
    range_m[0, :30] = np.nan
    second = np.full_like(range_m, np.nan)
    second[5, :100] = range_m[5, :100] + 0.85
    return Sweep(
        range_m=range_m,
        recorded=np.ones_like(range_m, bool),
        direction=direction,
        includes_lost=True,
        ring=np.broadcast_to(np.arange(RINGS)[:, None], range_m.shape),
        signal=400.0 / range_m**2,
        second=Second(range_m=second),
    )


def test_ground_height_and_its_farthest_return() -> None:
    sweep = ground_sweep()
    measured_ground = measure_ground(sweep.xyz_m[sweep.has_return])
    assert measured_ground is not None
    height, farthest, share = measured_ground
    # The perpendicular; 7000 points of 1 cm fix it to less than a millimetre, what is near the wall's foot adds some.
    assert height == pytest.approx(HEIGHT_M / np.hypot(1.0, 0.02), abs=0.005)
    on_ground = np.abs(sweep.xyz_m[..., 2] + HEIGHT_M - 0.02 * sweep.xyz_m[..., 0]) < 0.1
    assert farthest == pytest.approx(np.nanpercentile(sweep.range_m[on_ground], 99.9), rel=0.01)
    assert share == pytest.approx(on_ground.sum() / sweep.has_return.sum(), abs=0.01)
    rng = np.random.default_rng(2)
    assert measure_ground(rng.normal(0.0, 5.0, (50, 3))) is None


def test_losses_second_returns_rings_and_strengths() -> None:
    quantities = compared_quantities(side_of_sweep("real", ground_sweep()))
    pulses = RINGS * 300
    assert quantities["points"] == pulses - 30
    assert quantities["share of pulses kept"] == pytest.approx((pulses - 30) / pulses)
    assert quantities["second returns, 1 % gap [m]"] == pytest.approx(0.85)
    assert quantities["second returns, share"] == pytest.approx(100 / (pulses - 30))
    assert [count for _, count in quantities["rings"]] == [270] + [300] * (RINGS - 1)
    assert quantities["rings"][0][0] == pytest.approx(-25.0)
    # The signal falls with the square of the range: a quarter from octave to octave, whatever its unit.
    near, far = quantities["strength, 4 to 8 m"], quantities["strength, 16 to 32 m"]
    assert 6.0 < near / far < 40.0
    assert quantities["strength, 64 to 128 m"] is None


def test_page_and_numbers(tmp_path: Path) -> None:
    real = side_of_sweep("real", ground_sweep())
    bare = Side(
        name="bare",
        xyz_m=np.ones((3, 3)),
        range_m=np.full(3, np.sqrt(3.0)),
        ring=None,
        strength=None,
        return_share=None,
        gap_m=np.zeros(0),
    )
    report = compare_with_recording(bare, real)
    report.save(tmp_path)
    text = str(report)
    written = json.loads((tmp_path / "real.json").read_text())
    rows = {row["quantity"]: row for row in written["rows"]}
    assert {"quantity": "points", "bare": 3, "real": 7170, "ratio": 3 / 7170}.items() <= rows["points"].items()
    assert rows["sensor above ground [m]"]["bare"] is None
    page = (tmp_path / "index.html").read_text()
    assert "channels with points" in page
    assert "64 to 128" not in page  # of which neither side knows anything
    assert text.splitlines()[0] == written["verdict"]
    assert html.escape(written["verdict"]) in page.partition("<table>")[0]
    assert json.loads(report.as_json()) == written
    assert report.table["quantity"][0] == "points"
    assert (report.table["bare"][0], report.table["real"][0]) == (3, 7170)


def test_the_verdict_names_what_differs_most() -> None:
    points = _row("points", 90, 100)
    same_range, far, ring = (_row("range", 1.0, 1.05), _row("ground [m]", 10.0, 40.0), _row("points at 3", 1, 9))
    counts = "twin has 90 points, real 100 (-10 %)"
    unknown = _row("share", None, 0.9)
    sentence = verdict("twin", "real", [points, same_range, far, ring, unknown, _row("gap [m]", 0.8, None)])
    largest, alone = (
        "what differs most is 'ground [m]': 10 against 40",
        "only twin has 'gap [m]'; only real has 'share'",
    )
    assert sentence == f"{counts}; {largest}; {alone}."
    assert verdict("twin", "real", [points, same_range, ring]) == f"{counts}; nothing else differs by 10 % or more."
    assert (
        verdict("twin", "real", [points, unknown]) == f"{counts}; nothing else is known of both; only real has 'share'."
    )
    assert verdict("a", "b", [_row("points", 3, 3)]).startswith("a has 3 points, as many as b; nothing")
    assert verdict("a", "b", [_row("points", 3, 0)]).startswith("a has 3 points, b 0; nothing else")


def test_the_ground_is_the_lowest_level_not_the_fullest() -> None:
    """A platform a metre above the ground has three points of five; a few stray points lie below both."""
    place = np.stack(np.meshgrid(np.linspace(-20.0, 20.0, 50), np.linspace(-20.0, 20.0, 50)), axis=-1).reshape(-1, 2)
    number = np.arange(len(place))
    z = np.where(number % 5 < 2, -1.8, -0.8)
    z = np.where(number % 50 == 0, -4.0, z)
    xyz_m = np.column_stack([place, z])
    ground = measure_ground(xyz_m)
    assert ground is not None
    assert ground[0] == pytest.approx(1.8, abs=1e-6)
    assert ground[2] == pytest.approx(np.mean(z == -1.8))
    assert ground[1] == pytest.approx(
        np.percentile(np.linalg.norm(np.column_stack([place, z])[z == -1.8], axis=1), 99.9)
    )


def test_strengths_of_an_octave_are_of_its_own_ranges() -> None:
    """8 up to 8 m, 4 up to 16 m, and 1 farther out, where most points are: over the median of all, 1."""
    range_m = np.repeat([5.0, 10.0, 20.0], [200, 200, 600])
    side = Side(
        name="s",
        xyz_m=np.column_stack([range_m, 0.0 * range_m, 0.0 * range_m]),
        range_m=range_m,
        ring=None,
        strength=np.repeat([16.0, 8.0, 2.0], [200, 200, 600]),
        return_share=None,
        gap_m=np.zeros(0),
    )
    strengths = {name: value for name, value in compared_quantities(side).items() if name.startswith("strength")}
    assert list(strengths.values()) == [None, 8.0, 4.0, 1.0, None, None, None]


def test_the_height_is_square_to_the_ground() -> None:
    place = np.stack(np.meshgrid(np.linspace(-8.0, 8.0, 40), np.linspace(-8.0, 8.0, 40)), axis=-1).reshape(-1, 2)
    ground = measure_ground(np.column_stack([place, -1.8 + 0.05 * place[:, 0] + 0.1 * place[:, 1]]))
    assert ground is not None
    assert ground[0] == pytest.approx(1.8 / np.sqrt(1.0 + 0.05**2 + 0.1**2), abs=1e-6)


def test_second_returns_of_a_cloud_are_of_one_channel_at_one_time() -> None:
    """Two channels fire at 0 s; the first has a second return a metre on, and one at 1 s."""
    cloud = small_cloud(
        n=4,
        time_s=np.array([0.0, 0.0, 0.0, 1.0]),
        channel=np.array([0, 1, 0, 0], np.uint16),
        return_number=np.array([1, 1, 2, 1], np.uint8),
        range_m=np.array([10.0, 30.0, 11.0, 20.0], np.float32),
        signal=np.zeros(4, np.float32),
    )
    side = side_of_cloud("made", cloud)
    assert side.gap_m.tolist() == [1.0]
    assert side.range_m.tolist() == [10.0, 30.0, 20.0]
    np.testing.assert_array_equal(side.strength, cloud.intensity[[0, 1, 3]])  # no photons were counted
    assert side.return_share is None


def test_what_is_near_the_plane_is_ground_more_so_far_away() -> None:
    """0.1 m or 0.3 % of the range: 5 cm off at 5 m and 13 cm at 50 m are ground; 15 cm at 5 m and 20 cm at 50 m not."""
    place = np.stack(np.meshgrid(np.linspace(-15.0, 15.0, 40), np.linspace(-15.0, 15.0, 40)), axis=-1).reshape(-1, 2)
    plane = np.column_stack([place, np.full(len(place), -1.8)])
    other_points = np.array([[5.0, 0.0, -1.75], [50.0, 0.0, -1.67], [5.0, 0.0, -1.65], [50.0, 0.0, -1.6]])
    ground = measure_ground(np.concatenate([plane, other_points]))
    assert ground is not None
    assert ground[2] == pytest.approx((len(plane) + 2) / (len(plane) + 4))


def test_the_share_that_is_kept_is_of_what_was_recorded() -> None:
    sweep = ground_sweep()
    recorded = np.ones(sweep.shape, bool)
    recorded[:, 200:] = False
    side = side_of_sweep("real", replace(sweep, recorded=recorded, range_m=np.where(recorded, sweep.range_m, np.nan)))
    assert side.return_share == pytest.approx((RINGS * 200 - 30) / (RINGS * 200))
