"""Checks of the material data files themselves, with no model in between."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from helpers.mistakes import told

from lidarscene import catalog
from lidarscene.materials.material_file import catalogue_material

MATERIALS = Path(__file__).parents[2] / "src" / "lidarscene" / "catalog" / "materials"
WAVELENGTHS = [850, 905, 940, 1064, 1550]

COMMON = {"name", "description", "bsdf", "reflectivity"}
EXTRA = {
    "diffuse": set(),
    "coated": {"coat_ior", "coat_roughness", "coat_source"},
    "conductor": {"roughness", "roughness_source", "index"},
    "mirror": {"index"},
    "glass": {"index", "thickness_mm", "thickness_source"},
    "retroreflector": {
        "retro_coefficient_cd_per_lx_m2",
        "retro_source",
        "retro_half_angle_deg",
        "retro_half_angle_source",
    },
}

# What any material that scatters may have besides.
OPTIONAL = {"transmittance", "cover", "cover_source", "facet_slope_deg", "facet_slope_source"}

# Smallest and largest white minimum at 0.2 deg observation and -4 deg entrance in ASTM D4956-01:
# type I (70, seen in a copy of the tables) and type VII (750, from memory).
D4956_WHITE_RANGE = (70.0, 750.0)


def load(name: str) -> dict:
    """One data file, parsed."""
    return tomllib.loads((MATERIALS / f"{name}.toml").read_text(encoding="utf-8"))


def values(material: dict) -> dict[int, float]:
    """Reflectivity by wavelength in nm."""
    return {row["wavelength_nm"]: row["value"] for row in material["reflectivity"]}


def index(material: dict) -> tuple[np.ndarray, np.ndarray]:
    """Arrays n and k over the five wavelengths."""
    rows = material["index"]
    return np.array([row["n"] for row in rows]), np.array([row["k"] for row in rows])


def sources(node: object) -> list[str]:
    """Every value of a key `source` or `*_source`, at any depth."""
    if isinstance(node, list):
        return [text for item in node for text in sources(item)]
    if not isinstance(node, dict):
        return []
    direct = [text for key, text in node.items() if key.endswith("source")]
    return direct + [text for item in node.values() for text in sources(item)]


every_material = pytest.mark.parametrize("name", sorted(path.stem for path in MATERIALS.glob("*.toml")))


def by_bsdf(*kinds: str) -> list[str]:
    """Names of the materials of these kinds."""
    return sorted(path.stem for path in MATERIALS.glob("*.toml") if load(path.stem)["bsdf"] in kinds)


@every_material
def test_keys_are_exactly_those_of_the_bsdf(name):
    """The model forbids unknown keys; a missing one would fall back to an unsourced default."""
    material = load(name)
    assert material["name"] == name
    assert material["description"].strip()
    assert material["bsdf"] in EXTRA
    assert set(material) - {"note"} - OPTIONAL == COMMON | EXTRA[material["bsdf"]]
    assert ("cover" in material) == ("cover_source" in material)
    assert ("facet_slope_deg" in material) == ("facet_slope_source" in material)
    assert material.get("note", "x").strip()


@every_material
def test_reflectivity_rows(name):
    """Interpolation between lidar wavelengths relies on five ordered, physical values."""
    rows = load(name)["reflectivity"]
    assert [row["wavelength_nm"] for row in rows] == WAVELENGTHS
    assert all(set(row) == {"wavelength_nm", "value", "source"} for row in rows)
    assert all(0.0 <= row["value"] <= 1.0 for row in rows)


@every_material
def test_every_number_has_a_source(name):
    """A number without a source is not allowed in this project."""
    texts = sources(load(name))
    assert len(texts) >= len(WAVELENGTHS)
    assert all(isinstance(text, str) and len(text.strip()) > 10 for text in texts)


@every_material
def test_sources_do_not_hide_guesses(name):
    """A guess must start with 'estimate:', not hide one somewhere in a citation."""
    for text in sources(load(name)):
        assert text == text.strip()
        if "not seen" in text or "from memory" in text or "judgement" in text:
            assert text.startswith("estimate:")


@pytest.mark.parametrize("name", by_bsdf("conductor", "mirror", "glass"))
def test_index_rows(name):
    """The index table must line up with the reflectivity table."""
    rows = load(name)["index"]
    assert [row["wavelength_nm"] for row in rows] == WAVELENGTHS
    assert all(set(row) == {"wavelength_nm", "n", "k", "source"} for row in rows)
    assert all(row["n"] > 0.0 and row["k"] >= 0.0 for row in rows)


@pytest.mark.parametrize("name", by_bsdf("conductor", "mirror"))
def test_conductor_reflectance_follows_from_its_index(name):
    """Two tables of one metal must not contradict each other (Fresnel at normal incidence)."""
    material = load(name)
    n, k = index(material)
    fresnel = ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2)
    np.testing.assert_allclose(list(values(material).values()), fresnel, rtol=0, atol=0.01)
    assert 0.0 < material.get("roughness", 1.0) <= 1.0


@pytest.mark.parametrize("name", by_bsdf("glass"))
def test_glass_reflectance_is_fresnel_of_two_faces(name):
    """The incoherent sum of all reflections between two lossless faces is 2R/(1+R)."""
    material = load(name)
    n, k = index(material)
    face = ((n - 1) / (n + 1)) ** 2
    np.testing.assert_allclose(list(values(material).values()), 2 * face / (1 + face), rtol=0, atol=0.002)
    thickness_nm = material["thickness_mm"] * 1e6
    absorbed = 1 - np.exp(-4 * np.pi * k * thickness_nm / np.array(WAVELENGTHS))
    clear = name != "tinted_glass"
    assert np.all(absorbed < 0.5) == clear, "a clear pane lets most light through, a tinted one does not"


@pytest.mark.parametrize("name", by_bsdf("coated"))
def test_coat_is_a_dielectric(name):
    """Polymer coats have n of 1.4 to 1.7, water 1.33; the diffuse part and the surface cannot exceed 1 together."""
    material = load(name)
    assert 1.33 <= material["coat_ior"] <= 1.7
    assert 0.0 < material["coat_roughness"] <= 1.0
    surface = ((material["coat_ior"] - 1) / (material["coat_ior"] + 1)) ** 2
    assert max(values(material).values()) + surface <= 1.0


@pytest.mark.parametrize("name", ["grass", "tree_foliage"])
def test_vegetation_has_its_plateau_and_water_band(name):
    """Green leaves are bright beyond the red edge and dark where liquid water absorbs."""
    reflectivity = values(load(name))
    assert reflectivity[850] > 0.35
    assert reflectivity[1550] < reflectivity[1064]
    assert 0.2 < reflectivity[1550] < 0.35


def test_a_leaf_lets_through_what_it_does_not_reflect_or_absorb():
    """Leaves hardly absorb on the plateau, and water takes a third or more at 1550 nm (PROSPECT: Jacquemoud, 1990)."""
    material = load("leaf")
    reflected, through = (values(material), {row["wavelength_nm"]: row["value"] for row in material["transmittance"]})
    assert list(through) == WAVELENGTHS
    for wavelength in (850, 905, 940, 1064):
        assert 0.9 < reflected[wavelength] + through[wavelength] < 1.0
    assert 0.4 < reflected[1550] + through[1550] < 0.67


def test_skin_is_dark_where_water_absorbs():
    """Skin is mostly water: a dip at 940 nm and little left at 1550 nm."""
    reflectivity = values(load("skin"))
    assert reflectivity[940] < reflectivity[905]
    assert reflectivity[1550] < 0.2 * reflectivity[905]


@pytest.mark.parametrize("name", ["cotton_cloth", "wood"])
def test_cellulose_band(name):
    """Cellulose absorbs near 1490 nm, so these are darker at 1550 than at 1064 nm, but not black."""
    reflectivity = values(load(name))
    assert 0.5 * reflectivity[1064] < reflectivity[1550] < 0.9 * reflectivity[1064]


def test_car_paints_are_ordered():
    """White over red and grey over black: the order that lidar range tests rely on."""
    white, red, grey, black = (values(load(f"car_paint_{colour}"))[905] for colour in ("white", "red", "grey", "black"))
    assert white > red > black
    assert white > grey > black
    assert black < 0.05


def test_lane_marking_stands_out_from_asphalt():
    """A marking no brighter than its road could not be found by intensity."""
    marking, road = values(load("lane_marking")), values(load("asphalt"))
    assert all(marking[wavelength] > 2 * road[wavelength] for wavelength in WAVELENGTHS)
    assert load("lane_marking")["facet_slope_deg"] >= load("asphalt")["facet_slope_deg"], "nor at flat angles"


def test_the_ground_is_rough_and_targets_are_not():
    """Roads, concrete, soil, bark, brick have slopes; a target board is Lambertian by definition, as the paper's."""
    for name in ("asphalt", "lane_marking", "concrete", "soil", "bark", "brick"):
        assert 10 < load(name)["facet_slope_deg"] < 60, name
    for name in ("target_10", "target_80"):
        assert "facet_slope_deg" not in load(name)


@pytest.mark.parametrize(("name", "value"), [("target_10", 0.1), ("target_80", 0.8)])
def test_targets_are_exact(name, value):
    """Calibrated boards are defined, not measured."""
    material = load(name)
    assert material["bsdf"] == "diffuse"
    assert set(values(material).values()) == {value}


@pytest.mark.parametrize("name", by_bsdf("retroreflector"))
def test_retroreflector_is_a_real_sheeting(name):
    """R_A must be that of a D4956 sheeting, and the lobe may not return more light than came in."""
    material = load(name)
    low, high = D4956_WHITE_RANGE
    coefficient, half_angle = material["retro_coefficient_cd_per_lx_m2"], material["retro_half_angle_deg"]
    assert low <= coefficient <= high
    assert 0.2 <= half_angle <= 1.0
    # Gaussian lobe of that half angle through R_A at 0.2 deg, integrated over its solid angle.
    peak = coefficient * 2.0 ** ((0.2 / half_angle) ** 2)
    returned = peak * np.pi * np.radians(half_angle) ** 2 / np.log(2.0)
    assert 0.01 < returned < 1.0 - max(values(material).values())


@pytest.mark.parametrize("name", catalog.names("materials"))
def test_material_loads(name: str) -> None:
    material = catalogue_material(name)
    assert material.name == name
    assert 0 <= material.at(905e-9)["reflectivity"] <= 1


@pytest.mark.parametrize("name", ["../sensors/table1-apd", "/etc/passwd\0", "concret", ""])
def test_unknown_material(name: str) -> None:
    with told(f"material | {name}" if name else "material ''"):
        catalogue_material(name)
