"""The command `design`: a study file in; the designs that no other beats, as a page, tables and sensor files."""

from __future__ import annotations

import argparse
from contextlib import ExitStack
from typing import Any

from ..batch import WORKERS
from .options import CommandOptions, add_options
from .terminal import Answer, progress, save_report
from .words import whole_number

DESIGN_HELP = """\
examples:
  lidarscene design gain -o out/gain
  lidarscene design aperture -o out/aperture
  lidarscene design my-study.toml -o out/study --workers 2

The same command resumes an interrupted run. docs/design.md has the study file and its quantities.
"""


def add_design(commands: Any) -> None:
    """Add `design`."""
    command = commands.add_parser(
        "design",
        help="search for the best sensor for a task, by free keys, objectives and constraints",
        epilog=DESIGN_HELP,
        description="Search for the values of free keys that give the best designs under constraints, such as class 1.",
    )
    command.add_argument("study", metavar="STUDY", help="name of a study of the catalogue, or a study file (.toml)")
    add_options(command, CommandOptions, output="it gets index.html, front.csv and designs/*.toml")
    command.add_argument(
        "--workers",
        metavar="N",
        type=whole_number(WORKERS),
        help="number of processes for traced quantities (default: this process only)",
    )
    command.set_defaults(run=run_design)


def run_design(arguments: argparse.Namespace) -> Answer:
    """Run `design`.

    Raises:
        InputError: before anything is searched
        OutputError: before anything is searched
    """
    from ..figures.report import require_writable_report
    from ..studies.api import study_path
    from ..studies.design.design_study import run_study

    path = study_path(arguments.study)
    require_writable_report(arguments.output)
    with ExitStack() as opened:
        evaluate, show = None, opened.enter_context(progress("designs", logged=True))
        if arguments.workers is not None:
            from ..batch import cluster
            from ..kernel.device.blocks import usable_cores
            from ..studies.design.workers import on_workers

            cluster.require_packages(local=True)
            threads = max(usable_cores() // arguments.workers, 1)
            client = opened.enter_context(cluster.local_client(arguments.workers))
            evaluate = on_workers(client, path, threads=threads)
        report = run_study(path, arguments.output, evaluate=evaluate, progress=show)
        return save_report(report, arguments.output)
