"""The commands of tools/walks.py, which the wheel's check runs: the parser takes all that are to end well."""

import importlib.util

from helpers.documentation import ROOT

from lidarscene.cli import main


def test_walks_have_commands_that_exist() -> None:
    spec = importlib.util.spec_from_file_location("walks", ROOT / "tools" / "walks.py")
    assert spec is not None
    assert spec.loader is not None
    walks = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(walks)
    assert len(walks.WALKS) == 6
    for user in walks.WALKS:
        steps = list(walks.steps(user))
        assert len(steps) >= 4
        for step in steps:
            if not step.error:
                main._parser().parse_args(step.words)
