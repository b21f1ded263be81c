"""Make the pictures of the documentation again: `python docs/images/make.py`, from the repository's root."""

import dataclasses
import tempfile
from pathlib import Path

from PIL import Image

import lidarscene
from lidarscene.plots import frame_picture

HERE = Path(__file__).parent
WIDTH, COLOURS = 1200, 256


def main() -> None:
    """Render the car scene and store its picture small enough for a repository."""
    scene = lidarscene.load_scene(HERE.parents[1] / "scenes" / "car.toml")
    finer = [f"scanner.{axis}_step_deg=0.1" for axis in ("azimuth", "elevation")]  # as `make car`
    cloud = lidarscene.render(scene, overrides=finer)
    view = dataclasses.asdict(scene.view) if scene.view else {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "car.png"
        frame_picture(cloud, path, **view)
        picture = Image.open(path).convert("RGB")
    size = (WIDTH, round(WIDTH * picture.height / picture.width))
    small = picture.resize(size, Image.Resampling.LANCZOS).quantize(
        COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE
    )
    small.save(HERE / "car.png", optimize=True)


if __name__ == "__main__":
    main()
