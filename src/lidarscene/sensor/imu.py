"""Inertial measurement unit beside a lidar: a motion in, angular velocities and specific forces with noise out.

The rates are those of the exact motion, and accelerations are differences of its exact velocities. Both have white
noise, a bias that stays and flicker noise, as a data sheet gives them (`physics.inertial`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from ..catalog import path_of
from ..errors import InputError
from ..files.table_model import Table
from ..files.toml import read_toml, validate
from ..maths.arrays import Numbers
from ..maths.attributes import HintedAttributes
from ..maths.pose import Pose
from ..maths.trajectory import CLOCK_ROUNDING_S, Motion, Riding
from ..maths.units import Quantity
from ..physics import inertial
from .pose_file import PoseFile

STEP_S = 5e-4
"""Accuracy bought: step of the differences. An oscillation of 50 Hz is followed to 1e-7, and rounding adds 1e-11
m/s2."""

STENCIL = ((-3, -1 / 60), (-2, 3 / 20), (-1, -3 / 4), (1, 3 / 4), (2, -3 / 20), (3, 1 / 60))
"""Steps and weights of the central difference of sixth order."""

PIECE_SAMPLES = 1 << 15


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImuSamples:
    """Samples in the IMU's axes.

    Attributes:
        time_s: (n,) by the scene's clock, rising
        angular_velocity_rad_s: (n, 3) as measured
        specific_force_m_s2: (n, 3) as measured: upwards where the IMU rests
        sigmas: standard deviation of their white noise [rad/s, m/s2]
    """

    time_s: Numbers
    angular_velocity_rad_s: Numbers
    specific_force_m_s2: Numbers
    sigmas: tuple[float, float] = (0.0, 0.0)

    def __len__(self) -> int:
        return len(self.time_s)

    def between(self, start_s: float, end_s: float) -> ImuSamples:
        """Samples from a time on and before another; rounding moves none across."""
        part = slice(*np.searchsorted(self.time_s, np.array([start_s, end_s]) - CLOCK_ROUNDING_S))
        return ImuSamples(
            time_s=self.time_s[part],
            angular_velocity_rad_s=self.angular_velocity_rad_s[part],
            specific_force_m_s2=self.specific_force_m_s2[part],
            sigmas=self.sigmas,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Imu(HintedAttributes):
    """An IMU. Noise densities are one-sided, as data sheets have them; all numbers are those of each axis.

    Attributes:
        pose: on the lidar, or on the vehicle of a rig: the lever arm
    """

    pose: Pose = field(default_factory=Pose)
    rate_hz: Annotated[float, Quantity(gt=0, le=1e4, about="samples per second")] = 100.0
    gyroscope_noise_rad_s_sqrt_hz: Annotated[
        float, Quantity("deg_s_sqrt_hz", ge=0, le=10, about="noise density of the angular velocity")
    ] = 0.0
    gyroscope_instability_rad_s: Annotated[
        float,
        Quantity("deg_h", ge=0, le=1e5, about="bias instability: the minimum of the Allan deviation is 0.664 of it"),
    ] = 0.0
    gyroscope_offset_rad_s: Annotated[
        float, Quantity("deg_s", ge=0, le=100, about="standard deviation of the bias at the start")
    ] = 0.0
    accelerometer_noise_m_s2_sqrt_hz: Annotated[
        float, Quantity("ug_sqrt_hz", ge=0, le=1e6, about="noise density of the specific force")
    ] = 0.0
    accelerometer_instability_m_s2: Annotated[
        float, Quantity("ug", ge=0, le=1e6, about="bias instability: the minimum of the Allan deviation is 0.664 of it")
    ] = 0.0
    accelerometer_offset_m_s2: Annotated[
        float, Quantity("mg", ge=0, le=1e4, about="standard deviation of the bias at the start")
    ] = 0.0

    @property
    def sigmas(self) -> tuple[float, float]:
        """Standard deviations of the white noise of a sample: angular velocity [rad/s], specific force [m/s2]."""
        densities = self.gyroscope_noise_rad_s_sqrt_hz, self.accelerometer_noise_m_s2_sqrt_hz
        gyroscope, accelerometer = (inertial.white_sigma(density=n, rate_hz=self.rate_hz) for n in densities)
        return gyroscope, accelerometer

    def times_s(self, start_s: float, end_s: float) -> Numbers:
        """Times of the samples from one time on and before another: multiples of the period."""
        first, end = (np.ceil((time_s - CLOCK_ROUNDING_S) * self.rate_hz) for time_s in (start_s, end_s))
        return np.arange(first, end) / self.rate_hz

    def measure(self, carrier: Motion, time_s: Numbers, rng: np.random.Generator) -> ImuSamples:
        """Samples at (n,) times, evenly spaced.

        Args:
            carrier: motion of the lidar or the vehicle that the IMU is fixed to
        """
        motion = Riding(carrier=carrier, pose=self.pose)
        pieces = [time_s[first : first + PIECE_SAMPLES] for first in range(0, len(time_s), PIECE_SAMPLES)]
        exact = [np.zeros((0, 6)), *(_exact(motion, piece) for piece in pieces)]
        angular_velocity, force = np.hsplit(np.concatenate(exact), 2)
        gyroscope, accelerometer = self._errors(len(time_s), rng)
        return ImuSamples(
            time_s=time_s,
            angular_velocity_rad_s=angular_velocity + gyroscope,
            specific_force_m_s2=force + accelerometer,
            sigmas=self.sigmas,
        )

    def _errors(self, count: int, rng: np.random.Generator) -> Iterator[Numbers]:
        """Yield (n, 3) errors of the gyroscope and of the accelerometer."""
        numbers = (
            (self.gyroscope_offset_rad_s, self.gyroscope_instability_rad_s),
            (self.accelerometer_offset_m_s2, self.accelerometer_instability_m_s2),
        )
        for sigma, (offset, instability) in zip(self.sigmas, numbers, strict=True):
            bias = offset * rng.standard_normal(3)
            white = sigma * rng.standard_normal((count, 3))
            yield bias + white + _flicker(instability, 1.0 / self.rate_hz, count, rng)


def _exact(motion: Motion, time_s: Numbers) -> Numbers:
    """(n, 6) angular velocities [rad/s] and specific forces [m/s2] in the axes of the moving frame."""
    # Beyond its span a motion rests in its last pose: a difference across that edge would be a blow.
    reach_s = 3.0 * STEP_S
    first_s, last_s = motion.span_s
    centre_s = np.clip(time_s, min(first_s + reach_s, last_s), max(last_s - reach_s, first_s))
    shifted = [motion.at(centre_s + step * STEP_S).velocity_m_s * (weight / STEP_S) for step, weight in STENCIL]
    states = motion.at(time_s)
    force = inertial.specific_force_m_s2(rotation=states.rotation, acceleration_m_s2=np.sum(shifted, axis=0))
    return np.hstack([np.einsum("nji,nj->ni", states.rotation, states.turning_rad_s), force])


def _flicker(instability: float, period_s: float, count: int, rng: np.random.Generator) -> Numbers:
    """(n, 3) flicker noise: Gauss-Markov processes, each exact from sample to sample and stationary from the first."""
    from scipy.signal import lfilter  # late: it takes longest to import

    total = np.zeros((count, 3))
    sigma = inertial.markov_sigma(instability=instability)
    for decay in np.exp(-period_s / inertial.CORRELATION_TIMES_S) if instability and count else ():
        steps = sigma * np.sqrt(1.0 - decay**2) * rng.standard_normal((count, 3))
        steps[0] = sigma * rng.standard_normal(3)
        total += lfilter([1.0], [1.0, -decay], steps, axis=0)
    return total


class ImuNumbers(Table[Imu]):
    """Numbers of an IMU, of the catalogue or a sensor's own."""


class ImuModelFile(ImuNumbers):
    """A file of the catalogue of IMUs. ``sources`` says where each number comes from."""

    name: Annotated[str, Field(min_length=1)]
    description: str = ""
    sources: dict[str, str] = Field(default_factory=dict)


def imu_model(name: str, folder: Path | None = None) -> ImuModelFile:
    """Read an IMU of the catalogue by its name, or a file in a folder if the name ends in .toml.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    return read_imu_model((folder or Path()) / name if name.endswith(".toml") else path_of("imus", name))


def read_imu_model(path: Path) -> ImuModelFile:
    """Read a file with the numbers of an IMU.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    return validate(ImuModelFile, read_toml(path), str(path))


class ImuFile(ImuNumbers, PoseFile):
    """[imu]: an IMU on the lidar, or on the vehicle of a rig; keys that are given replace those of the model."""

    model: str | None = Field(
        default=None, description="catalogue name, or a file beside this one with the keys below, whose numbers it has"
    )

    def build(self, folder: Path) -> Imu:
        """Build the IMU in SI units; the file that it names lies in ``folder``.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        values: dict[str, Any] = {}
        if self.model is not None:
            try:
                values = imu_model(self.model, folder).values_in_si()
            except InputError as error:
                raise InputError(f"imu.model: {error}") from None
        replaced = {
            field for field, (key, _) in self.keys.items() if key in self.model_fields_set or self.model is None
        }
        changes = {field: value for field, value in self.values_in_si().items() if field in replaced}
        return Imu(**(values | changes), pose=self.pose())

    def files(self, folder: Path) -> Iterator[Path]:
        """Yield the file that it names beside its own."""
        if self.model is not None and self.model.endswith(".toml"):
            yield folder / self.model
