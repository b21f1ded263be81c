"""Range images of KITTI's frames beside those of generated ones, for the eye.

    python benchmarks/beside_kitti.py FOLDER -o out/beside_kitti.png

FOLDER has frames NNNNNN.bin of KITTI's HDL-64E, such as data/object/training/velodyne of kuixu/kitti_object_vis, which
are not shipped: neither they nor pictures of them belong in this repository (CC BY-NC-SA 3.0). The picture has two
strips for each frame: range on a logarithmic scale, and intensity. Below are as many frames of an `hdl-64e`, each in a
street of another seed.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from lidarscene import load_scene, load_sensor
from lidarscene.recordings.point_files import rows_of
from lidarscene.rendering.simulator import Simulator

Array = np.ndarray

ROWS_DEG = np.concatenate([np.arange(32) / 3.0 - 8.333, np.arange(32) / 2.0 - 24.33])
"""Elevations of the upper and lower block, by the manual; bent beams of single sensors are 0.2 degrees off."""
HALF_DEG, COLUMN_DEG = 60.0, 0.1
"""Half of what is shown, around the way ahead, and width of a column."""
RANGES_M, PERCENT = (2.5, 80.0), 97.0
"""Ranges that are black and white, and share of a frame's intensities below white: scales differ."""
BEGIN_S = 12.0
"""Time by which the vehicle drives, and has passed the first houses."""


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description="draw KITTI's range images beside generated ones")
    parser.add_argument("folder", type=Path, help="folder of KITTI's NNNNNN.bin")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/beside_kitti.png"))
    arguments = parser.parse_args()
    paths = sorted(arguments.folder.glob("*.bin"))
    if not paths:
        parser.error(f"{arguments.folder}: must have files NNNNNN.bin, got none")
    strips = [strip for rows in (*map(recorded, paths), *generated(len(paths))) for strip in strips_of(rows)]
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.concatenate(strips)).save(arguments.output)


def recorded(path: Path) -> Array:
    """Read x, y, z and intensity of KITTI's points."""
    try:
        return np.column_stack(list(rows_of(path, ("x", "y", "z", "intensity")).values()))
    except ValueError as error:
        raise SystemExit(f"{path}: {error}") from None


def generated(count: int) -> Iterator[Array]:
    """Yield x, y, z and intensity of frames in streets of seeds 1, 2, ..."""
    for seed in range(1, count + 1):
        changes = [f"street.seed={seed}", "street.loop=false", "street.bend_spacing_m=[20, 80]"]
        cloud = Simulator(load_scene("town", overrides=changes), load_sensor("hdl-64e")).render(
            begin_s=BEGIN_S, coordinates="sensor"
        )
        yield np.column_stack([cloud.xyz_m, cloud.intensity])[cloud.range_m > 0.0]


def strips_of(rows: Array) -> Iterator[Array]:
    """Yield images of range and intensity, nearest points first, with a black line below each."""
    x_m, y_m, z_m, intensity = rows[np.argsort(-np.hypot(*rows[:, :2].T))].astype(float).T
    range_m, azimuth_deg = np.hypot(np.hypot(x_m, y_m), z_m), np.degrees(np.arctan2(y_m, x_m))
    line = np.abs(np.degrees(np.arcsin(z_m / range_m))[:, None] - np.sort(ROWS_DEG)[::-1]).argmin(axis=1)
    column = np.floor((HALF_DEG - azimuth_deg) / COLUMN_DEG).astype(int)
    shown = np.abs(azimuth_deg) < HALF_DEG
    near, far = np.log(RANGES_M)
    for value in ((np.log(range_m) - near) / (far - near), intensity / np.percentile(intensity[shown], PERCENT)):
        image = np.zeros((len(ROWS_DEG), round(2.0 * HALF_DEG / COLUMN_DEG)), np.uint8)
        image[line[shown], column[shown]] = 20 + 235 * np.clip(value[shown], 0.0, 1.0)
        # A beam's 0.17 degrees are two columns in places.
        gap = image == 0
        image[:, 1:] += np.where(gap[:, 1:] & ~gap[:, :-1], image[:, :-1], 0).astype(np.uint8)
        yield np.pad(np.repeat(image, 3, axis=0), ((0, 6), (0, 0)))


if __name__ == "__main__":
    main()
