"""Area of a triangle mesh."""

import numpy as np


def area_m2(vertices_m: np.ndarray, faces: np.ndarray) -> float:
    """Area of all triangles, of (n, 3) corners and (m, 3) indices."""
    a, b, c = (vertices_m[faces[:, i]] for i in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)
