"""USD stages: what was authored comes back in metres and z up, piece by piece; what should not be seen is left out."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.meshes import area_m2
from helpers.mistakes import told
from helpers.scene_text import scene_of

from lidarscene.errors import OptionWarning
from lidarscene.maths.arrays import Numbers
from lidarscene.scene.meshes import usd
from lidarscene.scene.meshes.mesh_cache import SubMesh
from lidarscene.scene.meshes.reading import read_mesh
from lidarscene.scene.scene import Part

pytest.importorskip("pxr")


@pytest.fixture
def stage(tmp_path: Path) -> Any:
    """An empty stage in metres, z up, whose layer is saved by `saved`."""
    from pxr import Usd, UsdGeom

    new_stage = Usd.Stage.CreateNew(str(tmp_path / "stage.usda"))
    UsdGeom.SetStageMetersPerUnit(new_stage, 1.0)
    UsdGeom.SetStageUpAxis(new_stage, UsdGeom.Tokens.z)
    return new_stage


def save_and_read(stage: Any) -> list[SubMesh]:
    stage.Save()
    return read_mesh(Path(stage.GetRootLayer().realPath))


def add_mesh(stage: Any, path: str, points: Any, counts: Any, corners: Any) -> Any:
    from pxr import UsdGeom

    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr([tuple(map(float, point)) for point in points])
    mesh.CreateFaceVertexCountsAttr(counts)
    mesh.CreateFaceVertexIndicesAttr(corners)
    return mesh


def add_material(stage: Any, path: str, colour: tuple[float, float, float] | None = None) -> Any:
    from pxr import Sdf, UsdShade

    material = UsdShade.Material.Define(stage, path)
    if colour is not None:
        shader = UsdShade.Shader.Define(stage, f"{path}/preview")
        shader.CreateIdAttr("UsdPreviewSurface")
        shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(colour)
        material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    return material


def bind(prim: Any, material: Any) -> None:
    from pxr import UsdShade

    UsdShade.MaterialBindingAPI.Apply(prim.GetPrim()).Bind(material)


def extent(piece: SubMesh) -> tuple[Numbers, Numbers]:
    return piece.vertices_m.min(axis=0), piece.vertices_m.max(axis=0)


SQUARE = [(0, 0, 0), (2, 0, 0), (2, 3, 0), (0, 3, 0)]


def test_transforms_are_applied_from_the_inside_out(stage: Any) -> None:
    """A turn by 90 degrees around z inside a shift: (x, y) becomes (-y + 10, x)."""
    from pxr import UsdGeom

    UsdGeom.Xform.Define(stage, "/a").AddTranslateOp().Set((10.0, 0.0, 1.0))
    add_mesh(stage, "/a/m", SQUARE, [4], [0, 1, 2, 3]).AddRotateZOp().Set(90.0)
    (piece,) = save_and_read(stage)
    low, high = extent(piece)
    np.testing.assert_allclose((low, high), ((7, 0, 1), (10, 2, 1)), atol=1e-12)


@pytest.mark.parametrize(("up", "high"), [("Z", (0.2, 0.3, 0.0)), ("Y", (0.2, 0.0, 0.3)), (None, (0.2, 0.0, 0.3))])
def test_unit_and_axis_are_the_stage_s(stage: Any, up: str | None, high: tuple[float, ...]) -> None:
    """Y is up where the stage says nothing."""
    from pxr import UsdGeom

    UsdGeom.SetStageMetersPerUnit(stage, 0.1)
    stage.ClearMetadata("upAxis") if up is None else UsdGeom.SetStageUpAxis(stage, up)
    add_mesh(stage, "/m", SQUARE, [4], [0, 1, 2, 3])
    (piece,) = save_and_read(stage)
    np.testing.assert_allclose(extent(piece), ((0, 0, 0), high), atol=1e-12)


def test_a_stage_without_a_unit_is_told_to_be_in_centimetres(stage: Any) -> None:
    stage.ClearMetadata("metersPerUnit")
    add_mesh(stage, "/m", SQUARE, [4], [0, 1, 2, 3])
    with pytest.warns(OptionWarning, match="no metersPerUnit.*centimetre.*scale = 100"):
        (piece,) = save_and_read(stage)
    np.testing.assert_allclose(extent(piece)[1], (0.02, 0.03, 0.0))


def test_polygons_become_fans_and_holes_stay_open(stage: Any) -> None:
    """A pentagon, a hole and a triangle: their areas by the shoelace formula."""
    pentagon = [(0, 0, 0), (4, 0, 0), (5, 2, 0), (2, 4, 0), (-1, 2, 0)]
    mesh = add_mesh(
        stage, "/m", [*pentagon, (0, 0, 5), (1, 0, 5), (0, 2, 5)], [5, 3, 3], [0, 1, 2, 3, 4, 0, 1, 2, 5, 6, 7]
    )
    mesh.CreateHoleIndicesAttr([1])
    (piece,) = save_and_read(stage)
    assert len(piece.faces) == 3 + 1
    assert area_m2(piece.vertices_m, piece.faces) == pytest.approx(16.0 + 1.0)


def test_each_material_is_a_piece_with_its_names_and_colour(stage: Any) -> None:
    """Two squares of a mesh by subset, the third by the mesh's own material."""
    from pxr import UsdGeom, UsdShade, Vt

    strip = [(x, y, 0) for x in range(4) for y in (0, 1)]
    mesh = add_mesh(stage, "/car/body", strip, [4] * 3, [0, 2, 3, 1, 2, 4, 5, 3, 4, 6, 7, 5])
    bind(mesh, add_material(stage, "/looks/paint", (0.2, 0.4, 0.6)))
    api = UsdShade.MaterialBindingAPI(mesh.GetPrim())
    subset = api.CreateMaterialBindSubset("glass", Vt.IntArray([1, 2]), UsdGeom.Tokens.face)
    bind(subset, add_material(stage, "/looks/pane"))
    glass, paint = save_and_read(stage)
    assert glass.keys == ("pane", "body", "/car/body")
    assert (paint.keys[0], paint.grey) == ("paint", pytest.approx(0.4))
    assert (area_m2(glass.vertices_m, glass.faces), area_m2(paint.vertices_m, paint.faces)) == (2.0, 1.0)
    assert glass.grey is None


def test_a_colour_of_the_prim_serves_without_a_material(stage: Any) -> None:
    add_mesh(stage, "/m", SQUARE, [4], [0, 1, 2, 3]).CreateDisplayColorAttr([(0.1, 0.1, 0.4)])
    (piece,) = save_and_read(stage)
    assert piece.grey == pytest.approx(0.2)


def test_what_is_not_to_be_seen_is_left_out(stage: Any) -> None:
    from pxr import UsdGeom

    for name in ("seen", "hidden", "guide", "proxy", "render"):
        parent = UsdGeom.Xform.Define(stage, f"/{name}")
        add_mesh(stage, f"/{name}/m", SQUARE, [4], [0, 1, 2, 3])
        if name == "hidden":
            UsdGeom.Imageable(parent).MakeInvisible()
        elif name != "seen":
            UsdGeom.Imageable(parent).CreatePurposeAttr(name)
    assert [piece.keys[-1] for piece in save_and_read(stage)] == ["/seen/m", "/render/m"]


def test_instances_are_each_there(stage: Any) -> None:
    """Two references to one prim, made instanceable: USD shares them, we place both."""
    from pxr import Sdf, UsdGeom

    add_mesh(stage, "/_class_post/m", SQUARE, [4], [0, 1, 2, 3])
    stage.GetPrimAtPath("/_class_post").SetSpecifier(Sdf.SpecifierClass)
    for number in range(2):
        prim = UsdGeom.Xform.Define(stage, f"/post{number}")
        prim.AddTranslateOp().Set((10.0 * number, 0.0, 0.0))
        prim.GetPrim().GetReferences().AddInternalReference("/_class_post")
        prim.GetPrim().SetInstanceable(True)
    assert [extent(piece)[0][0] for piece in save_and_read(stage)] == [0.0, 10.0]


@pytest.mark.parametrize("specifier", ["SpecifierDef", "SpecifierOver", "SpecifierClass"])
def test_a_point_instancer_puts_its_prototypes_at_its_points(stage: Any, specifier: str) -> None:
    """The prototype's own shift first, then scale and place; the second point is masked.

    A prototype may be below an `over`, which is drawn nowhere else. Below a `class` it is left out, and counted.
    """
    from pxr import Sdf, UsdGeom

    instancer = UsdGeom.PointInstancer.Define(stage, "/trees")
    proto = UsdGeom.Xform.Define(stage, "/trees/kinds/a")
    proto.AddTranslateOp().Set((1.0, 0.0, 0.0))
    add_mesh(stage, "/trees/kinds/a/m", SQUARE, [4], [0, 1, 2, 3])
    stage.GetPrimAtPath("/trees/kinds").SetSpecifier(getattr(Sdf, specifier))
    instancer.CreatePrototypesRel().SetTargets(["/trees/kinds/a"])
    instancer.CreateProtoIndicesAttr([0, 0, 0])
    instancer.CreatePositionsAttr([(0.0, 0.0, 0.0), (50.0, 0.0, 0.0), (100.0, 0.0, 0.0)])
    instancer.CreateScalesAttr([(1.0, 1.0, 1.0), (1.0, 1.0, 1.0), (2.0, 2.0, 2.0)])
    instancer.CreateInvisibleIdsAttr([1])
    if specifier == "SpecifierClass":
        add_mesh(stage, "/m", SQUARE, [4], [0, 1, 2, 3])
        stage.Save()
        read = usd.read_stage(Path(stage.GetRootLayer().realPath))
        assert ([piece.keys[-1] for piece in read.pieces], list(read.left_out.values())) == (["/m"], [2])
        return
    pieces = save_and_read(stage)
    np.testing.assert_allclose(
        [extent(piece) for piece in pieces], [((1, 0, 0), (3, 3, 0)), ((102, 0, 0), (106, 6, 0))]
    )


@pytest.mark.parametrize(
    ("kind", "numbers", "low", "high"),
    [
        ("Cube", {"Size": 2.0}, (-1, -1, -1), (1, 1, 1)),
        ("Sphere", {"Radius": 3.0}, (-3, -3, -3), (3, 3, 3)),
        ("Plane", {"Width": 4.0, "Length": 6.0, "Axis": "Z"}, (-2, -3, 0), (2, 3, 0)),
        ("Plane", {"Width": 4.0, "Length": 6.0, "Axis": "X"}, (0, -3, -2), (0, 3, 2)),
        ("Plane", {"Width": 4.0, "Length": 6.0, "Axis": "Y"}, (-2, 0, -3), (2, 0, 3)),
        ("Cylinder", {"Height": 4.0, "Radius": 1.0, "Axis": "Z"}, (-1, -1, -2), (1, 1, 2)),
        ("Cylinder", {"Height": 4.0, "Radius": 1.0, "Axis": "X"}, (-2, -1, -1), (2, 1, 1)),
        ("Cylinder", {"Height": 4.0, "Radius": 1.0, "Axis": "Y"}, (-1, -2, -1), (1, 2, 1)),
        ("Cone", {"Height": 4.0, "Radius": 1.0, "Axis": "Z"}, (-1, -1, -2), (1, 1, 2)),
        ("Capsule", {"Height": 4.0, "Radius": 1.0, "Axis": "Z"}, (-1, -1, -3), (1, 1, 3)),
    ],
)
def test_solids_have_the_size_that_usd_gives_them(stage, kind, numbers, low, high):
    """Compared with USD's own bounding boxes; round ones are polygons, within 0.2 % of the radius."""
    from pxr import Usd, UsdGeom

    solid = getattr(UsdGeom, kind).Define(stage, "/s")
    for name, value in numbers.items():
        getattr(solid, f"Create{name}Attr")(value)
    (piece,) = save_and_read(stage)
    np.testing.assert_allclose(extent(piece), (low, high), atol=0.006)
    box = UsdGeom.BBoxCache(Usd.TimeCode.Default(), [UsdGeom.Tokens.default_]).ComputeWorldBound(solid.GetPrim())
    aligned = box.ComputeAlignedRange()
    np.testing.assert_allclose((aligned.GetMin(), aligned.GetMax()), (low, high), atol=1e-6)


def test_a_scene_file_names_a_stage_and_its_materials(stage: Any, tmp_path: Path) -> None:
    add_mesh(stage, "/wall", SQUARE, [4], [0, 1, 2, 3])
    bind(stage.GetPrimAtPath("/wall"), add_material(stage, "/looks/stone"))
    stage.Save()
    text = '[[bodies]]\nname = "w"\nmesh = "stage.usda"\nmaterials = {{ stone = "concrete" }}\n{}'
    (part,) = scene_of(tmp_path, text.format("")).bodies[0].parts
    assert isinstance(part, Part)
    assert (part.material, len(part.faces)) == ("concrete", 2)
    with told('bodies[0 "w"].unit | USD | mm'):
        scene_of(tmp_path, text.format('unit = "mm"\n'))


def test_mistakes_are_one_line(stage: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """And USD prints nothing of its own."""
    (tmp_path / "noise.usda").write_text("#usda 1.0\ndef {")
    with told("noise.usda | USD"):
        read_mesh(tmp_path / "noise.usda")
    with told("at least one triangle | none"):
        save_and_read(stage)
    (tmp_path / "lost.usda").write_text('#usda 1.0\n(metersPerUnit = 1)\ndef "a" (references = @nowhere.usda@) {}\n')
    with told("lost.usda | nowhere.usda"):
        read_mesh(tmp_path / "lost.usda")
    assert capfd.readouterr() == ("", "")


def test_faces_that_do_not_fit_are_refused(stage: Any) -> None:
    add_mesh(stage, "/m", SQUARE, [4], [0, 1, 2, 9])
    with told("/m | faces | points"):
        save_and_read(stage)


@pytest.mark.parametrize("arc", ["subLayers = [@./part.usda@]", "sublayers of a reference"])
def test_a_stage_that_refers_to_a_pipe_is_refused(library: Any, tmp_path: Path, arc: str) -> None:
    """The stage is refused at once: USD would open the pipe and wait without end. Also where a layer refers to a layer
    that does.
    """
    library("pxr")
    os.mkfifo(tmp_path / "part.usda")
    bad = "#usda 1.0\n(\n    subLayers = [@./part.usda@]\n)\n"
    path = tmp_path / "a.usda"
    if arc.startswith("subLayers"):
        path.write_text(bad)
    else:
        (tmp_path / "b.usda").write_text(bad)
        path.write_text('#usda 1.0\ndef "a" (references = @./b.usda@</a>)\n{\n}\n')
    with told("part.usda | USD file"):
        read_mesh(path)


def test_a_stage_over_which_usd_ends_the_process(stage: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: one byte of a binary stage makes USD abort. One line, and the next stage is read."""
    add_mesh(stage, "/m", SQUARE, [4], [0, 1, 2, 3])
    stage.Save()
    path = Path(stage.GetRootLayer().realPath)
    monkeypatch.setattr(usd, "_child", None)
    with monkeypatch.context() as crashing:
        (tmp_path / "sitecustomize.py").write_text("import os; os.abort()")
        crashing.syspath_prepend(tmp_path)
        with told(f"{path} | damaged"):
            read_mesh(path)
    assert len(read_mesh(path)) == 1
