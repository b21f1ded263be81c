"""Material files: what tables must be, and what they become."""

import pytest
from helpers.mistakes import calls, told

from lidarscene import Material
from lidarscene.files.toml import validate
from lidarscene.materials.material import Spectrum
from lidarscene.materials.material_file import MaterialFile, material_table


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


def grey(bsdf: str = "diffuse", name: object = "grey", **parameters: object) -> Material:
    return Material(name=name, bsdf=bsdf, reflectivity=0.2, parameters=parameters)


def sheeting(half_angle_deg: float) -> Material:
    return grey("retroreflector", retro_coefficient_cd_per_lx_m2=250.0, retro_half_angle_deg=half_angle_deg)


SLOPE = Spectrum(wavelength_m=(850e-9, 950e-9), value=(1.4, 1.6))
POINT = Spectrum(wavelength_m=(9e-7,), value=(0.0,))
test_objects_are_held_to_what_files_are = calls(
    (lambda: grey("foo"), "Material | bsdf | foo | diffuse"),
    (lambda: grey("glass"), "glass | needs | index_n and index_k"),
    (lambda: grey("glass", index_n=1.5), "index_n | index_k | both"),
    (lambda: grey("glass", index_n=1.5, index_k=-1.0), "index[0].k | -1.0 | >= 0"),
    (lambda: grey("glass", index_n=SLOPE, index_k=POINT), "index_n and index_k | same wavelengths"),
    (lambda: grey("coated"), "coated | coat_ior | coat_roughness"),
    (lambda: grey("retroreflector"), "retroreflector | retro_coefficient_cd_per_lx_m2 | retro_half_angle_deg"),
    (lambda: sheeting(half_angle_deg=0.005), "retro_half_angle_deg | >= 0.05 | 0.005"),
    (lambda: grey("mirror", cover=0.5), "mirror | no cover"),
    (lambda: grey(name=5), "name | text | int"),
    (lambda: grey(x=1), "parameters | 'x' | cover"),
    (lambda: grey(transmitance=0.3), "parameters | 'transmitance' | did you mean transmittance"),
    (lambda: grey(transmittance=3.0), "transmittance | 3.0 | <= 1"),
    (lambda: grey(transmittance=0.9), "reflectivity and transmittance | 1.1 | <= 1"),
    (lambda: grey(cover=Spectrum.constant(0.5)), "cover | a number"),
    (lambda: Material(reflectivity=Spectrum.constant(2.0)), "reflectivity | 2.0 | <= 1"),
    (lambda: Spectrum(wavelength_m=(850e-9, 950e-9), value=(0.1,)), "Spectrum | 1 for 2"),
)


@pytest.mark.parametrize("index", [1.5, SLOPE])
def test_a_file_takes_any_index(index: float | Spectrum) -> None:
    """A constant one, which files have as rows, and one of which only n depends on the wavelength."""
    pane = grey("glass", index_n=index, index_k=1e-7, thickness_m=0.004)
    again = validate(MaterialFile, material_table(pane), "a").build("grey").at(900e-9)
    assert [again[key] for key in ("index_n", "index_k", "thickness_m")] == pytest.approx([1.5, 1e-7, 0.004], rel=1e-12)
