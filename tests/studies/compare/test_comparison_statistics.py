"""Comparison of sensors: its statistics by other roads, its matching, and what the scene says by closed forms."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import chain
from helpers.clouds import small_cloud
from helpers.mistakes import told
from scipy import stats

from lidarscene import load_sensor
from lidarscene.detection.outcomes import Status
from lidarscene.maths.pose import Pose
from lidarscene.rendering.render_options import FrameOptions
from lidarscene.rendering.simulator import Simulator, Summary
from lidarscene.scene.scene import Air
from lidarscene.studies.compare import cloud_matching, observations
from lidarscene.studies.compare import comparison_statistics as statistics
from lidarscene.studies.compare.bench import Bench, _ray_key, fires_alike, with_beams_of
from lidarscene.studies.compare.illuminance_sweep import _equal_range_klux, lead_changes, sweep_illuminance
from lidarscene.studies.ranging import plane

COARSE = [
    "scanner.azimuth_fov_deg=60",
    "scanner.azimuth_step_deg=0.5",
    "scanner.elevation_fov_deg=20",
    "scanner.elevation_step_deg=0.5",
]
WEAK = "laser.peak_power_w=0.3"


def scene():
    """Boards of three reflectivities, far enough for a weak laser to find some of their pulses only."""
    return chain.scene(
        chain.facing(range_m=40.0, size_m=12.0, material="dark"),
        chain.box(at=(15.0, 6.0, 0.0)),
        chain.ball(at=(20.0, -5.0, 0.0), radius_m=2.0, material="bright"),
        materials=(chain.diffuse("dark", 0.05), chain.diffuse("bright", 0.6)),
    )


@pytest.fixture(scope="module")
def bench(mi):
    return Bench(scene(), FrameOptions(seed=3))


@pytest.fixture(scope="module")
def observed_pair(bench):
    """The scene by an APD and by a SiPM."""
    return [bench.observe(name, chain.sensor(name, WEAK, *COARSE)) for name in ("table1-apd", "table1-sipm")]


# --- statistics -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("hits", "total"), [(0, 10), (1, 10), (5, 11), (10, 10), (65429, 71785)])
def test_wilson_is_scipys(hits: int, total: int) -> None:
    ends = stats.binomtest(hits, total).proportion_ci(0.95, method="wilson")
    assert statistics.wilson_interval(hits, total) == pytest.approx((ends.low, ends.high), abs=1e-12)


def test_nothing_has_no_rate() -> None:
    assert statistics.wilson_interval(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize("p", [(0.5, 0.1, 0.05), (0.8, 0.02, 0.15), (0.3, 0.3, 0.3)])
def test_paired_interval_covers(p: tuple[float, float, float]) -> None:
    """Rationale: an interval of 95 % holds the true difference in 95 % of all samples.

    Reference: every outcome of 60 pairs, with its multinomial probability. Tolerance: the interval is
    approximate; in Agresti and Min's study it covers within 2 % of its level for such cases.
    """
    n, (_, only_a, only_b) = 60, p
    covered = 0.0
    neither_found = 1.0 - only_a - only_b
    for b in range(n + 1):
        for c in range(n + 1 - b):
            low, high = statistics.paired_interval(only_a=b, only_b=c, pulses=n)
            if low <= only_a - only_b <= high:
                covered += stats.multinomial.pmf([b, c, n - b - c], n, [only_a, only_b, neither_found])
    assert covered == pytest.approx(0.95, abs=0.02)


def surfaces(n: int = 400, seed: int = 0) -> observations.Surfaces:
    rng = np.random.default_rng(seed)
    return observations.Surfaces(
        pulse=np.sort(rng.choice(3 * n, n, replace=False)),
        detected=rng.random(n) < 0.6,
        snr=rng.random(n).astype(np.float32),
        true_range_m=rng.uniform(0.0, 130.0, n).astype(np.float32),
        incidence_angle_rad=rng.uniform(0.0, math.pi / 2, n).astype(np.float32),
        reflectivity=rng.choice([0.0, 0.1, 0.5, 1.0], n).astype(np.float32),
        body=rng.integers(-1, 3, n).astype(np.int32),
        class_id=rng.integers(-1, 2, n).astype(np.int32),
        probability=rng.random(n).astype(np.float32),
    )


def test_rates_by_brute_force() -> None:
    """Pulse by pulse, bin by bin."""
    all_surfaces = surfaces()
    bins = observations.range_bins(130.0)
    assert (bins.labels[0], bins.labels[-1], len(bins.labels)) == ("0 to 10", "120 to 130", 13)
    for number, rate in enumerate(statistics.rates_by_group(all_surfaces, bins)):
        inside = [i for i, r in enumerate(all_surfaces.true_range_m) if 10 * number <= r < 10 * (number + 1)]
        assert rate.surfaces == len(inside)
        assert rate.found == sum(bool(all_surfaces.detected[i]) for i in inside)
        assert rate.expected == pytest.approx(sum(float(all_surfaces.probability[i]) for i in inside) / len(inside))
    bodies = observations.Grouping(key="body", attribute="body", unit="", labels=("a", "b", "c"))
    assert [r.surfaces for r in statistics.rates_by_group(all_surfaces, bodies)] == [
        int(np.sum(all_surfaces.body == n)) for n in range(3)
    ]


def test_pairs_by_brute_force() -> None:
    a, b = surfaces(seed=1), surfaces(seed=2)
    of_a = dict(zip(a.pulse.tolist(), a.detected.tolist(), strict=True))
    of_b = dict(zip(b.pulse.tolist(), b.detected.tolist(), strict=True))
    outcomes_of_pairs = [(of_a[p], of_b[p]) for p in of_a if p in of_b]
    (counts,) = statistics.count_pairs(a, b)
    expected = [outcomes_of_pairs.count(kind) for kind in ((True, True), (True, False), (False, True), (False, False))]
    assert [counts.both, counts.only_a, counts.only_b, counts.neither] == expected
    bins = observations.range_bins(130.0)
    by_range = statistics.count_pairs(a, b, bins)
    assert sum(p.only_b for p in by_range) == counts.only_b
    assert counts.difference == pytest.approx((expected[1] - expected[2]) / len(outcomes_of_pairs))


@pytest.mark.parametrize(("reach", "step"), [(0.3, 0.02), (16.0, 1.0), (17.0, 2.0), (130.0, 10.0), (900.0, 100.0)])
def test_bins_hold_all(reach: float, step: float) -> None:
    bins = observations.range_bins(reach)
    assert bins.edges is not None
    assert bins.edges[1] == pytest.approx(step)
    assert 1 <= len(bins.labels) <= 16
    assert bins.edges[-1] >= reach


def test_edges_of_bins() -> None:
    """The upper edge belongs to the next bin, that of the last to the last; inf to none."""
    ranges = np.array([0.0, 10.0, 130.0, 131.0, np.inf], dtype=np.float32)
    edge_surfaces = dataclasses.replace(surfaces(5), true_range_m=ranges)
    assert observations.range_bins(130.0).group_index(edge_surfaces).tolist() == [0, 1, 12, -1, -1]


# --- what the simulation hands out ------------------------------------------------------------------


def test_observer_sees_every_surface(mi) -> None:
    """Rationale: points and missed pulses are handed out on another way, which must tell the same."""
    simulator = Simulator(scene(), chain.sensor("table1-apd", WEAK, *COARSE, "tdc.threshold_to_noise=3.5"))
    pulses, columns, missed_chunks, summary = [], [], [], Summary()
    cloud = simulator.render(
        seed=5,
        chunk=1000,
        summary=summary,
        missed=lambda *chunk: missed_chunks.append(chunk),
        points=lambda pulse, chunk_columns: (pulses.append(pulse), columns.append(chunk_columns)),
    )
    pulse = np.concatenate(pulses)
    assert len(columns) > 2  # chunks of whole tiles
    assert np.array_equal(simulator.sensor.scanner.time_s(pulse), cloud.time_s)
    columns = [chunk_columns for chunk_columns in columns if chunk_columns]  # a chunk of the sky has none
    hit_columns = {name: np.concatenate([chunk_columns[name] for chunk_columns in columns]) for name in columns[0]}
    assert len(hit_columns["pulse"]) == summary.hits
    assert np.array_equal(
        hit_columns["pulse"][hit_columns["outcome"] == 0], np.unique(pulse[cloud.status == Status.ECHO])
    )
    missed, outcomes = (np.concatenate([chunk[i] for chunk in missed_chunks]) for i in (0, 1))
    reason = dict(zip(missed.tolist(), outcomes.tolist(), strict=True))
    outcomes_of_pulses = zip(hit_columns["pulse"].tolist(), hit_columns["outcome"].tolist(), strict=True)
    assert all(reason.get(p, 0) == outcome for p, outcome in outcomes_of_pulses)
    echo_rows = np.searchsorted(hit_columns["pulse"], pulse[cloud.status == Status.ECHO])
    for name in ("true_range_m", "incidence_angle_rad", "reflectivity", "body", "class_id", "snr"):
        assert np.array_equal(hit_columns[name][echo_rows], getattr(cloud, name)[cloud.status == Status.ECHO]), name


def test_chunks_change_nothing(bench) -> None:
    sensor = chain.sensor("table1-apd", WEAK, *COARSE)
    in_one_chunk, parts = (
        bench.observe("a", sensor),
        Bench(scene(), FrameOptions(seed=3, chunk=700)).observe("a", sensor),
    )
    for field in dataclasses.fields(observations.Surfaces):
        assert np.array_equal(
            getattr(in_one_chunk.rated_surfaces, field.name), getattr(parts.rated_surfaces, field.name)
        ), field.name
    assert np.array_equal(in_one_chunk.pulse, parts.pulse)


# --- matching ---------------------------------------------------------------------------------------


def test_equal_sensors_do_not_differ(bench) -> None:
    sensor = chain.sensor("table1-apd", WEAK, *COARSE)
    a, b = bench.observe("a", sensor), bench.observe("b", sensor)
    (counts,) = statistics.count_pairs(a.rated_surfaces, b.rated_surfaces)
    assert (counts.only_a, counts.only_b, counts.difference) == (0, 0, 0.0)
    assert 0 < counts.both < counts.pulses
    difference = statistics.paired_range_difference(a, b)
    assert difference is not None
    assert (difference.points, difference.bias_m, difference.sigma_m) == (counts.both, 0.0, 0.0)
    cloud, kinds = statistics.difference_cloud(a, b)
    assert len(cloud) == counts.both
    assert not kinds.any()


def test_difference_cloud(observed_pair) -> None:
    """The definition, pulse by pulse; the points of the first where both have one."""
    a, b = observed_pair
    echoes = [set(observation.pulse[observation.is_echo].tolist()) for observation in observed_pair]
    cloud, kinds = statistics.difference_cloud(a, b)
    assert len(cloud) == len(echoes[0] | echoes[1])
    counts = [len(echoes[0] & echoes[1]), len(echoes[0] - echoes[1]), len(echoes[1] - echoes[0])]
    assert np.bincount(kinds, minlength=3).tolist() == counts
    assert counts[0] > 0
    assert counts[1] > 0  # in 100 klux the APD finds more
    assert np.array_equal(cloud.range_m[kinds < 2], a.cloud.range_m[statistics.first_echoes(a)[1]])
    assert np.all(np.diff(cloud.time_s) > 0.0)


@pytest.mark.parametrize(
    ("changes", "fire_alike"),
    [
        ((), True),
        (("detector.gain=60", "tdc.threshold_to_noise=4", "laser.wavelength_nm=1550"), True),
        (("scanner.azimuth_step_deg=0.4",), False),
        (("laser.repetition_rate_khz=60",), False),
        (("mounting.position_m=[0.0,0.0,1.9]",), False),
        (("scanner.jitter_mrad=1",), False),
        (("mounting.yaw_deg=3",), False),
    ],
)
def test_who_fires_alike(changes: tuple[str, ...], fire_alike: bool) -> None:
    first, second = load_sensor("table1-apd"), load_sensor("table1-apd", overrides=changes)
    assert fires_alike(first, second) is fire_alike
    assert fires_alike(first, with_beams_of(first, second))


def test_paths_are_shared_by_sensors_that_know_as_much_of_surfaces() -> None:
    """Rationale: paths that a sensor without leans traced gave another one the noise of level surfaces."""
    leaning = load_sensor("os0-128-rev7")
    assert leaning.histogram is not None
    changes: tuple[dict[str, Any], ...] = ({}, {"column_range_sigmas": 6.0}, {"column_range_sigmas": None})
    keys = [
        _ray_key(dataclasses.replace(leaning, histogram=dataclasses.replace(leaning.histogram, **changed)))
        for changed in changes
    ]
    assert keys[0] == keys[1] != keys[2]


def test_other_mechanisms_fire_unlike() -> None:
    names = ("vlp-16", "livox-mid-40", "os1-128")
    sensors = [load_sensor(name) for name in names]
    assert [[fires_alike(a, b) for b in sensors] for a in sensors] == np.eye(3, dtype=bool).tolist()


def test_files_match_as_pulses_do(observed_pair, tmp_path: Path) -> None:
    """Two roads: pulse numbers of the simulation, and times and angles of the points in files."""
    for observation in observed_pair:
        observation.cloud.save(tmp_path / f"{observation.name}.ply")
    read = cloud_matching.read_clouds([tmp_path / f"{observation.name}.ply" for observation in observed_pair])
    (by_number,) = statistics.count_pairs(observed_pair[0].rated_surfaces, observed_pair[1].rated_surfaces)
    (by_time,) = statistics.count_pairs(read[0].rated_surfaces, read[1].rated_surfaces)
    assert by_time.neither == 0
    assert by_time == dataclasses.replace(by_number, neither=0)
    classes = observations.groupings(read)[3]
    assert (
        sum(r.found for r in statistics.rates_by_group(read[1].rated_surfaces, classes))
        == by_time.both + by_time.only_b
    )
    assert cloud_matching.disagreeing_share(*read) == 0.0


def test_clouds_of_other_scenes_are_told_apart(mi, observed_pair) -> None:
    """Matched all the same, by name where numbers differ: with a body more before the others."""
    larger_scene = chain.scene(
        dataclasses.replace(chain.box(at=(9.0, -2.0, 0.0)), name="new"),
        *scene().bodies,
        materials=tuple(scene().materials.values()),
    )
    cloud = Bench(larger_scene, FrameOptions(seed=3)).observe("b", chain.sensor("table1-apd", WEAK, *COARSE)).cloud
    a, b = cloud_matching.observe_clouds(["x", "x"], [observed_pair[0].cloud, cloud])
    assert (a.name, b.name) == ("x", "x (2)")
    assert a.cloud.body_names == b.cloud.body_names == ("plane", "box", "ball", "new")
    assert 0.1 < cloud_matching.disagreeing_share(a, b) < 0.9
    assert "new" not in {
        r.group for r in statistics.rates_by_group(a.rated_surfaces, observations.groupings([a, b])[4]) if r.found
    }


def test_clouds_of_other_beams_are_not_matched(bench, observed_pair) -> None:
    finer = bench.observe("b", chain.sensor("table1-apd", WEAK, *COARSE, "laser.repetition_rate_khz=49"))
    observed = cloud_matching.observe_clouds(["a", "b"], [observed_pair[0].cloud, finer.cloud])
    assert all(observation.surfaces is None and observation.pulse is None for observation in observed)


def test_clouds_need_truth(observed_pair, tmp_path: Path) -> None:
    observed_pair[0].cloud.without_truth().save(tmp_path / "a.ply")
    with told("a.ply | truth"):
        cloud_matching.read_clouds([tmp_path / "a.ply"] * 2)


# --- closed forms -----------------------------------------------------------------------------------

DENSE = [
    "scanner.azimuth_fov_deg=1",
    "scanner.azimuth_step_deg=0.01",
    "scanner.elevation_fov_deg=1",
    "scanner.elevation_step_deg=0.01",
]


@pytest.mark.parametrize("name", ["table1-apd", "table1-sipm"])
@pytest.mark.parametrize("part", [0.9, 1.0, 1.15])
def test_rate_on_a_plane(mi, name: str, part: float) -> None:
    """Rationale: 10 201 pulses on a plane at about one range are so many draws with one probability.

    Reference: P_d of `studies.ranging.plane`, without tracing. Tolerance: 3.9 standard deviations of the binomial, a
    false-alarm rate of 1e-4 for each of six cases at a fixed seed; the half degree to each side makes ranges and
    cosines differ by 8e-5, which changes P_d by less than a tenth of a standard deviation. For the expected rate that
    part counts alone: 1e-3.
    """
    sensor = chain.sensor(name, *DENSE)
    target = plane.Target()
    limit, _ = plane.maximum_range_m(sensor, target)
    range_m = part * float(limit)
    observation = Bench(chain.scene(chain.facing(range_m=range_m))).observe(name, sensor)
    p = float(plane.detection_probability(sensor, target, range_m)[0])
    rate = statistics.overall_rate(observation.rated_surfaces)
    assert rate.surfaces == 101 * 101
    assert rate.expected == pytest.approx(p, abs=1e-3)
    assert abs(rate.found - p * rate.surfaces) < 3.9 * math.sqrt(p * (1.0 - p) * rate.surfaces)
    deviation = statistics.detection_deviation(observation.rated_surfaces)
    assert deviation is not None
    assert abs(deviation) < 3.9
    for grouping in observations.groupings([observation]):
        (only_group,) = [r for r in statistics.rates_by_group(observation.rated_surfaces, grouping) if r.surfaces]
        assert (only_group.surfaces, only_group.found) == (rate.surfaces, rate.found), grouping.key


def test_range_errors_by_hand(observed_pair) -> None:
    observation = observed_pair[0]
    echo = observation.cloud.status == Status.ECHO
    error = (observation.cloud.range_m - observation.cloud.true_range_m)[echo].astype(np.float64)
    (errors,) = statistics.range_errors(observation)
    # float32 ranges of 40 m: differences rounded to 4 um, their mean far less.
    assert errors.points == int(echo.sum())
    assert errors.bias_m == pytest.approx(error.mean(), abs=1e-6)
    assert errors.sigma_m == pytest.approx(error.std(ddof=1), abs=1e-6)
    by_range = statistics.range_errors(observation, observations.groupings(observed_pair)[0])
    assert sum(e.points for e in by_range) == errors.points
    assert sum(e.points * e.bias_m for e in by_range) == pytest.approx(errors.points * errors.bias_m)


def test_crossing_agrees_with_the_range_analysis(mi) -> None:
    """Rationale: at the illuminance at which two sensors reach equally far each finds a plane at that range half of the
    time, so that over a scene of that plane alone their expected rates cross there.

    Reference: `ranging.plane`, by bisection on ranges, without tracing. Tolerance: 1e-3 for probabilities in single
    precision and the last bracket of 3e-4.
    """
    sensors = [(name, chain.sensor(name, *chain.NARROW)) for name in ("table1-apd", "table1-sipm")]
    lux = plane.equal_range_illuminance_klux(*(s for _, s in sensors), plane.Target())
    range_m = float(plane.maximum_range_m(sensors[0][1], plane.Target(illuminance_klux=lux))[0])
    bench = Bench(chain.scene(chain.facing(range_m=range_m), air=Air(transmittance=0.98)))
    swept = sweep_illuminance(bench, sensors, (1.0, 10.0))
    (crossing,) = swept.crossings["table1-sipm"]
    assert crossing.illuminance_klux == pytest.approx(lux, rel=1e-3)
    assert crossing.expected == pytest.approx(0.5, abs=2e-3)
    assert (crossing.ahead_below, crossing.ahead_above) == ("table1-sipm", "table1-apd")
    at_nine_tenths = plane.equal_range_illuminance_klux(*(s for _, s in sensors), plane.Target(), probability=0.9)
    assert swept.on_plane_klux["table1-sipm"] == pytest.approx(at_nine_tenths, rel=1e-9)


def test_equal_sensors_do_not_cross(mi) -> None:
    sensors = [(name, chain.sensor("table1-apd", *chain.NARROW)) for name in ("a", "b")]
    swept = sweep_illuminance(Bench(chain.scene(chain.facing(range_m=60.0))), sensors, (1.0, 100.0))
    assert swept.crossings == {"b": []}
    assert swept.on_plane_klux == {"b": None}


def test_the_place_may_be_another(mi) -> None:
    """Reference: the nearest corner of the box, 9 m ahead and 4.5 m aside. Tolerance: the beams' half a degree."""
    bench = Bench(scene(), FrameOptions(pose=Pose.from_degrees(position_m=(5.0, 0.0, 0.0))))
    observation = bench.observe("a", chain.sensor("table1-apd", *COARSE))
    assert float(observation.rated_surfaces.true_range_m.min()) == pytest.approx(math.hypot(9.0, 4.5), rel=5e-3)


def test_a_paired_interval_by_hand() -> None:
    """98 pulses that both found: half of one on each side of 100, deviation sqrt(1) / 100, 1.96 of it either way."""
    assert statistics.paired_interval(only_a=0, only_b=0, pulses=98) == pytest.approx((-0.0195996, 0.0195996), rel=1e-5)
    # 10.5 and 0.5 of 100: 10 %, variance 11 - 100 / 100.
    half = 1.959964 * math.sqrt(10.0) / 100.0
    assert statistics.paired_interval(only_a=10, only_b=0, pulses=98) == pytest.approx(
        (0.1 - half, 0.1 + half), rel=1e-5
    )


def test_who_is_ahead_and_middles_of_bins() -> None:
    counts = statistics.PairCounts(group="all", both=1, only_a=6, only_b=2, neither=1)
    assert counts.difference == pytest.approx(0.4)
    assert sum(counts.difference_interval) > 0.0
    angles = observations.Grouping(
        key="incidence",
        attribute="incidence_angle_rad",
        unit="deg",
        labels=("", ""),
        edges=np.radians([0.0, 10.0, 40.0]),
    )
    assert angles.middles == pytest.approx([5.0, 25.0])
    assert observations.range_bins(20.0).middles[0] == pytest.approx(1.0)


def test_intervals_of_a_mean_and_a_deviation() -> None:
    """1.96 sigma / sqrt(n) and, of a Gaussian, 1.96 sigma / sqrt(2 (n - 1)); of one echo there is no deviation."""
    errors = statistics.RangeError(group="all", points=9, bias_m=0.0, sigma_m=0.03)
    assert errors.bias_interval_m == pytest.approx(1.959964 * 0.01)
    assert errors.sigma_interval_m == pytest.approx(1.959964 * 0.03 / 4.0)
    assert statistics.RangeError(group="all", points=1, bias_m=0.0, sigma_m=0.0).sigma_interval_m == 0.0


def test_ranges_of_one_sensor_less_those_of_another() -> None:
    """Pulses 0 to 3 and 2 to 5: of both are 2 and 3, whose ranges are 3 and 1 m longer for A."""

    def observation_of(name: str, first: int, ranges: list[float]) -> observations.Observation:
        cloud = small_cloud(
            n=4,
            range_m=np.array(ranges, np.float32),
            true_range_m=np.ones(4, np.float32),
            status=np.full(4, Status.ECHO, np.uint8),
        )
        return observations.Observation(name=name, cloud=cloud, pulse=first + np.arange(4), losses={})

    difference = statistics.paired_range_difference(
        observation_of("a", 0, [9, 9, 7, 8]), observation_of("b", 2, [4, 7, 9, 9])
    )
    assert difference is not None
    assert (difference.points, difference.bias_m, difference.sigma_m) == (
        2,
        pytest.approx(2.0),
        pytest.approx(math.sqrt(2.0)),
    )


def test_only_false_alarms_are_false_alarms() -> None:
    """Points of weather, of other lidars and of the pulse before are none."""
    cloud = small_cloud(n=7, status=np.array([0, 1, 2, 3, 4, 1, 0], np.uint8))
    assert observations.Observation(name="a", cloud=cloud, losses={}).false_alarms == 2


def test_snrs_are_compared_where_both_are_known() -> None:
    """Found by both, by A, by B and by none; of the last two one SNR is not known."""
    plain = surfaces()
    columns = {
        name: getattr(plain, name)[:4]
        for name in ("true_range_m", "incidence_angle_rad", "reflectivity", "body", "class_id")
    }
    a, b = (
        observations.Surfaces(pulse=np.arange(4), detected=np.array(detected), snr=np.array(snr), **columns)
        for detected, snr in (([1, 1, 0, 0], [9.0, 8.0, 0.0, 3.0]), ([1, 0, 1, 0], [7.0, 2.0, 6.0, 0.0]))
    )
    a, b = (
        dataclasses.replace(sensor_surfaces, detected=sensor_surfaces.detected.astype(bool))
        for sensor_surfaces in (a, b)
    )
    of_a, of_b, range_group = statistics.paired_snr(a, b)
    assert (of_a.tolist(), of_b.tolist(), range_group.tolist()) == ([9.0, 8.0], [7.0, 2.0], [0, 1])


def test_tripped_less_expected_in_standard_deviations() -> None:
    """100 echoes of one half: 60 that tripped are two of the binomial's five away."""
    few_surfaces = surfaces()
    hundred = dataclasses.replace(
        few_surfaces,
        **{
            name: np.resize(getattr(few_surfaces, name), 100)
            for name in ("detected", "snr", "true_range_m", "incidence_angle_rad", "reflectivity", "body", "class_id")
        },
        pulse=np.arange(100),
        probability=np.full(100, 0.5),
        tripped=np.arange(100) < 60,
    )
    assert statistics.detection_deviation(hundred) == pytest.approx(2.0)


def test_places_are_changed_within_the_sweep_only() -> None:
    """An APD and a SiPM reach equally far at some 3 klux on Table 1's plane: not between 10 and 100."""
    sensors = load_sensor("table1-apd"), load_sensor("table1-sipm")
    equal_klux = _equal_range_klux(*sensors, (0.1, 100.0))
    expected = plane.equal_range_illuminance_klux(*sensors, plane.Target(), probability=0.9)
    assert equal_klux == pytest.approx(expected, rel=1e-6)
    assert _equal_range_klux(*sensors, (10.0, 100.0)) is None


def test_numbers_without_a_name_are_in_no_group() -> None:
    names = observations.Grouping(key="body", attribute="body", unit="", labels=("a", "b"))
    cloud = small_cloud(n=4, body=np.array([0, 1, 2, -1], np.int32))
    assert names.group_index(cloud).tolist() == [0, 1, -1, -1]


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("first", "second"), [(2.0, 5.0), (3.0, 3.6), (1.2, 8.0), (5.0, 6.0)])
def test_two_crossings_between_neighbouring_steps(first, second, sign):
    """A lead with two roots by hand, of which the ends say nothing; 1e-3 is what the halvings leave. Nearer ones than
    a fiftieth of the steps' distance may stay unseen, and a lead that only grows must cost few calls.
    """
    calls = []

    def lead_at(lux):
        calls.append(lux)
        return sign * math.log(lux / first) * math.log(lux / second)

    leads = {lux: lead_at(lux) for lux in (0.1, 1.0, 10.0, 100.0)}
    found = lead_changes(lead_at, leads)
    assert [place for place, _ in found] == pytest.approx([first, second], rel=1e-3)
    assert [ahead_below for _, ahead_below in found] == [sign > 0.0, sign < 0.0]
    calls.clear()
    assert lead_changes(lambda lux: lead_at(20.0 * lux), {lux: lead_at(20.0 * lux) for lux in (1.0, 10.0, 100.0)}) == []
    assert len(calls) == 5
