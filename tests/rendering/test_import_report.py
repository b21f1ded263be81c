"""Import report: one form for every kind of file, and what each file says of itself."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.command_line import Run
from helpers.gltf import WALL, Gltf

from lidarscene.errors import InputError, OptionWarning
from lidarscene.rendering.import_report import ImportReport, import_report

BOX = (4.0, 2.0, 1.0)

XML = """<scene version="3.0.0">
    <emitter type="constant"/>
    <bsdf type="diffuse" id="grey"/>
    <shape type="shapegroup" id="pair"><shape type="cube"><ref id="grey"/></shape></shape>
    <shape type="instance"><ref id="pair"/></shape>
    <shape type="instance"><ref id="pair"/><transform name="to_world"><translate x="2"/></transform></shape>
    <shape type="sphere"><point name="center" x="0" y="0" z="1"/></shape>
</scene>
"""

STAGE = """#usda 1.0
( metersPerUnit = 0.01
  upAxis = "Y" )
def Cube "cube"
{
    double size = 100
}
def BasisCurves "wire"
{
}
def Cube "helper"
{
    token visibility = "invisible"
}
"""


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "off"])
def test_files_that_say_neither_unit_nor_axis(tmp_path: Path, suffix: str) -> None:
    trimesh.creation.box(BOX).export(tmp_path / f"a.{suffix}")
    report = import_report(tmp_path / f"a.{suffix}")
    assert (report.kind, report.meshes, report.triangles) == (suffix.upper(), 1, 12)
    assert report.unit == "1 m, taken, the file does not say"
    assert report.up == "z, taken, the file does not say"
    np.testing.assert_allclose(report.size_m, BOX)
    assert (report.extensions, report.honoured, report.left_out) == ((), (), ())


def test_gltf(tmp_path: Path) -> None:
    file = Gltf()
    file.add("materials", name="leaf", alphaMode="MASK")
    file.add("materials", name="pane", alphaMode="BLEND")
    file.mesh(WALL * [1, 2, 3], material=0)
    file.mesh(material=1, attributes={"COLOR_0": file.numbers(np.full((4, 4), 0.5))})
    file.add("samplers", wrapS=33071)
    file.add("samplers", wrapS=10497)
    file.mesh(faces=None, mode=1)
    file.content["scenes"] = [{"nodes": [0, 1, 2]}]
    for mesh in range(3):
        file.add("nodes", mesh=mesh)
    file.add("animations", channels=[], samplers=[])
    file.add("skins", joints=[0])
    path = file.save(tmp_path / "a.glb", required=("KHR_mesh_quantization",), used=("EXT_b",))
    with pytest.warns(OptionWarning, match="EXT_b"):
        report = import_report(path)
    assert report == ImportReport(
        kind="glTF 2",
        meshes=3,
        triangles=4,
        materials=("leaf", "pane"),
        extensions=("EXT_b", "KHR_mesh_quantization"),
        skins=1,
        unit="1 m, by the format",
        up="y, by the format",
        size_m=(0.0, 12.0, 8.0),
        honoured=(
            "KHR_mesh_quantization",
            "skins, in the pose in which their joints rest",
            "gaps of leaf (alphaMode MASK)",
        ),
        left_out=(
            "EXT_b",
            "transparency (alphaMode BLEND), which a material of glass has: pane",
            "animations: 1",
            "points and lines: 1",
            "alpha of the colours of vertices: 1",
            "images that do not repeat: 1",
        ),
    )


def test_a_stage(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    (tmp_path / "a.usda").write_text(STAGE)
    report = import_report(tmp_path / "a.usda")
    assert (report.kind, report.meshes, report.triangles) == ("USD", 1, 12)
    assert (report.unit, report.up) == ("0.01 m, by the stage", "y, by the stage")
    np.testing.assert_allclose(report.size_m, (1, 1, 1))
    assert report.left_out == ("BasisCurves: 1", "hidden: 1")


def test_a_mitsuba_scene(tmp_path: Path) -> None:
    """Two cubes, of instances, and a ball that is half above them."""
    (tmp_path / "a.xml").write_text(XML)
    report = import_report(tmp_path / "a.xml")
    assert (report.kind, report.meshes, report.triangles) == ("Mitsuba XML", 3, 24)
    assert report.materials == ("grey", "bsdf")
    np.testing.assert_allclose(report.size_m, (4, 2, 3), rtol=1e-6)
    assert report.left_out == ("emitters: 1",)


def test_check_prints_it(run: Run, tmp_path: Path) -> None:
    """A mesh in millimetres has its mistake first, then the report; other files have no report."""
    trimesh.creation.box(np.multiply(BOX, 1000)).export(tmp_path / "mm.obj")
    ran = run("check", "mm.obj", "car")
    lines = ran.out.splitlines()
    assert ran.code == InputError.exit_code
    assert "if its unit is millimetres" in lines[0]
    assert [line.split()[0] for line in lines[1:11]] == [
        *("format", "meshes", "materials", "extensions", "skins", "unit", "up", "size", "honoured", "left")
    ]
    assert "  size        4,000 x 2,000 x 1,000 m" in lines
    assert lines[11:] == ["car: no mistake found"]
    numbers = json.loads(run("check", "mm.obj", "--json").out)
    assert numbers["imports"]["mm.obj"]["size_m"] == [4000.0, 2000.0, 1000.0]


def test_a_file_that_cannot_be_read_has_its_mistake_only(run: Run, tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(b"glTF")
    ran = run("check", "a.glb")
    assert (ran.code, len(ran.out.splitlines())) == (InputError.exit_code, 1)
