"""What the strength of a return says of the reflectivity there.

Apparent reflectivity: that of a matt board square to the beam with the same return. It is the surface's reflectivity
times its scattering law at that angle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...maths.arrays import Numbers
from ...physics.optics import reflection
from ...recordings.sweep import Second, Sweep

SLOPE_DEG = 45.0
"""Of the facets of all measured surfaces: as the catalogue's asphalt."""

LEAST = 2e-3
"""Lower reflectivities are unknown surfaces, and black."""

WHITE = 100.0
"""Of an Ouster's reflectivity, which counts linearly up to there, and of a Velodyne's intensity."""

ASSUMED_MEDIAN = 0.2
"""Of the apparent reflectivities, where the recording's intensity has no known unit."""

STEEPEST = 4.0
"""Exponent of the range by which a table is continued, at most."""

_LEAST_COUNTS = 5.0
_BINS_PER_OCTAVE = 4
_LEAST_PIXELS = 10


def withheld_mask(sweep: Sweep) -> Numbers:
    """Mask of the lost pulses for which a reflectivity is told: an echo was found there, and its range withheld.

    Ousters do so by the thousand, at edges and close by. What stands there is not known.
    """
    if sweep.reflectivity is None:
        return np.zeros(sweep.shape, bool)
    return np.asarray(sweep.lost & (sweep.reflectivity > 0.0))


def scattering_law(cos: Numbers) -> Numbers:
    """Light sent straight back by a surface at this angle, over that at normal incidence: equation (T7a) times cos."""
    relief = reflection.relief(np.radians(SLOPE_DEG))
    per_sr = reflection.rough_diffuse_per_sr(
        reflectivity=np.pi, relief=relief, cos_in=cos, cos_out=cos, cos_between=np.ones_like(cos)
    )
    return np.asarray(per_sr * cos)


def largest_reflectivity() -> float:
    """At normal incidence, of a surface with `SLOPE_DEG`."""
    return reflection.largest_reflectivity(float(np.radians(SLOPE_DEG)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Gauge:
    """From strength to apparent reflectivity.

    range_m, per_count  a table over range; one entry where strengths are calibrated already
    field               of the sweep that is taken: signal, reflectivity or intensity
    assumed             whether the scale is a guess
    """

    field: str
    range_m: Numbers
    per_count: Numbers
    assumed: bool = False

    @classmethod
    def from_sweep(cls, sweep: Sweep) -> Gauge | None:
        """Of a recording; None where it has no strengths.

        With signal and reflectivity, their ratio over the range is the maker's own calibration: it takes out the near
        field, and signals are finer than reflectivities in steps of 1 % and not cut off above white.
        """
        if sweep.reflectivity is not None and sweep.signal is not None:
            table = _reflectivity_per_photon(sweep)
            if table is not None:
                return cls(field="signal", range_m=table[0], per_count=table[1])
        if sweep.reflectivity is not None:
            return cls(field="reflectivity", range_m=np.ones(1), per_count=np.full(1, 1.0 / WHITE))
        if sweep.intensity is None:
            return None
        strength = sweep.intensity[sweep.has_return & np.isfinite(sweep.intensity)]
        if not len(strength) or not np.median(strength) > 0.0:
            return None
        if "velodyne" in sweep.metadata.get("format", ""):
            return cls(field="intensity", range_m=np.ones(1), per_count=np.full(1, 1.0 / WHITE))
        scale = ASSUMED_MEDIAN / float(np.median(strength))
        return cls(field="intensity", range_m=np.ones(1), per_count=np.full(1, scale), assumed=True)

    def apparent(self, returns: Sweep | Second, range_m: Numbers) -> Numbers:
        """Apparent reflectivity of a sweep's strengths at these ranges; `LEAST` where a strength is no number."""
        strength = np.asarray(getattr(returns, self.field), np.float64)
        log_range, table, value = np.log(np.maximum(range_m, 1e-3)), np.log(self.range_m), np.log(self.per_count)
        log_factor = np.interp(log_range, table, value)
        if len(table) > 1:
            # Before the table as between its first two bins; beyond it signals fall as 1 / range^2.
            slope = np.clip((value[1] - value[0]) / (table[1] - table[0]), -STEEPEST, STEEPEST)
            log_factor = (
                log_factor
                + slope * np.minimum(log_range - table[0], 0.0)
                + 2.0 * np.maximum(log_range - table[-1], 0.0)
            )
        factor = np.exp(log_factor)
        return np.maximum(np.nan_to_num(strength * factor, posinf=0.0), LEAST)


def _reflectivity_per_photon(sweep: Sweep) -> tuple[Numbers, Numbers] | None:
    """Reflectivity of a photon by range, from pixels well above the steps of the reflectivity and below white."""
    assert sweep.reflectivity is not None
    assert sweep.signal is not None
    good = (
        sweep.has_return & (sweep.reflectivity >= _LEAST_COUNTS) & (sweep.reflectivity < WHITE) & (sweep.signal > 0.0)
    )
    if good.sum() < _LEAST_PIXELS:
        return None
    log_range = np.log2(sweep.range_m[good])
    ratio = sweep.reflectivity[good].astype(np.float64) / WHITE / sweep.signal[good]
    bins = np.floor(log_range * _BINS_PER_OCTAVE).astype(int)
    range_m, per_count = [], []
    for number in np.unique(bins):
        mask = bins == number
        if mask.sum() >= _LEAST_PIXELS:
            range_m.append(2.0 ** float(np.median(log_range[mask])))
            per_count.append(float(np.median(ratio[mask])))
    return (np.array(range_m), np.array(per_count)) if range_m else None
