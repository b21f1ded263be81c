"""A stride: where the joints of someone who walks are over one cycle, from one contact of the left heel to the next.

Sources; only the strides of children were looked up, the other numbers are as remembered of these works, so assumed:

* Thigh and knee over the cycle, at the bounds of its phases: J. Perry and J. M. Burnfield, "Gait analysis", 2nd ed.
  (2010). Foot against the ground, 20 degrees toe up at contact and 60 down at toe off, which comes at 62 %: D. A.
  Winter, "Biomechanics and motor control of human movement", 4th ed. (2009). Shoulder and elbow: M. P. Murray, S. B.
  Sepic and E. J. Barnard, Phys. Ther. 47 (1967), 272.
* Stride of children: J. M. Hausdorff et al., J. Appl. Physiol. 86 (1999), 1040: 1.00 m/s and 0.900 s at 3 to 4 years,
  1.20 m/s and 0.955 s at 6 to 7, 1.28 m/s and 1.072 s at 11 to 14. Speed of adults by age and sex: R. W. Bohannon and
  A. Williams Andrews, Physiotherapy 97 (2011), 182. Their walk ratio, step over steps a minute, 0.0065 m: N. Sekiya and
  H. Nagasaki, Gait Posture 7 (1998), 225; here in proportion to stature, 1.72 m having just that.

A foot that bears must stand: its place follows from the way of the body, and the leg between hip and ankle from both.
The published angles give the swing of the leg, between the two ends that the other foot's bearing leaves it. Angles are
in radians, in the plane of walking: a leg ahead, a bent knee, a lifted toe and a bent elbow are positive.
"""

from dataclasses import dataclass

import numpy as np
from modelling import curve

TOE_OFF = 0.62
KEYS = 96  # key frames of a stride
_HEEL_DOWN, _HEEL_UP = 0.08, 0.33
_PHASES = (0.0, 0.12, 0.31, 0.50, 0.62, 0.75, 0.87, 1.0)
_THIGH_DEG = (20.0, 20.0, 0.0, -20.0, -10.0, 15.0, 25.0, 20.0)
_KNEE_DEG = (5.0, 15.0, 5.0, 10.0, 40.0, 60.0, 25.0, 5.0)
_FOOT = ((0.0, _HEEL_DOWN, _HEEL_UP, 0.50, TOE_OFF, 0.72, 0.82, 0.92, 1.0), (20, 0, 0, -24, -60, -40, -2, 16, 20))
_TOES = ((0.0, _HEEL_DOWN, 0.50, TOE_OFF, 0.70, 0.82, 0.92, 1.0), (20, 0, 0, -28, -20, 0, 16, 20))
WALK_RATIO_M = 0.0065
BEARING_REACH, SWING_REACH = 0.990, 0.9985  # longest leg, as a share of its length: a knee that locks would snap


@dataclass(frozen=True, slots=True)
class Leg:
    """Lengths of a leg [m]: thigh, shank, height of the ankle, from there to heel and toe joint, and of the toes."""

    thigh: float
    shank: float
    ankle: float
    heel: float
    ball: float
    toes: float


@dataclass(frozen=True, slots=True)
class Stride:
    """Angles over a stride at phases 0, 1/96, ..., 1, of the left side; the right side is half a stride later.

    Attributes:
        pelvis_m: (97,) height of the hips
        thigh, knee, foot, toe: (97,) thigh and foot against the vertical and the ground, knee and toe joint bent
        standing: height of the hips, thigh and knee, as one stands
    """

    pelvis_m: np.ndarray
    thigh: np.ndarray
    knee: np.ndarray
    foot: np.ndarray
    toe: np.ndarray
    standing: tuple[float, float, float]


def stride_of_adult(speed_m_s, stature_m):
    """(length, time) of a stride at a speed: a step is WALK_RATIO times the steps in a minute."""
    step_m = np.sqrt(60.0 * speed_m_s * WALK_RATIO_M * stature_m / 1.72)
    return 2.0 * step_m, 2.0 * step_m / speed_m_s


def walk(leg, *, stride_m, crouch=0.0, lift=1.0):
    """The stride of a leg: as upright as it reaches but for `crouch`, a share; `lift` scales the foot's angles."""
    phase = np.arange(KEYS + 1) / KEYS
    foot, toes = (np.radians(lift * curve(phase, *knots)) for knots in (_FOOT, _TOES))
    longest = (leg.thigh + leg.shank) * (BEARING_REACH - crouch)
    # The pelvis is highest as the foot is below it.
    bob_m = 0.013 * stride_m * np.cos(4.0 * np.pi * (phase - 0.32))
    best = None
    bearing = phase <= TOE_OFF
    for heel_m in np.linspace(0.10, 0.35, 51) * stride_m:
        ankle = _bearing_ankle(phase, foot, toes, leg, heel_m, stride_m)
        room = longest**2 - ankle[bearing, 0] ** 2
        if (room > 0).all():
            height_m = float((ankle[bearing, 1] + np.sqrt(room) - bob_m[bearing]).min())
            if best is None or height_m > best[0]:
                best = height_m, ankle
    pelvis_m = best[0] + bob_m
    against_hip = best[1] - np.stack([0.0 * pelvis_m, pelvis_m], axis=1)
    bent = np.clip(toes - foot, 0.0, None)
    for raised_m in np.arange(0.0, 0.2, 0.002):
        ankle = _with_swing(phase, against_hip, leg, raised_m)
        if _lowest(ankle[:, 1] + pelvis_m, foot, bent, leg)[(phase > 0.68) & (phase < 0.95)].min() > 0.012:
            break
    thigh, knee = _bent(ankle, leg)
    stands = _bent(np.array([[0.0, -longest]]), leg)
    standing = (leg.ankle + longest, float(stands[0][0]), float(stands[1][0]))
    return Stride(pelvis_m, thigh, knee, foot, bent, standing)


def arm(phase, *, swing=1.0):
    """(shoulder, elbow) of the left arm: it is behind as the left heel meets the ground."""
    turn = 2.0 * np.pi * phase
    shoulder = np.radians(-8.0 - 16.0 * swing * np.cos(turn - 0.15))
    elbow = np.radians(22.0 - 10.0 * swing * np.cos(turn - 0.5))
    return shoulder, elbow


def _bearing_ankle(phase, foot, toes, leg, heel_m, stride_m):
    """(n, 2) ankle ahead of the hip and above the ground: it turns about the heel, is flat, turns about the toes."""
    at_m = heel_m - stride_m * phase
    cos, sin = np.cos(foot), np.sin(foot)
    about_heel = np.stack([leg.heel * cos - leg.ankle * sin, leg.heel * sin + leg.ankle * cos], axis=1)
    tip_m = leg.heel + leg.ball + leg.toes
    ball = np.stack([tip_m - leg.toes * np.cos(toes), -leg.toes * np.sin(toes)], axis=1)
    about_toes = ball + np.stack([-leg.ball * cos - leg.ankle * sin, -leg.ball * sin + leg.ankle * cos], axis=1)
    return np.where((phase < _HEEL_UP)[:, None], about_heel, about_toes) + np.stack([at_m, 0 * at_m], axis=1)


def _lowest(ankle_m, foot, toe, leg):
    """Lowest of heel, ball and tip of a foot, whose ankle is so high."""
    ball_m = ankle_m + leg.ball * np.sin(foot) - leg.ankle * np.cos(foot)
    heel_m = ankle_m - leg.heel * np.sin(foot) - leg.ankle * np.cos(foot)
    return np.minimum(np.minimum(ball_m, heel_m), ball_m + leg.toes * np.sin(foot + toe))


def _with_swing(phase, ankle, leg, raised_m):
    """The ankle against the hip over the whole stride: the published swing, led from toe-off to contact, and raised."""
    knots = np.asarray(_PHASES)
    thigh, knee = (np.radians(curve(phase, knots, angles)) for angles in (_THIGH_DEG, _KNEE_DEG))
    free = np.stack(
        [
            leg.thigh * np.sin(thigh) + leg.shank * np.sin(thigh - knee),
            -leg.thigh * np.cos(thigh) - leg.shank * np.cos(thigh - knee),
        ],
        axis=1,
    )
    step = 1.0 / KEYS
    off = int(np.flatnonzero(phase <= TOE_OFF)[-1])
    swings = np.arange(off, KEYS + 1)
    u = (phase[swings] - phase[off]) / (1.0 - phase[off])
    span = 1.0 - phase[off]
    # What the published way misses at both ends, in place and speed, is spread over the swing.
    misses = [ankle[off] - free[off], ankle[0] - free[-1]]
    rates = [
        ((ankle[off] - ankle[off - 1]) - (free[off + 1] - free[off])) / step * span,
        ((ankle[1] - ankle[0]) - (free[-1] - free[-2])) / step * span,
    ]
    shares = (2 * u**3 - 3 * u**2 + 1, 3 * u**2 - 2 * u**3, u**3 - 2 * u**2 + u, u**3 - u**2)
    led = free[swings] + sum(np.outer(share, part) for share, part in zip(shares, misses + rates, strict=True))
    led[:, 1] += raised_m * 16 * (u * (1 - u)) ** 2
    reach = np.hypot(*led.T) / (leg.thigh + leg.shank)
    room = SWING_REACH - BEARING_REACH
    softly = BEARING_REACH + room * (1 - np.exp(-np.maximum(reach - BEARING_REACH, 0) / room))
    led *= np.where(reach > BEARING_REACH, softly / reach, 1.0)[:, None]
    way = ankle.copy()
    way[swings] = led
    way[-1] = way[0]
    return way


def _bent(ankle, leg):
    """(thigh, knee) of a leg whose ankle is at (n, 2) from the hip."""
    reach = np.minimum(np.hypot(*ankle.T), (leg.thigh + leg.shank) * 0.9995)
    knee = np.pi - np.arccos((leg.thigh**2 + leg.shank**2 - reach**2) / (2 * leg.thigh * leg.shank))
    ahead = np.arctan2(ankle[:, 0], -ankle[:, 1])
    return ahead + np.arccos(np.clip((leg.thigh**2 + reach**2 - leg.shank**2) / (2 * leg.thigh * reach), -1, 1)), knee
