"""Edge of a SiPM's count: its mean course while a pulse passes, and how often its noise lifts it over a level.

A cell that fires stays busy for the dead time, so the count does not follow the light: it adds up the light of the last
dead time, while the background fires fewer of the cells that are left. A weak flash's count therefore goes as

    w(v) = e^{-a v + a^2 / 2} (Phi(v - a) - Phi(v - a - T)),                                            (T118)

the pulse in the dead time before, each avalanche fading at the rate a (`sipm_response.residual_busy`). Strong light is
taken as slow: at each time the cells that fired are those of a weaker flash, of w(v) over its maximum.

The count steps up and down by cells and forgets itself within a dead time, so it passes a level more often than it is
above it at its peak. Around the peak it is a random walk of D steps a sigma_p on a falling mean. Over a stretch of time
with the variance 2 S sigma^2, at whose end the mean is lower by d sigma, its maximum exceeds its end by about

    f = ((d / S)^2 + pi / (4 S))^{-1/2}                                                                  (T119)

sigma: sqrt(4 S / pi) of a level mean, S / d of one that falls (a Brownian motion's exact means). Before and behind the
peak that makes 1 - P = (1 - P_peak) exp(-h (f_before + f_behind - 1 / 2 sigma)), with the hazard h of the normal
distribution at the peak. The last term is that of whole cells, which pass a level exactly where P_peak is counted half
a cell lower. Held to events one by one in tests/validation/sipm_events; numbers: docs/sipm.md.

Symbols: sigma_p standard deviation of the pulse, unit of all places v, which count from the light's peak; T dead time;
a decay, rate of the background times sigma_p; sigma noise at the peak.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ...maths.arrays import Lanes, xp
from ...maths.special import expm1, log1p, normal_tail

_LATEST = 2.5
"""Accuracy bought: latest peak of the count, in sigma_p: 99.4 % of the pulse is there."""

_SHORTEST, _FASTEST = 0.05, 3.0
"""Accuracy bought: bounds of T and a: beyond them the count follows the light, and single precision would end."""

_EARLIEST = 8.0
"""Accuracy bought: earliest place on the edge before the light's peak, in sigma_p: 6e-16 of the pulse has come."""

_STEPS = 6  # Newton's, of the edge's place: 1e-4 sigma_p below 98 % of the peak

_STRETCHES = (0.5, 1.0, 2.0)
"""Accuracy bought: stretches of time on either side of the peak of which the one with the largest f counts, in
sigma_p."""

_FORGOTTEN = math.sqrt(4.0 / math.pi)
"""Choice: most deviations by which a count on the edge exceeds its mean: (T119) of a level mean over a dead time, where
S is 1. Over a stretch of several it is no random walk."""

_SURE = 5.0
"""Accuracy bought: deviations above the level at which P_d is 1 in single precision."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Passage:
    """Passages of a level around the peak of the count; each field (n,).

    Attributes:
        on_edge: probability that the count has passed the level by its peak
        ever: probability that it passes the level before the cells revive, P_d
        before: f of the stretch before the peak
        duration: time behind the peak in which the late passages happen, in sigma_p
    """

    on_edge: Lanes
    ever: Lanes
    before: Lanes
    duration: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class CountEdge:
    """Edge of the count under a background, for a Gaussian pulse.

    Attributes:
        sigma_s: standard deviation of the pulse
        decay: a, rate at which the background takes back the count of an echo, times sigma_p
        dead_time: T, in sigma_p
        free: cells that the background leaves ready
        jumps: variance of the background's steps up and down in a sigma_p, cells squared
        cluster: variance of the cells that fire with one avalanche, over that of one cell: 1 without crosstalk
    """

    sigma_s: Lanes
    decay: Lanes
    dead_time: Lanes
    free: Lanes
    jumps: Lanes
    cluster: Lanes = 1.0

    @classmethod
    def from_cells(
        cls, *, sigma_s: Lanes, rate_hz: Lanes, dead_time_s: Lanes, busy: Lanes, free: Lanes, variance: Lanes
    ) -> CountEdge:
        """Build from rate_hz, at which the background fires a ready cell, and the variance of the busy cells."""
        ops, cells = xp(sigma_s, rate_hz, free), busy + free
        dead_time = ops.maximum(dead_time_s / sigma_s, _SHORTEST)
        # Independent cells have the variance busy (free / N); they fire and revive busy / T times each.
        return cls(
            sigma_s=sigma_s,
            decay=ops.minimum(rate_hz * sigma_s, _FASTEST),
            dead_time=dead_time,
            free=free,
            jumps=2.0 * variance * cells / free / dead_time,
            cluster=variance * cells / ops.maximum(free * busy, 1e-6 * free),
        )

    @property
    def peak(self) -> Lanes:
        """Place of the count's peak: where the pulse brings as many cells as the background and the dead time take."""
        ops, a, dead_time = xp(self.decay, self.dead_time), self.decay, self.dead_time
        middle = 0.5 * dead_time
        place = ops.minimum(1.0, middle) + 0.0 * a
        for _ in range(3):
            new, old = _density(place), _density(place - dead_time)
            held = _below(place) - _below(place - dead_time)
            hazard = (new - old) / held
            slope = (old * (place - dead_time) - new * place) / held - hazard * hazard
            # Where the background is weak the peak runs off to the end of the plateau: the pulse's end will do.
            place = ops.maximum(ops.minimum(place - (hazard - a) / ops.minimum(slope, -1e-6), _LATEST), -_LATEST)
        return ops.minimum(ops.minimum(place + a, _LATEST), middle)

    def course(self, place: Lanes) -> Lanes:
        """w: count of a weak pulse at a place, for one avalanche in all, (T118)."""
        ops, a = xp(place, self.decay), self.decay
        arrived = _below(place - a) - _below(place - a - self.dead_time)
        return ops.exp(a * (0.5 * a - place)) * arrived

    def place(self, share: Lanes) -> Lanes:
        """Place on the edge at which the course has a share of its maximum; the peak for shares of 1 and more."""
        ops, a, peak = xp(share, self.decay), self.decay, self.peak
        highest = self.course(peak)
        log_level = ops.log(ops.maximum(ops.minimum(share, 1.0) * highest, 1e-30))
        # ln w is concave, and w is below exp(-v^2 / 2) before the light's peak: Newton's steps from there only rise.
        place = -ops.minimum(ops.sqrt(ops.maximum(-2.0 * log_level, 0.0)), _EARLIEST)
        for _ in range(_STEPS):
            arrived = _below(place - a) - _below(place - a - self.dead_time)
            slope = (_density(place - a) - _density(place - a - self.dead_time)) / arrived - a
            error = log_level - ops.log(arrived) - a * (0.5 * a - place)
            place = ops.minimum(place + error / ops.maximum(slope, 1e-6), peak)
        return place

    def time_s(self, share: Lanes) -> Lanes:
        """Time after the light's peak at which the mean count has a share of its peak's light, s."""
        return self.sigma_s * self.place(share)

    def passage(self, at_peak: Lanes, *, threshold: Lanes, signal: Lanes, sigma: Lanes) -> Passage:
        """Probability that the count passes a level anywhere on the echo, (T119).

        Args:
            at_peak: probability that it is above the level at its peak
            threshold: the level, above the mean background
            signal: highest mean count, above the same
            sigma: its standard deviation there
        """
        ops = xp(at_peak, signal, self.decay)
        sigma = ops.maximum(sigma, 1e-6)
        ratio = ops.maximum(ops.minimum((threshold - signal) / sigma, 10.0), -_SURE)
        hazard = _density(ratio) / _below(ratio)
        peak = self.peak
        after_peak = ops.maximum(self.dead_time - 1.0 - peak, _STRETCHES[-1])
        before: Lanes = 0.0
        for stretch in _STRETCHES:
            before = ops.maximum(before, self._excess(peak, peak - stretch, signal, sigma)[0])
        behind, variance = self._excess(peak, peak + after_peak, signal, sigma)
        for longer in (*_STRETCHES, 0.5 * after_peak):
            behind = ops.maximum(behind, self._excess(peak, peak + longer, signal, sigma)[0])
        half_cell = 0.5 / sigma
        quiet = 1.0 - at_peak
        on_edge = at_peak - quiet * expm1(-hazard * ops.maximum(before - half_cell, 0.0))
        ever = at_peak - quiet * expm1(-hazard * ops.maximum(before + behind - half_cell, 0.0))
        # A level mean is passed evenly in the root of time: half of S = pi f^2 / 4 in the mean, twice that at most.
        duration = after_peak * ops.minimum(0.5 * math.pi * behind * behind / variance, 1.0)
        return Passage(on_edge=on_edge, ever=ever, before=before, duration=duration)

    def _excess(self, peak: Lanes, end: Lanes, signal: Lanes, sigma: Lanes) -> tuple[Lanes, Lanes]:
        """f and S of the stretch from the peak to a place before or behind it, in deviations at the peak."""
        ops = xp(peak, signal, self.decay)
        low, high = ops.minimum(peak, end), ops.maximum(peak, end)
        highest, dead_time = self.course(peak), self.dead_time
        # How far the mean follows the light: s = free (1 - exp(-y)).
        firings = -log1p(-ops.minimum(signal / self.free, 0.999))
        follows = ops.where(
            firings > 1e-4, (1.0 - signal / self.free) * firings / ops.maximum(signal / self.free, 1e-4), 1.0
        )
        drop = signal * follows * ops.maximum(1.0 - self.course(end) / highest, 0.0)
        arrived = _below(high) - _below(low)
        revived = _below(high - dead_time) - _below(low - dead_time)
        steps = self.jumps * (high - low) + self.cluster * signal * (arrived + revived) / highest
        # Behind the peak fewer cells fire than revive.
        steps = ops.maximum(ops.where(end > peak, steps - drop, steps), 0.5 * self.jumps * (high - low))
        variance = ops.maximum(0.5 * steps / (sigma * sigma), 1e-9)
        fall = drop / sigma / variance
        return 1.0 / ops.sqrt(fall * fall + 0.25 * math.pi / variance), variance

    def excess(self, share: Lanes, *, level: Lanes, sigma: Lanes, passage: Passage) -> Lanes:
        """Cells by which the count's maximum so far exceeds its mean course on the edge.

        There the count steps forth and back, so that it passes a level before its mean would: by D / (2 m'), less the
        half cell, and by no more than at the peak.

        Args:
            share: of the light of the peak
            level: mean count at that share
            sigma: noise there
        """
        place, ops = self.place(share), xp(share, level)
        # On an edge the count is free (1 - exp(-y)), with y in proportion to the light.
        fired = ops.minimum(level / self.free, 0.999)
        per_pulse = self.free * (1.0 - fired) * -log1p(-fired) / ops.maximum(share, 1e-30) / self.course(self.peak)
        arriving = self.cluster * per_pulse * _density(place)
        reviving = self.cluster * per_pulse * _density(place - self.dead_time)
        steep = 2.0 * sigma * ops.maximum(arriving - reviving, 0.0) / (self.jumps + arriving + reviving + 1e-9)
        before = ops.maximum(passage.before, 1e-6)
        before = ops.where(self.dead_time < _STRETCHES[-1], ops.minimum(before, _FORGOTTEN), before)
        return ops.maximum(sigma / ops.sqrt(steep * steep + 1.0 / (before * before)) - 0.5, 0.0)


def late_place(passage: Passage, tail: Lanes) -> Lanes:
    """Place behind the peak, in sigma_p from it, at which an echo passes a level that it has not reached by then.

    Args:
        tail: probability of an echo with more noise than this one's, between `Passage.on_edge` and `Passage.ever`; 0
            below
    """
    ops = xp(tail, passage.ever)
    late = (tail - passage.on_edge) / ops.maximum(passage.ever - passage.on_edge, 1e-9)
    late = ops.minimum(ops.maximum(late, 0.0), 1.0)
    return passage.duration * late * late


def _below(x: Lanes) -> Lanes:
    """Phi, with its relative precision in the lower tail."""
    return normal_tail(-x)


def _density(x: Lanes) -> Lanes:
    """Standard normal density."""
    return xp(x).exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)
