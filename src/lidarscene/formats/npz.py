"""Write and read point clouds as NPZ: one compressed NumPy archive, exact.

For Python users without further packages: an array for each column, and a text from which the cloud is restored.
"""

from __future__ import annotations

import os

import numpy as np

from ..files.atomic import put_arrays
from ..files.inputs import require_archive
from .cloud_columns import Cloud, Fields
from .cloud_description import described_fields, description, input_errors

DESCRIPTION = "lidarscene"


def write_npz(path: str | os.PathLike[str], cloud: Cloud) -> None:
    """Write an array for each column, by its name, and the `cloud_description.description` as an array of text."""
    columns = {column.name: cloud.column(column.name) for column in cloud.columns}
    put_arrays(path, {DESCRIPTION: np.array(description(cloud))} | columns)


def read_npz(path: str | os.PathLike[str]) -> Fields:
    """Read a file of `write_npz`.

    Raises:
        InputError: in one line
    """
    with input_errors(path), open(path, "rb") as file:
        require_archive(file)
        archive = np.load(file, allow_pickle=False)
        if DESCRIPTION not in archive:
            raise ValueError("not a point cloud of lidarscene: there is no description in it")
        columns = {name: archive[name] for name in archive.files if name != DESCRIPTION}
        return described_fields(columns, str(archive[DESCRIPTION]))
