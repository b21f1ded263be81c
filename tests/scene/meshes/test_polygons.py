"""Polygons of more than three corners: concave ones are not filled, in any format, from any first corner."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.meshes import area_m2

from lidarscene.scene.meshes.mesh_objects import named_pieces
from lidarscene.scene.meshes.polygons import triangulate
from lidarscene.scene.meshes.reading import read_mesh

L = np.array([[10, -2, 0], [10, 2, 0], [10, 2, 2], [10, 0, 2], [10, 0, 4], [10, -2, 4]], float)
"""An L of 12 m2 in a square of 4 x 4 m, whose notch is at y > 0, z > 2."""

ARROW = np.array([[10, 0, 0], [10, 2, 4], [10, 0, 1], [10, -2, 4]], float)
"""A concave quad of 2 m2."""


def rows(values: np.ndarray) -> str:
    return "".join(" ".join(f"{value:g}" for value in row) + "\n" for row in values)


def write_obj(path: Path, corners: np.ndarray) -> None:
    """Texture coordinates for some of the polygon's corners, and indices that count from the end."""
    words = " ".join(f"{index - len(corners)}/1" for index in range(len(corners)))
    vertices = "".join(f"v {row}\n" for row in rows(corners).splitlines())
    path.write_text(f"{vertices}vt 0 0\nf {words} # a polygon\n")


def write_off(path: Path, corners: np.ndarray) -> None:
    count = len(corners)
    face = f"{count} {' '.join(map(str, range(count)))} 255 0 0\n"
    path.write_text(f"OFF\n# a polygon\n{count} 1 0\n{rows(corners)}{face}")


def ply_header(count: int, form: str, faces: int = 1) -> str:
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    of_faces = f"element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
    return f"ply\nformat {form} 1.0\nelement vertex {count}\n{axes}{of_faces}"


def write_ply(path: Path, corners: np.ndarray) -> None:
    count = len(corners)
    face = f"{count} {' '.join(map(str, range(count)))}\n"
    path.write_text(ply_header(count, "ascii") + rows(corners) + face)


def write_uniform_ply(path: Path, corners: np.ndarray) -> None:
    count = len(corners)
    face = bytes([count]) + np.arange(count, dtype="<i4").tobytes()
    path.write_bytes(ply_header(count, "binary_little_endian").encode() + corners.astype("<f4").tobytes() + face)


def write_mixed_ply(path: Path, corners: np.ndarray) -> None:
    """A triangle of no area comes after the polygon, so that the faces have different lengths."""
    count = len(corners)
    faces = bytes([count]) + np.arange(count, dtype=">i4").tobytes() + bytes([3]) + bytes(12)
    path.write_bytes(ply_header(count, "binary_big_endian", faces=2).encode() + corners.astype(">f4").tobytes() + faces)


def write_usda(path: Path, corners: np.ndarray) -> None:
    points = ", ".join(f"({x:g}, {y:g}, {z:g})" for x, y, z in corners)
    path.write_text(
        '#usda 1.0\n( metersPerUnit = 1\n  upAxis = "Z" )\ndef Mesh "l"\n{\n'
        f"    point3f[] points = [{points}]\n    int[] faceVertexCounts = [{len(corners)}]\n"
        f"    int[] faceVertexIndices = {list(range(len(corners)))}\n}}\n"
    )


WRITERS: dict[str, Callable[[Path, np.ndarray], None]] = {
    "a.obj": write_obj,
    "a.off": write_off,
    "a.ply": write_ply,
    "uniform.ply": write_uniform_ply,
    "mixed.ply": write_mixed_ply,
    "a.usda": write_usda,
}


def assert_covers(vertices: np.ndarray, faces: np.ndarray, area: float, notch: tuple[float, float]) -> None:
    """The triangles have the polygon's area, which they could have twice in one place, and none is in the notch."""
    assert area_m2(vertices, faces) == pytest.approx(area, rel=1e-6)
    middles = vertices[faces[np.ptp(faces, axis=1) > 0]].mean(axis=1)
    assert not ((middles[:, 1] > notch[0]) & (middles[:, 2] > notch[1])).any()


@pytest.mark.parametrize("name", WRITERS)
def test_an_l_has_its_notch_from_any_first_corner(tmp_path: Path, name: str) -> None:
    if name.endswith("usda"):
        pytest.importorskip("pxr")
    for first in range(6):
        for way in (1, -1):
            path = tmp_path / f"{first}{way}{name}"
            WRITERS[name](path, np.roll(L, first, axis=0)[::way])
            (piece,) = read_mesh(path)
            assert_covers(piece.vertices_m, piece.faces, 12.0, (0.0, 2.0))


@pytest.mark.parametrize("name", WRITERS)
def test_a_concave_quad(tmp_path: Path, name: str) -> None:
    if name.endswith("usda"):
        pytest.importorskip("pxr")
    for first in range(4):
        WRITERS[name](tmp_path / f"{first}{name}", np.roll(ARROW, first, axis=0))
        (piece,) = read_mesh(tmp_path / f"{first}{name}")
        assert_covers(piece.vertices_m, piece.faces, 2.0, (-0.5, 3.9))


def test_quads_of_arrays() -> None:
    for first in range(4):
        ((_, piece),) = named_pieces((np.roll(ARROW, first, axis=0), [[0, 1, 2, 3]]), "scene.add")
        assert area_m2(piece.vertices_m, piece.faces) == pytest.approx(2.0)


def test_convex_polygons_are_fans() -> None:
    """The fan is around the first corner, in the file's order; polygons of fewer than three corners are nothing."""
    vertices = np.array([[0, 0, 0], [2, 0, 0], [3, 1, 0], [2, 2, 0], [0, 2, 0]], float)
    counts, corners = np.array([5, 2, 3, 4]), np.array([0, 1, 2, 3, 4, 0, 1, 2, 1, 0, 0, 1, 3, 4])
    triangles, polygon = triangulate(vertices, counts, corners)
    assert corners[triangles].tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4], [2, 1, 0], [0, 1, 3], [0, 3, 4]]
    assert polygon.tolist() == [0, 0, 0, 2, 3, 3]


@pytest.mark.parametrize("size", [7, 40])
def test_a_star_in_any_plane(size: int) -> None:
    """Corners at random distances around a middle: the area is the sum of the slices', and no triangle is turned.

    One corner lies in each slice: free angles leave half of the turn empty in one draw of nine; then edges can cross.
    """
    rng = np.random.default_rng(size)
    angle, radius = 2 * np.pi * (np.arange(size) + rng.uniform(0, 1, size)) / size, rng.uniform(0.1, 1, size)
    flat = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1)
    turned = flat @ np.linalg.qr(rng.normal(size=(3, 3)))[0] + [100, 20, 3]
    triangles, _ = triangulate(turned, np.array([size]), np.arange(size))
    slices = radius * np.roll(radius, -1) * np.sin(np.roll(angle, -1) - angle)
    assert area_m2(turned, triangles) == pytest.approx(slices.sum() / 2, rel=1e-9)
    a, b, c = (flat[triangles[:, i], :2] for i in range(3))
    assert ((b - a)[:, 0] * (c - a)[:, 1] > (b - a)[:, 1] * (c - a)[:, 0]).all()


def test_a_hole_that_a_bridge_joins_to_the_edge_stays_open() -> None:
    corners = np.array([[0, 0], [4, 0], [4, 4], [0, 4], [0, 0], [1, 1], [1, 3], [3, 3], [3, 1], [1, 1]], float)
    corners = np.column_stack([corners, np.zeros(10)])
    triangles, _ = triangulate(corners, np.array([10]), np.arange(10))
    assert area_m2(corners, triangles) == pytest.approx(12.0)


def test_triangles_have_the_colour_of_their_polygon(tmp_path: Path) -> None:
    """A red arrow, of two triangles, and a black triangle."""
    colours = "".join(f"property uchar {colour}\n" for colour in ("red", "green", "blue"))
    header = ply_header(4, "ascii", faces=2).replace("end_", f"{colours}end_")
    (tmp_path / "a.ply").write_text(header + rows(ARROW) + "4 0 1 2 3 255 0 0\n3 0 1 2 0 0 9\n")
    (piece,) = read_mesh(tmp_path / "a.ply", "colour")
    assert piece.pattern is not None
    assert piece.pattern.values[piece.faces].tolist() == [[1.0] * 3, [1.0] * 3, [0.0] * 3]


def test_textures_of_polygons_stay_where_they_were(tmp_path: Path) -> None:
    """A PLY file with coordinates of its vertices in an image, and an L."""
    axes = "".join(f"property float {axis}\n" for axis in ("x", "y", "z", "s", "t"))
    header = (
        "ply\nformat ascii 1.0\ncomment TextureFile a.png\nelement vertex 6\n" + axes
    ) + "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    uv = L[:, 1:] / 4.0
    (tmp_path / "a.ply").write_text(header + rows(np.column_stack([L, uv])) + "6 0 1 2 3 4 5\n")
    from PIL import Image

    Image.new("RGB", (2, 2), (255, 0, 0)).save(tmp_path / "a.png")
    (piece,) = read_mesh(tmp_path / "a.ply", "colour")
    assert_covers(piece.vertices_m, piece.faces, 12.0, (0.0, 2.0))
    assert piece.pattern is not None
    assert piece.pattern.uv is not None
    np.testing.assert_allclose(piece.pattern.uv * (1, -1) + (0, 1), piece.vertices_m[:, 1:] / 4.0, atol=1e-6)
