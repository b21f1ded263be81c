"""Meshes of one BSDF become one, and every point is what and where it was."""

from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers import chain

import lidarscene
from lidarscene import PointCloud, Status
from lidarscene.kernel.world import merged_meshes
from lidarscene.kernel.world.mitsuba_xml import load_shapes

COARSE = chain.raster(60, 6, 1)

SHAPE = """<shape type="{kind}" id="{name}">{more}
    <transform name="to_world"><rotate y="1" angle="-90"/><translate x="18" y="{y}"/></transform>
    <ref id="{bsdf}"/></shape>"""

PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_index
end_header
-1 -1 0
1 -1 0
1 1 0
-1 1 0
3 0 1 2
3 0 2 3
"""

# A roof: its two normals are those of the ridge and of the eaves, not those of the triangles.
ROOF = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
property float nx
property float ny
property float nz
element face 2
property list uchar int vertex_index
end_header
-1 -1 0 -0.6 0 0.8
1 -1 0 0.6 0 0.8
1 1 0 0.6 0 0.8
-1 1 0 -0.6 0 0.8
3 0 1 2
3 0 2 3
"""


@pytest.fixture
def mixed(tmp_path: Path) -> Path:
    """Flat meshes of two BSDFs, a ball, an image, and smooth meshes, side by side."""
    (tmp_path / "flat.ply").write_text(PLY)
    (tmp_path / "roof.ply").write_text(ROOF)
    flat, roof = (f'<string name="filename" value="{name}.ply"/>' for name in ("flat", "roof"))
    flat += '<boolean name="face_normals" value="true"/>'
    rows = [
        ("a", "rectangle", "grey", ""),
        ("b", "ply", "white", flat),
        ("c", "ply", "grey", flat),
        ("d", "sphere", "grey", ""),
        ("e", "rectangle", "checked", ""),
        ("f", "ply", "grey", flat),
        ("g", "rectangle", "checked", ""),
        ("h", "ply", "grey", roof),
    ]
    shapes = "".join(
        SHAPE.format(name=name, kind=kind, bsdf=bsdf, more=more, y=-2.5 * len(rows) / 2 + 2.5 * i)
        for i, (name, kind, bsdf, more) in enumerate(rows)
    )
    (tmp_path / "mixed.xml").write_text(f"""<scene version="3.0.0">
        <bsdf type="diffuse" id="grey"><rgb name="reflectance" value="0.25"/></bsdf>
        <bsdf type="roughplastic" id="white"/>
        <bsdf type="diffuse" id="checked"><texture type="checkerboard" name="reflectance">
            <rgb name="color0" value="0.2"/><rgb name="color1" value="0.7"/></texture></bsdf>
        {shapes}</scene>""")
    return tmp_path / "mixed.xml"


def test_shapes_of_one_bsdf_become_one(mi: ModuleType, mixed: Path) -> None:
    """Five of eight shapes stay. The rectangle's normals are those of its triangles, the roof's are not."""
    placed = merged_meshes.merge_by_bsdf(load_shapes(mixed, {}, {}, 905e-9), 3)
    assert [(mesh.material, mesh.face_body.tolist(), mesh.is_plain) for mesh in placed] == [
        ("grey", [3, 3, 5, 5, 8, 8], True),
        ("white", [4, 4], True),
        ("grey", [6], False),
        ("checked", [7, 7, 9, 9], False),
        ("grey", [10, 10], False),
    ]


def test_every_point_is_what_it_was(mi: ModuleType, mixed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Reference: the same file with every shape by itself. Tolerance: single precision."""

    def echoes() -> PointCloud:
        cloud = lidarscene.render(mixed, overrides=COARSE)
        return cloud.select(cloud.status == Status.ECHO)

    merged = echoes()
    monkeypatch.setattr(merged_meshes, "_merge_key", lambda *about: None)
    apart = echoes()
    assert merged.body_names == apart.body_names == tuple("abcdefgh")
    assert set(np.unique(merged.body)) == set(range(8))
    np.testing.assert_array_equal(merged.body, apart.body)
    np.testing.assert_array_equal(merged.material, apart.material)
    np.testing.assert_allclose(merged.reflectivity, apart.reflectivity, rtol=1e-5)
    np.testing.assert_allclose(merged.xyz_m, apart.xyz_m, rtol=1e-4)
    np.testing.assert_allclose(merged.snr, apart.snr, rtol=1e-3)
    assert len(np.unique(merged.reflectivity[merged.body == 4])) == 2  # the checks were seen


@pytest.mark.parametrize(
    ("bsdf", "varies"),
    [
        ({"type": "diffuse"}, False),
        ({"type": "twosided", "inner": {"type": "diffuse", "reflectance": {"type": "checkerboard"}}}, True),
        ({"type": "bumpmap", "map": {"type": "checkerboard"}, "inner": {"type": "diffuse"}}, True),
        ({"type": "mask", "opacity": {"type": "checkerboard"}, "inner": {"type": "diffuse"}}, True),
        ({"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_c"}}, True),
        ({"type": "roughconductor", "alpha_u": 0.1, "alpha_v": 0.2}, True),
    ],
)
def test_what_reads_a_place_varies(mi: ModuleType, bsdf: dict[str, object], varies: bool) -> None:
    assert merged_meshes._varies(mi.load_dict(bsdf)) == varies


def test_meshes_that_are_turned_inside_out_stay_alone() -> None:
    """Mitsuba's `flip_normals`: a merged mesh has one such flag for all."""

    def mesh_shape(*, flipped: bool, faces: int = 2, is_mesh: bool = True) -> Any:
        shape = SimpleNamespace(
            is_mesh=lambda: is_mesh,
            face_count=lambda: 2,
            has_flipped_normals=lambda: flipped,
            has_mesh_attributes=lambda: False,
            has_vertex_texcoords=lambda: False,
            has_vertex_normals=lambda: False,
        )
        return SimpleNamespace(shape=shape, faces=faces, bsdf=None)

    assert merged_meshes._merge_key(mesh_shape(flipped=False), False) is not None
    for alone in (
        mesh_shape(flipped=True),
        mesh_shape(flipped=False, faces=3),
        mesh_shape(flipped=False, is_mesh=False),
    ):
        assert merged_meshes._merge_key(alone, False) is None
