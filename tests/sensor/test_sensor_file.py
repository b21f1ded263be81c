"""Sensor files: what follows from other keys."""

from pathlib import Path

import pytest

from lidarscene import InputError, catalog
from lidarscene.sensor.sensor_file import load_sensor


@pytest.mark.parametrize(
    ("name", "override", "rate_khz"),
    [
        ("os1-128", "scanner.columns_per_turn=1024", 128 * 1024 * 0.01),
        ("vlp-16", "scanner.cycle_us=110.592", 16 / 0.110592),
        ("pandar64", "scanner.rotation_hz=-5", None),
    ],
)
def test_a_changed_firing_table_gives_the_rate(name: str, override: str, rate_khz: float | None) -> None:
    usual, changed = load_sensor(name), load_sensor(name, overrides=[override])
    expected = 0.5 * float(usual.laser.repetition_rate_hz) if rate_khz is None else 1e3 * rate_khz
    assert float(changed.laser.repetition_rate_hz) == pytest.approx(expected, rel=1e-3)


def test_a_rate_that_is_left_out_follows_from_the_table(tmp_path: Path) -> None:
    lines = catalog.path_of("sensors", "vlp-16").read_text().splitlines(keepends=True)
    path = tmp_path / "vlp-16.toml"
    path.write_text("".join(line for line in lines if not line.startswith("repetition_rate_khz")))
    assert float(load_sensor(str(path)).laser.repetition_rate_hz) == pytest.approx(16 / 55.296e-6, rel=1e-9)


def test_units_differ_in_shift_and_scale_of_the_elevation() -> None:
    usual, shifted = (
        load_sensor("vlp-16", overrides=more).scanner.angles(0)
        for more in ((), ("scanner.elevation_shift_deg=0.5", "scanner.elevation_scale=0.99"))
    )
    degrees = 57.29577951308232
    assert float(usual[1]) * degrees == pytest.approx(-15.0, abs=1e-5)
    assert float(shifted[1]) * degrees == pytest.approx(-15.0 * 0.99 + 0.5, abs=1e-5)


@pytest.mark.parametrize(
    ("name", "overrides", "both_edges"),
    [
        ("table1-sipm", [], True),
        ("table1-apd", [], False),
        ("table1-apd", ["detector.saturation_ua=5"], True),
        ("table1-apd", ["detector.saturation_ua=5", "tdc.edges='rising'"], False),
        ("table1-apd", ["tdc.edges='both'"], True),
    ],
)
def test_both_edges_are_timed_where_heights_are_lost(name: str, overrides: list[str], both_edges: bool) -> None:
    text = (catalog.path_of("sensors", name)).read_text()
    assert "edges" not in text
    assert load_sensor(name, overrides=overrides).tdc.both_edges == both_edges


def test_a_beam_spreads_as_far_as_its_light_must() -> None:
    """M2 of 1: theta = 4 lambda / (pi D), 0.2305 mrad of 5 mm at 905 nm, on either axis."""
    exit_mm, least = "laser.exit_diameter_mm=5", 4.0 * 905e-6 / (3.141592653589793 * 5.0) * 1e3
    assert load_sensor("table1-apd", overrides=[exit_mm, f"laser.divergence_mrad={1.001 * least!r}"])
    for key in ("divergence_mrad", "divergence_elevation_mrad"):
        with pytest.raises(InputError, match=f"laser: {key}: must be >= 0.23 for a beam of 5 mm"):
            load_sensor("table1-apd", overrides=[exit_mm, "laser.divergence_mrad=3", f"laser.{key}=0.1"])


def test_the_window_may_end_with_the_pulse_period() -> None:
    """10 us at 100 kHz; a longer one is a mistake."""
    assert load_sensor("table1-apd", overrides=["laser.repetition_rate_khz=100", "tdc.window_us=10"])


def test_light_of_which_nobody_says_how_it_swings_is_unpolarised() -> None:
    """Rationale: fully polarised by default, it made raked panes 3.5 to 7.5 % too dark."""
    assert load_sensor("apd-905").laser.polarisation.share == 0.0
