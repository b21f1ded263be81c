"""`--json` and `--quiet` of every command: JSON alone on standard output, or nothing while all is well."""

import json
import socket
from pathlib import Path
from typing import Any

import pytest
from helpers.command_line import Run

from lidarscene import catalog
from lidarscene.cli import main

OUSTER = catalog.files("examples")["os0-32"].with_suffix(".json")

CALLS = {
    "render": ["wall.toml -o a.ply"],
    "stream": ["wall.toml --sensor vlp-16 --udp 127.0.0.1:{port} --frames 1 --rate 1000"],
    "range": [
        "table1-apd",
        "table1-apd --over distance --n 2 --csv a.csv",
        "table1-apd --sensitivities",
        "table1-apd --eye-safety",
    ],
    "catalog": ["designs", "scenes car", "meshes car", "materials", "check table1-apd", "scenes car --copy copy"],
    "check": ["wall.toml job"],
    "doctor": [""],
    "street": ["-o street --length-m 200"],
    "sensor": [f"--from {OUSTER} -o unit.toml"],
}
"""Command -> calls of it that are quick."""

ELSEWHERE = {"batch", "certify", "compare", "design", "fit", "fov", "paper", "twin"}
"""Commands whose JSON is read by tests of what they compute."""


def test_every_command_with_figures_takes_both_options() -> None:
    """A new command has them, since `main` adds them; one that prints a file, a page or a script alone is named."""
    (chosen,) = [action for action in main._parser()._actions if action.dest == "==SUPPRESS=="]
    commands: dict[str, Any] = dict(chosen.choices or {})
    with_figures = {name for name, command in commands.items() if {"--json", "-q"} <= {*command._option_string_actions}}
    assert commands.keys() - with_figures == {*main.WITHOUT_FIGURES}
    assert with_figures == CALLS.keys() | ELSEWHERE


@pytest.mark.parametrize("line", [f"{name} {call}" for name, calls in CALLS.items() for call in calls])
def test_json_alone_or_nothing(line: str, mi: Any, run: Run, wall: str, no_charts: None) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind(("127.0.0.1", 0))
        words = line.format(port=port.getsockname()[1]).split()
        printed = run(*words, "--json")
        quiet = run(*words, "--quiet")
    assert printed.code == 0
    numbers = json.loads(printed.out, parse_constant=pytest.fail)
    assert isinstance(numbers, dict | list)
    assert numbers
    assert (quiet.code, quiet.out) == (0, "")
    assert quiet.err == ""


def test_a_page_is_saved_quietly(mi: Any, run: Run, wall: str) -> None:
    ran = run("view", wall, "--save", "a.html", "-q")
    assert (ran.code, ran.out, ran.err) == (0, "", "")
    assert Path("a.html").stat().st_size > 0


def test_what_is_amiss_is_printed_even_if_quiet(run: Run) -> None:
    ran = run("check", "no.toml", "--quiet")
    assert (ran.code, ran.out) == (2, "no.toml: no such file\n")
    assert json.loads(run("check", "no.toml", "--json").out) == {"mistakes": {"no.toml": ["no.toml: no such file"]}}
