"""Primitives: closed, outward and of exact size."""

import numpy as np
import pytest
import trimesh

from lidarscene.scene.meshes import primitives

SOLIDS = {
    "box": (primitives.box_mesh(size_m=(1.0, 2.0, 3.0)), (1, 2, 3), 6.0),
    "long box": (primitives.box_mesh(size_m=(50.0, 0.3, 33.3)), (50, 0.3, 33.3), 50 * 0.3 * 33.3),
    "cylinder": (primitives.cylinder_mesh(radius_m=0.5, height_m=2.0), (1, 1, 2), np.pi / 2),
    "tall cylinder": (primitives.cylinder_mesh(radius_m=2.0, height_m=40.0), (4, 4, 40), np.pi * 160),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_solids_are_closed_outward_and_of_exact_size(name: str) -> None:
    """Volume: exact for boxes; a cylinder's 64 flats enclose sin(2 pi / 64) / (2 pi / 64) of the circle."""
    (vertices, faces), size_m, volume_m3 = SOLIDS[name]
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    step = 2 * np.pi / 64
    expected = volume_m3 * (np.sin(step) / step if "cylinder" in name else 1.0)
    assert mesh.volume == pytest.approx(expected, rel=1e-12)
    np.testing.assert_allclose(mesh.bounds, np.array([[-0.5], [0.5]]) * size_m, rtol=1e-15)
    assert mesh.area_faces.min() > 0


@pytest.mark.parametrize("size_m", [(1.0, 2.0), (100.0, 7.0)])
def test_plane_faces_up(size_m: tuple[float, float]) -> None:
    vertices, faces = primitives.plane_mesh(size_m=size_m)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    np.testing.assert_allclose(mesh.face_normals, np.tile([0.0, 0.0, 1.0], (len(faces), 1)), atol=1e-15)
    np.testing.assert_allclose(mesh.bounds, [[-size_m[0] / 2, -size_m[1] / 2, 0], [size_m[0] / 2, size_m[1] / 2, 0]])
    assert mesh.area == pytest.approx(size_m[0] * size_m[1])


def test_large_primitives_are_cut_but_not_without_end() -> None:
    vertices, faces = primitives.plane_mesh(size_m=(100.0, 7.0))
    assert np.ptp(vertices[faces], axis=1).max() <= primitives.LARGEST_EDGE_M
    assert len(primitives.plane_mesh(size_m=(1e6, 1.0))[1]) == 2 * primitives.MOST_CUTS
