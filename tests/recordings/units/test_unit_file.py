"""The unit's sensor file is the model's with other beams, however the model's file is written."""

import tomllib
from pathlib import Path

import pytest

from lidarscene import catalog
from lidarscene.recordings.units.unit_beams import Unit
from lidarscene.recordings.units.unit_file import unit_text

UNIT = Unit(
    model="vlp-16", name="mine", lists={"elevation_deg": tuple(1.5 * n for n in range(16))}, scanner={"rotation_hz": 20}
)


@pytest.mark.parametrize(
    ("as_shipped", "as_valid"),
    [
        ("[laser]", "[laser] # VCSEL"),
        ("[scanner]", "[ scanner ]"),
        ('type = "spinning"', 'type="spinning"'),
        ("repetition_rate_khz = ", "repetition_rate_khz="),
        ("cycle_us = ", "cycle_us="),
        ("[published]", "[ published ]"),
        ('"scanner.cycle_us" = ', "'scanner.cycle_us' = "),
    ],
)
def test_a_model_may_be_written_in_any_toml(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, as_shipped: str, as_valid: str
) -> None:
    shipped = catalog.path_of("sensors", "vlp-16").read_text(encoding="utf-8")
    expected = tomllib.loads(unit_text(UNIT, Path("mine.csv"))[0])
    model = tmp_path / "model.toml"
    model.write_text(shipped.replace(as_shipped, as_valid, 1), encoding="utf-8")
    assert model.read_text(encoding="utf-8") != shipped
    monkeypatch.setattr(catalog, "path_of", lambda kind, name: model)
    assert tomllib.loads(unit_text(UNIT, Path("mine.csv"))[0]) == expected


def test_the_beams_are_the_units_and_the_rest_the_models() -> None:
    text, _, notes = unit_text(UNIT, Path("mine.csv"))
    unit, model = tomllib.loads(text), tomllib.loads(catalog.path_of("sensors", "vlp-16").read_text(encoding="utf-8"))
    assert (unit["scanner"]["elevation_deg"], unit["scanner"]["rotation_hz"]) == ([1.5 * n for n in range(16)], 20)
    assert unit["scanner"].keys() == {"type", "rotation_hz", "cycle_us", "elevation_deg", "firing_time_us"}
    assert unit["sources"]["scanner.cycle_us"] == "of the catalogue's vlp-16"
    assert "published" not in unit
    assert "repetition_rate_khz" not in unit["laser"]
    assert (unit["detector"], unit["tdc"], notes) == (model["detector"], model["tdc"], [])
