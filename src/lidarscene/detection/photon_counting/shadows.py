"""Shadows: how many SPADs are free behind light that came up to four dead times before.

Light that fires SPADs is gathered by dead times: what came in the last one, in the one before, and so on. A SPAD
fires once in each. How free the SPADs are follows from the firings of each dead time and the renewal of those in the
sun (T106).

Symbols: lambda rate of detections of one free SPAD, tau its dead time, sigma width of an echo in the histogram, Lambda
detections of an echo.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ...light.waveform import Waveform
from ...maths.arrays import Lanes, xp
from ...physics.photon_counting import dead_time, pile_up
from ...sensor.detectors.macropixel import Macropixel

DEAD_TIMES = 4
"""Dead times before a place in which light is looked for: of older firings a tenth and less is still missing."""

_STEPS = (12, 6, 6, 6, 6)
"""Steps of the integral of the air's light in each of them, and before them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shadow:
    """SPADs that light of the last dead times has fired, over those that are free in even light.

    Attributes:
        place: (n,) place, in sigmas, behind that light
        sun: lambda sigma
        dead: tau in sigmas
        firings: (n,) each: firings within the last dead time before the place, the one before, and so on
        places: (n,) each: their mean places
    """

    place: Lanes
    sun: Lanes
    dead: Lanes
    firings: tuple[Lanes, ...]
    places: tuple[Lanes, ...]

    def free(self, earlier: int = 0) -> Lanes:
        """Free SPADs over those of even light, (n,), so many whole dead times before the place."""
        ops = xp(self.place)
        free: Lanes = ops.full(self.place, 1.0)
        for number in range(earlier, min(len(self.firings), DEAD_TIMES)):
            # Light of the dead time before has come back once, and so on.
            back = number - earlier
            since = ops.maximum(self.place - earlier * self.dead - self.places[number], back * self.dead)
            free = free - self.firings[number] * self._missing(since, (1.0,) * back)
        return ops.maximum(free, 0.0)

    def due_hz(self, pixel: Macropixel, earlier: int, free: Lanes) -> Lanes:
        """Afterpulses a second that free SPADs are to have so many dead times before the place, over those free in
        even light, (n,) (T109).

        Args:
            free: (n,) free SPADs then, as of `free`
        """
        ops, spad, even_hz = xp(self.place), pixel.spad, pixel.even_afterpulses_hz
        assert spad.afterpulse is not None
        assert spad.afterpulse_s is not None
        delay_s = spad.afterpulse_s

        def free_again(since_s: Lanes) -> Lanes:
            # The sun may have fired it by then; a dead time on it has its share of free SPADs again.
            return ops.maximum(ops.exp(-pixel.rate_hz * since_s), pixel.free)

        due = even_hz * free
        for fired, place in zip(self.firings[earlier + 1 :], self.places[earlier + 1 :], strict=True):
            since_s = (self.place - earlier * self.dead - place) * pixel.sigma_s
            back_s = ops.maximum(since_s - spad.dead_time_s, 0.0)
            renewed_s = ops.maximum(back_s - spad.dead_time_s, 0.0)
            # What the SPAD was to have when light fired it, and what it has of that firing, has come meanwhile or is
            # still to come. Those of the sun come anew from when it has fired the SPAD again.
            lasting = ops.exp(-since_s / delay_s)
            of_old = lasting * (spad.afterpulse / delay_s + even_hz) - even_hz
            of_new = even_hz * (1.0 - ops.exp(-renewed_s / delay_s))
            due = due + fired * (free_again(back_s) * of_old + free_again(renewed_s) * of_new)
        return ops.maximum(due, 0.0)

    def _missing(self, since: Lanes, back: tuple[Lanes, ...]) -> Lanes:
        """Share of SPADs still missing a time after a firing (T106), in sigmas."""
        return dead_time.missing_share(firings_s=since, rate_hz=self.sun, dead_time_s=self.dead, back=back)

    @classmethod
    def before(cls, pixel: Macropixel, wave: Waveform, place: Lanes, time_s: Lanes) -> Shadow:
        """Gather the light before a place.

        Args:
            wave: light on the detector, as wide as echoes are in the histogram
            place: (n,) place on it
            time_s: (n,) time of flight to the place
        """
        ops, sun, dead = xp(place), pixel.sun, pixel.blind_sigmas
        if pixel.spad.fires_once:
            # None comes back, neither of those that the sun has fired.
            light, *_ = _light_between(pixel, wave, (place, None), time_s, 0)
            fired = dead_time.firing_share(detections=light)
            return cls(place=place, sun=0.0, dead=dead, firings=(fired,), places=(place,))
        shadow = cls(place=place, sun=sun, dead=dead, firings=(), places=())
        # Afterpulses come of all that is older, too.
        for number in reversed(range(DEAD_TIMES + (pixel.spad.afterpulse is not None))):
            end = place - number * dead
            begin = end - dead if number < DEAD_TIMES else None
            light, mean, whole = _light_between(
                pixel, wave, (end, begin), time_s - number * pixel.spad.dead_time_s, number
            )
            echo = pile_up.firings(detections=light, sun=sun)
            mean = ops.minimum(mean + echo.mean, end)
            if begin is not None:
                mean = ops.maximum(mean, begin)
            free: Lanes = ops.full(place, 1.0)
            at_first = dead_time.firing_share(detections=light)
            for fired, earlier in zip(shadow.firings, shadow.places, strict=True):
                since = ops.maximum(mean - earlier, 0.0)
                # SPADs that come back while the light lasts meet part of it.
                back = tuple(
                    dead_time.firing_share(detections=light * share_before(since - count * dead))
                    / ops.maximum(at_first, 1e-20)
                    for count in range(1, DEAD_TIMES)
                )
                free = free - fired * shadow._missing(since, back)
            # Of an echo that is cut off fewer SPADs come free within its light.
            fired = at_first * ops.maximum(free, 0.0) + whole * (echo.share - at_first)
            shadow = replace(shadow, firings=(fired, *shadow.firings), places=(mean, *shadow.places))
        return shadow


def share_before(ahead: Lanes) -> Lanes:
    """Share of a Gaussian that lies before a place so many sigmas behind its centre, to 2e-4.

    A logistic function: Page, "Approximations to the cumulative normal function", Appl. Statist. 26, 75, 1977.
    """
    ops = xp(ahead)
    ahead = ops.minimum(ops.maximum(ahead, -6.0), 6.0)
    return 1.0 / (1.0 + ops.exp(-ahead * (1.5976 + 0.07056 * ahead * ahead)))


def _light_between(
    pixel: Macropixel, wave: Waveform, ends: tuple[Lanes, Lanes | None], time_s: Lanes, number: int
) -> tuple[Lanes, Lanes, Lanes]:
    """Detections of a free SPAD before a place and behind an earlier one, their mean place, and which part they are of
    whole echoes, (n,) each.

    Args:
        ends: the later place and the earlier one; None: when the pulse left
        time_s: time of flight to the later one
        number: dead times before the place whose shadow this is
    """
    ops, (end, begin), sigma = xp(time_s), ends, pixel.sigma_s
    zero: Lanes = ops.full(end, 0.0)
    light, moment, inside = zero, zero, zero
    energy = pixel.per_watt * sigma * math.sqrt(2.0 * math.pi)
    for centre, height in zip(wave.centres, wave.heights, strict=True):
        ahead = end - centre
        share, behind = share_before(ahead), ops.exp(-0.5 * ahead * ahead)
        if begin is not None:
            since = begin - centre
            share, behind = share - share_before(since), behind - ops.exp(-0.5 * since * since)
        part = share * height * energy
        # The mean of a Gaussian between two places.
        moment = moment - (ahead * part + behind * height * energy * (1.0 / math.sqrt(2.0 * math.pi)))
        light, inside = light + part, inside + part * share
    if wave.volume is not None:
        since = ops.maximum(time_s, 0.0)
        if begin is not None:
            since = ops.minimum(since, pixel.spad.dead_time_s)
        steps = _STEPS[number]
        step = since / (sigma * steps)
        for k in range(steps):
            part = wave.air_w(end - (k + 0.5) * step) * step * sigma * pixel.per_watt
            light, moment = light + part, moment - part * (k + 0.5) * step
            inside = inside + part
    total = ops.maximum(light, 1e-20)
    return light, end + moment / total, inside / total
