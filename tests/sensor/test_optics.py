"""The receiver's filter in a sensor file: shapes, tables, mistakes."""

import math
from pathlib import Path

import numpy as np
import pytest

from lidarscene import catalog, load_sensor
from lidarscene.sensor.optics import FilterFile, read_transmittance
from lidarscene.sensor.sensor_file import read_sensor
from lidarscene.sensor.sensor_model import Sensor
from lidarscene.studies.ranging import plane

SENSOR = catalog.path_of("sensors", "table1-apd").read_text(encoding="utf-8")
SENSOR = SENSOR.replace('"optics.sun_irradiance_w_m2" = 0.05\n', "")  # of [uncertainty]: only a number has it
GIVEN = "sun_irradiance_w_m2 = 29.4"


def irradiance(folder: Path, entry: str, **files: str) -> float:
    """The sensor's solar irradiance with this instead of the given one."""
    for name, text in files.items():
        (folder / f"{name}.csv").write_text(text, encoding="utf-8")
    path = folder / "sensor.toml"
    path.write_text(SENSOR.replace(GIVEN, entry), encoding="utf-8")
    return float(read_sensor(path).optics.sun_irradiance_w_m2)


@pytest.mark.parametrize(
    ("entry", "w_m2"),
    [
        ("filter = { centre_nm = 905, width_nm = 42.837 }", 29.4),
        ('filter = { centre_nm = 905, width_nm = 20, shape = "gaussian" }', 13.896),
        ('filter = { csv = "box.csv" }', 29.4),
    ],
)
def test_filters(entry: str, w_m2: float, tmp_path: Path) -> None:
    """Table 1's irradiance by the box it implies; the others pinned (docs/sun.md)."""
    pytest.importorskip("pvlib")
    box = "\ufeffwavelength_nm, transmittance\n# of the maker\n\n883.5815,1\n926.4185,1\n"
    assert irradiance(tmp_path, entry, box=box) == pytest.approx(w_m2, rel=1e-4)


def test_table_is_straight_lines_and_zero_outside(tmp_path: Path) -> None:
    path = tmp_path / "filter.csv"
    path.write_text("900,0.5\n910,1\n", encoding="utf-8")
    transmittance = read_transmittance(path).at(np.array([899, 900, 905, 910, 911]) * 1e-9)
    np.testing.assert_allclose(transmittance, [0, 0.5, 0.75, 1, 0], atol=1e-9)


def test_shape_without_files() -> None:
    curve = FilterFile(centre_nm=905.0, width_nm=10.0).transmittance(Path())
    np.testing.assert_allclose(curve.wavelength_m, [900e-9, 910e-9])


def test_a_focus_is_where_the_spot_is_sharp() -> None:
    """There the detector's share of a coaxial spot is 1 - exp(-2 (field / spot)^2); at infinity the focus blurs it. The
    offset stays known.
    """
    keys = ["laser.divergence_mrad=8", "laser.exit_diameter_mm=5", "optics.overlap.transmitter_offset_mm=[0, 0]"]
    near, far = (load_sensor("table1-apd", overrides=[*keys, *more]) for more in (["optics.overlap.focus_at_m=5"], []))
    spot_rad = math.hypot(2.5e-3 / 5.0, 4e-3)
    field_rad = float(near.detector.radius_m / near.optics.focal_length_m)
    shares = [float(sensor.optics.overlap.share(np.array([5.0]))[0]) for sensor in (near, far)]
    assert shares[0] == pytest.approx(1.0 - math.exp(-2.0 * (field_rad / spot_rad) ** 2), rel=2e-3)
    assert shares[1] < 0.8 * shares[0]
    aside = load_sensor("table1-apd", overrides=[*keys[:2], "optics.overlap.transmitter_offset_mm=[30, 40]"])
    assert aside.optics.overlap.offset_m == pytest.approx(0.05)


def shifted(folder: Path, entry: str, laser: str = "") -> Sensor:
    """Table 1 with this filter, and these keys of its laser."""
    path = folder / "sensor.toml"
    path.write_text(SENSOR.replace(GIVEN, entry).replace("[laser]", f"[laser]\n{laser}"), encoding="utf-8")
    return read_sensor(path)


def test_a_laser_that_leaves_its_filter(tmp_path: Path) -> None:
    """17 nm beside the middle of a Gaussian: the echo by hand, and the range where noise limits it, R ~ sqrt(echo).

    Tolerance: 1e-4, the filter's table of straight lines.
    """
    pytest.importorskip("pvlib")
    entry = 'filter = { centre_nm = 905, width_nm = 40, shape = "gaussian" }'
    cold = shifted(tmp_path, entry)
    warm = shifted(tmp_path, entry, "drift_nm = 16.8")
    share = 2.0 ** -((2 * 16.8 / 40) ** 2)
    echoes = {name: plane.echoes_of_plane(lidar, plane.Target(), 50.0) for name, lidar in (("c", cold), ("w", warm))}
    assert echoes["w"].peak_power_w == pytest.approx(share * echoes["c"].peak_power_w, rel=1e-4)
    assert echoes["w"].background_power_w == echoes["c"].background_power_w
    assert echoes["w"].white_w_m2 == echoes["c"].white_w_m2
    ranges = [plane.maximum_range_m(lidar, plane.Target(illuminance_klux=0.0))[0] for lidar in (cold, warm)]
    assert ranges[1] / ranges[0] == pytest.approx(math.sqrt(share), rel=1e-4)
    # Without a drift nothing is shifted, to the last bit.
    assert cold.optics.filter_share is None


def test_a_laser_within_its_box(tmp_path: Path) -> None:
    """A drift of 16 nm: beyond half of a box 30 nm wide, within one of 40."""
    pytest.importorskip("pvlib")
    entry = "filter = {{ centre_nm = 905, width_nm = {} }}"
    assert shifted(tmp_path, entry.format(40), "drift_nm = 16").optics.filter_share == 1.0
