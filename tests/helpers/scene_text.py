"""Scene files of a test."""

from pathlib import Path

from lidarscene.scene.scene import Scene
from lidarscene.scene.scene_file import load_scene


def scene_of(folder: Path, text: str, name: str = "scene.toml") -> Scene:
    """Write a scene file, and load it."""
    (folder / name).write_text(text, encoding="utf-8")
    return load_scene(folder / name)
