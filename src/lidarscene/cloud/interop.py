"""Conversion of point clouds for pandas, PyTorch and Open3D, and their display in notebooks.

None of these libraries is a dependency. Each is imported in the function that needs it, and shares the cloud's memory
where it can.
"""

from __future__ import annotations

import base64
import html
import warnings
from typing import Any

import numpy as np

from ..files.encodings.png import encode_png
from ..files.open3d import open3d
from ..files.optional import import_optional
from ..formats.category_array import CategoryArray
from ..formats.cloud_columns import Cloud
from ..maths.arrays import Numbers
from .pixels import camera_for, eye_dome_picture, splat, unpack_rgb

THUMBNAIL_PX = (720, 405)
BACKGROUND = (11, 14, 20)
NEAR, MIDDLE, FAR = (255, 214, 102), (70, 190, 190), (72, 76, 160)
"""Colours of the nearest, the middle and the farthest points of a thumbnail."""


def to_pandas(cloud: Cloud) -> Any:
    """See `PointCloud.to_pandas`."""
    pandas = import_optional("pandas", extra="pandas")
    frame = pandas.DataFrame(
        {column.name: _series(pandas, cloud.column(column.name)) for column in cloud.columns}, copy=False
    )
    frame.attrs.update(cloud.metadata)
    return frame


def _series(pandas: Any, values: Numbers) -> Any:
    """Values of a column; those with names as categories."""
    if not isinstance(values, CategoryArray) or not values.has_names:
        return np.asarray(values)
    return pandas.Categorical.from_codes(np.asarray(values), categories=list(values.names))


def to_torch(cloud: Cloud) -> Any:
    """See `PointCloud.to_torch`."""
    torch = import_optional("torch")
    with warnings.catch_warnings():
        # Our arrays are read-only, which tensors cannot be.
        warnings.simplefilter("ignore", UserWarning)
        tensors = {"xyz": torch.from_numpy(cloud.xyz_m)}
        return tensors | {
            column.name: torch.from_numpy(np.asarray(cloud.column(column.name))) for column in cloud.columns[3:]
        }


def to_open3d(cloud: Cloud, *, colours: Numbers | None = None, legacy: bool = False) -> Any:
    """See `PointCloud.to_open3d`; ``colours`` are (n, 3) uint8."""
    module: Any = open3d()
    rgb = None if colours is None else colours.astype(np.float32) / np.float32(255.0)
    if legacy:
        legacy_cloud = module.geometry.PointCloud(module.utility.Vector3dVector(cloud.xyz_m.astype(np.float64)))
        if rgb is not None:
            legacy_cloud.colors = module.utility.Vector3dVector(rgb.astype(np.float64))
        return legacy_cloud
    tensor_cloud = module.t.geometry.PointCloud()
    tensor_cloud.point["positions"] = module.core.Tensor(np.ascontiguousarray(cloud.xyz_m))
    for column in cloud.columns[3:]:
        tensor_cloud.point[column.name] = module.core.Tensor(np.array(cloud.column(column.name)[:, None]))
    if rgb is not None:
        tensor_cloud.point["colors"] = module.core.Tensor(rgb)
    return tensor_cloud


def thumbnail(cloud: Cloud) -> bytes:
    """PNG of the cloud from above and behind its sensor, coloured by range."""
    width, height = THUMBNAIL_PX
    front = splat(camera_for(cloud), cloud.xyz_m, size=(2 * width, 2 * height))
    order = np.log(np.maximum(cloud.column("range"), 1e-3))
    low, high = np.percentile(order, (2, 98)) if len(cloud) else (0.0, 1.0)
    part = ((order - low) / max(float(high - low), 1e-6)).clip(0, 1)
    rgb = np.stack([np.interp(part, (0, 0.5, 1), channel) for channel in zip(NEAR, MIDDLE, FAR, strict=True)], 1)
    image, _ = eye_dome_picture(front, rgb.astype(np.uint8), background=np.array(BACKGROUND, np.uint8), reduction=2)
    return encode_png(unpack_rgb(image))


def to_html(cloud: Cloud) -> str:
    """HTML of the thumbnail with the cloud's repr below it."""
    picture = base64.b64encode(thumbnail(cloud)).decode("ascii")
    caption = html.escape(repr(cloud))
    return (
        f'<figure style="margin:0"><img src="data:image/png;base64,{picture}" width="{THUMBNAIL_PX[0]}" '
        f'alt="point cloud"><figcaption>{caption}</figcaption></figure>'
    )
