"""Material files: what tables must be, and what they become."""

import pytest
from helpers.mistakes import told

from lidarscene.files.toml import validate
from lidarscene.materials.material_file import MaterialFile


def spectrum_rows(*pairs: tuple[float, float]) -> tuple[dict[str, float], ...]:
    return tuple({"wavelength_nm": nm, "value": value} for nm, value in pairs)


def read_material(**table: object) -> MaterialFile:
    return validate(MaterialFile, table, "sheet.toml")


@pytest.mark.parametrize(
    ("reflectivity", "transmittance", "named"),
    [
        (0.6, 0.5, "sheet.toml | reflectivity and transmittance | <= 1 | 1.1"),
        (spectrum_rows((850, 0.1), (950, 0.9)), 0.3, "sheet.toml | <= 1 | 1.2 at 950 nm"),
        (
            spectrum_rows((850, 0.1), (950, 0.9)),
            spectrum_rows((800, 0.1), (900, 0.6), (1000, 0.0)),
            "sheet.toml | <= 1 | 1.1 at 900 nm",
        ),
    ],
)
def test_no_more_light_leaves_than_came(reflectivity: object, transmittance: object, named: str) -> None:
    with told(named):
        read_material(reflectivity=reflectivity, transmittance=transmittance)
    assert read_material(reflectivity=0.6, transmittance=0.4)


@pytest.mark.parametrize("pairs", [((900, 0.1), (900, 0.2)), ((900, 0.1), (850, 0.2))])
def test_wavelengths_rise(pairs: tuple[tuple[float, float], ...]) -> None:
    with told("reflectivity | rising wavelength_nm"):
        read_material(reflectivity=spectrum_rows(*pairs))


def test_a_table_covers_its_own_wavelengths() -> None:
    """A table reaches 1 nm farther on either side, and straight lines between."""
    material = read_material(reflectivity=spectrum_rows((850, 0.1), (950, 0.3))).build("sheet")
    assert material.at(875e-9)["reflectivity"] == pytest.approx(0.15)
    assert material.at(849.5e-9)["reflectivity"] == pytest.approx(0.1)
    for nm in (848.0, 952.0):
        with told(f"reflectivity | {nm:.0f} nm | 850 | 950 nm"):
            material.at(1e-9 * nm)


def test_a_panes_thickness_is_in_metres() -> None:
    index = ({"wavelength_nm": 905.0, "n": 1.5},)
    material = read_material(bsdf="glass", reflectivity=0.0, index=index, thickness_mm=4.0).build("pane")
    assert material.parameters["thickness_m"] == pytest.approx(4e-3)
