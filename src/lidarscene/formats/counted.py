"""Counted: files whose header counts the points, of clouds that come one after the other."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import IO

from ..cloud.points import PointCloud
from ..files.atomic import atomic_output


@contextmanager
def counted_stream(
    path: str | os.PathLike[str],
    *,
    header: Callable[[PointCloud, int], bytes],
    write: Callable[[IO[bytes], PointCloud], None],
) -> Iterator[Callable[[PointCloud], None]]:
    """Write the clouds that are appended in the block, at least one, as one: the first's names and metadata.

    header  of a cloud and so many points; as long for any number of them
    write   the points of a cloud behind what is there
    """
    with atomic_output(path) as temporary, open(temporary, "wb") as file:
        first: list[PointCloud] = []
        points = 0

        def append(cloud: PointCloud) -> None:
            nonlocal points
            if not first:
                first.append(cloud.without_points())
                file.write(header(cloud, 0))
            points += len(cloud)
            write(file, cloud)

        yield append
        file.seek(0)
        file.write(header(first[0], points))
