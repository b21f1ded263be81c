"""Report of a run: its summary and profile as text and for JSON.

The simulator only counts; this module words the counts.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from ..detection.outcomes import OUTCOME_TEXT as OUTCOME_TEXT
from ..detection.outcomes import Outcome
from ..kernel.device.profile import KernelHistory, peak_memory_bytes
from ..rendering.simulator import Summary
from ..rendering.surroundings import Surroundings

# Stages whose time is proportional to the number of beams; the others are start-up and files.
_FRAME_STAGES = ("record", "trace", "collect", "assemble")


def beams_per_second(summary: Summary) -> float:
    """Beams per second of the time from beams to points, without start-up and files."""
    seconds = sum(summary.seconds.get(stage, 0.0) for stage in _FRAME_STAGES)
    return summary.beams / seconds if seconds > 0.0 else 0.0


def as_dict(summary: Summary) -> dict[str, Any]:
    """Entries of a summary for JSON."""
    return {
        "beams": summary.beams,
        "hits": summary.hits,
        "points": summary.points,
        "echoes": summary.points - summary.false_alarms - summary.weather - summary.stray - summary.revived,
        "false_alarms": summary.false_alarms,
        "weather": summary.weather,
        "stray": summary.stray,
        "revived": summary.revived,
        "missed": {text.replace(" ", "_"): int(summary.outcomes[o]) for o, text in OUTCOME_TEXT.items()},
        "seconds": {stage: round(seconds, 6) for stage, seconds in summary.seconds.items()},
        "beams_per_second": round(beams_per_second(summary)),
    }


def profile_as_dict(history: KernelHistory) -> dict[str, Any]:
    """Kernels and memory for JSON; the summary has the time by stage."""
    return {
        "kernels": {key: round(value, 6) for key, value in dataclasses.asdict(history).items()},
        "peak_memory_bytes": peak_memory_bytes(),
    }


def profile_as_text(summary: Summary, history: KernelHistory) -> str:
    """Text of the time by stage, the kernels and the memory."""
    total = sum(summary.seconds.values())
    lines = ["profile"]
    for stage, seconds in summary.seconds.items():
        lines.append(f"  {stage:<12}{seconds:>12.3f} s {seconds / total:>6.1%}")
    peak = peak_memory_bytes()
    counts = (
        f"{history.launched} launched, {history.compiled} compiled, {history.from_disk} from the disk cache; "
        f"{history.helpers} helpers"
    )
    times = (
        f"{history.device_s:.3f} s on the device, {history.codegen_s:.3f} s to write, "
        f"{history.compile_s:.3f} s to compile"
    )
    memory = "unknown" if peak is None else f"{peak / 2**20:,.0f} MiB"
    lines += [f"  kernels     {counts}", f"  their time  {times}", f"  peak memory {memory}"]
    return "\n".join(lines)


def as_text(summary: Summary, written: Sequence[str], surroundings: Surroundings) -> str:
    """Text of a summary; ``written`` names the files."""
    lines = [
        f"scene         {surroundings.line()}",
        f"beams         {summary.beams:>12,}",
        f"hits          {summary.hits:>12,}",
        f"points        {summary.points:>12,}   of which {summary.false_alarms:,} false alarms"
        + (f", {summary.weather:,} of the weather" if summary.weather else "")
        + (f", {summary.stray:,} of stray light" if summary.stray else "")
        + (f", {summary.revived:,} of revived SPADs" if summary.revived else ""),
    ]
    for outcome, text in OUTCOME_TEXT.items():
        # The word stands once, before the first reason.
        head = "missed        " if outcome == Outcome.NO_SURFACE else " " * 14
        lines.append(f"{head}{int(summary.outcomes[outcome]):>12,}   {text}")
    if surroundings.walk is not None:
        lines.append(f"walk          {surroundings.walk}")
    stages = ", ".join(f"{stage} {seconds:.3f}" for stage, seconds in summary.seconds.items())
    lines.append(f"seconds       {sum(summary.seconds.values()):>12.3f}   {stages}")
    lines.append(f"beams/second  {beams_per_second(summary):>12,.0f}   from beams to points")
    lines.append(f"wrote         {', '.join(written)}")
    return "\n".join(lines)
