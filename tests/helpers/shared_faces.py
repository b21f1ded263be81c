"""Points of a frame that lie on faces of two bodies."""

import numpy as np

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.scene.scene import Part, Scene

NEAR_M = 1e-4
"""As near to a face as single precision puts a point that is on it."""

_TOGETHER = 64


def on_another_body(scene: Scene, cloud: PointCloud) -> np.ndarray:
    """(n,) number of a body that stands still, other than a point's own, on a face of which the point lies; else -1.

    Args:
        cloud: in world coordinates, of a sensor that stands still
    """
    beam = cloud.xyz_m - scene.sensor_pose.position_m
    beam /= np.linalg.norm(beam, axis=1, keepdims=True)
    places = cloud.xyz_m + beam * (cloud.true_range_m - cloud.range_m).astype(np.float64)[:, None]
    other = np.full(len(cloud), -1)
    for number, body in enumerate(scene.bodies):
        meshes = [part for part in body.parts if isinstance(part, Part)]
        if body.motion is not None or not meshes:
            continue
        triangles = np.concatenate([body.pose.apply(part.vertices_m)[part.faces] for part in meshes])
        low, high = triangles.min(axis=(0, 1)) - NEAR_M, triangles.max(axis=(0, 1)) + NEAR_M
        near = np.flatnonzero((cloud.body != number) & ((places >= low) & (places <= high)).all(axis=1))
        for some in np.split(near, np.arange(_TOGETHER, len(near), _TOGETHER)):
            if len(some):
                other[some[_on_faces(places[some], triangles)]] = number
    return other


def _on_faces(points_m: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Numbers of those of (n, 3) points that lie on one of (m, 3, 3) triangles."""
    low, high = points_m.min(axis=0) - NEAR_M, points_m.max(axis=0) + NEAR_M
    corners = triangles[((triangles.min(axis=1) <= high) & (triangles.max(axis=1) >= low)).all(axis=1)]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    corners, normal = corners[area > 0.0], normal[area > 0.0] / area[area > 0.0, None]
    height_m = points_m @ normal.T - np.einsum("mi,mi->m", corners[:, 0], normal)
    point, triangle = np.nonzero(np.abs(height_m) < NEAR_M)
    inside = np.ones(len(point), dtype=bool)
    for corner in range(3):
        edge = corners[triangle, (corner + 1) % 3] - corners[triangle, corner]
        inwards = np.cross(normal[triangle], edge / np.linalg.norm(edge, axis=1, keepdims=True))
        inside &= np.einsum("ki,ki->k", inwards, points_m[point] - corners[triangle, corner]) > -NEAR_M
    return np.unique(point[inside])
