"""Response tables of a SiPM, by events and by equation, and where (27) is wrong.

docs/sipm.md is made of these tables.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lidarscene.maths.arrays import Numbers
from lidarscene.physics.electronics import sipm, sipm_response
from lidarscene.physics.reference import sipm as reference_sipm

from .cells import CellArray, Light
from .working_point import moments, pulse_outputs


@dataclass(frozen=True, slots=True, kw_only=True)
class ResponseTable:
    """The output when its mean is highest, over light; in units of one recovered cell.

    Attributes:
        background_photons: (b,) in one dead time
        signal_photons: (s,) as in (24)
        mean: (b, s), also variance and skewness; ``before`` (b,) is the mean without echo and ``noise`` (b,) the
            standard deviation
        peak_time_s: (b, s) after the light's peak
        shots: per point; 0 if the numbers are exact
    """

    background_photons: Numbers
    signal_photons: Numbers
    before: Numbers
    noise: Numbers
    mean: Numbers
    variance: Numbers
    skewness: Numbers
    peak_time_s: Numbers
    shots: int

    @property
    def snr(self) -> Numbers:
        """(b, s) SNR, to compare with (27)."""
        return np.asarray((self.mean - self.before[:, None]) / self.noise[:, None])


def response_by_events(array, *, background_photons, signal_photons, pulse_fwhm_s, shots=2000, seed=0, steps=16):
    """The table by event simulation, for any cells. Each point has its own shots, all from one seed."""
    shape = (len(background_photons), len(signal_photons))
    columns = np.zeros((6, *shape))
    for i, background in enumerate(background_photons):
        for j, signal in enumerate(signal_photons):
            light = Light(background_photons=background, signal_photons=signal, pulse_fwhm_s=pulse_fwhm_s)
            point_seed = seed + i * shape[1] + j
            output = moments(*pulse_outputs(array, light, shots=shots, seed=point_seed, steps=steps))
            top = int(np.argmax(output.mean))
            columns[:, i, j] = (
                output.mean[0],
                output.variance[0],
                output.mean[top],
                output.variance[top],
                output.skewness[top],
                output.time_s[top],
            )
    return ResponseTable(
        background_photons=np.asarray(background_photons, float),
        signal_photons=np.asarray(signal_photons, float),
        before=columns[0].mean(axis=1),
        noise=np.sqrt(columns[1].mean(axis=1)),
        mean=columns[2],
        variance=columns[3],
        skewness=columns[4],
        peak_time_s=columns[5],
        shots=shots,
    )


def response_by_equation(array, *, background_photons, signal_photons, pulse_fwhm_s, steps=None):
    """The table from the equation of the busy share, without chance: box shape, cells without memory."""
    if array.shape != "box" or array.warm_up_s > 0.0 or array.crosstalk > 0.0:
        raise ValueError("only cells of box shape without recovery, crosstalk and afterpulses have an equation")
    background, signal = np.asarray(background_photons, float), np.asarray(signal_photons, float)
    tau = array.dead_time_s
    x = background * array.pde / array.cells + array.dark_count_rate_hz * tau
    whole = np.asarray(sipm_response.captured_photons(photons=signal, pulse_fwhm_s=pulse_fwhm_s, dead_time_s=1e3))
    time, busy = sipm_response.busy_share_over_time(
        background=x[:, None],
        flash=(whole * array.pde / array.cells)[None, :],
        pulse_to_dead_time=pulse_fwhm_s / tau,
        steps=steps,
    )
    share, before = busy.max(axis=0), x / (1.0 + x)
    return ResponseTable(
        background_photons=background,
        signal_photons=signal,
        before=array.cells * before,
        noise=np.sqrt(array.cells * before * (1.0 - before)),
        mean=array.cells * share,
        variance=array.cells * share * (1.0 - share),
        skewness=np.asarray(reference_sipm.binomial_skewness(share=share, cells=array.cells)),
        peak_time_s=time[busy.argmax(axis=0)] * tau,
        shots=0,
    )


def published_snr(array: CellArray, *, background_photons: Sequence[float], signal_photons: Sequence[float]) -> Numbers:
    """(b, s) SNR by (27) as printed."""
    background = np.asarray(background_photons, float)[:, None]
    signal = np.asarray(signal_photons, float)[None, :]
    light = {"pde": array.pde, "cells": array.cells}
    busy = array.cells * sipm.fired_share_published(photons=background, **light)
    dark = sipm.dark_counts(
        cells=array.cells, dark_count_rate_hz=array.dark_count_rate_hz, dead_time_s=array.dead_time_s
    )
    variance = sipm.fired_variance_published(fired=busy, cells=array.cells) + dark
    fired = (array.cells - busy - dark) * sipm.fired_share_published(photons=signal, **light)
    return np.asarray(fired / np.sqrt(variance))


def error_of_published_snr(array: CellArray, table: ResponseTable, *, pulse_fwhm_s: float | None = None) -> Numbers:
    """(b, s) SNR by (27) over that of the table, minus one.

    Args:
        pulse_fwhm_s: gives (24) the photons of this pulse in the dead time around its peak, instead of half of P_r
            FWHM, so that only the effect of dead cells is left; None: (27) as printed
    """
    photons = table.signal_photons
    if pulse_fwhm_s is not None:
        photons = np.asarray(
            sipm_response.captured_photons(photons=photons, pulse_fwhm_s=pulse_fwhm_s, dead_time_s=array.dead_time_s)
        )
    printed = published_snr(array, background_photons=list(table.background_photons), signal_photons=list(photons))
    return np.asarray(printed / table.snr - 1.0)


GRID_BACKGROUND = (10.0, 686.093)
GRID_SIGNAL = (10.0, 100.0, 500.0, 2660.31, 10000.0)
GRID_PULSE_TO_DEAD_TIME = (0.1, 0.5, 1.0, 1.9)


def rows_of_published_error(array: CellArray) -> list[list[str]]:
    """Error of (27) in percent, a row for each pulse width and background, a cell for each signal.

    A cell has the error of (27) as printed, and the error with the photons of the dead time around the peak in (24).
    Only photons PDE / N matters, so one number of cells is enough.
    """
    rows = []
    for ratio in GRID_PULSE_TO_DEAD_TIME:
        fwhm_s = ratio * array.dead_time_s
        table = response_by_equation(
            array, background_photons=GRID_BACKGROUND, signal_photons=GRID_SIGNAL, pulse_fwhm_s=fwhm_s
        )
        errors = (error_of_published_snr(array, table), error_of_published_snr(array, table, pulse_fwhm_s=fwhm_s))
        for background, printed, counted in zip(GRID_BACKGROUND, *errors, strict=True):
            cells = [f"{100 * a:+.0f} / {100 * b:+.0f}" for a, b in zip(printed, counted, strict=True)]
            rows.append([f"{ratio:g}", f"{background:.0f}", *cells])
    return rows
