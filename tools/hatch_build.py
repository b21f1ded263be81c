"""A hook of hatchling: the wheel carries scenes/ and their meshes, so that `lidarscene render car` needs no clone.

In a clone they stay where they are, and `lidarscene.catalog` finds them there: an editable wheel must not hold copies,
which would grow old.
"""

from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

CARRIED = {"scenes": "lidarscene/catalog/scenes", "assets/meshes": "lidarscene/catalog/assets/meshes"}
"""Folder of the repository, and its place in the wheel. Scenes name their meshes by `../assets/meshes/`."""


class CarryScenes(BuildHookInterface):  # type: ignore[type-arg]
    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if version != "editable":
            build_data["force_include"].update(CARRIED)
