"""Make the pictures of the documentation again: `python docs/images/make.py`, from the repository's root."""

import dataclasses
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

import lidarscene
from lidarscene import PointCloud
from lidarscene.deskew import deskewed
from lidarscene.plots import BACKGROUND, INK, frame_picture

HERE = Path(__file__).parent
SCENES = HERE.parents[1] / "scenes"
WIDTH, COLOURS = 1200, 256


def main() -> None:
    """Draw all of them, small enough for a repository."""
    with tempfile.TemporaryDirectory() as folder:
        for name, draw in {"car": car, "drive": drive}.items():
            path = Path(folder) / f"{name}.png"
            draw(path)
            shrink(path, HERE / f"{name}.png")


def car(path: Path) -> None:
    """The car scene."""
    scene = lidarscene.load_scene(SCENES / "car.toml")
    finer = [f"scanner.{axis}_step_deg=0.1" for axis in ("azimuth", "elevation")]  # as `make car`
    cloud = lidarscene.render(scene, overrides=finer)
    frame_picture(cloud, path, **(dataclasses.asdict(scene.view) if scene.view else {}))


def drive(path: Path) -> None:
    """A frame of the drive scene from above, raw and deskewed, coloured by time."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    scene = lidarscene.load_scene(SCENES / "drive.toml")
    simulator = lidarscene.Simulator(scene, lidarscene.load_sensor(scene.sensor_name))
    raw = simulator.render()
    figure = Figure(figsize=(12.0, 10.8), dpi=100, facecolor=BACKGROUND, layout="constrained")
    FigureCanvasAgg(figure)
    clouds = {"raw": raw, "deskewed": deskewed(raw, simulator.motion)}
    for axes, (name, cloud) in zip(figure.subplots(2, 1), clouds.items(), strict=True):
        shown = above(axes, cloud, name)
    figure.axes[-1].set_xlabel("x [m]", color=INK)
    bar = figure.colorbar(shown, ax=figure.axes, orientation="horizontal", pad=0.01, aspect=70)
    bar.set_label("time within the frame [ms]", color=INK)
    bar.ax.tick_params(colors=INK)
    bar.outline.set_visible(False)
    figure.savefig(path, facecolor=BACKGROUND)


def above(axes, cloud: PointCloud, name: str):
    """What stands above the ground, from above."""
    x, y, z = np.asarray(cloud.xyz_m, dtype=np.float64).T
    kept = (z > 0.3) & (z < 3.0) & (x > 44.0) & (x < 92.0) & (np.abs(y) < 10.0)
    shown = axes.scatter(
        x[kept], y[kept], c=1e3 * cloud.time_s[kept], s=1.2, cmap="turbo", vmin=0.0, vmax=100.0, linewidths=0
    )  # fmt: skip
    axes.axvline(50.0, color=INK, linewidth=0.6, linestyle=(0, (4, 4)))
    axes.set(xlim=(44, 92), ylim=(-10, 10), aspect="equal", facecolor=BACKGROUND)
    axes.set_ylabel("y [m]", color=INK)
    axes.set_title(name, color=INK, loc="left", fontsize=11)
    axes.tick_params(colors=INK)
    axes.spines[:].set_visible(False)
    return shown


def shrink(source: Path, target: Path) -> None:
    """Store a picture with few pixels and few colours."""
    picture = Image.open(source).convert("RGB")
    size = (WIDTH, round(WIDTH * picture.height / picture.width))
    small = picture.resize(size, Image.Resampling.LANCZOS).quantize(
        COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE
    )
    small.save(target, optimize=True)


if __name__ == "__main__":
    main()
