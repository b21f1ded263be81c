"""Point cloud whose columns are on the device, where other libraries read them without a copy (DLPack).

PyTorch, CuPy, JAX and NumPy take such arrays by ``from_dlpack``. On a GPU nothing is copied to the host until `numpy`;
on a CPU all of them share the memory.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..files.arguments import checks_arguments
from ..formats.cloud_columns import NAMES, attributes
from ..kernel.device import transfer
from ..kernel.device.gate import exclusive
from ..kernel.rays.device_columns import DeviceColumns
from ..maths.arrays import retire_with
from .builder import CloudBuilder
from .point_cloud import PointCloud

CPU = 1
"""A CPU's kind of device, as DLPack counts them."""


@checks_arguments
@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class DeviceCloud:
    """The points of one frame on the device, by the attributes of `PointCloud`: ``xyz_m``, ``range_m``, ...

    Each is a `DeviceColumn`. They stay as they are whatever is rendered later, and whether or not the simulator still
    exists.

    Attributes:
        columns: the columns as the device computed them
        vectors: True if there are normals and velocities
        sensor_names: names and metadata as in `PointCloud`
        body_names: see there
        class_names: see there
        material_names: see there
        metadata: see there
    """

    columns: DeviceColumns
    vectors: bool = False
    sensor_names: tuple[str, ...] = ()
    body_names: tuple[str, ...] = ()
    class_names: tuple[str, ...] = ()
    material_names: tuple[str, ...] = ()
    metadata: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        retire_with(self, self.columns)

    def __len__(self) -> int:
        return self.columns.count

    def __repr__(self) -> str:
        return f"DeviceCloud({len(self)} points; sensor '{self.metadata.get('sensor', 'unknown')}')"

    def __dir__(self) -> list[str]:
        return [*object.__dir__(self), *attributes(truth=True, vectors=self.vectors)]

    @exclusive
    def __getattr__(self, name: str) -> DeviceColumn:
        if name not in attributes(truth=True, vectors=self.vectors):
            raise AttributeError(f"DeviceCloud has no column or attribute '{name}'")
        return DeviceColumn(self.columns.array(name))

    @exclusive
    def numpy(self) -> PointCloud:
        """The same cloud in NumPy, as `render` gives it; on a CPU in the same memory."""
        if not len(self):
            return self.without_points()
        return PointCloud(**self._description | self.columns.in_numpy(), checked=True)

    def without_points(self, **metadata: str) -> PointCloud:
        """Names and metadata of the cloud in NumPy, with further ``metadata``."""
        description = self._description | {"metadata": {**self.metadata, **metadata}}
        return PointCloud(**CloudBuilder(vectors=self.vectors).fields(**description))

    @property
    def _description(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in (*NAMES.values(), "metadata")}


class DeviceColumn:
    """One column on the device, for ``from_dlpack`` of other libraries. It must not be written to.

    Args:
        array: a Dr.Jit array or tensor
    """

    def __init__(self, array: Any) -> None:
        self._array = array
        retire_with(self, array)

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def shape(self) -> tuple[int, ...]:
        """Points, and three numbers each of xyz_m."""
        shape: tuple[int, ...] = self._array.shape
        return shape

    def __dlpack_device__(self) -> tuple[int, int]:
        """Kind of the device, `CPU` or 2 for a CUDA GPU, and its number."""
        device: tuple[int, int] = self._array.__dlpack_device__()
        return device

    @exclusive
    def __dlpack__(
        self,
        *,
        stream: Any = None,
        max_version: tuple[int, int] | None = None,
        dl_device: tuple[int, int] | None = None,
        copy: bool | None = None,
    ) -> Any:
        """Share the memory, or copy it to the CPU where that is asked for; other libraries call it.

        Args:
            stream: that of the caller, as DLPack has it
            max_version: of DLPack, likewise
            dl_device: where the caller wants it; None: where it is
            copy: True for a copy, False for none

        Raises:
            BufferError: for another device than its own and the CPU, or a copy that is asked for or needed in vain
        """
        transfer.wait()
        own, target = self.__dlpack_device__(), dl_device or self.__dlpack_device__()
        if target == own and not copy:
            return self._array.__dlpack__(stream=stream)
        if target[0] != CPU or copy is False:
            raise BufferError("a column can be copied to the CPU alone")
        return np.array(self._array.numpy()).__dlpack__()
