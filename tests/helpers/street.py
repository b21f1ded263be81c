"""A small street without a back end: two cars, a wall that hides a part of one, a road; traced triangle by triangle."""

import numpy as np

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.formats.cloud_columns import SENSOR_TO_WORLD
from lidarscene.maths.pose import Pose
from lidarscene.scene.meshes.primitives import box_mesh, plane_mesh
from lidarscene.scene.scene import Body, Part, Scene

SENSOR = Pose.from_degrees(position_m=(3.0, -2.0, 1.8), yaw_deg=20.0, pitch_deg=-2.0)
CLASSES = ("road", "car", "barrier", "gantry")


def block(name: str, class_name: str, size_m: tuple[float, float, float], pose: Pose) -> Body:
    vertices, faces = box_mesh(size_m=size_m)
    return Body(
        name=name, class_name=class_name, parts=(Part(vertices_m=vertices, faces=faces, material="m"),), pose=pose
    )


def scene() -> Scene:
    """The near car is seen whole, the far one behind the wall, which is as wide as the car and half as high."""
    vertices, faces = plane_mesh(size_m=(80.0, 80.0))
    road = Body(name="road", class_name="road", parts=(Part(vertices_m=vertices, faces=faces, material="m"),))
    return Scene(
        name="street",
        bodies=(
            road,
            block("near", "car", (4.0, 2.0, 1.5), pose_at(12.0, -3.0, 0.75, 30.0)),
            block("far", "car", (4.4, 1.8, 1.6), pose_at(25.0, 9.0, 0.8, 110.0)),
            block("wall", "barrier", (0.2, 8.0, 0.9), pose_at(20.0, 5.5, 0.45, 20.0)),
        ),
    )


def pose_at(forward_m: float, left_m: float, up_m: float, yaw_deg: float) -> Pose:
    return Pose.from_degrees(position_m=(forward_m, left_m, up_m), yaw_deg=yaw_deg)


def cloud(
    frame: str = "world", *, step_deg: float = 0.4, described: Scene | None = None, sensor: Pose = SENSOR
) -> PointCloud:
    """What a lidar without noise sees of the scene, 60 by 24 degrees."""
    described = described or scene()
    azimuth, elevation = np.meshgrid(
        np.radians(np.arange(30.0, -30.01, -step_deg)), np.radians(np.arange(6.0, -18.01, -step_deg))
    )
    azimuth, elevation = azimuth.ravel(), elevation.ravel()
    directions = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
    )
    range_m, body = nearest(described, sensor.position_m, directions @ sensor.rotation.T)
    hit = np.flatnonzero(np.isfinite(range_m))
    row = np.searchsorted(-np.unique(elevation)[::-1], -elevation)
    points_m = directions[hit] * range_m[hit, None]
    metadata = {
        "sensor": "brute",
        "scene": described.name,
        "frame": frame,
        "intensity_unit": "A",
        SENSOR_TO_WORLD: words(np.column_stack([sensor.rotation, sensor.position_m])),
    }
    if frame == "world":
        points_m = sensor.apply(points_m)
        metadata |= {"sensor_position_m": words(sensor.position_m), "sensor_rotation": words(sensor.rotation)}
    names = list(dict.fromkeys(scene_body.class_name for scene_body in described.bodies))
    class_of = np.array([names.index(scene_body.class_name) for scene_body in described.bodies])
    n, zeros = len(hit), np.zeros(len(hit))
    columns = {
        "xyz_m": points_m.astype(np.float32),
        "range_m": range_m[hit],
        "intensity": 1e-6 / range_m[hit] ** 2,
        "snr": zeros + 50,
        "detection_probability": zeros + 1,
        "time_s": hit * 1e-5,
        "channel": row[hit],
        "azimuth_rad": azimuth[hit],
        "elevation_rad": elevation[hit],
        "return_number": np.ones(n),
        "status": zeros,
        "true_range_m": range_m[hit],
        "body": body[hit],
        "class_id": class_of[body[hit]],
    }
    return PointCloud(
        **(zero_columns(n) | columns),
        body_names=tuple(scene_body.name for scene_body in described.bodies),
        class_names=tuple(names),
        material_names=("m",),
        metadata=metadata,
    )


def zero_columns(n: int) -> dict[str, np.ndarray]:
    """Zeros for every attribute of a cloud, whatever columns there are."""
    from lidarscene.formats.cloud_columns import MEASURED, TRUTH

    return {a: np.zeros((n, 3) if a == "xyz_m" else n) for a in (*MEASURED, *TRUTH)}


def words(values: np.ndarray) -> str:
    return " ".join(repr(float(x)) for x in values.ravel())


def nearest(described: Scene, origin_m: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Range (inf without a hit) and body of each ray: Moeller and Trumbore's formula for every triangle."""
    best, body = np.full(len(direction), np.inf), np.full(len(direction), -1)
    for index, scene_body in enumerate(described.bodies):
        for part in scene_body.parts:
            assert isinstance(part, Part)
            corners = scene_body.pose.apply(part.vertices_m)[part.faces.astype(int)]
            for a, b, c in corners:
                t = triangle(origin_m, direction, a, b - a, c - a)
                nearer = t < best
                best[nearer], body[nearer] = t[nearer], index
    return best, body


def triangle(
    origin: np.ndarray, direction: np.ndarray, corner: np.ndarray, edge: np.ndarray, second_edge: np.ndarray
) -> np.ndarray:
    p = np.cross(direction, second_edge)
    determinant = p @ edge
    with np.errstate(divide="ignore", invalid="ignore"):
        s = origin - corner
        u = p @ s / determinant
        q = np.cross(s, edge)
        v = direction @ q / determinant
        t = second_edge @ q / determinant
        inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    return np.where(inside, t, np.inf)
