"""Points by column: the names, units and clocks of drivers, and points that stand for nothing."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

from lidarscene.recordings.sweep_from_columns import sweep_of

XYZ = {"x": np.array([1.0, 2.0, 0.0, np.inf]), "y": np.array([0.0, 0.0, 5e-4, 0.0]), "z": np.zeros(4)}
"""The third is the zero that drivers write for a lost pulse, to half a millimetre; the last is no place."""


def test_what_is_no_point_is_no_point() -> None:
    """Such rows are left out of a list; of an array they are pulses of which nothing came back."""
    columns = XYZ | {"scalar_Ring": np.arange(4)}
    listed = sweep_of(columns, metadata={})
    assert listed.range_m.tolist() == [1.0, 2.0]
    assert listed.ring is not None
    assert listed.ring.tolist() == [0, 1]
    array = sweep_of(columns, shape=(2, 2), metadata={})
    assert array.lost.tolist() == [[False, False], [True, True]]


def test_marks_within_the_window_are_no_points() -> None:
    """Rationale: nuScenes' sweeps have thousands of points nearer than 5 cm, and the twin had surfaces there."""
    columns = {"x": np.array([0.03, 0.0, 0.06]), "y": np.array([0.0, 0.049, 0.0]), "z": np.zeros(3)}
    assert sweep_of(columns, metadata={}).range_m.tolist() == [0.06]
    assert sweep_of(columns, shape=(1, 3), metadata={}).lost.tolist() == [[True, True, False]]


def test_lost_pulses_before_the_first_point() -> None:
    """Rationale: an Ouster's cloud that begins in the sky; its `t` is unsigned."""
    columns = {"x": np.array([0.0, 2.0]), "y": np.zeros(2), "z": np.zeros(2), "t": np.array([1000, 5000], np.uint32)}
    sweep = sweep_of(columns, shape=(1, 2), start_s=50.0, metadata={})
    assert sweep.time_s is not None
    assert sweep.time_s[0].tolist() == pytest.approx([-4e-6, 0.0])


@pytest.mark.parametrize("names", ["xyz", ("x", "y", "z", "ring")])
def test_rows_are_lasers(names: Iterable[str]) -> None:
    """Rationale: RoboSense's and Velodyne's drivers write organised clouds with a row for each firing."""
    ring, firing = np.indices((3, 50))
    columns = {"x": 9.0 + firing, "y": 1.0 * firing, "z": (ring - 1.0) * (9.0 + firing), "ring": ring}
    columns["x"][1, 7] = columns["y"][1, 7] = np.nan  # a lost pulse
    for named in (columns, {name: values.T for name, values in columns.items()}):
        sweep = sweep_of({name: named[name] for name in names}, shape=named["x"].shape, metadata={})
        assert sweep.shape == (3, 50)
        assert np.argwhere(sweep.lost).tolist() == [[1, 7]]
        np.testing.assert_allclose(sweep.xyz_m[2, 9], [18.0, 9.0, 18.0])
    leaning = {"x": columns["x"], "y": columns["y"], "z": columns["y"] + 1e-3 * columns["z"]}
    assert sweep_of(leaning, shape=(3, 50), metadata={}).shape == (3, 50)  # of a sensor that was mounted askew


@pytest.mark.parametrize(
    ("stamps", "start_s", "times_s", "began_s"),
    [
        (np.array([2_000, 3_000, 0, 0], np.int32), 50.0, [0.0, 1e-6], 50.000_002),  # nanoseconds after the message's
        (np.array([2_000, 3_000, 0, 0], np.uint32), 0.0, [0.0, 1e-6], 2e-6),
        (np.array([2e-6, 3e-6, -9.0, -9.0]), 50.0, [0.0, 1e-6], 50.000_002),  # seconds
        (np.array([2e-6, np.nan, 0.0, 0.0]), 50.0, [0.0, np.nan], 50.000_002),
        (np.array([1.7e9, 1.7e9 + 0.5, 0.0, 0.0]), 50.0, [0.0, 0.5], 1.7e9),  # since 1970: no stamp is added
        (np.array([17, 17 + 5, 0, 0], np.int64) * 10**17, 50.0, [0.0, 5e8], 1.7e9),
    ],
)
def test_clocks_of_drivers(stamps: Any, start_s: float, times_s: list[float], began_s: float) -> None:
    """Whole numbers are nanoseconds. The first time is that of a point: the stamps of lost pulses may be anything."""
    sweep = sweep_of(XYZ | {"t": stamps}, start_s=start_s, metadata={})
    assert sweep.time_s is not None
    np.testing.assert_allclose(sweep.time_s, times_s, rtol=1e-9, atol=1e-15)
    assert sweep.start_s == pytest.approx(began_s, rel=1e-15)
    array = sweep_of(XYZ | {"t": stamps}, shape=(2, 2), start_s=start_s, metadata={})
    assert array.time_s is not None
    np.testing.assert_allclose(array.time_s[0], times_s, rtol=1e-9, atol=1e-15)
    assert array.start_s == pytest.approx(began_s, rel=1e-15)


def test_a_name_says_nanoseconds() -> None:
    """Rationale: a table with gaps has floats of nanoseconds, which were taken as seconds: a sweep of years."""
    sweep = sweep_of(XYZ | {"offset_ns": np.array([2e3, np.nan, 0.0, 0.0])}, metadata={})
    assert sweep.time_s is not None
    np.testing.assert_allclose(sweep.time_s, [0.0, np.nan])
    assert sweep.start_s == pytest.approx(2e-6)


def test_a_damaged_number_warns_nobody() -> None:
    """Rationale: NumPy warned of float32 NaNs that signal, which flipped bits may be."""
    x_m = np.array([0x7F800001, 0x41200000, 0x41A00000, 0x41F00000], np.uint32).view(np.float32)
    sweep = sweep_of({"x": x_m, "y": XYZ["y"], "z": XYZ["z"]}, metadata={})
    assert len(sweep.range_m) == 3
