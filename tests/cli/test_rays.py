"""`render --rays` of a beam without a width: one line that says so, and only then."""

from pathlib import Path

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
    [("--rays", "3", "--set", "laser.divergence_mrad=2"), ("--rays", "3", "--set", "laser.exit_diameter_mm=9"), ()],
)
def test_nothing_is_told_of_others(run: Run, wall: str, wide: tuple[str, ...]) -> None:
    run.well("render", wall, "-o", "o.ply", *wide, *COARSE)


PANE = """
[[bodies]]
name = "pane"
primitive = "plane"
size_m = [10, 10]
material = "{material}"
position_m = [10, 0, 1]
pitch_deg = {pitch}
"""


@pytest.mark.parametrize("sensor", ["table1-apd", "table1-sipm"])
@pytest.mark.parametrize(("material", "pitch"), [("clear_glass", 90), ("wire_mesh", 90), ("mirror_chrome", 80)])
def test_rays_in_a_scene_without_solid_surfaces(
    run: Run, tmp_path: Path, sensor: str, material: str, pitch: int
) -> None:
    """Rationale: where no ray ends on a surface, what all have in common is one number, not one for each ray."""
    (tmp_path / "pane.toml").write_text(PANE.format(material=material, pitch=pitch))
    wide = ("--sensor", sensor, "--set", "laser.divergence_mrad=3")
    run.well("render", "pane.toml", "-o", "o.ply", "--rays", "4", "--json", *wide, *COARSE)
