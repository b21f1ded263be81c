"""SiPM in the time domain: how many cells are busy while a pulse passes, and a table of the peak.

(24) counts half of the pulse, whatever the dead time. The time domain counts what a cell really sees. A cell that is
dead for tau after each firing is busy at t if it fired in (t - tau, t], so its busy share obeys

    b(t) = int_{t-tau}^{t} r(u) (1 - b(u)) du,       r = background + dark counts + pulse,        (B)

exactly. Cells are independent and alike, so the count at any one time is binomial, N cells of share b(t): variance
N b (1 - b), skewness (1 - 2b) / sqrt(N b (1 - b)). Only what joins different times (first crossings, timing) and what
couples cells has to be simulated; tests/validation/sipm_events does that, and checks this. Numbers: docs/sipm.md.

In units of tau the peak depends on three numbers only: busy share before the pulse, pulse width over tau, light per
cell. So one table serves every sensor; it is computed once per process, when first needed.

Symbols: tau dead time, b busy share, x background firings per cell and dead time.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from ...maths.arrays import Lanes, LookupTable, Numbers, xp
from ...maths.special import log1p, normal_tail
from .pulse_sums import SIGMAS_PER_FWHM

_LN2 = math.log(2.0)
_ENERGY = math.sqrt(math.pi / (4.0 * _LN2))  # of a Gaussian of unit peak and FWHM, 1.0645

LATEST_PEAK = 0.6
"""Accuracy bought: time after the light's peak by which the count has peaked, in dead times. In weak light it peaks at
0.5, in strong light earlier; with a short pulse when all of the pulse has arrived."""

_EDGE = 2.0
"""Accuracy bought: distance from its peak, in FWHM, at which a pulse is cut off: 1.5e-5 of it."""

_WIDTHS, _SHARES, _FLASHES = 49, 15, 65  # points of the table along its axes

_LARGEST_BACKGROUND = 30.0
"""Accuracy bought: end of the table over x, the background's firings in a dead time."""

_LARGEST_FLASH = 1e3
"""Accuracy bought: end of the table over the light's firings of a cell that never dies."""

_LARGEST_REFILL = 40.0
"""Accuracy bought: background firings of a cell between the light's peak and the count's that single precision can
raise e to."""

_LARGEST_YIELD = 14.0
"""Accuracy bought: -log(1 - share) at the inverse's end; single precision ends at a share of 1 - 1e-6."""


def captured_photons(*, photons: Lanes, pulse_fwhm_s: Lanes, dead_time_s: Lanes) -> Lanes:
    """Photons of a Gaussian pulse in the dead time centred on its peak.

    A box of tau around the peak holds 2 1.0645 erf(sqrt(ln 2) tau / FWHM) times that: 1.62 times at tau = FWHM, 2.13
    times (the whole pulse) at tau >> FWHM, as much at tau = 0.53 FWHM.

    Args:
        photons: as (24) counts them, half of P_r FWHM
    """
    inner = 1.0 - 2.0 * normal_tail(math.sqrt(2.0 * _LN2) * dead_time_s / pulse_fwhm_s)
    return 2.0 * _ENERGY * inner * photons


def peak_photons(*, photons: Lanes, busy_share: Lanes, pulse_to_dead_time: Lanes, pde: Lanes, cells: Lanes) -> Lanes:
    """Photons of a flash that would fire as many free cells as the pulse adds to the busy cells at its peak.

    Fewer than arrived: cells that fired early in the pulse are dead or alive again at its peak, and the background
    finds fewer free cells meanwhile. Interpolated to 0.5 % (docs/sipm.md).

    Args:
        photons: photons of the pulse in the dead time around its peak, `captured_photons`
        busy_share: before the pulse, x / (1 + x)
        pulse_to_dead_time: FWHM / tau
    """
    forward, _ = tables()
    per_cell = photons * pde / cells
    ratio = forward.at(*_place(pulse_to_dead_time, busy_share), log1p(per_cell) / math.log1p(_LARGEST_FLASH))
    return photons * xp(ratio).exp(ratio)


def captured_for_peak(
    *, photons: Lanes, busy_share: Lanes, pulse_to_dead_time: Lanes, pde: Lanes, cells: Lanes
) -> Lanes:
    """`peak_photons` solved for the photons of the pulse, by a second table."""
    _, inverse = tables()
    per_cell = photons * pde / cells
    ratio = inverse.at(*_place(pulse_to_dead_time, busy_share), per_cell / _LARGEST_YIELD)
    return photons * xp(ratio).exp(ratio)


def _place(pulse_to_dead_time: Lanes, busy_share: Lanes) -> tuple[Lanes, Lanes]:
    """Coordinates in the tables, from 0 to 1.

    1 / (1 + width) puts both limits at finite places: a flash at 1, an endless pulse at 0.
    """
    return 1.0 / (1.0 + pulse_to_dead_time), -log1p(-busy_share) / math.log1p(_LARGEST_BACKGROUND)


def residual_busy(*, age_s: Lanes, rate_hz: Lanes, dead_time_s: Lanes, sigma_s: Lanes) -> Lanes:
    """Count above the background's that an earlier echo leaves, for each cell that it fired: 1 at first, theory (T45b).

    Without the pulse's width it is exp(-r t) up to tau: the background fires fewer ready cells and the count falls
    back. At tau the echo's cells revive all together, none of them busy with background: until 2 tau the count is
    *below* what it was, -exp(-r a) (1 - exp(-x) - r a) at a = t - tau. Both solve (B) for a flash exactly. What is left
    after 2 tau, 4 % at Table 1's sun and 15 % at x = 1.25, counts as none. The pulse's width smears the revival.

    Args:
        age_s: since the echo's light peaked
        rate_hz: rate at which the background fires a ready cell, x / tau
        sigma_s: standard deviation of the pulse
    """
    ops = xp(age_s, rate_hz)
    revived = 1.0 - normal_tail((age_s - dead_time_s) / sigma_s)
    since_revival_s = ops.maximum(age_s - dead_time_s, 0.0)
    missing = 1.0 - ops.exp(-rate_hz * dead_time_s) - rate_hz * since_revival_s
    below = ops.where(since_revival_s < dead_time_s, ops.exp(-rate_hz * since_revival_s) * missing, 0.0)
    fired = 1.0 - normal_tail(age_s / sigma_s)
    # The background takes nothing back before the pulse: without this, exp(r t) of an echo yet to come overflows.
    since_s = ops.minimum(ops.maximum(age_s, 0.0), dead_time_s)
    return (fired - revived) * ops.exp(-rate_hz * since_s) - revived * below


def fired_by_pulse(*, peak: Lanes, rate_hz: Lanes, pulse_fwhm_s: Lanes, dead_time_s: Lanes, cells: Lanes) -> Lanes:
    """Cells that a pulse fired in all, from the most that were busy with it at a time; at most all cells.

    The first to fire revive before the last, if the pulse is not short of the dead time, and the background's count
    falls on the way to the peak.
    """
    inner = 1.0 - 2.0 * normal_tail(math.sqrt(2.0 * _LN2) * dead_time_s / pulse_fwhm_s)
    lag_s = peak_lag_s(pulse_fwhm_s=pulse_fwhm_s, dead_time_s=dead_time_s)
    ops = xp(peak, rate_hz)
    # The bound of the exponent keeps single precision finite; cells end the growth long before.
    refilled = ops.exp(ops.minimum(rate_hz * lag_s, _LARGEST_REFILL))
    return ops.minimum(peak / inner * refilled, cells)


def peak_lag_s(*, pulse_fwhm_s: Lanes, dead_time_s: Lanes) -> Lanes:
    """Time from the light's peak to the count's: half a dead time, or two sigma of a pulse that is all there before."""
    whole_pulse_s = 2.0 / SIGMAS_PER_FWHM * pulse_fwhm_s
    return xp(whole_pulse_s, dead_time_s).minimum(whole_pulse_s, 0.5 * dead_time_s)


def busy_share_over_time(
    *, background: Numbers, flash: Numbers, pulse_to_dead_time: float, steps: int | None = None
) -> tuple[Numbers, Numbers]:
    """Solve (B): times from the pulse's peak in dead times, (t,), and the busy share at them, (t, ...).

    From 2 FWHM before the light's peak until the count has peaked. Second order in the step and stable for any light,
    because within a step the rate and the share of reviving cells are taken as constant and integrated exactly.

    Args:
        background: (...) firings per cell and dead time, x
        flash: (...) firings that the whole pulse would cause in a cell that never dies
        steps: per dead time; fine enough for the table if None
    """
    steps = steps or max(24, math.ceil(24.0 / pulse_to_dead_time))
    steps_before = math.ceil(_EDGE * pulse_to_dead_time * steps)
    steps_after = math.ceil(min(_EDGE * pulse_to_dead_time, LATEST_PEAK) * steps)
    times = np.arange(-steps_before, steps_after + 1) / steps
    arrived = _arrived(times / pulse_to_dead_time)
    x, y = np.broadcast_arrays(np.asarray(background, float), np.asarray(flash, float))
    alive = 1.0 / (1.0 + x)
    fired = np.zeros((len(times) - 1, *x.shape))
    free = np.zeros((len(times), *x.shape))
    free[0] = alive
    early = x * alive / steps  # revives in a step of the first dead time, from the stationary state
    # alive(t + dt) = alive exp(-e) + revived (1 - exp(-e)) / e, with e the firings per live cell in the step: those
    # who were alive may fire, those who revive do so evenly over the step.
    for k in range(len(times) - 1):
        exponent = x / steps + y * (arrived[k + 1] - arrived[k])
        revived = fired[k - steps] if k >= steps else early
        survive = np.exp(-exponent)
        mean = np.where(exponent > 1e-6, -np.expm1(-exponent) / np.maximum(exponent, 1e-6), 1.0)
        next_alive = alive * survive + revived * mean
        fired[k] = alive - next_alive + revived
        free[k + 1] = alive = next_alive
    return times, 1.0 - free


def busy_share_in_steps(
    *,
    rate: Numbers,
    busy_share: Numbers,
    steps: int,
    crosstalk: float = 0.0,
    afterpulse: float = 0.0,
    afterpulse_to_dead_time: float = 1.0,
) -> Numbers:
    """Solve (B) for any light: the busy share at the end of each step, (n, times).

    Args:
        rate: (n, times) firings of a ready cell by light beyond the background, per dead time
        busy_share: (n,) under the background alone, its crosstalk and afterpulses in it
        steps: per dead time
        crosstalk: as of `sipm.busy_share_correlated`
        afterpulse: as there; afterpulses within the dead time are lost
        afterpulse_to_dead_time: as there
    """
    free = 1.0 - busy_share
    # What the background and all that follows from it does to a ready cell; light adds to it.
    background_rate = busy_share / free - crosstalk * busy_share
    fired = np.zeros_like(rate)
    busy = np.zeros_like(rate)
    early, pending = busy_share / steps, 0.0 * busy_share
    fading = math.exp(-1.0 / (steps * afterpulse_to_dead_time))
    lasting = afterpulse * math.exp(-1.0 / afterpulse_to_dead_time)
    for k in range(rate.shape[1]):
        revived = fired[:, k - steps] if k >= steps else early
        pending = pending + lasting * (revived - early)
        refires, pending = pending * (1.0 - fading), pending * fading
        # f / (1 - p f): each firing tries one more cell at once.
        exponent = (background_rate + rate[:, k]) / (1.0 - crosstalk * free) / steps + refires
        survive = np.exp(-exponent)
        mean = np.where(exponent > 1e-6, -np.expm1(-exponent) / np.maximum(exponent, 1e-6), 1.0)
        next_free = free * survive + revived * mean
        fired[:, k] = free - next_free + revived
        free = next_free
        busy[:, k] = 1.0 - free
    return busy


def _arrived(time: Numbers) -> Numbers:
    """Share of a Gaussian pulse that has arrived by ``time``, in FWHM from its peak."""
    return np.asarray(1.0 - normal_tail(SIGMAS_PER_FWHM * time))


@functools.cache
def tables() -> tuple[LookupTable, LookupTable]:
    """log(peak / captured photons) over (width, busy share, light), and log of its inverse; about 1 s, once."""
    places = np.linspace(0.0, 1.0, _WIDTHS)
    shares = -np.expm1(-np.linspace(0.0, math.log1p(_LARGEST_BACKGROUND), _SHARES))
    captured = np.expm1(np.linspace(0.0, math.log1p(_LARGEST_FLASH), _FLASHES))
    captured[0] = 1e-6
    reached = np.linspace(0.0, 1.0, _FLASHES) * _LARGEST_YIELD
    reached[0] = 1e-6
    forward = np.zeros((_WIDTHS, _SHARES, _FLASHES))
    inverse = np.zeros_like(forward)
    for i, place in enumerate(places):
        peak = _peak(place, shares[:, None], captured[None, :])
        forward[i] = np.log(peak / captured)
        for j in range(_SHARES):
            # np.interp needs rising abscissae; rounding may leave ripples where the response is flat.
            rising = np.maximum.accumulate(peak[j])
            inverse[i, j] = np.interp(np.log(reached), np.log(rising), -forward[i, j])
    return LookupTable(forward), LookupTable(inverse)


def _peak(place: float, share: Numbers, captured: Numbers) -> Numbers:
    """Photons per cell of the flash that matches the pulse's peak; both limits of ``place`` in closed form."""
    background = share / (1.0 - share)
    if place == 0.0:  # a pulse so long that the cells follow it: x / (1 + x) of all the light
        return np.log1p(captured * (1.0 - share))
    if place == 1.0:  # a flash
        return np.broadcast_to(captured, np.broadcast_shapes(share.shape, captured.shape)).copy()
    width = 1.0 / place - 1.0
    inner = math.erf(math.sqrt(_LN2) / width)
    _, busy = busy_share_over_time(background=background, flash=captured / inner, pulse_to_dead_time=width)
    fired = (busy.max(axis=0) - share) / (1.0 - share)
    return np.asarray(-np.log1p(-np.minimum(fired, 1.0 - 1e-12)))
