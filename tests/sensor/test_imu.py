"""IMUs: the pose gives what they measure, and their noise is that of the data sheet."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.run_seed import chosen

from lidarscene import catalog, load_sensor
from lidarscene.cli.main import main
from lidarscene.files.toml import read_toml
from lidarscene.maths.arrays import Numbers
from lidarscene.maths.pose import Pose
from lidarscene.maths.trajectory import Course, Motion, Riding, Spline
from lidarscene.physics.constants import STANDARD_GRAVITY_M_S2
from lidarscene.physics.reference import surroundings as reference_surroundings
from lidarscene.sensor.imu import Imu
from lidarscene.sensor.rig_file import load_rig

LEVER = Pose.from_degrees(position_m=(0.8, -0.4, 1.2), yaw_deg=20.0, pitch_deg=-8.0, roll_deg=3.0)
EXACT = Imu(pose=LEVER)
NO_NOISE = np.random.default_rng(0)


def wandering(seed: int) -> Spline:
    """A path with turns about all axes: 9 poses in 4 s."""
    rng = np.random.default_rng(seed)
    poses = [
        Pose.from_degrees(
            position_m=(4.0 * n, rng.normal(), 0.3 * rng.normal()),
            yaw_deg=15.0 * rng.normal(),
            pitch_deg=5.0 * rng.normal(),
            roll_deg=5.0 * rng.normal(),
        )
        for n in range(9)
    ]
    return Spline(time_s=np.linspace(0.0, 4.0, 9), poses=tuple(poses))


@pytest.mark.parametrize("seed", range(3))
def test_second_differences_of_the_pose_give_the_force(seed: int) -> None:
    """Reference: positions and rotations alone. Times lie within the segments: at the poses accelerations jump.

    Second differences over 0.25 ms are off by h^2/12 of the fourth derivative, some 1e-5 m/s2 here; differences of
    rotations by h^2/6 of the third, some 1e-6 rad/s.
    """
    motion, step_s = Riding(carrier=wandering(seed), pose=LEVER), 2.5e-4
    times_s = np.linspace(0.0, 4.0, 9)[:-1] + np.array([0.1, 0.25, 0.4])[:, None]
    times_s = np.sort(times_s.ravel())
    samples = EXACT.measure(wandering(seed), times_s, NO_NOISE)
    before, at, after = (motion.at(times_s + shift) for shift in (-step_s, 0.0, step_s))
    acceleration = (before.position_m - 2.0 * at.position_m + after.position_m) / step_s**2
    force = np.einsum("nji,nj->ni", at.rotation, acceleration + np.array([0.0, 0.0, 9.80665]))
    np.testing.assert_allclose(samples.specific_force_m_s2, force, atol=2e-4)
    turned = np.einsum("nji,njk->nik", before.rotation, after.rotation)
    angles = 0.5 * np.stack([turned[:, 2, 1] - turned[:, 1, 2], turned[:, 0, 2] - turned[:, 2, 0]], axis=1)
    np.testing.assert_allclose(samples.angular_velocity_rad_s[:, :2], angles / (2.0 * step_s), atol=1e-4)
    assert np.ptp(samples.specific_force_m_s2, axis=0).min() > 0.1


def test_a_lever_arm_in_a_circle() -> None:
    """Computed by hand: at v and w about z the arm (x, y) feels -w^2 x ahead, and v w - w^2 y aside."""
    circle = Course(speed_m_s=10.0, yaw_rate_rad_s=0.5)
    imu = Imu(pose=Pose(position_m=np.array([2.0, 1.0, 5.0])))
    samples = imu.measure(circle, imu.times_s(0.0, 3.0), NO_NOISE)
    assert len(samples) == 300
    np.testing.assert_allclose(samples.angular_velocity_rad_s, np.tile([0.0, 0.0, 0.5], (300, 1)), atol=1e-12)
    expected = np.tile([-0.5, 5.0 - 0.25, STANDARD_GRAVITY_M_S2], (300, 1))
    np.testing.assert_allclose(samples.specific_force_m_s2, expected, atol=1e-8)


def test_the_ends_of_a_motion_are_no_blows() -> None:
    """A straight, even path has no acceleration at its ends, though beyond them it rests: 10 m/s in 1 ms."""
    poses = tuple(Pose(position_m=np.array([10.0 * t, 0.0, 0.0])) for t in (0.0, 0.5, 1.0))
    path = Spline(time_s=np.array([0.0, 0.5, 1.0]), poses=poses)
    samples = Imu().measure(path, np.array([0.0, 0.5, 1.0]), NO_NOISE)
    np.testing.assert_allclose(samples.specific_force_m_s2, np.tile([0.0, 0.0, 9.80665], (3, 1)), atol=1e-8)


def test_samples_are_on_one_grid() -> None:
    """Runs that begin at other times have the same instants, so that they can be joined."""
    imu = Imu(rate_hz=200.0)
    np.testing.assert_array_equal(imu.times_s(0.0, 0.015), [0.0, 0.005, 0.01])
    np.testing.assert_array_equal(imu.times_s(0.0951, 0.106), [0.1, 0.105])
    assert imu.times_s(1.7e9 + 0.25, 1.7e9 + 0.26).tolist() == [1.7e9 + 0.25, 1.7e9 + 0.255]


def allan_variances(values: Numbers, size: int) -> Numbers:
    """(columns,) Allan variances over clusters of ``size`` samples."""
    means = values[: len(values) // size * size].reshape(-1, size, values.shape[1]).mean(axis=1)
    return np.asarray(0.5 * np.mean(np.diff(means, axis=0) ** 2, axis=0))


@pytest.mark.parametrize("name", chosen(1, ["adis16470", "bmi088", "iam-20680ht"]))
def test_allan_deviation_is_that_of_the_data_sheet(name: str) -> None:
    """Reference: the closed form, of the numbers in the catalogue's file as printed there.

    Eight runs of three axes: the mean Allan variance is within five standard errors, which they give themselves (false
    alarm some 1e-4 for each of 3 IMUs, 2 quantities and 3 times, with 23 degrees of freedom).
    """
    printed = read_toml(catalog.path_of("imus", name))
    imu = load_sensor("vlp-16", overrides=[f"imu.model={name}", "imu.rate_hz=50"]).imu
    assert imu is not None
    rng, times_s = np.random.default_rng(1), np.arange(8192) / 50.0
    runs = [imu.measure(Course(), times_s, rng) for _ in range(8)]
    quantities = (
        (np.degrees(np.hstack([run.angular_velocity_rad_s for run in runs])), "gyroscope", "deg_h", 1.0 / 3600.0),
        (np.hstack([run.specific_force_m_s2 for run in runs]) / 9.80665e-6, "accelerometer", "ug", 1.0),
    )
    for values, part, unit, scale in quantities:
        density = printed[f"{part}_noise_{'deg_s' if part == 'gyroscope' else 'ug'}_sqrt_hz"]
        instability = scale * printed.get(f"{part}_instability_{unit}", 0.0)
        for size in (1, 16, 256):
            expected = reference_surroundings.allan_deviation(
                density=density, instability=instability, tau_s=np.array(size / 50.0)
            )
            variances = allan_variances(values, size)
            error = np.std(variances, ddof=1) / math.sqrt(len(variances))
            assert abs(np.mean(variances) - expected**2) < 5.0 * error


def test_the_floor_of_an_allan_curve_is_that_of_the_sheet() -> None:
    """The ADIS16470's sheet states the lowest points, 8 deg/h and 13 ug."""
    printed = read_toml(catalog.path_of("imus", "adis16470"))
    for key, lowest in (("gyroscope_instability_deg_h", 8.0), ("accelerometer_instability_ug", 13.0)):
        curve = reference_surroundings.allan_deviation(
            density=0.0, instability=printed[key], tau_s=np.geomspace(20.0, 2000.0, 100)
        )
        assert curve == pytest.approx(np.full(100, lowest), rel=0.02)


def test_flicker_noise_of_the_samples() -> None:
    """The same with flicker noise alone, at times that only it reaches: 1, 10 and 40 s.

    48 series: five standard errors are wrong in some 1e-5 of runs. Means of samples of 62 ms differ by 1e-3 from those
    of the process.
    """
    rng, imu = np.random.default_rng(2), Imu(rate_hz=16.0, gyroscope_instability_rad_s=1e-3)
    runs = [imu.measure(Course(), np.arange(8192) / 16.0, rng).angular_velocity_rad_s for _ in range(16)]
    for size in (16, 160, 640):
        expected = reference_surroundings.allan_deviation(density=0.0, instability=1e-3, tau_s=np.array(size / 16.0))
        variances = allan_variances(np.hstack(runs), size)
        error = np.std(variances, ddof=1) / math.sqrt(len(variances))
        assert abs(np.mean(variances) - expected**2) < 5.0 * error + 2e-3 * expected**2


def test_the_bias_of_a_run() -> None:
    """Its spread over 400 runs of three axes is the file's: 1200 draws, five standard errors are 10 %."""
    rng, imu = np.random.default_rng(4), Imu(gyroscope_offset_rad_s=0.01, accelerometer_offset_m_s2=0.2)
    runs = [imu.measure(Course(), np.zeros(1), rng) for _ in range(400)]
    rates = np.std([run.angular_velocity_rad_s for run in runs])
    forces = np.std([run.specific_force_m_s2 - [[0.0, 0.0, 9.80665]] for run in runs])
    assert (rates, forces) == (pytest.approx(0.01, rel=0.1), pytest.approx(0.2, rel=0.1))


@pytest.mark.parametrize("name", catalog.names("imus"))
def test_every_number_of_the_catalogue_has_a_source(name: str) -> None:
    tables = read_toml(catalog.path_of("imus", name))
    assert set(tables) - {"name", "description", "sources"} == set(tables["sources"])
    assert tables["name"] == name


def test_files_of_imus_are_checked(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """The command `check` knows them by their keys; a number without its factor is told."""
    paths = [str(catalog.path_of("imus", name)) for name in catalog.names("imus")]
    assert main(["check", *paths]) == 0
    text = (
        Path(paths[0])
        .read_text()
        .replace("gyroscope_noise_deg_s_sqrt_hz = 0.008", "gyroscope_noise_deg_s_sqrt_hz = -8")
    )
    (tmp_path / "wrong.toml").write_text(text)
    assert main(["check", str(tmp_path / "wrong.toml")]) == 2
    assert "gyroscope_noise_deg_s_sqrt_hz: must be >= 0, got -8" in capsys.readouterr().out


def test_keys_of_the_file_replace_those_of_the_model(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text('name = "own"\naccelerometer_noise_ug_sqrt_hz = 50\nrate_hz = 400\n')
    (tmp_path / "rig.toml").write_text(
        '[imu]\nmodel = "own.toml"\nrate_hz = 100\nposition_m = [1, 2, 3]\n'
        '[[sensors]]\nlabel = "a"\nsensor = "vlp-16"\n'
    )
    rig = load_rig(tmp_path / "rig.toml")
    assert rig.imu is not None
    assert (rig.imu.rate_hz, rig.imu.pose.position_m.tolist()) == (100.0, [1.0, 2.0, 3.0])
    assert rig.imu.accelerometer_noise_m_s2_sqrt_hz == pytest.approx(50 * 9.80665e-6)
    assert rig.files[-1] == tmp_path / "own.toml"


def test_noise_does_not_depend_on_the_motion() -> None:
    """Rationale: a seed is compared from run to run while the path is edited."""
    imu = replace(Imu(), gyroscope_noise_rad_s_sqrt_hz=1e-3, accelerometer_noise_m_s2_sqrt_hz=1e-2)
    motions: tuple[Motion, ...] = (Course(), Course(speed_m_s=5.0))
    samples = [imu.measure(motion, imu.times_s(0.0, 1.0), np.random.default_rng(3)) for motion in motions]
    np.testing.assert_allclose(samples[0].specific_force_m_s2, samples[1].specific_force_m_s2, atol=1e-9)
