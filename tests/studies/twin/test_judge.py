"""What the table counts, on pulses made by hand."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.twins import N, pulses, room_sweep

from lidarscene.maths.arrays import Numbers
from lidarscene.recordings.sweep import Sweep
from lidarscene.studies.held import Held
from lidarscene.studies.twin import judge
from lidarscene.studies.twin.judge import bias_and_scatter, spread
from lidarscene.studies.twin.matched_pulses import NO_SURFACE, MatchedPulses
from lidarscene.studies.twin.surfels import ROUGH, SMOOTH


def rows_named(rows: Any, quantity: str) -> list[Held]:
    return [row for row in rows if row.quantity == quantity]


def with_nan(values: Numbers, mask: Numbers) -> Numbers:
    return np.where(mask, np.nan, values)


def test_bias_and_scatter_come_apart() -> None:
    """A shift is bias alone. A normal twice as wide has its area: 2 sigma phi(0) = 0.798 sigma between quantiles."""
    rng = np.random.default_rng(2)
    values = rng.normal(0.0, 1.0, 100_000)
    assert bias_and_scatter(values, values + 3.0) == pytest.approx((3.0, 0.0), abs=1e-9)
    bias, scatter = bias_and_scatter(values, 2.0 * values)
    assert (bias, scatter) == (pytest.approx(0.0, abs=0.01), pytest.approx(0.798, abs=0.01))


def test_spread_is_the_deviation_whatever_a_few_do() -> None:
    values = np.random.default_rng(1).normal(0.0, 3.0, 20_000)
    values[:400] = 100.0
    assert spread(values) == pytest.approx(3.0, rel=0.05)


@pytest.mark.parametrize("sigma_mm", [0.5, 0.9, 1.5, 2.2])
def test_spread_of_whole_millimetres(sigma_mm: float) -> None:
    """Noise and step add as squares, step^2 / 12; by the median deviation these four read 0, 1.5, 1.5 and 3 mm.

    20 000 numbers have 0.5 % of sigma: 4 % are 6 sigma and 1 % for the steps at the ends.
    """
    values_mm = np.rint(np.random.default_rng(3).normal(0.3, sigma_mm, 20_000))
    values_mm[:200] = 80.0
    assert spread(values_mm) == pytest.approx(math.sqrt(sigma_mm**2 + 1.0 / 12.0), rel=0.04)
    assert spread(np.full(9, 3.0)) == 0.0


def test_scatter_is_told_by_octaves_and_fails_in_the_one_that_is_off() -> None:
    base = pulses()
    assert base.signal is not None
    weak = base.signal < 32.0
    rows = rows_named(
        judge._ranges(pulses(simulated_change_m=base.simulated_change_m * np.where(weak, 2.0, 1.0))), "range, scatter"
    )
    assert {row.condition: row.verdict for row in rows} == {"signal 16 to 32": False, "signal 32 to 64": True}


def test_returns_before_what_was_recorded_are_counted_there() -> None:
    base = pulses()
    too_near = (base.range_m > 16.0) & (base.range_m < 20.0) & (np.arange(N) % 4 == 0)
    lost = np.arange(N) % 5 == 0
    simulated_m = with_nan(base.simulated_range_m - np.where(too_near, 0.5, 0.0), lost)
    assert [row.value for row in judge._nearer(base, True)] == [0.0, 0.0]
    whole, worst = judge._nearer(pulses(simulated_range_m=simulated_m), True)
    assert whole.value == pytest.approx(too_near[~lost].mean())
    assert not whole.verdict
    assert worst.condition == "16 to 32 m"
    assert not next(judge._nearer(pulses(simulated_range_m=simulated_m), False)).is_limited
    of_octave = (base.range_m >= 16.0) & ~lost & (base.range_m < 32.0)
    assert worst.value == pytest.approx(too_near[of_octave].mean())


def test_what_is_of_another_surface_has_no_bias() -> None:
    base = pulses()
    far = np.arange(N) % 3 == 0
    (row,) = rows_named(judge._ranges(pulses(range_m=base.range_m + 5.0 * far)), "range, bias")
    assert row.verdict


def test_points_and_the_worst_ring() -> None:
    base = pulses()
    is_lost = (base.ring == 3) & (np.arange(N) < N // 2)
    rows = list(judge._points(pulses(simulated_range_m=with_nan(base.simulated_range_m, is_lost))))
    (points,), (worst,) = rows_named(rows, "points"), rows_named(rows, "points per ring, worst")
    assert points.value == pytest.approx(-1.0 / 16.0)
    assert (worst.condition, worst.value, worst.verdict) == ("ring 3", pytest.approx(-0.5), False)


def test_losses_count_on_smooth_surfaces_and_without_those_withheld() -> None:
    base = pulses()
    number = np.arange(N)
    is_lost, withheld, sky, rough = number < 500, number < 100, number // 100 == 1, number // 100 == 4
    kept_anyway = (number >= 200) & (number < 230)
    lossy = pulses(
        range_m=with_nan(base.range_m, is_lost),
        withheld=withheld,
        kind=np.where(sky, NO_SURFACE, np.where(rough, ROUGH, SMOOTH)),
        simulated_range_m=with_nan(base.simulated_range_m, (number >= 230) & (number < 400)),
    )
    losses = judge.losses_kept(lossy)
    assert (losses.condition, losses.value) == ("of 200", pytest.approx(kept_anyway.sum() / 200.0))
    (returns_kept,) = rows_named(judge._kept_quantities(lossy), "real returns kept")
    assert (returns_kept.value, returns_kept.verdict) == (1.0, True)


@pytest.mark.parametrize(("kept", "is_met"), [(0.89, True), (0.91, False)])
def test_losses_by_chance_are_held_to_what_the_recording_keeps_there(kept: float, is_met: bool) -> None:
    """A pulse that is kept in four turns of five is kept as often by the very sensor, whatever was lost before."""
    base, number = exact_pulses(), np.arange(N)
    lossy = exact_pulses(
        range_m=with_nan(base.range_m, number < 200),
        simulated_range_m=with_nan(base.simulated_range_m, (number < 200) & (number >= 200 * kept)),
    )
    row = judge.losses_kept(lossy, np.where(number < 200, 0.8, 0.0))
    assert (row.reference, row.value, row.verdict) == (pytest.approx(0.8), pytest.approx(kept), is_met)
    assert judge.losses_kept(lossy.select(number % 3 == 0), np.ones(N)[number % 3 == 0]).value is None


def test_disagreement_is_held_to_that_of_two_real_frames() -> None:
    range_m = np.array(room_sweep().range_m)
    range_m[0, :36] = np.nan
    between = judge.disagreement(room_sweep(), room_sweep(range_m=range_m))
    assert between == pytest.approx(0.1 / 24.0)
    base = pulses()
    for share, is_met in ((0.03, True), (0.04, False)):
        is_lost = np.arange(N) < share * N
        rows = judge._kept_quantities(pulses(simulated_range_m=with_nan(base.simulated_range_m, is_lost)), between)
        (row,) = rows_named(rows, "kept or lost otherwise than real")
        assert (row.value, row.verdict) == (pytest.approx(share), is_met)
    assert judge.disagreement(room_sweep(), room_sweep(includes_lost=False)) is None


def exact_pulses(**changed: Any) -> MatchedPulses:
    """Pulses as `pulses`, but both sides agree to the last digit."""
    true_m = np.linspace(5.0, 40.0, N)
    return pulses(**{"range_m": true_m, "simulated_range_m": true_m} | changed)


def value_of(rows: Any, quantity: str) -> Held:
    return next(row for row in rows if row.quantity == quantity and row.value is not None)


def test_the_bias_is_of_the_simulation_against_the_recording() -> None:
    """The recording is 5 mm behind the twin's surface, the simulation 9 mm."""
    true_m = exact_pulses().true_range_m
    rows = list(judge._ranges(exact_pulses(range_m=true_m + 0.005, simulated_range_m=true_m + 0.009)))
    assert value_of(rows, "range, bias").value == pytest.approx(4.0)
    assert value_of(rows, "range, double validation metric").value == pytest.approx(4.0)


@pytest.mark.parametrize(("factor", "is_met"), [(0.7, False), (0.85, True), (1.2, True), (1.4, False)])
def test_scatter_is_that_of_the_simulation_over_the_recorded(factor: float, is_met: bool) -> None:
    plain = pulses()
    row = value_of(judge._ranges(pulses(signal=None, simulated_change_m=factor * plain.change_m)), "range, scatter")
    assert (row.value, row.verdict) == (pytest.approx(factor), is_met)


def test_limits_of_the_scatter_are_those_of_the_table_for_few_pulses_too() -> None:
    """Rationale: two sigma of so many pulses made them 0.65 to 1.53, which hid misses. Fewer than 600 do not count."""
    plain = pulses(signal=None)
    for count, rows in ((600, 1), (599, 0)):
        few = list(judge._scatters(plain.select(np.arange(N) < count)))
        assert [row.limits[:2] for row in few] == [(0.8, 1.25)] * rows


def test_errors_of_the_signal_do_not_cancel_over_the_range() -> None:
    """30 % too much near by, 20 % too little far off: 25 % in the mean; the bins are half and half."""
    plain = exact_pulses()
    assert plain.signal is not None
    near = plain.true_range_m < np.median(plain.true_range_m)
    rows = list(judge._signals(exact_pulses(simulated_signal=plain.signal * np.where(near, 1.3, 0.8))))
    by_range = [row.value for row in rows_named(rows, "signal, mean")]
    assert by_range == [pytest.approx(0.3, abs=1e-3)] * 4 + [pytest.approx(-0.2, abs=1e-3)] * 4
    assert value_of(rows, "signal, mean error over the range").value == pytest.approx(0.25, abs=1e-3)
    assert [row.verdict for row in judge._signals(pulses(signal=None))] == [None]
    for factor, is_met in ((1.14, True), (1.16, False), (0.86, True), (0.84, False)):
        scaled = judge._signals(exact_pulses(simulated_signal=factor * plain.signal))
        assert value_of(scaled, "signal, mean error over the range").verdict is is_met


def test_the_mean_signal_is_of_the_pulses_that_return_on_both_sides() -> None:
    """What one side alone lost is three times as strong on the other, and stays out of both means."""
    plain = exact_pulses()
    assert plain.signal is not None
    numbers = np.arange(N)
    is_lost, is_missed = numbers % 3 == 0, numbers % 3 == 1
    rows = judge._signals(
        exact_pulses(
            range_m=with_nan(plain.range_m, is_lost),
            signal=plain.signal * np.where(is_missed, 3.0, np.where(is_lost, 0.0, 1.0)),
            simulated_range_m=with_nan(plain.simulated_range_m, is_missed),
            simulated_signal=1.1 * plain.signal * np.where(is_lost, 3.0, 1.0),
        )
    )
    assert value_of(rows, "signal, mean").value == pytest.approx(0.1, abs=1e-6)


def test_a_mean_that_chance_moves_by_its_limit_is_not_judged() -> None:
    """One retro-reflector of 96 pulses beyond 64 m had a third of their light and more, and was met on one side."""
    plain = exact_pulses()
    assert plain.signal is not None
    octave = np.floor(np.log2(plain.range_m))
    far = np.flatnonzero(octave == octave.max())
    signal = np.where(np.arange(N) == far[0], plain.signal[far].sum(), plain.signal)
    rows = list(judge._signals(exact_pulses(signal=signal, simulated_signal=plain.signal)))
    assert value_of(rows, "signal, error in the worst octave of the range").value == pytest.approx(0.0, abs=1e-6)
    met = judge._signals(exact_pulses(signal=signal, simulated_signal=signal * 1.2))
    assert value_of(list(met), "signal, error in the worst octave of the range").value == pytest.approx(0.2, abs=1e-6)


def test_clusters_stand_beside_those_of_the_columns_that_made_the_twin() -> None:
    """Thirty poles on a circle of 10 m: the simulated cloud has all of them, the recorded columns four in five."""
    x, y, z = (axis.ravel() for axis in np.meshgrid(*(0.15 * (np.arange(n) + 0.5) for n in (2, 2, 9))))
    angle = np.radians(np.repeat(np.arange(0.0, 360.0, 12.0), len(x)))
    points_m = np.stack([10.0 * np.cos(angle), 10.0 * np.sin(angle), np.zeros_like(angle)], axis=-1)
    points_m += np.tile(np.stack([x, y, z], axis=-1), (30, 1))
    n = len(points_m)
    here = pulses(
        range_m=np.r_[np.ones(n), np.full(N - n, np.nan)], simulated_range_m=np.r_[np.ones(n), np.full(N - n, np.nan)]
    )
    cloud_m = np.concatenate([points_m, np.zeros((N - n, 3))])
    range_m = np.linalg.norm(points_m[n // 5 :], axis=1)
    sweep = Sweep(
        range_m=range_m, recorded=np.ones(len(range_m), bool), direction=points_m[n // 5 :] / range_m[:, None]
    )
    row = judge._clusters(replace(here, xyz_m=cloud_m, simulated_xyz_m=cloud_m), sweep)
    assert (row.simulated, row.reference, row.value) == (1.0, 0.8, 1.25)
    assert row.condition == "of 30, real: in what the twin is made of"
    assert judge._clusters(replace(here, xyz_m=cloud_m, simulated_xyz_m=cloud_m)).condition == "of 30"


def test_ranges_without_a_recorded_signal_have_no_error() -> None:
    """A field of zeros is one that the recorder lacked: of its half of the range nothing is judged."""
    plain = exact_pulses()
    assert plain.signal is not None
    far = plain.true_range_m >= np.median(plain.true_range_m)
    rows = list(judge._signals(exact_pulses(signal=np.where(far, 0.0, plain.signal))))
    assert [row.value for row in rows_named(rows, "signal, mean")] == [pytest.approx(0.0, abs=1e-3)] * 4
    none = judge._signals(exact_pulses(signal=np.zeros(N)))
    assert [row.value for row in rows_named(none, "signal, mean error over the range")] == [None]


def test_signals_that_go_against_each_other_correlate_with_minus_one() -> None:
    plain = exact_pulses()
    assert plain.signal is not None
    rows = judge._signals(exact_pulses(simulated_signal=1e4 / plain.signal))
    assert value_of(rows, "signal, correlation of logarithms").value == pytest.approx(-1.0)


@pytest.mark.parametrize(
    ("quantity", "lost_share", "is_met"),
    [
        ("points", 0.04, True),
        ("points", 0.06, False),
        ("real returns kept", 0.04, True),
        ("real returns kept", 0.06, False),
        ("points per ring, worst", 0.09, True),
        ("points per ring, worst", 0.11, False),
    ],
)
def test_limits_of_what_is_lost(quantity: str, lost_share: float, is_met: bool) -> None:
    plain = exact_pulses()
    is_lost = (np.arange(N) // 8) % 100 < 100 * lost_share  # as many on each ring
    thinned = exact_pulses(simulated_range_m=with_nan(plain.simulated_range_m, is_lost))
    assert value_of([*judge._points(thinned), *judge._kept_quantities(thinned)], quantity).verdict is is_met


@pytest.mark.parametrize(("kept_anyway", "is_met"), [(95, True), (105, False)])
def test_of_real_losses_no_more_than_half_may_be_kept(kept_anyway: int, is_met: bool) -> None:
    plain, number = exact_pulses(), np.arange(N)
    lossy = exact_pulses(
        range_m=with_nan(plain.range_m, number < 200),
        simulated_range_m=with_nan(plain.simulated_range_m, (number >= kept_anyway) & (number < 200)),
    )
    assert judge.losses_kept(lossy).verdict is is_met


@pytest.mark.parametrize(("angle_deg", "is_met"), [(0.009, True), (0.011, False)])
def test_beams_agree_to_a_hundredth_of_a_degree(
    angle_deg: float, is_met: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("_ranges", "_signals", "_points", "_second"):
        monkeypatch.setattr(judge, name, lambda *_: ())
    rows = judge.twin_quantities(exact_pulses(angle_rad=np.full(N, np.radians(angle_deg))))
    row = value_of(rows, "beam direction")
    assert (row.value, row.verdict) == (pytest.approx(angle_deg), is_met)
    one_ring = np.where(exact_pulses().ring == 3, 2.0 * angle_deg, 0.0)
    whole, worst = judge._directions(exact_pulses(angle_rad=np.radians(one_ring)))
    assert (whole.value, worst.condition) == (0.0, "ring 3")
    assert (worst.value, worst.verdict) == (pytest.approx(2.0 * angle_deg), is_met)


@pytest.mark.parametrize(("farthest_m", "is_met"), [(43.0, True), (41.0, False), (57.0, True), (58.0, False)])
def test_the_farthest_ground_is_held_to_15_per_cent(
    farthest_m: float, is_met: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    clouds: list[Numbers] = []

    def ground_m(xyz_m: Numbers) -> float:
        clouds.append(xyz_m)
        return 50.0 if len(clouds) == 1 else farthest_m

    monkeypatch.setattr(judge, "farthest_ground_m", ground_m)
    row = judge._ground(exact_pulses())
    assert (row.value, row.verdict) == (pytest.approx(farthest_m / 50.0 - 1.0), is_met)
    assert [cloud.shape for cloud in clouds] == [(N, 3), (N, 3)]


@pytest.mark.parametrize(
    ("period", "gap_m", "share_met", "gap_met"),
    [(14, 0.90, True, True), (16, 1.10, False, True), (10, 1.20, True, False), (6, 0.80, False, False)],
)
def test_limits_of_second_returns(period: int, gap_m: float, share_met: bool, gap_met: bool) -> None:
    """Every tenth recorded pulse has a second return, a metre apart at least; shares to 1.5, gaps to 15 %."""
    number = np.arange(N)
    share, gap = judge._second(
        exact_pulses(
            gap_m=np.where(number % 10 == 0, 1.0 + (number > 1000), np.nan),
            simulated_gap_m=np.where(number % period == 0, gap_m + (number > 1000), np.nan),
        )
    )
    assert (share.value, share.verdict) == (pytest.approx(10.0 / period, rel=0.01), share_met)
    assert (gap.value, gap.verdict) == (pytest.approx(gap_m - 1.0), gap_met)
    assert (gap.reference, gap.simulated) == (pytest.approx(1.0), pytest.approx(gap_m))
    assert list(judge._second(pulses())) == []


def test_frames_are_told_apart_by_the_pulses_that_both_recorded() -> None:
    """A quarter of the pulses is lost in one frame; the half that holds them was recorded in both."""
    plain = room_sweep()
    range_m, recorded = np.array(plain.range_m), np.ones(plain.shape, bool)
    range_m[:, :90] = np.nan
    recorded[:, 180:] = False
    assert judge.disagreement(room_sweep(recorded=recorded), room_sweep(range_m=range_m)) == pytest.approx(0.5)


@pytest.mark.parametrize(("bias_mm", "is_met"), [(9.9, True), (10.1, False), (-9.9, True), (-10.1, False)])
def test_ten_millimetres_of_bias_either_way(bias_mm: float, is_met: bool) -> None:
    rows = judge._ranges(exact_pulses(simulated_range_m=exact_pulses().true_range_m + 1e-3 * bias_mm))
    assert value_of(rows, "range, bias").verdict is is_met


def test_what_too_few_pulses_are_there_for_is_listed() -> None:
    """Rationale: the rows of the scatter and of the rings vanished, and the verdict counted the others."""
    few = pulses().select(np.arange(N) < judge.LEAST_PULSES // 2)
    rows = [*judge._ranges(few), *judge._signals(few), *judge._points(few)]
    unmeasured = {row.quantity for row in rows if row.is_limited and row.value is None}
    signals = {"signal, mean error over the range", "signal, error in the worst octave of the range"}
    assert unmeasured == {"range, bias", "range, scatter", "points per ring, worst", *signals}


def test_a_near_field_that_is_off_shows_in_its_octave() -> None:
    """Rationale: near ranges have few returns, so a mean over bins of as many returns hid -70 % at 1 to 3 m.

    Here 100 of 4000 returns, from 5 to 5.9 m, have 0.3 of their signal; those of the octave from 4 to 8 m are 343.
    """
    plain = pulses()
    near = np.arange(N) < 100
    signal = np.asarray(plain.signal)
    rows = list(judge._signals(pulses(simulated_signal=np.where(near, 0.3, 1.0) * signal)))
    (mean,) = rows_named(rows, "signal, mean error over the range")
    (worst,) = rows_named(rows, "signal, error in the worst octave of the range")
    octave = (np.asarray(plain.range_m) >= 4.0) & (np.asarray(plain.range_m) < 8.0)
    expected = 0.7 * signal[near].sum() / signal[octave].sum()
    assert mean.verdict
    assert worst.condition == "4 to 8 m"
    assert worst.value == pytest.approx(expected, rel=0.02)
    assert worst.verdict is False
