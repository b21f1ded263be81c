"""Make the pictures of the documentation again: `python docs/images/make.py`, from the repository's root."""

import dataclasses
import tempfile
from pathlib import Path

from PIL import Image

import lidarscene
from lidarscene.analysis import compare_study
from lidarscene.plots import frame_picture

HERE = Path(__file__).parent
SCENES = HERE.parents[1] / "scenes"
WIDTH, COLOURS = 1200, 256


def main() -> None:
    """Every picture, small enough for a repository."""
    car()
    glass()
    compare()


def car() -> None:
    """The car scene, as `make car` renders it."""
    scene = lidarscene.load_scene(SCENES / "car.toml")
    finer = [f"scanner.{axis}_step_deg=0.1" for axis in ("azimuth", "elevation")]
    cloud = lidarscene.render(scene, overrides=finer)
    view = dataclasses.asdict(scene.view) if scene.view else {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "car.png"
        frame_picture(cloud, path, **view)
        store(Image.open(path), "car.png")


def glass() -> None:
    """The glass scene, coloured by how many panes and mirrors were on the way."""
    scene = lidarscene.load_scene(SCENES / "glass.toml")
    finer = [f"scanner.{axis}_step_deg=0.1" for axis in ("azimuth", "elevation")]
    cloud = lidarscene.render(scene, overrides=finer)
    view = dataclasses.asdict(scene.view) if scene.view else {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "glass.png"
        frame_picture(cloud, path, colour_by="interactions", strips=("range", "interactions"), **view)
        store(Image.open(path), "glass.png")


def compare() -> None:
    """Of the comparison in docs/compare.md: the difference cloud, below it rate over range and over illuminance."""
    scene = lidarscene.load_scene(SCENES / "street.toml")
    sensors = [
        (name, lidarscene.load_sensor(name, overrides=["laser.peak_power_w=1"]))
        for name in ("table1-apd", "table1-sipm")
    ]
    with tempfile.TemporaryDirectory() as folder:
        compare_study.of_sensors(scene, sensors, Path(folder), illuminances_klux=(0.1, 1.0, 10.0, 100.0))
        top, left, right = (
            Image.open(Path(folder) / f"{name}.png").convert("RGB")
            for name in ("difference-table1-sipm", "rate-range", "illuminance")
        )
    half = WIDTH // 2
    charts = [
        one.resize((half, round(half * one.height / one.width)), Image.Resampling.LANCZOS)
        for one in (left, right)
    ]
    whole = Image.new("RGB", (WIDTH, top.height + max(one.height for one in charts)), "white")
    whole.paste(top, (0, 0))
    for number, one in enumerate(charts):
        whole.paste(one, (number * half, top.height))
    store(whole, "compare.png")


def store(picture: Image.Image, name: str) -> None:
    """Beside this file, with fewer pixels and colours."""
    size = (WIDTH, round(WIDTH * picture.height / picture.width))
    small = picture.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    reduced = small.quantize(COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    reduced.save(HERE / name, optimize=True)


if __name__ == "__main__":
    main()
