"""A recording that we rendered ourselves becomes a twin, whose rendering agrees with the closed truth."""

import html
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.mistakes import told
from helpers.twins import HALF_M, HEIGHT_M, REFLECTIVITY, recording_of, room, unit_json

from lidarscene.errors import InputError
from lidarscene.materials.material import Material, Spectrum
from lidarscene.maths.pose import Pose
from lidarscene.recordings.recording import Recording
from lidarscene.recordings.sweep import Second, Sweep
from lidarscene.recordings.units.unit_file import read_unit, write_unit
from lidarscene.rendering.simulator import Simulator
from lidarscene.scene.meshes.primitives import plane_mesh
from lidarscene.scene.scene import Body, Part, Scene, Sun
from lidarscene.scene.scene_file import load_scene
from lidarscene.sensor.sensor_file import load_sensor
from lidarscene.sensor.sensor_model import Sensor
from lidarscene.studies.twin import matched_pulses as twin_pulses
from lidarscene.studies.twin.certificate import certify_in_twin
from lidarscene.studies.twin.judge import twin_quantities
from lidarscene.studies.twin.matched_pulses import (
    MatchedPulses,
    in_step,
    match_pulses,
    ranges_from_exit,
    simulate_pulses,
)
from lidarscene.studies.twin.planes import select_columns
from lidarscene.studies.twin.surfels import SMOOTH
from lidarscene.studies.twin.twin_files import COLUMNS, TwinFrames, build_twin

RoomTwin = tuple[Recording, Path, Sensor]


def scene_of_room() -> Scene:
    """The walls and the ground of `helpers.twins`, 8 m high."""
    flat = {
        name: Material(name=name, bsdf="diffuse", reflectivity=Spectrum.constant(value))
        for name, value in zip(("ends", "sides", "ground"), REFLECTIVITY, strict=True)
    }
    bodies = []
    for number, (yaw, distance_m, width) in enumerate(
        (
            (0.0, HALF_M[0], HALF_M[1]),
            (180.0, HALF_M[0], HALF_M[1]),
            (90.0, HALF_M[1], HALF_M[0]),
            (-90.0, HALF_M[1], HALF_M[0]),
        )
    ):
        vertices, faces = plane_mesh(size_m=(20.0, 2.0 * width))
        pose = Pose.from_degrees(yaw_deg=yaw) @ Pose.from_degrees(position_m=(distance_m, 0.0, 0.0), pitch_deg=90.0)
        part = Part(vertices_m=vertices, faces=faces, material="ends" if number < 2 else "sides")
        bodies.append(Body(name=f"wall{number}", class_name="wall", parts=(part,), pose=pose))
    vertices, faces = plane_mesh(size_m=(2.0 * HALF_M[0], 2.0 * HALF_M[1]))
    ground = Part(vertices_m=vertices, faces=faces, material="ground")
    bodies.append(
        Body(name="ground", class_name="ground", parts=(ground,), pose=Pose(position_m=np.array([0.0, 0.0, -HEIGHT_M])))
    )
    return Scene(bodies=tuple(bodies), materials=flat, sun=Sun(illuminance_klux=0.0))


def record_scene(scene: Scene, sensor: Sensor) -> Sweep:
    """What the sensor records of a scene, as its maker would have it."""
    pulses_of_points: list[Any] = []
    cloud = Simulator(scene, sensor).render(seed=3, points=lambda pulse, _: pulses_of_points.append(pulse))
    pulse = np.concatenate(pulses_of_points).astype(int)
    pulses = np.arange(sensor.scanner.pulses, dtype=np.uint32)
    rows, columns = sensor.scanner.line_pulses, sensor.scanner.pulses // sensor.scanner.line_pulses

    def as_image(values: Any, lanes: Any = None) -> Any:
        flat = np.full((sensor.scanner.pulses, *np.shape(values)[1:]), np.nan)
        flat[slice(None) if lanes is None else lanes] = values
        return np.moveaxis(flat.reshape(columns, rows, *flat.shape[1:]), 0, 1)

    start = sensor.scanner.offset_m(pulses)
    assert start is not None
    return Sweep(
        range_m=as_image(cloud.range_m, pulse),
        recorded=np.ones((rows, columns), bool),
        direction=as_image(np.stack([np.asarray(x, float) for x in sensor.scanner.direction(pulses)], axis=-1)),
        origin_m=as_image(np.stack([np.asarray(x, float) for x in start], axis=-1)),
        signal=as_image(cloud.signal, pulse),
        reflectivity=as_image(cloud.intensity, pulse),
        includes_lost=True,
    )


@pytest.fixture(scope="module")
def room_twin(mi: Any, tmp_path_factory: pytest.TempPathFactory) -> RoomTwin:
    """A recording of the room, its twin made of every second column, and the sensor."""
    folder = tmp_path_factory.mktemp("twin")
    unit = unit_json(folder / "unit.json")
    write_unit(read_unit(unit), unit, folder / "unit.toml")
    sensor = load_sensor(str(folder / "unit.toml"))
    recording = recording_of(folder / "unit.pcap", record_scene(scene_of_room(), sensor))
    printed = build_twin(recording, TwinFrames(frames=(0,), held_out=COLUMNS), folder / "twin")
    assert "reflectivities: by the recording's signal" in printed
    return recording, folder / "twin", sensor


@pytest.fixture(scope="module")
def pulses(room_twin: RoomTwin) -> MatchedPulses:
    recording, folder, _ = room_twin
    scene = load_scene(folder / "scene.toml")
    sweep = select_columns(recording[0], slice(1, None, 2))
    return simulate_pulses(scene, load_sensor(scene.sensor_name), sweep)[0]


def test_ranges_agree_with_the_room_to_millimetres(room_twin: RoomTwin, pulses: MatchedPulses) -> None:
    """Rationale: planes of 15 noisy pixels are sure to some 5 mm; the median over thousands to 1 mm, of which four."""
    recording, _, _ = room_twin
    sweep = select_columns(recording[0], slice(1, None, 2))
    assert sweep.origin_m is not None
    truth_m, _, _ = zip(
        *(
            room(direction[None], Pose(position_m=start))
            for direction, start in zip(
                sweep.direction.reshape(-1, 3)[::50], sweep.origin_m.reshape(-1, 3)[::50], strict=True
            )
        ),
        strict=True,
    )
    error = (pulses.true_range_m[::50] - np.concatenate(truth_m))[pulses.kind[::50] == SMOOTH]
    assert len(error) > 50
    assert abs(np.median(error)) < 4e-3
    assert np.quantile(np.abs(error), 0.8) < 0.02


def test_signals_agree_to_per_cent(pulses: MatchedPulses) -> None:
    """The reflectivities are right: the same sensor has the same photons from the twin as from the room."""
    has_both = pulses.has_return & pulses.has_simulated_return & (pulses.kind == SMOOTH)
    assert pulses.signal is not None
    ratio = pulses.simulated_signal[has_both].sum() / pulses.signal[has_both].sum()
    assert ratio == pytest.approx(1.0, abs=0.03)


def test_a_sensor_is_held_to_its_own_recording(pulses: MatchedPulses) -> None:
    """Rationale: whoever recorded is who simulates, so the limits for real sensors are met with ease."""
    rows = twin_quantities(pulses)
    failed = [(row.quantity, row.condition, row.value) for row in rows if row.verdict is False]
    assert failed == []
    assert {"beam direction", "range, bias", "range, scatter", "points", "real returns kept"} <= {
        row.quantity for row in rows if row.verdict
    }


def test_another_sensor_is_not(room_twin: RoomTwin) -> None:
    """Half of the light: signals are off, and the page says so."""
    recording, folder, _ = room_twin
    scene = load_scene(folder / "scene.toml")
    weak = load_sensor(scene.sensor_name, overrides=["laser.peak_power_w=0.1"])
    matched, _ = simulate_pulses(scene, weak, recording[0])
    failed = {row.quantity for row in twin_quantities(matched) if row.verdict is False}
    assert "signal, mean error over the range" in failed


def test_page_and_numbers(room_twin: RoomTwin, tmp_path: Path) -> None:
    recording, folder, _ = room_twin
    compared = certify_in_twin(folder / "scene.toml", recording)
    compared.save(tmp_path / "page")
    assert compared.passed
    text = str(compared)
    (first, *_) = text.splitlines()
    assert first.startswith("Pass: the simulated sensor meets all ")
    assert "every second column" in text
    report = json.loads((tmp_path / "page" / "certificate.json").read_text())
    assert report["verdict"] == first
    assert html.escape(first) in (tmp_path / "page" / "index.html").read_text().partition("<table>")[0]
    measured = [row for row in report["rows"] if row["value"] is not None]
    assert len(measured) >= len(report["rows"]) - 3  # few losses, clusters, patches
    assert report["twin"]["held_out"] == COLUMNS
    assert {"quantity", "value", "low", "high", "met"} <= report["rows"][0].keys()
    assert "data:image/png" in (tmp_path / "page" / "index.html").read_text()
    with told("frame 7 | 0"):
        certify_in_twin(folder / "scene.toml", recording, frame=7)


def test_a_list_of_points_is_compared_by_its_statistics(room_twin: RoomTwin, open3d: Any, tmp_path: Path) -> None:
    """Rationale: without rows and lost pulses nothing can be matched; what can be counted is."""
    recording, folder, _ = room_twin
    sweep = recording[0]
    has_return = sweep.has_return
    listed = Sweep(
        range_m=sweep.range_m[has_return],
        direction=sweep.direction[has_return],
        recorded=np.ones(has_return.sum(), bool),
        intensity=np.asarray(sweep.reflectivity)[has_return],
        metadata={"format": "kitti"},
    )
    of_list = recording_of(tmp_path / "0.bin", listed)
    printed = build_twin(of_list, TwinFrames(frames=(0,)), tmp_path / "twin", sensor=str(folder / "sensor.toml"))
    assert "scaled to a median of 0.2, since its unit is not known" in printed
    text = str(certify_in_twin(tmp_path / "twin" / "scene.toml", of_list))
    points = next(line.split() for line in text.splitlines() if line.startswith("points "))
    # The quads of a list do not meet at edges, and cover no corner.
    assert int(points[1].replace(",", "")) == pytest.approx(int(points[2].replace(",", "")), rel=0.1)


def test_other_beams_are_refused(room_twin: RoomTwin) -> None:
    recording, _, sensor = room_twin
    sweep = recording[0]
    with told("12 channels | 24"):
        match_pulses(
            sensor, Sweep(range_m=sweep.range_m[::2], recorded=sweep.recorded[::2], direction=sweep.direction[::2])
        )


def test_points_of_a_pulse_are_its_first_and_second() -> None:
    """Points of pulses 3, 1 and 5, of which 3 has three: the third is neither."""
    first, second = twin_pulses._by_pulse(np.array([3, 3, 3, 1, 5, 5]), 6)
    assert first.tolist() == [-1, 3, -1, 0, -1, 4]
    assert second.tolist() == [-1, -1, -1, 1, -1, 5]


def test_the_strongest_point_of_a_pulse_is_its_first_if_these_are_kept() -> None:
    first, second = twin_pulses._by_pulse(np.array([3, 3, 3, 1, 5, 5]), 6, np.array([1.0, 9.0, 4.0, 2.0, 7.0, 3.0]))
    assert first.tolist() == [-1, 3, -1, 1, -1, 4]
    assert second.tolist() == [-1, -1, -1, 2, -1, 5]


def test_the_first_of_two_returns_is_the_one_with_more_photons_counted(room_twin: RoomTwin) -> None:
    """Beams meet a slat and the wall behind it. Which return has more is drawn, and need not have the higher mean."""
    _, _, sensor = room_twin
    several = replace(sensor, tdc=replace(sensor.tdc, stops=2))
    room = scene_of_room()
    vertices, faces = plane_mesh(size_m=(8.0, 0.001))
    slats = tuple(
        Body(
            name=f"slat{number}",
            class_name="wall",
            parts=(Part(vertices_m=vertices, faces=faces, material="sides"),),
            pose=Pose.from_degrees(position_m=(4.0, y_m, 0.0), pitch_deg=90.0),
        )
        for number, y_m in enumerate(np.arange(-3.0, 3.0, 0.01))
    )
    scene = replace(room, bodies=(*room.bodies, *slats))
    matched, cloud = simulate_pulses(scene, several, record_scene(scene, several))
    chunks: list[Any] = []
    Simulator(scene, several, rays=twin_pulses.RAYS).render(points=lambda pulse, _: chunks.append(pulse))
    pulse = np.concatenate(chunks).astype(int)
    most = np.zeros(sensor.scanner.pulses)
    np.maximum.at(most, pulse, cloud.signal)
    twice = np.bincount(pulse, minlength=len(most)) == 2
    is_seen = twice[matched.pulse]
    np.testing.assert_array_equal(matched.simulated_signal[is_seen], most[matched.pulse][is_seen])
    by_mean, _ = twin_pulses._by_pulse(pulse, len(most), np.asarray(cloud.snr))
    assert np.mean(np.asarray(cloud.signal)[by_mean[twice]] < most[twice]) > 0.01


def test_changes_along_a_ring_have_the_deviation_of_what_is_independent() -> None:
    """A straight wall has no changes; weights of one pulse and its neighbours have squares that sum to one."""
    impulse = np.zeros((1, 9))
    impulse[0, 4] = 1.0
    assert np.sum(twin_pulses._second_difference(impulse, 2) ** 2) == pytest.approx(1.0)
    straight = 3.0 + 0.2 * np.arange(9.0)[None, :]
    np.testing.assert_allclose(twin_pulses._second_difference(straight, 2)[0, 2:-2], 0.0, atol=1e-12)


def directions_by_channel(sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """Directions of all pulses, (channels, columns, 3) by channel and time, and their numbers."""
    pulse = np.arange(sensor.scanner.pulses, dtype=np.uint32)
    direction = np.stack([np.asarray(x, float) for x in sensor.scanner.direction(pulse)], axis=-1)
    order = np.argsort(np.asarray(sensor.scanner.channel(pulse)), kind="stable").reshape(sensor.scanner.line_pulses, -1)
    return direction[order], order


@pytest.mark.parametrize("turned_deg", [0.0, 0.3, -0.3])
def test_pulses_are_matched_around_the_turn_and_whatever_the_order_of_the_rows(turned_deg: float) -> None:
    """Less than half a column aside the nearest pulse is the same, also where azimuths pass 180 degrees."""
    sensor = load_sensor("os1-128", overrides=["scanner.columns_per_turn=512"])
    direction, numbers = directions_by_channel(sensor)
    turn = Pose.from_degrees(yaw_deg=turned_deg).rotation
    turned = (direction @ turn.T)[::-1]
    sweep = Sweep(range_m=np.ones(turned.shape[:2]), recorded=np.ones(turned.shape[:2], bool), direction=turned)
    matches, angle_rad = match_pulses(sensor, sweep)
    assert np.array_equal(matches, numbers[::-1])
    # Beams within 23 degrees of level turn by nearly as much as the sensor.
    np.testing.assert_allclose(np.degrees(angle_rad), abs(turned_deg), rtol=0.1, atol=1e-4)


@pytest.mark.parametrize(("pitch_deg", "refused"), [(0.6, False), (1.0, True)])
def test_beams_half_a_degree_away_are_others(pitch_deg: float, refused: bool) -> None:
    """Pitched by so much, the median beam is off by 0.7 of it: the sine of its azimuth is that on average."""
    sensor = load_sensor("vlp-16")
    direction, _ = directions_by_channel(sensor)
    pitched = direction @ Pose.from_degrees(pitch_deg=pitch_deg).rotation.T
    sweep = Sweep(range_m=np.ones(pitched.shape[:2]), recorded=np.ones(pitched.shape[:2], bool), direction=pitched)
    if refused:
        with told("sensor | recording"):
            match_pulses(sensor, sweep)
    else:
        match_pulses(sensor, sweep)


def test_turns_of_a_head_that_no_encoder_clocks_begin_anywhere() -> None:
    """The second turn of a VLP-16 begins 0.45 columns on, with a motor 0.3 % too slow; one with an encoder stays."""
    sensor, slow = load_sensor("vlp-16"), load_sensor("vlp-16", overrides=["scanner.rotation_hz=-9.97"])
    pulse = slow.scanner.pulses + np.arange(slow.scanner.pulses, dtype=np.uint32)
    direction = np.stack([np.asarray(x, float) for x in slow.scanner.direction(pulse)], axis=-1)
    direction = direction.reshape(-1, 16, 3).swapaxes(0, 1)
    sweep = Sweep(
        range_m=np.ones(direction.shape[:2]), recorded=np.ones(direction.shape[:2], bool), direction=direction
    )
    medians_deg = [
        float(np.degrees(np.median(match_pulses(fired, sweep)[1]))) for fired in (sensor, in_step(sensor, sweep))
    ]
    assert medians_deg[0] > 0.03
    assert medians_deg[1] < 1e-3
    odd = in_step(sensor, select_columns(sweep, slice(1, None, 2)))
    np.testing.assert_allclose(
        odd.scanner.direction(pulse[:99]), in_step(sensor, sweep).scanner.direction(pulse[:99]), atol=1e-5
    )
    clocked = load_sensor("pandar64")
    assert in_step(clocked, sweep) is clocked


def test_points_that_count_from_the_origin_are_seen_from_the_exits() -> None:
    """Beams of a VLP-16 start up to 11 mm above or below: at 5 m points that count from the origin are 0.13 deg off."""
    sensor = load_sensor("vlp-16")
    direction, numbers = directions_by_channel(sensor)
    start = sensor.scanner.offset_m(np.arange(sensor.scanner.pulses, dtype=np.uint32))
    assert start is not None
    point_m = 5.0 * direction + np.stack([np.asarray(x, float) for x in start], axis=-1)[numbers]
    range_m = np.linalg.norm(point_m, axis=-1)
    sweep = Sweep(range_m=range_m, recorded=np.ones(range_m.shape, bool), direction=point_m / range_m[..., None])
    assert np.degrees(match_pulses(sensor, sweep)[1].max()) < 1e-3


def test_ranges_count_from_the_simulated_exit() -> None:
    """A recording whose maker counts from the sensor's middle: 10 m there are less from the beam's exit."""
    sensor = load_sensor("os1-128", overrides=["scanner.columns_per_turn=512"])
    direction, numbers = directions_by_channel(sensor)
    start = sensor.scanner.offset_m(np.arange(sensor.scanner.pulses, dtype=np.uint32))
    assert start is not None
    exit_m = np.stack([np.asarray(x, float) for x in start], axis=-1)[numbers]
    shape = direction.shape[:2]
    from_exit, middle = (
        Sweep(range_m=np.full(shape, 10.0), recorded=np.ones(shape, bool), direction=direction, origin_m=origin_m)
        for origin_m in (exit_m, None)
    )
    np.testing.assert_allclose(ranges_from_exit(sensor, from_exit, numbers), 10.0, rtol=1e-6)  # beams are single
    ahead_m = np.einsum("...i,...i", exit_m, direction)
    assert np.median(ahead_m) > 0.005
    np.testing.assert_allclose(ranges_from_exit(sensor, middle, numbers), 10.0 - ahead_m, rtol=1e-6)


def test_changes_are_of_smooth_surfaces_and_gaps_have_no_sign(
    room_twin: RoomTwin, pulses: MatchedPulses, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recording whose stronger return comes first has farther and nearer second ones, all a metre apart.

    Changes are over 1.4 degrees, two columns of 512. Pulses that are lost are pulses, too.
    """
    steps, change = [], twin_pulses._second_difference

    def record_step(range_m: np.ndarray, step: int) -> np.ndarray:
        steps.append(step)
        return change(range_m, step)

    monkeypatch.setattr(twin_pulses, "_second_difference", record_step)
    for changes in (pulses.change_m, pulses.simulated_change_m):
        assert np.isfinite(changes).sum() > 100
        assert np.all(pulses.kind[np.isfinite(changes)] == SMOOTH)
    assert np.any(pulses.has_return & pulses.has_simulated_return & (pulses.kind != SMOOTH))
    assert not np.allclose(pulses.change_m, pulses.simulated_change_m, equal_nan=True)
    recording, folder, sensor = room_twin
    sweep = recording[0]
    nearer = np.where(np.arange(sweep.shape[1]) % 2 == 0, -1.0, 1.0)
    is_lost = np.arange(sweep.shape[1]) % 8 == 0
    two = replace(
        sweep, second=Second(range_m=sweep.range_m + nearer), range_m=np.where(is_lost, np.nan, sweep.range_m)
    )
    laid, _ = simulate_pulses(load_scene(folder / "scene.toml"), sensor, two)
    assert steps == [2, 2]
    assert len(laid.range_m) == sweep.range_m.size
    assert np.mean(laid.has_return) == pytest.approx(np.mean(two.has_return))
    assert not laid.has_return.all()
    np.testing.assert_allclose(laid.gap_m[laid.has_return], 1.0, rtol=1e-6)


@pytest.mark.parametrize(("name", "keep"), [("os1-128", "strongest"), ("vls-128", "strongest_and_last")])
def test_a_catalogue_sensor_reports_as_many_returns_as_were_recorded(
    room_twin: RoomTwin, name: str, keep: str, tmp_path: Path
) -> None:
    """Rationale: a dual-return Velodyne was judged with one stop, and missed its second returns."""
    sweep = room_twin[0][0]
    for second, expected in ((None, (1, load_sensor(name).tdc.keep)), (Second(range_m=sweep.range_m + 1.0), (2, keep))):
        recording = recording_of(tmp_path / "unit.pcap", replace(sweep, second=second))
        printed = build_twin(recording, TwinFrames(frames=(0,)), tmp_path / "twin", sensor=name)
        tdc = load_sensor(str(tmp_path / "twin" / "sensor.toml")).tdc
        assert (tdc.stops, tdc.keep) == expected
        assert ("--rays" in printed) is (second is not None)


@pytest.mark.parametrize(("stops", "rays"), [(1, 1), (2, 16)])
def test_a_second_return_needs_several_rays(
    room_twin: RoomTwin, stops: int, rays: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rays_traced = []

    def record_rays(*_: Any, **options: Any) -> None:
        rays_traced.append(options["rays"])
        raise InputError("enough")

    monkeypatch.setattr(twin_pulses, "Simulator", record_rays)
    recording, folder, sensor = room_twin
    several = replace(sensor, tdc=replace(sensor.tdc, stops=stops))
    with pytest.raises(InputError, match="enough"):
        simulate_pulses(load_scene(folder / "scene.toml"), several, recording[0])
    assert rays_traced == [rays]
