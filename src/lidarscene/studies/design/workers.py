"""Evaluate designs on the processes of a Dask client, in the order in which they are asked for."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from ...kernel.device.gate import exclusive
from .designs import Values
from .search import EvaluateAll, alone


def on_workers(client: Any, study: Path, *, threads: int) -> EvaluateAll:
    """Evaluate many designs of a study file at once, each in a process that compiles the scene once.

    Args:
        client: of `distributed`; its processes see the study file
        threads: of Dr.Jit in each process
    """

    def evaluate(designs: Sequence[Values]) -> Iterable[dict[str, float] | str]:
        answers = client.map(_evaluate, designs, study=str(study.absolute()), threads=threads, pure=False)
        for answer in answers:
            yield answer.result()

    return evaluate


@exclusive
def _evaluate(values: Values, *, study: str, threads: int) -> dict[str, float] | str:
    """Evaluate one design in this process, one at a time: all designs share the scene."""
    return next(iter(_evaluator(study, threads)([values])))


@functools.cache
def _evaluator(study: str, threads: int) -> EvaluateAll:
    from .design_study import load_study

    settings, evaluator = load_study(Path(study))
    if settings.is_traced:
        from ...kernel.device import blocks

        blocks.use_threads(threads)
    return alone(evaluator)
