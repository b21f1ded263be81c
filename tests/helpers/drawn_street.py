"""A street of boxes as a raster sees it, without tracing."""

from typing import Any

import numpy as np

from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.formats.cloud_columns import MEASURED, TRUTH

BOXES = (  # low and high corner in metres, z from the sensor, 1.8 m above the road
    ((14.0, 2.0, -1.5), (18.2, 3.8, -0.3)),
    ((15.0, 2.1, -0.3), (17.4, 3.7, 0.1)),
    ((24.0, -4.4, -1.5), (28.4, -2.6, -0.3)),
    ((25.2, -4.3, -0.3), (27.6, -2.7, 0.0)),
    ((9.0, -6.0, -1.8), (9.5, -5.5, 0.0)),
    ((5.0, 11.0, -1.8), (60.0, 16.0, 4.0)),
    ((40.0, -14.0, -1.8), (55.0, -9.0, 6.0)),
)


def street(*, step_deg: float = 0.5, alarms: int = 20, seed: int = 3) -> PointCloud:
    """A road with cars, a post, a ball and houses, by brute force: every beam against every body."""
    azimuth_grid, elevation_grid = np.meshgrid(
        np.radians(np.arange(-60, 60, step_deg) + step_deg / 2), np.radians(np.arange(-25, 10, step_deg) + step_deg / 2)
    )
    azimuth, elevation = azimuth_grid.ravel(), elevation_grid.ravel()
    beam = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    nearest, body, cosine = (np.full(azimuth.shape, np.inf), np.full(azimuth.shape, -1), np.zeros(azimuth.shape))

    def meet(t: Any, k: int, cos: Any) -> None:
        better = (t > 0) & (t < nearest)
        nearest[better], body[better], cosine[better] = t[better], k, np.broadcast_to(cos, t.shape)[better]

    with np.errstate(divide="ignore"):
        meet(-1.8 / beam[2], 0, -beam[2])
        for k, (low, high) in enumerate(BOXES, start=1):
            sides = np.sort([np.array(low)[:, None] / beam, np.array(high)[:, None] / beam], axis=0)
            enter = sides[0].max(axis=0)
            cos = np.abs(np.take_along_axis(beam, sides[0].argmax(axis=0)[None], axis=0)[0])
            meet(np.where(enter < sides[1].min(axis=0), enter, np.inf), k, cos)
    along = np.array([12.0, -1.5, -1.1]) @ beam
    discriminant = along**2 - (12.0**2 + 1.5**2 + 1.1**2 - 0.7**2)
    meet(
        np.where(discriminant > 0, along - np.sqrt(np.maximum(discriminant, 0)), np.inf),
        len(BOXES) + 1,
        np.sqrt(np.maximum(discriminant, 0)) / 0.7,
    )
    rng = np.random.default_rng(seed)
    true = nearest
    alarm = np.zeros(len(true), bool)
    alarm[rng.choice(len(true), alarms, replace=False)] = True
    reported = np.where(alarm, rng.uniform(2, 150, len(true)), true + rng.normal(0, 0.015, len(true)))
    in_range = alarm | (true < 120)
    material = np.array([0, 1, 1, 2, 2, 3, 4, 4, 5, -1])[body]
    reflectivity = np.array([0.12, 0.5, 0.08, 0.8, 0.35, 0.6, 0.0])[material]
    snr = np.where(np.isfinite(true), reflectivity * cosine * 2e6 / np.maximum(true, 1) ** 2, 0) + 5
    columns: dict[str, Any] = dict.fromkeys((*MEASURED, *TRUTH), np.zeros(len(true))) | {
        "xyz_m": (beam * reported).T.astype(np.float32),
        "range_m": reported,
        "intensity": snr * 1e-9,
        "snr": snr,
        "pulse_width_s": 1e-8 * np.ones(len(true)),
        "detection_probability": 1 - np.exp(-snr / 10),
        "time_s": np.arange(len(true)) * 2e-5,
        "channel": np.arange(len(true)) % 16,
        "azimuth_rad": azimuth,
        "elevation_rad": elevation,
        "return_number": np.ones(len(true)),
        "status": alarm,
        "true_range_m": true,
        "incidence_angle_rad": np.arccos(np.clip(cosine, 0, 1)),
        "reflectivity": reflectivity,
        "sun_angle_rad": np.full(len(true), 0.5),
        "body": body,
        "class_id": np.array([0, 1, 1, 1, 1, 2, 3, 3, 4, -1])[body],
        "material": material,
    }
    return PointCloud(
        **{name: values[in_range] for name, values in columns.items()},
        body_names=("road", "car", "cabin", "van", "van cabin", "post", "house", "block", "ball"),
        class_names=("road", "vehicle", "post", "building", "ball"),
        material_names=("asphalt", "white paint", "black paint", "steel", "brick", "rubber"),
        metadata={"scene": "scenes/street.toml", "sensor": "raster-test", "intensity_unit": "A"},
    )
