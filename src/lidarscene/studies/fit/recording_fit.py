"""Fit of a recording: its laws, the sensor file of the unit, the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ...errors import InputError
from ...files.atomic import put_text
from ...files.json_text import json_text
from ...recordings.opening import open_recording
from ...recordings.pcap_reader import metadata_of
from ...recordings.sweep import Sweep
from ...sensor.sensor_model import Sensor
from ..held import passed
from .near_field import fit_near_field
from .products import QUANTITIES, find_products
from .recorded_pulses import RecordedPulses, gather_pulses
from .recording_fit_report import PAGE, RecordingFit, as_dict, check_outputs, write_report
from .row_gains import fit_rows
from .scatter import fit_scatter
from .sensor_text import base_text, fitted_text, parse_sensor
from .threshold import fit_threshold


def fit_recordings(
    recordings: Sequence[Path],
    sensor: str,
    output: Path,
    report: Path,
    *,
    metadata: Path | None = None,
    as_json: bool = False,
) -> tuple[str, bool]:
    """Fit, and write sensor file, page and JSON; returns the text to print and whether no check failed.

    sensor    catalogue sensor of its kind, or a sensor file: the source of all numbers that the recording leaves open
    metadata  the maker's description of the unit; None: the json beside the recording, if there is one
    Raises InputError and OutputError.
    """
    check_outputs(output, report)
    base = base_text(sensor, metadata_of(recordings[0], metadata))
    where = f"--sensor {sensor}"
    base_sensor = parse_sensor(base, where)
    pulses = _read_pulses(recordings, metadata)
    fit = fit_pulses(pulses, recording=", ".join(path.name for path in recordings), sensor=sensor, optics=base_sensor)
    if base_sensor.histogram is not None:
        if fit.threshold is not None:
            fit = replace(fit, spread=fit.threshold.spread(base_sensor))
        known_keys = [estimate.key for estimate in fit.estimates if estimate.is_known and estimate.key in QUANTITIES]
        fit = replace(fit, products=find_products(base_sensor, known_keys) if known_keys else None)
    estimates = {estimate.key: estimate for estimate in fit.estimates}
    text, notes = fitted_text(base, estimates, fit.recording, where, rows=fit.rows)
    fit = replace(fit, notes=notes)
    parse_sensor(text, str(output))
    put_text(output, text)
    text = write_report(fit, report)
    return json_text(as_dict(fit)) if as_json else f"{text}\nwrote {output} and {report / PAGE}", passed(fit.checks)


def fit_pulses(pulses: RecordedPulses, *, recording: str, sensor: str, optics: Sensor | None = None) -> RecordingFit:
    """Fit all laws to these pulses. Raises InputError if none can be fitted.

    optics  sensor whose own near field is stretched, unless it has one lens; None: law of one lens
    """
    fit = RecordingFit(
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


def _read_pulses(recordings: Sequence[Path], metadata: Path | None) -> RecordedPulses:
    def sweeps() -> list[Sweep]:
        gathered: list[Sweep] = []
        for path in recordings:
            with open_recording(path, metadata) as recording:
                gathered += list(recording)
        return gathered

    try:
        return gather_pulses(sweeps())
    except ValueError as error:
        raise InputError(f"{recordings[0]}: {error}") from None
