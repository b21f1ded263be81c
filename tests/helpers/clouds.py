"""Small clouds with every column different, and equality to the bit."""

from typing import Any

import numpy as np

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.formats.cloud_columns import COLUMNS, MEASURED, TRUTH, columns_of

NAMES: dict[str, tuple[str, ...]] = {
    "sensor_names": ("roof", "left"),
    "body_names": ("road", "Käfer\nrot", "sign end_header"),
    "class_names": ("road", "car"),
    "material_names": ("asphalt", "paint texturefile.png"),
}


def small_columns(n: int = 7, *, truth: bool = True, seed: int = 1) -> dict[str, Any]:
    """Arrays by attribute: every column different, with the extremes that are legal."""
    rng = np.random.default_rng(seed)
    columns: dict[str, Any] = {"xyz_m": rng.normal(0, 30, (n, 3)).astype(np.float32)}
    for c in columns_of(truth=True, vectors=False)[3:]:
        if c.dtype.startswith("float"):
            columns[c.attribute] = rng.random(n).astype(c.dtype)
        else:
            columns[c.attribute] = rng.integers(0, 2, n).astype(c.dtype)
    columns["true_range_m"][::3] = np.inf
    for name in ("body", "class_id", "material"):
        columns[name][::3] = -1
    return columns if truth else {a: v for a, v in columns.items() if a not in TRUTH}


def chunk_of(n: int, *, velocity: float = 0.0) -> dict[str, Any]:
    """Points of a chunk as the simulator hands them over where nothing moves and there is no glass."""
    absent = {c.attribute: np.dtype(c.dtype).type(c.absent) for c in COLUMNS if c.absent is not None}
    absent["radial_velocity_m_s"] = np.float32(velocity)
    return small_columns(n) | {name: np.broadcast_to(value, n) for name, value in absent.items()}


def small_cloud(n: int = 7, *, truth: bool = True, seed: int = 1, **changes: Any) -> PointCloud:
    metadata = {"sensor": "test", "frame": "sensor", "seed": "7"}
    return PointCloud(**(small_columns(n, truth=truth, seed=seed) | NAMES | {"metadata": metadata} | changes))


def assert_same_columns(a: PointCloud, b: PointCloud) -> None:
    """Every column of the first equal to the bit."""
    for column in a.columns:
        np.testing.assert_array_equal(a.column(column.name), b.column(column.name), err_msg=column.name)


def assert_same(a: PointCloud, b: PointCloud) -> None:
    """Every array equal to the bit, dtype included, and all text."""
    assert a.has_truth == b.has_truth
    for attribute in MEASURED + (TRUTH if a.has_truth else ()):
        np.testing.assert_array_equal(getattr(a, attribute), getattr(b, attribute), strict=True)
    assert {n: getattr(a, n) for n in NAMES} == {n: getattr(b, n) for n in NAMES}
    assert a.metadata == b.metadata
