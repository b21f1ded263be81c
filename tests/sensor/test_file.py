"""Sensor files: what follows from other keys."""

from pathlib import Path

import pytest

from lidarscene import catalog
from lidarscene.errors import InputError
from lidarscene.sensor.catalogue import load_sensor


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
    with pytest.raises(InputError, match=r"laser.repetition_rate_khz: must be "):
        load_sensor("vlp-16", overrides=["scanner.cycle_us=110.592", "laser.repetition_rate_khz=300"])


def test_a_rate_that_is_left_out_follows_from_the_table(tmp_path: Path) -> None:
    for name, told in (
        ("vlp-16", None),
        ("table1-apd", 'laser.repetition_rate_khz: must be given with scanner.type = "raster", got none'),
    ):
        lines = catalog.path_of("sensors", name).read_text().splitlines(keepends=True)
        path = tmp_path / f"{name}.toml"
        path.write_text("".join(line for line in lines if not line.startswith("repetition_rate_khz")))
        if told is None:
            rate_hz = float(load_sensor(str(path)).laser.repetition_rate_hz)
            assert rate_hz == pytest.approx(16 / 55.296e-6, rel=1e-9)
        else:
            with pytest.raises(InputError) as caught:
                load_sensor(str(path))
            assert told in str(caught.value)


def test_units_differ_in_shift_and_scale_of_the_elevation() -> None:
    usual, other = (
        load_sensor("vlp-16", overrides=more).scanner.angles(0)
        for more in ((), ("scanner.elevation_shift_deg=0.5", "scanner.elevation_scale=0.99"))
    )
    degrees = 57.29577951308232
    assert float(usual[1]) * degrees == pytest.approx(-15.0, abs=1e-5)
    assert float(other[1]) * degrees == pytest.approx(-15.0 * 0.99 + 0.5, abs=1e-5)
    with pytest.raises(InputError, match=r"elevations must be -90 to 90 degrees, got 92"):
        load_sensor("vlp-16", overrides=["scanner.elevation_deg=[88]", "scanner.elevation_shift_deg=4",
                                         "scanner.firing_time_us=[0]", "scanner.height_mm=[0]"])  # fmt: skip
