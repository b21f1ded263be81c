"""Import optional packages, or raise an error of one line that names what to install.

Most formats need a package that most users do not need. They are imported when a file of the format is written or read;
without the package the error is the command that installs it instead of a traceback.
"""

from __future__ import annotations

import importlib
import importlib.util
from typing import Any

from ..errors import LidarSceneError

EXTRAS = {
    "las": {"laspy": "laspy", "lazrs": "lazrs"},
    "e57": {"pye57": "pye57"},
    "parquet": {"pyarrow": "pyarrow"},
    "pcd": {"lzf": "python-neo-lzf"},
    "ros": {"rosbags": "rosbags"},
    "osi": {"betterosi": "betterosi", "mcap": "mcap"},
    "rerun": {"rerun": "rerun-sdk"},
    "usd": {"pxr": "usd-core"},
    "pandas": {"pandas": "pandas"},
    "ouster": {"ouster.sdk": "ouster-sdk"},
    "velodyne": {"velodyne_decoder": "velodyne-decoder", "yaml": "pyyaml"},
    "design": {"pymoo": "pymoo"},
    "completion": {"shtab": "shtab"},
    "open3d": {"open3d": "open3d libusb-package"},
}
"""Group of pyproject.toml -> {module that is imported: packages that bring it}."""


def import_optional(module: str, *, extra: str = "") -> Any:
    """Import a module.

    extra  group of `EXTRAS` that brings it; "" if none does
    Raises LidarSceneError, in one line, with what to type.
    """
    try:
        return importlib.import_module(module)
    except (ImportError, OSError) as error:
        reason, package = " ".join(str(error).split()), module.partition(".")[0]
        group = f"pip install 'lidarscene[{extra}]', or " if extra else ""
        packages = " ".join(EXTRAS[extra].values()) if extra else package
        raise LidarSceneError(
            f"{package} is needed and cannot be imported ({reason}); try: {group}pip install {packages}"
        ) from error


def is_installed(module: str) -> bool:
    """Whether Python finds a module; it is not imported."""
    try:
        return importlib.util.find_spec(module) is not None
    except (ImportError, ValueError):  # its package is missing, or hidden
        return False


def require_together(*extras: str) -> None:
    """Raise one LidarSceneError for all of these groups that lack a module, before the first of them is imported."""
    missing = [extra for extra in extras if not all(map(is_installed, EXTRAS[extra]))]
    if missing:
        packages = " ".join(package for extra in missing for package in EXTRAS[extra].values())
        raise LidarSceneError(
            f"{' and '.join(missing)}: packages of these groups are missing; "
            f"try: pip install 'lidarscene[{','.join(missing)}]', or pip install {packages}"
        )


def require(extra: str) -> None:
    """Raise LidarSceneError if any module of this group cannot be imported."""
    for module in EXTRAS[extra]:
        import_optional(module, extra=extra)
