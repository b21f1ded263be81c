"""The commands of tools/walks.py, which the wheel's check runs: the parser takes all that are to end well."""

from helpers.documentation import ROOT
from helpers.sources import module_of

from lidarscene.cli import main


def test_walks_have_commands_that_exist() -> None:
    walks = module_of(ROOT / "tools" / "walks.py")
    assert len(walks.WALKS) == 6
    for user in walks.WALKS:
        steps = list(walks.steps(user))
        assert len(steps) >= 4
        for step in steps:
            if not step.error:
                main._parser().parse_args(step.words)
