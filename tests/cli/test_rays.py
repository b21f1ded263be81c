"""`render --rays` of a beam without a width: one line that says so, and only then."""

import pytest
from helpers.command_line import COARSE, Run

pytestmark = pytest.mark.usefixtures("mi")


def test_rays_without_a_divergence_are_told_of(run: Run, wall: str) -> None:
    ran = run("render", wall, "-o", "o.ply", "--rays", "3", *COARSE)
    assert ran.code == 0
    assert ran.err == (
        "lidarscene: note: --rays 3 changes nothing: laser.divergence_mrad of 'table1-apd' is 0; "
        "a width is given by --set laser.divergence_mrad=3\n"
    )


@pytest.mark.parametrize(
    "wide",
    [
        ("--rays", "3", "--set", "laser.divergence_mrad=2"),
        ("--rays", "3", "--set", "laser.exit_diameter_mm=9"),
        (),
    ],
)
def test_nothing_is_told_of_others(run: Run, wall: str, wide: tuple[str, ...]) -> None:
    ran = run("render", wall, "-o", "o.ply", *wide, *COARSE)
    assert (ran.code, ran.err) == (0, "")
