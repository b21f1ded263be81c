"""Libraries that read our files: without warnings that are not ours, and a skip where one cannot be had."""

import importlib
import importlib.util
import sys
import warnings
from collections.abc import Callable
from types import ModuleType

import pytest

from lidarscene.cloud.point_cloud import PointCloud


@pytest.fixture
def library(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    """Import a module, or skip the test."""
    if importlib.util.find_spec("cv2") is None:
        # pykitti imports OpenCV beside its other readers, for pictures alone.
        monkeypatch.setitem(sys.modules, "cv2", ModuleType("cv2"))

    def imported(name: str) -> ModuleType:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                return importlib.import_module(name)
            except ImportError as error:
                pytest.skip(str(error))

    return imported


@pytest.fixture(scope="session")
def street_cloud() -> PointCloud:
    """The street of `street.py`, in the world frame."""
    from helpers import street

    return street.cloud()
