"""Reflectivity and colours of mesh files: where each format keeps them, and what they become."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.scene_text import scene_of
from PIL import Image

from lidarscene.scene.meshes import reflectivity_patterns
from lidarscene.scene.meshes.reading import read_mesh

CORNERS = [[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]]
FACES = [[0, 1, 2], [0, 2, 3]]


def ply(*, of_vertices="", of_faces="", vertices=("", "", "", ""), faces=("", "")) -> str:
    head = "".join(
        f"property {declaration}\n"
        for declaration in ("float x", "float y", "float z", *of_vertices.split(","))
        if declaration
    )
    more = "".join(f"property {declaration}\n" for declaration in of_faces.split(",") if declaration)
    rows = [" ".join(map(str, corner)) + " " + value for corner, value in zip(CORNERS, vertices, strict=True)]
    rows += ["3 " + " ".join(map(str, face)) + " " + value for face, value in zip(FACES, faces, strict=True)]
    return (
        f"ply\nformat ascii 1.0\nelement vertex 4\n{head}element face 2\nproperty list uchar int vertex_indices\n"
        f"{more}end_header\n" + "\n".join(rows) + "\n"
    )


def one_piece(path: Path, kind: reflectivity_patterns.Kind):
    (piece,) = read_mesh(path, kind)
    return piece


@pytest.mark.parametrize("name", reflectivity_patterns.NAMES)
def test_property_of_vertices(tmp_path: Path, name: str) -> None:
    (tmp_path / "a.ply").write_text(ply(of_vertices=f"float {name}", vertices=("0.1", "0.2", "0.3", "0.4")))
    piece = one_piece(tmp_path / "a.ply", "reflectivity")
    np.testing.assert_allclose(piece.pattern.values, [0.1, 0.2, 0.3, 0.4], rtol=1e-6)
    assert len(piece.vertices_m) == 4
    assert one_piece(tmp_path / "a.ply", None).pattern is None


def test_property_of_faces(tmp_path: Path) -> None:
    """Each triangle keeps its place, its order and its value: it has three vertices of its own."""
    (tmp_path / "a.ply").write_text(ply(of_faces="float reflectivity", faces=("0.25", "0.75")))
    piece = one_piece(tmp_path / "a.ply", "reflectivity")
    np.testing.assert_array_equal(piece.vertices_m[piece.faces], np.array(CORNERS, float)[FACES])
    np.testing.assert_array_equal(piece.pattern.values[piece.faces], [[0.25] * 3, [0.75] * 3])


def test_binary_ply_and_gltf_attribute(tmp_path: Path) -> None:
    box = trimesh.Trimesh(CORNERS, FACES, process=False)
    box.vertex_attributes["reflectivity"] = np.linspace(0, 1, 4, dtype=np.float32)
    box.export(tmp_path / "a.ply", encoding="binary", vertex_normal=False)
    box.vertex_attributes = {"_REFLECTIVITY": np.linspace(0, 1, 4, dtype=np.float32)}
    box.export(tmp_path / "a.glb")
    for name in ("a.ply", "a.glb"):
        pattern = one_piece(tmp_path / name, "reflectivity").pattern
        np.testing.assert_allclose(pattern.values, np.linspace(0, 1, 4), rtol=1e-6)


@pytest.mark.parametrize(("suffix", "half"), [("ply", 0.2158605), ("glb", 128 / 255)])
def test_vertex_colours(tmp_path: Path, suffix: str, half: float) -> None:
    """Colours of PLY are sRGB (128 is 21.6 % of the light, IEC 61966-2-1), COLOR_0 of glTF is linear. Red counts."""
    box = trimesh.Trimesh(CORNERS, FACES, process=False)
    box.visual.vertex_colors = [[0, 90, 9, 255], [128, 0, 0, 255], [255, 0, 0, 255], [128, 255, 255, 255]]
    box.export(tmp_path / f"a.{suffix}")
    pattern = one_piece(tmp_path / f"a.{suffix}", "colour").pattern
    np.testing.assert_allclose(pattern.values, [0.0, half, 1.0, half], rtol=1e-6)


def write_textured_quad(path: Path) -> None:
    """A quad of 2 m by 1 m, whose image is white at the top left, half red at the bottom right, else black."""
    image = np.zeros((2, 2, 3), np.uint8)
    image[0, 0], image[1, 1] = 255, (255, 0, 0)
    material = trimesh.visual.material.PBRMaterial(
        name="brick", baseColorTexture=Image.fromarray(image), baseColorFactor=[128, 255, 255, 255]
    )
    quad = trimesh.Trimesh(CORNERS, FACES, process=False)
    quad.visual = trimesh.visual.TextureVisuals(uv=[[0, 0], [1, 0], [1, 1], [0, 1]], material=material)
    quad.export(path)


def test_texture(tmp_path: Path) -> None:
    """The image's red in linear light, times the base colour's; corners of the quad where the image has them."""
    write_textured_quad(tmp_path / "a.glb")
    pattern = one_piece(tmp_path / "a.glb", "colour").pattern
    np.testing.assert_allclose(pattern.values, np.array([[1.0, 0.0], [0.0, 1.0]]) * 128 / 255, rtol=1e-6)
    np.testing.assert_array_equal(pattern.uv, [[0, 1], [1, 1], [1, 0], [0, 0]])


def test_linear_light() -> None:
    """IEC 61966-2-1, both pieces of its curve."""
    np.testing.assert_allclose(
        reflectivity_patterns.srgb_to_linear(np.array([0.0, 0.04, 0.5, 1.0])), [0, 0.0030960, 0.2140411, 1], rtol=1e-5
    )


SCENE = """
[[bodies]]
name = "wall"
mesh = "{mesh}"
material = "{material}"
pattern = "{pattern}"
"""


def scene(folder: Path, **values: str):
    return scene_of(folder, SCENE.format(**values))


def test_mean_of_a_scene_is_by_area(tmp_path: Path) -> None:
    """Two faces of equal area, 1 m2 each, of which one is black: the mean is half of the other's red."""
    colours = "uchar red,uchar green,uchar blue"
    (tmp_path / "a.ply").write_text(ply(of_faces=colours, faces=("255 0 0", "0 255 0")))
    (body,) = scene(tmp_path, mesh="a.ply", material="brick", pattern="colour").bodies
    assert body.parts[0].pattern.mean == pytest.approx(0.5)


def test_the_pieces_of_the_srgb_curve_meet() -> None:
    """IEC 61966-2-1: at 0.04045 a line gives way to a power; 0.1 and 0.3 are on the power."""
    linear = reflectivity_patterns.srgb_to_linear(np.array([0.04044, 0.04046, 0.1, 0.3]))
    np.testing.assert_allclose(linear, [0.0031300, 0.0031316, 0.0100228, 0.0732390], rtol=2e-5)


def test_a_large_triangle_counts_for_more() -> None:
    """Two right triangles, of 2 and 8 m2 or mm2, with values of 0.1 and 0.6 all over. No area has no mean."""
    vertices = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [9, 0, 0], [13, 0, 0], [9, 4, 0]], float)
    pattern = reflectivity_patterns.ReflectivityPattern(kind="reflectivity", values=np.repeat([0.1, 0.6], 3))
    for scale, mean in ((1.0, (2 * 0.1 + 8 * 0.6) / 10), (1e-3, (2 * 0.1 + 8 * 0.6) / 10), (0.0, 0.0)):
        patterns = [(pattern, scale * vertices, np.arange(6).reshape(2, 3))]
        assert reflectivity_patterns.mean_over_surface(patterns) == pytest.approx(mean)
