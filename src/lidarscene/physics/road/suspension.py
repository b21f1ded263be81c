"""A vehicle on its springs: heave, pitch and roll of the body over the heights of the road below four wheels.

The linear model of seven degrees of freedom that is usual for ride below 15 Hz: a rigid body on four springs and
dampers, four unsprung masses on the springs of their tyres.

The body pitches about its centre of mass, since wheels roll freely ahead, and rolls about an axis in the ground, where
tyres hold it: so its centre of mass swings aside.

Symbols: q = (heave of the centre of mass, pitch, roll, heights of the four wheels); M, D, K matrices of mass, damping
and stiffness; u input: heights of the road below the wheels [m], accelerations ahead and to the left [m/s2].
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Annotated

import numpy as np

from ...maths.arrays import Numbers
from ...maths.units import Quantity
from ..constants import STANDARD_GRAVITY_M_S2

BODY, WHEELS = slice(0, 3), slice(3, 7)
"""Heave, pitch and roll, and the wheels (front left, front right, rear left, rear right), among the coordinates."""

_TERMS = 16
"""Accuracy bought: terms of a series in a matrix of norm 1/2; the next one is below 1e-18."""

Pair = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Suspension:
    """A vehicle's masses, springs and dampers; pairs are of the front and the rear axle, springs of each wheel.

    The defaults are a BMW 320i of the U.S. Department of Transportation's rollover study, as tabled by Althoff and
    Würsching, "CommonRoad: Vehicle Models", 2020, table 6; there too both roll axes are at height 0.
    """

    sprung_kg: Annotated[float, Quantity(ge=1, le=1e6, about="mass of the body on its springs")] = 965.7
    unsprung_kg: Annotated[Pair, Quantity(ge=0.1, le=1e6, about="mass of each axle with its wheels")] = (63.8, 63.8)
    pitch_inertia_kg_m2: Annotated[float, Quantity(ge=0.1, le=1e8, about="of the body about its own y axis")] = 1565.8
    roll_inertia_kg_m2: Annotated[float, Quantity(ge=0.1, le=1e8, about="of the body about its own x axis")] = 207.3
    spring_n_per_m: Annotated[Pair, Quantity(ge=1, le=1e8, about="at each wheel")] = (24450.0, 19640.0)
    damper_n_s_per_m: Annotated[Pair, Quantity(ge=0, le=1e7, about="at each wheel")] = (1786.0, 1649.0)
    anti_roll_n_m: Annotated[Pair, Quantity(ge=0, le=1e8, about="moment of an axle's anti-roll bar per radian")] = (
        6915.0,
        2644.0,
    )
    tyre_n_per_m: Annotated[float, Quantity(ge=1, le=1e8, about="of each tyre")] = 158300.0
    axle_m: Annotated[
        Pair, Quantity(gt=0, le=100, about="from the body's centre of mass, forward and back, to the axles")
    ] = (1.156, 1.423)
    track_m: Annotated[Pair, Quantity(gt=0, le=20, about="between the wheels of an axle")] = (1.387, 1.364)
    height_m: Annotated[float, Quantity(ge=0, le=20, about="of the body's centre of mass above the ground")] = 0.614

    @property
    def wheels_m(self) -> Numbers:
        """(4, 2) places of the wheels: front left, front right, rear left, rear right."""
        (front, rear), (front_track, rear_track) = self.axle_m, self.track_m
        return np.array(
            [[front, front_track / 2], [front, -front_track / 2], [-rear, rear_track / 2], [-rear, -rear_track / 2]]
        )

    def matrices(self) -> tuple[Numbers, Numbers, Numbers, Numbers]:
        """Matrices of M q'' + D q' + K q = F u (T142): (7, 7) of mass, damping, stiffness, and (7, 6) of the input."""
        x, y = self.wheels_m.T
        # Travel of each spring, and turn of the body against each axle, of the coordinates.
        travel = np.hstack([np.stack([np.ones(4), x, y], axis=1), -np.eye(4)])
        left_minus_right = np.array([[1.0, -1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0]])
        turn = np.hstack([np.zeros((2, 2)), np.ones((2, 1)), -left_minus_right / np.array(self.track_m)[:, None]])
        spring, damper = np.repeat(self.spring_n_per_m, 2), np.repeat(self.damper_n_s_per_m, 2)
        mass = np.diag(
            [
                self.sprung_kg,
                self.pitch_inertia_kg_m2,
                # Roll about the ground swings the centre of mass aside (T142).
                self.roll_inertia_kg_m2 + self.sprung_kg * self.height_m**2,
                *np.repeat(np.array(self.unsprung_kg) / 2.0, 2),
            ]
        )
        damping = travel.T @ (damper[:, None] * travel)
        stiffness = travel.T @ (spring[:, None] * travel) + turn.T @ (np.array(self.anti_roll_n_m)[:, None] * turn)
        stiffness[WHEELS, WHEELS] += self.tyre_n_per_m * np.eye(4)
        # The weight of a tilted body pulls it further over.
        stiffness[[1, 2], [1, 2]] -= self.sprung_kg * STANDARD_GRAVITY_M_S2 * self.height_m
        forces = np.zeros((7, 6))
        forces[WHEELS, :4] = self.tyre_n_per_m * np.eye(4)
        # Inertia acts at the centre of mass and is held at the ground: speeding up lifts the nose, a bend to the left
        # presses the right side down.
        forces[1, 4] = forces[2, 5] = self.sprung_kg * self.height_m
        return mass, damping, stiffness, forces

    def response(self, frequency_hz: Numbers) -> Numbers:
        """(n, 7, 6) complex response of the coordinates to inputs exp(2 pi i f t) at (n,) frequencies (T142)."""
        mass, damping, stiffness, forces = self.matrices()
        w = 2.0 * np.pi * np.asarray(frequency_hz, dtype=np.float64)[:, None, None]
        return np.asarray(np.linalg.solve(stiffness + 1j * w * damping - w * w * mass, forces.astype(complex)))

    def ride(self, inputs: Numbers, step_s: float) -> Numbers:
        """Body's heave, pitch and roll, with first and second derivatives: (n, 3, 3), coordinate last.

        Args:
            inputs: (n, 6) on an even grid, straight from one instant to the next, for which the steps are exact. Before
                the first of them the vehicle stands still
        """
        _, _, stiffness, forces = self.matrices()
        flow, drive, by_state, by_input, by_slope = _steps(self, step_s)
        pushes = inputs[:-1] @ (by_input - by_slope).T + inputs[1:] @ by_slope.T
        at_rest = np.concatenate([np.linalg.solve(stiffness, forces @ inputs[0]), np.zeros(7)])
        # x(k + 1) = S x(k) + p(k), so that x(k) = sum S^(k - j) p(j): the sum over 2^n instants, from two halves of it.
        states = np.concatenate([at_rest[None], pushes])
        ago, power = 1, by_state.T
        while ago < len(states):
            states[ago:] += states[:-ago] @ power
            ago, power = 2 * ago, power @ power
        rates = states @ flow.T + inputs @ drive.T
        return np.stack([states[:, BODY], states[:, 7:10], rates[:, 7:10]], axis=1)


@cache
def _steps(suspension: Suspension, step_s: float) -> tuple[Numbers, ...]:
    """Matrices of x' = A x + B u, with x the coordinates and their rates, and those of one step of it.

    A (14, 14), B (14, 6); over a step by the state (14, 14), by the input at its start, and by the input's change.
    """
    mass, damping, stiffness, forces = suspension.matrices()
    inverse = np.linalg.inv(mass)
    flow = np.block([[np.zeros((7, 7)), np.eye(7)], [-inverse @ stiffness, -inverse @ damping]])
    drive = np.vstack([np.zeros((7, 6)), inverse @ forces])
    # The exponential of this matrix carries state, input and the input's change over one step.
    whole = np.zeros((26, 26))
    whole[:14, :14], whole[:14, 14:20], whole[14:20, 20:] = flow * step_s, drive * step_s, np.eye(6)
    step = matrix_exponential(whole)
    return flow, drive, step[:14, :14], step[:14, 14:20], step[:14, 20:]


def matrix_exponential(matrix: Numbers) -> Numbers:
    """Exponential of an (n, n) matrix: of 2^-k of the matrix by a Taylor series, and then squared k times.

    `scipy.linalg` has this, too, but takes 0.25 s to import, in each process that loads a scene with a ride.
    """
    halvings = max(0, math.frexp(float(np.abs(matrix).sum(axis=0).max()))[1] + 1)
    part, term = np.ldexp(matrix, -halvings), np.eye(len(matrix))
    whole = term.copy()
    for number in range(1, _TERMS):
        term = term @ part / number
        whole += term
    for _ in range(halvings):
        whole = whole @ whole
    return whole
