"""Import optional packages, or raise an error of one line that names what to install.

Most formats need a package that most users do not need. They are imported when a file of the format is written or read;
without the package the error is the command that installs it instead of a traceback.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Collection
from typing import Any

from ..errors import LidarSceneError

EXTRAS = {
    "las": {"laspy": "laspy", "lazrs": "lazrs"},
    "e57": {"pye57": "pye57"},
    "parquet": {"pyarrow": "pyarrow"},
    "pcd": {"lzf": "python-neo-lzf"},
    "ros": {"mcap_ros2": "mcap-ros2-support", "rosbags": "rosbags"},
    "osi": {"betterosi": "betterosi", "mcap": "mcap"},
    "rerun": {"rerun": "rerun-sdk"},
    "usd": {"pxr": "usd-core"},
    "draco": {"DracoPy": "DracoPy"},
    "pandas": {"pandas": "pandas"},
    "ouster": {"ouster.sdk": "ouster-sdk"},
    "velodyne": {"velodyne_decoder": "velodyne-decoder", "yaml": "pyyaml"},
    "certify": {"sklearn": "scikit-learn"},
    "design": {"pymoo": "pymoo"},
    "notebook": {"anywidget": "anywidget"},
    "completion": {"shtab": "shtab"},
    "traffic": {"sumo": "eclipse-sumo", "sumolib": "sumolib"},
    "open3d": {"open3d": "open3d libusb-package"},
    "batch": {"distributed": "distributed", "pyarrow": "pyarrow", "cryptography": "cryptography", "bokeh": "bokeh"},
}
"""Group of pyproject.toml -> {module that is imported: packages that bring it}."""


def import_optional(module: str, *, extra: str = "") -> Any:
    """Import a module.

    Args:
        extra: group of `EXTRAS` that brings it; "" if none does

    Raises:
        LidarSceneError: in one line, with what to type
    """
    package = module.partition(".")[0]
    try:
        return importlib.import_module(module)
    except (ImportError, OSError) as error:
        reason = " ".join(str(error).split())
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


def require_together(*extras: str, without: Collection[str] = ()) -> None:
    """Raise one LidarSceneError for all modules that these groups lack, before the first of them is imported.

    Args:
        without: modules that are not needed
    """
    missing = {
        extra: [
            packages for module, packages in EXTRAS[extra].items() if module not in without and not is_installed(module)
        ]
        for extra in extras
    }
    groups = [extra for extra in extras if missing[extra]]
    packages = [package for extra in groups for names in missing[extra] for package in names.split()]
    if packages:
        listed = " and ".join(filter(None, (", ".join(packages[:-1]), packages[-1])))
        raise LidarSceneError(
            f"{listed} {'is' if len(packages) == 1 else 'are'} needed and cannot be found; "
            f"try: pip install 'lidarscene[{','.join(groups)}]', or pip install {' '.join(packages)}"
        )


def require(extra: str) -> None:
    """Raise LidarSceneError if any module of this group cannot be imported."""
    for module in EXTRAS[extra]:
        import_optional(module, extra=extra)
