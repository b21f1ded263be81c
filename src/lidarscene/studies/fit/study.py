"""Fit a recording: its laws, the sensor file of the unit, the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ...errors import InputError
from ...files.atomic import put_text
from ...recordings.opening import open_recording
from ...recordings.pcap_reader import metadata_of
from ...recordings.sweep import Sweep
from ...sensor.model import Sensor
from .near_field import fit_near_field
from .products import QUANTITIES, products_of
from .pulses import Pulses, pulses_of
from .report import Fit, as_dict, as_text, check_places, told, write_report
from .rows import fit_rows
from .scatter import fit_scatter
from .threshold import fit_threshold
from .unit import base_text, fitted_text, sensor_of


def fit_recordings(
    recordings: Sequence[Path],
    sensor: str,
    output: Path,
    report: Path,
    *,
    metadata: Path | None = None,
    as_json: bool = False,
) -> tuple[str, bool]:
    """Fit, and write sensor file, page and JSON; returns what is printed and whether all checks held.

    sensor    the catalogue's sensor of its kind, or a sensor file: what the recording does not tell comes from it
    metadata  what the maker says of the unit; None: the json beside the recording, if there is one
    Raises InputError and OutputError.
    """
    check_places(output, report)
    base = base_text(sensor, metadata_of(recordings[0], metadata))
    where = f"--sensor {sensor}"
    before = sensor_of(base, where)
    pulses = _pulses(recordings, metadata)
    fit = fit_pulses(pulses, recording=", ".join(path.name for path in recordings), sensor=sensor, optics=before)
    if before.histogram is not None:
        if fit.threshold is not None:
            fit = replace(fit, spread=fit.threshold.spread(before))
        known_keys = [estimate.key for estimate in fit.estimates if estimate.is_known and estimate.key in QUANTITIES]
        fit = replace(fit, products=products_of(before, known_keys) if known_keys else None)
    estimates = {estimate.key: estimate for estimate in fit.estimates}
    text, notes = fitted_text(base, estimates, fit.recording, where, rows=fit.rows)
    fit = replace(fit, notes=notes)
    sensor_of(text, str(output))
    put_text(output, text)
    write_report(fit, report)
    return told(as_dict(fit), as_text(fit), output, report, as_json=as_json), fit.passed


def fit_pulses(pulses: Pulses, *, recording: str, sensor: str, optics: Sensor | None = None) -> Fit:
    """The laws of these pulses. Raises InputError if they tell of none.

    optics  the sensor whose near field it is, if its file has more than one lens; None: one lens
    """
    fit = Fit(
        recording=recording,
        sensor=sensor,
        pulses=int(pulses.recorded.sum()),
        frames=pulses.frames,
        near_field=fit_near_field(pulses, optics),
        threshold=fit_threshold(pulses),
        scatter=fit_scatter(pulses),
        rows=fit_rows(pulses),
    )
    if not fit.estimates and fit.rows is None:
        raise InputError(
            f"{recording}: must have SIGNAL, NEAR_IR or REFLECTIVITY of enough pulses, as Ousters record; got none. "
            "Without them only threshold over power could be had, and not apart from the reflectivities"
        )
    return fit


def _pulses(recordings: Sequence[Path], metadata: Path | None) -> Pulses:
    def sweeps() -> list[Sweep]:
        gathered: list[Sweep] = []
        for path in recordings:
            with open_recording(path, metadata) as recording:
                gathered += list(recording)
        return gathered

    try:
        return pulses_of(sweeps())
    except ValueError as error:
        raise InputError(f"{recordings[0]}: {error}") from None
