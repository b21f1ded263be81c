"""Range images: a PointCloud in, images of ring by azimuth out, one pixel per beam, as PNG or NPZ.

Rows run from the highest elevation down, columns from the left to the right. Of several points of one beam the
first return is shown.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..cloud.builder import CloudBuilder
from ..cloud.pixels import OPTIONAL, images
from ..cloud.point_cloud import PointCloud
from ..errors import InputError
from ..files.atomic import atomic_output, put_arrays
from ..files.encodings.png import encode_png
from ..formats.cloud_description import unit_of
from ..maths.arrays import Numbers

RANGE_STEP_M = 0.01
"""Choice: step of a 16-bit range, which ends at 655.35 m."""

SUFFIXES = (".png", ".npz")


@contextmanager
def range_image_stream(path: str | os.PathLike[str]) -> Iterator[Callable[[PointCloud], None]]:
    """Write the images of the clouds (at least one) that are appended in the block; other columns are dropped."""
    builder = CloudBuilder()
    yield lambda cloud: builder.add(_image_columns(cloud))
    write_range_image(path, PointCloud(**builder.fields()))


def write_range_image(path: str | os.PathLike[str], cloud: PointCloud) -> tuple[Path, ...]:
    """Write all images and return the files: one NPZ, or a 16-bit PNG for each image."""
    arrays = images(cloud)
    files = range_image_paths(path, cloud)
    if files[0].suffix.lower() == ".npz":
        put_arrays(files[0], arrays)
        return files
    for name, file in zip(arrays, files, strict=False):
        levels, unit = _levels(arrays[name], name, cloud)
        with atomic_output(file) as temporary:
            temporary.write_bytes(encode_png(levels, text={"Title": name, "Description": f"one step is {unit}"}))
    return files


def range_image_paths(path: str | os.PathLike[str], cloud: PointCloud | None = None) -> tuple[Path, ...]:
    """Files of `write_range_image`: F.png is the range, F.intensity.png and so on are the others."""
    file = Path(path)
    if file.suffix.lower() not in SUFFIXES:
        raise InputError(f"{file}: the name must end in {' or '.join(SUFFIXES)}")
    if file.suffix.lower() == ".npz":
        return (file,)
    columns = () if cloud is None else tuple(c.name for c in cloud.columns)
    names = ["intensity", *(name for name in OPTIONAL if name in columns), "status"]
    return (file, *(file.with_name(f"{file.stem}.{name}{file.suffix}") for name in names))


def all_range_image_paths(path: str | os.PathLike[str]) -> tuple[Path, ...]:
    """Files that `write_range_image` may write, whatever columns the cloud has."""
    file, *always = range_image_paths(path)
    optional = [file.with_name(f"{file.stem}.{name}{file.suffix}") for name in OPTIONAL] if always else []
    return (file, *always, *optional)


def _image_columns(cloud: PointCloud) -> PointCloud:
    """Same points; each column that no image needs is one number, repeated by a stride of 0."""
    needed = {"azimuth", "elevation", "return_number", "range", "intensity", "status", *OPTIONAL}
    measured = cloud.without_truth()
    repeated: dict[str, Any] = {}
    for column in measured.columns:
        if column.name not in needed:
            values = getattr(measured, column.attribute)
            # A cloud needs all columns; a broadcast number takes no memory.
            repeated[column.attribute] = np.broadcast_to(values.dtype.type(0), values.shape)
    return dataclasses.replace(measured, **repeated)


def _levels(image: Numbers, name: str, cloud: PointCloud) -> tuple[Numbers, str]:
    """16-bit levels of an image, and text for the size of one step."""
    if image.dtype.kind != "f":
        return image.astype(np.uint16), "1"
    step, unit = RANGE_STEP_M, "m"
    # Ranges have a fixed step, so that images compare. Others are scaled to their own largest value.
    if name != "range":
        step, unit = float(image.max(initial=0.0)) / 65535.0 or 1.0, unit_of(cloud, name)
    return np.rint(image.astype(np.float64) / step).clip(0, 65535).astype(np.uint16), f"{step!r} {unit}"
