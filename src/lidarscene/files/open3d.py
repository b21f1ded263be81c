"""Import Open3D, or raise an error of one line that names what to install: the only import of Open3D in this package.

Open3D is optional. Its Linux wheels load libusb for its depth cameras, and bare machines lack libusb. The package
`libusb-package` brings it, but to a place where no loader looks, so it is loaded here beforehand.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

from ..errors import LidarSceneError

LIBUSB = "libusb-1.0"
_PACKAGES = "pip install 'lidarscene[open3d]', or pip install open3d" + " libusb-package" * (sys.platform == "linux")
_SYSTEM = "apt install libusb-1.0-0 libgl1 libegl1 libgomp1 libx11-6"


@functools.cache
def open3d() -> ModuleType:
    """Return the `open3d` module.

    Raises:
        LidarSceneError: in one line, with what to install and the loader's error
    """
    try:
        try:
            return _import()
        except (ImportError, OSError) as error:
            if LIBUSB not in str(error) or not _preload_libusb():
                raise
            return _import()
    except (ImportError, OSError) as error:
        raise LidarSceneError(_error_text(error)) from error


def _import() -> ModuleType:
    import open3d as module

    return module  # type: ignore[no-any-return]


def _preload_libusb() -> bool:
    """Load the libusb of `libusb-package` into this process; return False if the package is not there."""
    spec = importlib.util.find_spec("libusb_package")
    for folder in (spec and spec.submodule_search_locations) or ():
        with contextlib.suppress(OSError):
            ctypes.CDLL(str(Path(folder) / f"{LIBUSB}.so"), mode=ctypes.RTLD_GLOBAL)
            return True
    return False


def _error_text(error: Exception) -> str:
    reason = " ".join(str(error).split())
    if isinstance(error, ModuleNotFoundError):
        way_out = _PACKAGES
    elif LIBUSB in reason:
        way_out = "pip install libusb-package, or apt install libusb-1.0-0"
    elif ".so" in reason:
        way_out = _SYSTEM
    else:
        way_out = f"{_PACKAGES} --force-reinstall"
    return f"Open3D cannot be imported ({reason}); try: {way_out}"
