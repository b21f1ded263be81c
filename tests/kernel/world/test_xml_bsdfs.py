"""BSDFs of Mitsuba files: seen from behind, and of types that Mitsuba does not have."""

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from helpers import chain
from helpers.mistakes import told

import lidarscene
from lidarscene.catalog import names
from lidarscene.errors import OptionWarning
from lidarscene.kernel.world.mitsuba_xml import FileShape, load_shapes
from lidarscene.kernel.world.xml_bsdfs import STAND_INS
from lidarscene.materials.material_file import catalogue_material

FACING = '<transform name="to_world"><rotate y="1" angle="{angle}"/><translate x="10"/></transform>'
FRONT, BACK = FACING.format(angle=-90), FACING.format(angle=90)
RADIO = '<bsdf type="itu-radio-material" id="{id}"><string name="type" value="{kind}"/></bsdf>'
COARSE = chain.raster(8, 8, 1)


def wall(folder: Path, bsdf: str, *, more: str = "", place: str = FRONT) -> Path:
    """A file of one rectangle with this BSDF, 10 m ahead."""
    (folder / "wall.xml").write_text(
        f'<scene version="3.0.0">{more}<shape type="rectangle" id="wall">{place}{bsdf}</shape></scene>'
    )
    return folder / "wall.xml"


def only_shape(folder: Path, bsdf: str, *, more: str = "") -> FileShape:
    (shape,) = load_shapes(wall(folder, bsdf, more=more), {}, {}, 905e-9)
    return shape


def scattered_per_sr(mi: ModuleType, bsdf: object, side: float) -> float:
    """f_r cos of a beam at 37 degrees, 20 degrees off the way back, from the front (1) or from behind (-1)."""
    surface = mi.SurfaceInteraction3f()
    surface.wi = mi.Vector3f(0.6, 0.0, side * 0.8)
    value = bsdf.eval(mi.BSDFContext(), surface, mi.Vector3f(0.3, 0.0, side * 0.954), True)
    return float(value[0][0])


@pytest.mark.parametrize(
    "bsdf",
    [
        *(f'<bsdf type="{kind}"/>' for kind in ("diffuse", "plastic", "roughplastic", "pplastic", "principled")),
        '<bsdf type="roughconductor"><float name="alpha" value="0.6"/></bsdf>',
        "",
        '<bsdf type="mask"><float name="opacity" value="0.5"/><bsdf type="diffuse"/></bsdf>',
        '<bsdf type="blendbsdf"><float name="weight" value="0.5"/><bsdf type="diffuse"/><bsdf type="plastic"/></bsdf>',
        '<bsdf type="twosided"><bsdf type="diffuse"/></bsdf>',
        '<ref id="plain"/>',
        '<bsdf type="twosided"><ref id="plain"/></bsdf>',
    ],
)
def test_opaque_bsdfs_are_as_bright_from_behind(mi: ModuleType, tmp_path: Path, bsdf: str) -> None:
    shape = only_shape(tmp_path, bsdf, more='<bsdf type="diffuse" id="plain"/>')
    from_front, from_behind = (scattered_per_sr(mi, shape.bsdf, side) for side in (1.0, -1.0))
    assert from_front > 0.01
    assert from_behind == from_front


def test_mirrors_reflect_on_both_sides(mi: ModuleType, tmp_path: Path) -> None:
    """`conductor` has no lobe to evaluate; its flags tell."""
    flags = only_shape(tmp_path, '<bsdf type="conductor"/>').bsdf.flags()
    assert mi.has_flag(flags, mi.BSDFFlags.BackSide)


@pytest.mark.parametrize(
    ("bsdf", "kind"),
    [
        ('<bsdf type="dielectric"/>', "SmoothDielectric"),
        ('<bsdf type="thindielectric"/>', "ThinDielectric"),
        ('<bsdf type="roughdielectric"/>', "RoughDielectric"),
        ('<bsdf type="principled"><float name="spec_trans" value="0.9"/></bsdf>', "Principled"),
    ],
)
def test_glass_stays_as_it_is(mi: ModuleType, tmp_path: Path, bsdf: str, kind: str) -> None:
    assert only_shape(tmp_path, bsdf).bsdf.class_name() == kind


def test_a_wall_that_is_turned_away_is_seen(mi: ModuleType, tmp_path: Path) -> None:
    clouds = [
        lidarscene.render(wall(tmp_path, '<bsdf type="diffuse" id="a"/>', place=place), overrides=COARSE)
        for place in (FRONT, BACK)
    ]
    assert len(clouds[0]) > 30
    np.testing.assert_allclose(clouds[1].snr, clouds[0].snr, rtol=1e-5)


# --- types that Mitsuba does not have -----------------------------------------------------------------


def test_stand_ins_are_in_the_catalogue() -> None:
    assert set(STAND_INS.values()) <= set(names("materials"))


@pytest.mark.parametrize(
    ("bsdf", "material_name"),
    [
        (RADIO.format(id="box-mat", kind="metal"), "galvanised_steel"),
        (RADIO.format(id="facade", kind="marble"), "plaster_white"),
        (RADIO.format(id="metal", kind="wet_ground"), "soil"),
        ('<bsdf type="radio-material" id="mat-itu_brick"/>', "brick"),
        ('<bsdf type="twosided" id="Window_2"><bsdf type="game"/></bsdf>', "clear_glass"),
        ('<bsdf type="ConcreteShader"/>', "concrete"),
        ('<bsdf type="game" id="car_paint_red"/>', "car_paint_red"),
    ],
)
def test_unknown_bsdfs_by_their_names(mi: ModuleType, tmp_path: Path, bsdf: str, material_name: str) -> None:
    """Reference: the catalogue's material of that name."""
    shape = only_shape(tmp_path, bsdf)
    assert (shape.material, shape.values) == (material_name, catalogue_material(material_name).at(905e-9))


def test_materials_of_the_scene_file_go_first(mi: ModuleType, tmp_path: Path) -> None:
    path = wall(tmp_path, RADIO.format(id="facade", kind="brick"))
    scene_materials = {"brick": catalogue_material("wood").at(905e-9)}
    (shape,) = load_shapes(path, {}, scene_materials, 905e-9)
    assert shape.values == scene_materials["brick"]
    (shape,) = load_shapes(path, {"facade": "grass"}, {"grass": catalogue_material("grass").at(905e-9)}, 905e-9)
    assert (shape.material, shape.assumed) == ("grass", "")


def test_what_is_assumed_is_told_once(mi: ModuleType, tmp_path: Path) -> None:
    path = wall(tmp_path, RADIO.format(id="facade", kind="brick"))
    with pytest.warns(OptionWarning) as warned:
        cloud = lidarscene.render(path, overrides=COARSE)
    (line,) = [str(warning.message) for warning in warned]
    assert line == (
        f"{path}: BSDFs that Mitsuba does not have are of the catalogue's materials, by their names: "
        "facade is brick; base_materials can name others"
    )
    assert (set(cloud.body_names), set(cloud.material_names)) == ({"wall"}, {"brick"})


@pytest.mark.parametrize(
    ("bsdf", "named"),
    [
        (RADIO.format(id="sky", kind="vacuum"), "bsdf type | Mitsuba's own plugins"),
        ('<bsdf type="hair" id="sky"/>', "BSDF 'sky' | shape 'wall'"),
        ('<bsdf type="diffuse" id="sky"><float name="gloss" value="1"/></bsdf>', "wall.xml | Mitsuba scene"),
    ],
)
def test_errors_of_bsdfs_name_base_materials(mi: ModuleType, tmp_path: Path, bsdf: str, named: str) -> None:
    with told(f"base_materials | {named}"):
        only_shape(tmp_path, bsdf)
    (shape,) = load_shapes(
        tmp_path / "wall.xml", {"sky": "brick"}, {"brick": catalogue_material("brick").at(905e-9)}, 905e-9
    )
    assert shape.material == "brick"
