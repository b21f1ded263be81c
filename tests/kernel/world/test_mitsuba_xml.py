"""Mitsuba XML scenes: names, materials, paths, and nothing left in Mitsuba afterwards."""

import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from helpers import chain
from helpers.child import assert_ended
from helpers.mistakes import told
from helpers.run_seed import chosen

import lidarscene
from lidarscene import PointCloud, Pose, Status
from lidarscene.errors import InputError
from lidarscene.kernel.world.mitsuba_xml import load_shapes
from lidarscene.materials.material_file import catalogue_material

COARSE = chain.raster(40, 20, 1)

TRIANGLE = "v 0 0 -1\nv 0 0 1\nv 0 2 0\nv 0 -2 0\nf 1 3 2\nf 1 2 4\n"

# A sphere on the left, a kite of two triangles in a folder in the middle, a rectangle on the right, all 10 m off.
XML = """<?xml version="1.0" encoding="utf-8"?>
<scene version="3.0.0">
    <default name="folder" value="parts"/>
    <integrator type="path"/>
    <sensor type="perspective"/>
    <emitter type="constant"/>
    <bsdf type="twosided" id="grey"><bsdf type="diffuse"><rgb name="reflectance" value="0.25"/></bsdf></bsdf>
    <bsdf type="twosided" id="paint"><bsdf type="plastic"/></bsdf>
    <shape type="sphere" id="ball">
        <point name="center" x="10" y="3" z="0"/>
        <ref id="paint"/>
    </shape>
    <shape type="obj" id="kite">
        <string name="filename" value="$folder/kite.obj"/>
        <transform name="to_world"><translate x="10"/></transform>
        <ref id="grey"/>
    </shape>
    <shape type="rectangle">
        <transform name="to_world"><rotate y="1" angle="-90"/><translate x="10" y="-3"/></transform>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.75"/></bsdf>
    </shape>
</scene>
"""


@pytest.fixture
def base(tmp_path: Path) -> Path:
    (tmp_path / "xml" / "parts").mkdir(parents=True)
    (tmp_path / "xml" / "parts" / "kite.obj").write_text(TRIANGLE)
    (tmp_path / "xml" / "base.xml").write_text(XML)
    return tmp_path / "xml" / "base.xml"


def echoes_of(cloud: PointCloud, name: str) -> np.ndarray:
    """Which echoes are of this body."""
    assert cloud.body is not None
    return (np.array(cloud.body_names)[cloud.body] == name) & (cloud.status == Status.ECHO)


def material_of(cloud: PointCloud, name: str) -> str:
    assert cloud.material is not None
    (index,) = set(cloud.material[echoes_of(cloud, name)])
    return cloud.material_names[index]


def reflectivity_of(cloud: PointCloud, name: str) -> float:
    assert cloud.reflectivity is not None
    return float(np.unique(cloud.reflectivity[echoes_of(cloud, name)])[0])


def test_shapes_keep_their_names_and_bsdfs(mi: ModuleType, base: Path) -> None:
    """Reference: the reflectances in the file."""
    cloud = lidarscene.render(base, overrides=COARSE)
    assert cloud.metadata["scene"] == "base"
    assert set(cloud.body_names) == {"ball", "kite", "shape_2"}
    for name, side in (("ball", 3), ("kite", 0), ("shape_2", -3)):
        assert np.abs(cloud.xyz_m[echoes_of(cloud, name), 1] - side).max() < 2.1
    assert [material_of(cloud, name) for name in ("ball", "kite", "shape_2")] == ["paint", "grey", "bsdf"]
    assert reflectivity_of(cloud, "kite") == pytest.approx(0.25)
    assert reflectivity_of(cloud, "shape_2") == pytest.approx(0.75)


def test_the_same_seen_from_elsewhere(mi: ModuleType, base: Path) -> None:
    """The origin of a Mitsuba file stays where it is."""
    cloud = lidarscene.render(base, pose=Pose.from_degrees(position_m=(4, 0, 0.5)), overrides=COARSE)
    assert np.count_nonzero(echoes_of(cloud, "kite")) > 50
    assert np.abs(cloud.xyz_m[echoes_of(cloud, "kite"), 0] - 10).max() < 0.5  # range noise


def test_mapped_materials_and_own_bodies(mi: ModuleType, base: Path, tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(
        'base = "xml/base.xml"\nsensor = { position_m = [0, 0, 0] }\n[base_materials]\n'
        'grey = "concrete"\npaint = "retroreflective_sheeting"\n'
        '[[bodies]]\nname = "floor"\nclass = "road"\nprimitive = "plane"\nsize_m = [20, 20]\nmaterial = "asphalt"\n'
        "position_m = [10, 0, -1.5]\n"
    )
    cloud = lidarscene.render(tmp_path / "scene.toml", overrides=COARSE)
    assert set(cloud.body_names) == {"floor", "ball", "kite", "shape_2"}
    assert set(cloud.class_names) == {"road", "unlabelled"}
    for name, made_of in (("kite", "concrete"), ("ball", "retroreflective_sheeting"), ("floor", "asphalt")):
        assert material_of(cloud, name) == made_of
        expected = catalogue_material(made_of).at(905e-9)["reflectivity"]
        assert reflectivity_of(cloud, name) == pytest.approx(expected, rel=1e-6)
    assert reflectivity_of(cloud, "shape_2") == pytest.approx(0.75)


def test_a_mapped_bsdf_scatters_as_on_an_own_body(mi: ModuleType, base: Path, tmp_path: Path) -> None:
    """Rationale: two roads to one wall. The rectangle of the file with a coated material against a plane of
    ours at the same place. Tolerance: single precision.
    """
    clouds = []
    base.write_text(
        XML.replace('<bsdf type="diffuse"><rgb name="reflectance" value="0.75"/></bsdf>', '<ref id="grey"/>')
    )
    head = 'base = "xml/base.xml"\nbase_materials = { grey = "car_paint_red" }\n'
    plane = (
        'base = "xml/base.xml"\n[[bodies]]\nname = "shape_2"\nprimitive = "plane"\nsize_m = [2, 2]\n'
        'material = "car_paint_red"\nposition_m = [9.999, -3, 0]\npitch_deg = 90\n'
    )
    for text in (head, plane):
        (tmp_path / "scene.toml").write_text(text)
        clouds.append(lidarscene.render(tmp_path / "scene.toml", overrides=(*COARSE, "tdc.threshold_to_noise=3")))
    theirs, ours = (cloud.snr[echoes_of(cloud, "shape_2")] for cloud in clouds)
    assert len(theirs) > 50
    np.testing.assert_allclose(theirs, ours, rtol=1e-3)


def test_includes_and_their_bsdfs(mi: ModuleType, base: Path) -> None:
    """An included file's BSDF can be replaced, also where a parameter names the file."""
    (base.parent / "parts" / "more.xml").write_text(
        '<scene version="3.0.0"><bsdf type="diffuse" id="inner"/>'
        '<shape type="sphere" id="extra"><ref id="inner"/></shape></scene>'
    )
    for name in ("parts/more.xml", "$folder/more.xml"):
        base.write_text(XML.replace("</scene>", f'<include filename="{name}"/></scene>'))
        materials = {"brick": catalogue_material("brick").at(905e-9)}
        shapes = {shape.name: shape for shape in load_shapes(base, {"inner": "brick"}, materials, 905e-9)}
        assert set(shapes) == {"ball", "kite", "shape_2", "extra"}
        assert shapes["extra"].material == "brick"
        assert shapes["extra"].reflectivity == pytest.approx(materials["brick"]["reflectivity"])
        assert shapes["kite"].faces == 2


def test_metal_reflects_no_sky_as_on_an_own_body(mi: ModuleType, base: Path) -> None:
    (kite,) = (
        shape
        for shape in load_shapes(base, {"grey": "chrome"}, {"chrome": catalogue_material("chrome").at(905e-9)}, 905e-9)
        if shape.name == "kite"
    )
    assert kite.reflectivity == 0


def test_a_bsdf_called_as_a_material_is_told_apart(mi: ModuleType, base: Path) -> None:
    base.write_text(XML.replace('"paint"', '"brick"'))
    materials = {"brick": catalogue_material("brick").at(905e-9)}
    shapes = {shape.name: shape for shape in load_shapes(base, {"grey": "brick"}, materials, 905e-9)}
    assert (shapes["kite"].material, shapes["ball"].material) == ("brick", "brick of base.xml")


def test_mitsuba_looks_in_no_folder_more_than_before(mi: ModuleType, base: Path) -> None:
    before = str(mi.file_resolver())
    for _ in range(2):
        load_shapes(base, {}, {}, 905e-9)
    assert str(mi.file_resolver()) == before
    (base.parent / "parts" / "kite.obj").unlink()
    with pytest.raises(InputError):
        load_shapes(base, {}, {}, 905e-9)
    assert str(mi.file_resolver()) == before


@pytest.mark.parametrize(
    "name", chosen(3, ["dielectric", "thindielectric", "roughconductor", "roughplastic", "principled", "null"])
)
def test_any_bsdf_of_mitsuba_is_used_as_it_is(mi: ModuleType, base: Path, name: str) -> None:
    base.write_text(
        XML.replace('<bsdf type="plastic"/>', '<bsdf type="diffuse"/>').replace(
            '<bsdf type="diffuse"><rgb name="reflectance" value="0.75"/></bsdf>', f'<bsdf type="{name}" id="own"/>'
        )
    )
    cloud = lidarscene.render(base, overrides=(*COARSE, "tdc.threshold_to_noise=1"))
    assert "own" in cloud.material_names
    assert np.isfinite(cloud.intensity).all()


# --- native code beside a scene -----------------------------------------------------------------------

PLANTED = """
#include <stdio.h>
__attribute__((constructor)) static void run(void) { FILE *f = fopen("%s", "w"); if (f) fclose(f); }
"""

WITH_PLUGIN = """
<scene version="3.0.0">{more}
    <default name="kind" value="{kind}"/>
    <bsdf type="{written}" id="own"/>
    <shape type="rectangle"><ref id="own"/></shape>
</scene>
"""


@pytest.fixture
def planted(tmp_path: Path) -> Path:
    """A folder with `plugins/` whose libraries leave a mark when they are loaded; the file that is the mark."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("needs a C compiler")
    (tmp_path / "plugins").mkdir()
    (tmp_path / "planted.c").write_text(PLANTED % (tmp_path / "mark"))
    library = tmp_path / "plugins" / "evil.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", str(library), str(tmp_path / "planted.c")], check=True)
    for name in ("diffuse", "thindielectric", "rectangle"):
        shutil.copy(library, library.with_stem(name))
    return tmp_path / "mark"


@pytest.mark.parametrize("where", ["scene", "current", "path", "climbing", "absolute", "parameter"])
def test_a_library_beside_a_scene_does_not_run(mi, planted, monkeypatch, where):
    """Rationale: Mitsuba loads plugins from `plugins/` of each folder of its search path, and by paths as names."""
    folder, scenes = planted.parent, planted.parent / ("." if where == "scene" else "scenes")
    scenes.mkdir(exist_ok=True)
    if where == "current":
        monkeypatch.chdir(folder)
    kind = {
        "climbing": "../" * 30 + str(folder / "plugins" / "evil").lstrip("/"),
        "absolute": str(folder / "plugins" / "evil"),
    }.get(where, "evil")
    more = f'<path value="{folder}"/>' if where == "path" else ""
    written = "$kind" if where == "parameter" else kind
    (scenes / "own.xml").write_text(WITH_PLUGIN.format(kind=kind, written=written, more=more))
    with told("bsdf type | Mitsuba's own plugins"):
        load_shapes(scenes / "own.xml", {}, {}, 905e-9)
    assert not planted.exists()


def test_plugins_of_a_known_name_are_mitsubas_own(planted: Path) -> None:
    """Run in a process of its own: Mitsuba keeps the plugins that it has loaded."""
    wall = planted.parent / "wall.xml"
    wall.write_text(WITH_PLUGIN.format(kind="diffuse", written="diffuse", more=""))
    code = f"import lidarscene; print(len(lidarscene.render({str(wall)!r}, overrides={COARSE!r})))"
    ran = subprocess.run([sys.executable, "-c", code], cwd=planted.parent, capture_output=True, text=True, timeout=300)
    assert_ended(ran)
    assert not planted.exists()


def test_a_bsdf_that_cannot_be_used_stops_no_later_frame(mi: ModuleType, tmp_path: Path) -> None:
    """Every kernel asks all BSDFs that are alive, and whoever keeps an error keeps its frames."""
    (tmp_path / "hair.xml").write_text(
        "<scene version='3.0.0'><shape type='sphere' id='one'><bsdf type='hair' id='h'/></shape></scene>"
    )
    with pytest.raises(InputError, match="cannot be used") as raised:
        load_shapes(tmp_path / "hair.xml", {}, {}, 905e-9)
    assert len(lidarscene.render("edges", overrides=COARSE)) > 0
    assert raised.value


GROUPS = """<scene version="3.0.0">
    <bsdf type="diffuse" id="grey"><rgb name="reflectance" value="0.25"/></bsdf>
    <shape type="shapegroup" id="pair">
        <shape type="rectangle" id="flag">
            <transform name="to_world"><rotate y="1" angle="-90"/><translate z="1.5"/></transform>
            <bsdf type="diffuse"><rgb name="reflectance" value="0.75"/></bsdf>
        </shape>
        <shape type="sphere" id="foot"><float name="radius" value="0.5"/><ref id="grey"/></shape>
    </shape>
    <shape type="instance" id="near">
        <ref id="pair"/>
        <transform name="to_world"><scale value="0.5"/><rotate z="1" angle="30"/><translate x="8" y="2"/></transform>
    </shape>
    <shape type="instance">
        <ref id="pair"/>
        <transform name="to_world">
            <matrix value="1 0 0 12  0 1.5 0 -2  0 0 1.5 0  0 0 0 1"/>
        </transform>
    </shape>
    <shape type="shapegroup" id="single"><shape type="cube"/></shape>
    <shape type="instance" id="alone">
        <ref id="single"/>
        <transform name="to_world"><translate x="20"/></transform>
    </shape>
</scene>
"""


ALIASES = GROUPS.replace('<ref id="grey"/>', '<ref id="slate"/>').replace(
    '<shape type="shapegroup" id="pair">',
    '<alias id="grey" as="dark"/><alias id="dark" as="slate"/><shape type="shapegroup" id="pair">',
)


@pytest.mark.parametrize("groups", [GROUPS, ALIASES], ids=["ids", "aliases"])
def test_instances_are_where_mitsuba_has_them(mi: ModuleType, tmp_path: Path, groups: str) -> None:
    """Mitsuba's own scene, with its groups, is met by the same rays at the same distance, but for noise."""
    path = tmp_path / "groups.xml"
    path.write_text(groups)
    cloud = lidarscene.render(path, overrides=COARSE, pose=Pose())
    points = np.stack([cloud["x"], cloud["y"], cloud["z"]])[:, np.isin(cloud["status"], Status.ECHO)]
    far = np.linalg.norm(points, axis=0)
    theirs = mi.load_file(str(path))  # it must live until its answer is computed
    met = theirs.ray_intersect(mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(*(points / far)))).t.numpy()
    # Noise has a sigma of 8 cm, and a beam that an edge divides may be met beside it.
    assert (np.abs(far - met) < 0.2).mean() > 0.95
    assert set(cloud.body_names) == {"near.flag", "near.foot", "pair.flag", "pair.foot", "alone"}
    for name, reflectivity in (("near.flag", 0.75), ("pair.foot", 0.25), ("alone", 0.5)):
        assert reflectivity_of(cloud, name) == pytest.approx(reflectivity, abs=0.01)
    assert material_of(cloud, "pair.foot") == "grey"


def test_instances_of_a_group_take_our_materials(mi: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "groups.xml").write_text(GROUPS)
    (tmp_path / "s.toml").write_text(
        'base = "groups.xml"\nbase_materials = { grey = "brick" }\n[sensor]\nposition_m = [0, 0, 0]\n'
    )
    cloud = lidarscene.render(tmp_path / "s.toml", overrides=COARSE)
    assert material_of(cloud, "pair.foot") == "brick"


def test_an_instance_without_its_group_is_one_line(mi: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "groups.xml").write_text(GROUPS.replace('<ref id="pair"/>', '<ref id="pear"/>', 1))
    with told("groups.xml | instance 'near' | 'pear'"):
        load_shapes(tmp_path / "groups.xml", {}, {}, 905e-9)
