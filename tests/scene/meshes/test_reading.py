"""Mesh files: every format, its pieces and transforms."""

import contextlib
import json
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from helpers.child import assert_ended
from helpers.meshes import area_m2
from helpers.mistakes import told

from lidarscene.errors import InputError, OptionWarning
from lidarscene.scene.meshes.reading import read_mesh

PENTAGON = """ply
format ascii 1.0
element vertex 6
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
0 0 0
2 0 0
2 1 0
1 2 0
0 1 0
2 0 3
5 0 1 2 3 4
3 1 2 5
"""
HOUSE = """{mtl}
v 0 0 0
v 2 0 0
v 2 2 0
v 0 2 0
v 0 0 1
o walls
usemtl dark brick
f 1 2 3 4
usemtl tile
f 1 2 5
o back
usemtl dark brick
f 2 3 5
"""


def test_ctrl_c_within_a_parser_is_heard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: a parser of trimesh caught it as if a texture were damaged, and the mesh without it was kept."""
    loader = trimesh.load_scene

    def load(*arguments: Any, **settings: Any) -> Any:
        with contextlib.suppress(BaseException):
            signal.raise_signal(signal.SIGINT)
        return loader(*arguments, **settings)

    (tmp_path / "a.obj").write_text(HOUSE.format(mtl="# not in the cache"), encoding="utf-8")
    monkeypatch.setattr(trimesh, "load_scene", load)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it
    try:
        with pytest.raises(KeyboardInterrupt):
            read_mesh(tmp_path / "a.obj")
    finally:
        signal.signal(signal.SIGINT, before)


def coloured_box(name: str, colour: list[float]) -> trimesh.Trimesh:
    box = trimesh.creation.box(extents=(1, 2, 3))
    material = trimesh.visual.material.PBRMaterial(name=name, baseColorFactor=colour)
    box.visual = trimesh.visual.TextureVisuals(material=material)
    return box


@pytest.mark.parametrize("suffix", ["ply", "stl", "obj", "glb", "off"])
def test_a_box_in_every_format(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"box.{suffix}"
    trimesh.creation.box(extents=(1, 2, 3)).export(path)
    (piece,) = read_mesh(path)
    assert piece.vertices_m.dtype == np.float64
    np.testing.assert_allclose(piece.vertices_m.max(axis=0), [0.5, 1, 1.5])
    assert area_m2(piece.vertices_m, piece.faces) == pytest.approx(22)


def test_polygons_become_triangles(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_text(PENTAGON)
    (piece,) = read_mesh(tmp_path / "a.ply")
    assert piece.faces.shape == (4, 3)
    assert area_m2(piece.vertices_m, piece.faces) == pytest.approx(3 + 1.5)
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 2 0 0\nv 2 1 0\nv 1 2 0\nv 0 1 0\nf 1 2 3 4 5\nf -5 -4 -3 -1\n")
    (piece,) = read_mesh(tmp_path / "a.obj")
    assert area_m2(piece.vertices_m, piece.faces) == pytest.approx(3 + 2)


@pytest.mark.parametrize(
    ("plain", "odd"),
    [
        ("f 2 3 5", "  f 2 3 5"),
        ("f 2 3 5", "f\t2\t3 5"),
        ("f 2 3 5", "f 2 3 5 # the tip"),
        ("f 2 3 5", "f 2 \\\n3 5"),
        ("usemtl tile", "usemtl\ttile"),
        ("v 0 0 0", "\ufeffv 0 0 0"),
        ("\n", "\r"),
        ("\n", "\r\n"),
    ],
)
def test_an_obj_is_the_same_in_every_dialect(tmp_path: Path, plain: str, odd: str) -> None:
    text = HOUSE.format(mtl="").lstrip()
    assert plain in text
    (tmp_path / "plain.obj").write_text(text)
    (tmp_path / "odd.obj").write_bytes(text.replace(plain, odd).encode())
    pieces, others = (read_mesh(tmp_path / f"{name}.obj") for name in ("plain", "odd"))
    for piece, other in zip(pieces, others, strict=True):
        assert piece.keys[0] == other.keys[0]
        np.testing.assert_array_equal(piece.vertices_m[piece.faces], other.vertices_m[other.faces])


@pytest.mark.parametrize("mtl", ["", "mtllib none.mtl", "mtllib half.mtl"])
def test_obj_groups_keep_their_material_names(tmp_path: Path, mtl: str) -> None:
    """Groups keep them with no .mtl at all, with one that is not there, and with one that lacks a material."""
    (tmp_path / "half.mtl").write_text("newmtl tile\nKd 0.6 0.3 0.0\n")
    (tmp_path / "a.obj").write_text(HOUSE.format(mtl=mtl))
    pieces = {piece.keys[0]: piece for piece in read_mesh(tmp_path / "a.obj")}
    assert set(pieces) == {"dark brick", "tile"}
    assert area_m2(pieces["dark brick"].vertices_m, pieces["dark brick"].faces) == pytest.approx(4 + 5**0.5)
    assert area_m2(pieces["tile"].vertices_m, pieces["tile"].faces) == pytest.approx(1)
    assert pieces["dark brick"].grey is None
    assert pieces["tile"].grey == (pytest.approx(0.3, abs=0.002) if "half" in mtl else None)


def two_boxes() -> trimesh.Scene:
    """One geometry in two nodes, the second in the frame of the first."""
    scene = trimesh.Scene()
    turn = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 0, 1])
    turn[:3, 3] = [10, 0, 0]
    scene.add_geometry(coloured_box("paint", [0.2, 0.4, 0.6, 1.0]), node_name="a", geom_name="box", transform=turn)
    shift = trimesh.transformations.translation_matrix([5, 0, 0])
    scene.graph.update(frame_to="b", frame_from="a", matrix=shift, geometry="box")
    return scene


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_nodes_of_gltf_are_placed(tmp_path: Path, suffix: str) -> None:
    two_boxes().export(tmp_path / f"a.{suffix}")
    pieces = {piece.keys[-1]: piece for piece in read_mesh(tmp_path / f"a.{suffix}")}
    assert set(pieces) == {"a", "b"}
    for name, centre in (("a", [10, 0, 0]), ("b", [10, 5, 0])):
        vertices = pieces[name].vertices_m
        np.testing.assert_allclose((vertices.max(axis=0) + vertices.min(axis=0)) / 2, centre, atol=1e-6)
        np.testing.assert_allclose(np.ptp(vertices, axis=0), [2, 1, 3], atol=1e-6)
        assert pieces[name].keys == ("paint", "box", name)
        assert pieces[name].grey == pytest.approx(0.4, abs=0.002)


def test_nothing_is_printed(tmp_path: Path, run_python: Any) -> None:
    """Run in a Python of its own: pytest would catch what is logged. A texture that is not there makes trimesh talk."""
    (tmp_path / "a.obj").write_text(HOUSE.format(mtl="mtllib a.mtl"))
    (tmp_path / "a.mtl").write_text("newmtl tile\nmap_Kd none.png\nKd x y z\n")
    process = run_python(f"from lidarscene.scene.meshes.reading import *; read_mesh(Path({str(tmp_path / 'a.obj')!r}))")
    assert_ended(process, stdout="")


def test_a_buffer_that_is_not_there(tmp_path: Path) -> None:
    two_boxes().export(tmp_path / "a.gltf")
    for buffer in tmp_path.glob("*.bin"):
        buffer.unlink()
    assert json.loads((tmp_path / "a.gltf").read_text())["buffers"]
    with told("a.gltf | mesh"):
        read_mesh(tmp_path / "a.gltf")


@pytest.mark.parametrize("reference", ["mtllib", "map_Kd", "buffer", "image", "TextureFile"])
@pytest.mark.parametrize("kind", ["pipe", "zero"])
def test_a_mesh_that_refers_to_a_pipe_or_a_device(tmp_path: Path, reference: str, kind: str) -> None:
    """One line, and no wait: a pipe that nobody writes to never ends, and /dev/zero has no end."""
    target = tmp_path / ("part.mtl" if reference == "mtllib" else "part.png")
    if kind == "pipe":
        os.mkfifo(target)
    else:
        target.symlink_to("/dev/zero")
    if reference in ("mtllib", "map_Kd"):
        path = tmp_path / "a.obj"
        path.write_text(HOUSE.format(mtl=f"mtllib {'part.mtl' if reference == 'mtllib' else 'a.mtl'}"))
        (tmp_path / "a.mtl").write_text("newmtl tile\nmap_Kd part.png\n")
    elif reference == "TextureFile":
        path = tmp_path / "a.ply"
        lines = ["ply", "format ascii 1.0", "comment TextureFile part.png", "element vertex 3"]
        lines += [f"property float {axis}" for axis in "xyz"] + ["element face 1"]
        lines += ["property list uchar int vertex_indices", "end_header", "0 0 0", "1 0 0", "0 1 0", "3 0 1 2"]
        path.write_text("\n".join(lines) + "\n")
    else:
        path = tmp_path / "a.gltf"
        two_boxes().export(path)
        content = json.loads(path.read_text())
        if reference == "buffer":
            content["buffers"][0]["uri"] = "part.png"
        else:
            content |= {"images": [{"uri": "part.png"}], "textures": [{"source": 0}]}
            content["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
            for mesh in content["meshes"]:
                mesh["primitives"][0]["material"] = 0
        path.write_text(json.dumps(content))
    told = (
        pytest.warns(OptionWarning, match="images that are not there")
        if reference == "image"
        else contextlib.nullcontext()
    )
    with told, contextlib.suppress(InputError):  # a texture is left out, a buffer is needed
        assert read_mesh(path)
