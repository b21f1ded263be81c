"""Pictures of what the recipes and guides render: three suns, a hut, a mesh, an Ouster, classes, a range image."""

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

from drawing import FINER, HERE, INK, SCENES, below, dark, saved, store
from PIL import Image

import lidarscene
from lidarscene.figures.pictures import frame_picture, range_image
from lidarscene.scene.scene import View

LIGHTS = {
    "night": {"illuminance_klux": 0.0},
    "low sun": {"illuminance_klux": 20.0, "elevation_deg": 5.0},
    "noon": {"illuminance_klux": 100.0, "elevation_deg": 65.0},
}


@contextlib.contextmanager
def shown_files(page: str) -> Iterator[Path]:
    """A folder with the files that a page of the documentation shows, as the working directory."""
    text = (HERE.parent / page).read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for block in text.split("```")[1::2]:
            first, _, rest = block.partition("\n")
            if rest.startswith("# ") and first in ("toml", "obj"):
                Path(rest[2:].split()[0]).write_text(rest, encoding="utf-8")
        yield Path(folder)


def lights() -> None:
    """SNR of the echoes of the car scene at night, in a low sun and at noon."""
    from matplotlib.colors import LogNorm

    figure, axes = dark(3, 1, height=7.0)
    clouds = {}
    for name, changes in LIGHTS.items():
        overrides = [f"sun.{key}={value}" for key, value in changes.items()]
        here = lidarscene.load_scene(SCENES / "car.toml", overrides=overrides)
        clouds[name] = lidarscene.render(here, overrides=FINER)
    for one, (name, cloud) in zip(axes, clouds.items(), strict=True):
        echoes = cloud.status == 0
        shown = one.scatter(
            57.29578 * cloud.azimuth_rad[echoes],
            57.29578 * cloud.elevation_rad[echoes],
            c=cloud.snr[echoes],
            s=0.6,
            cmap="inferno",
            linewidths=0,
            norm=LogNorm(5.0, 5000.0),
        )
        one.set(xlim=(45, -45), ylim=(-14, 10))
        one.set_ylabel("elevation [°]", color=INK)
        one.set_title(f"{name}: {int(echoes.sum()):,} echoes", color=INK, loc="left", fontsize=11)
    axes[-1].set_xlabel("azimuth [°]  (left is positive)", color=INK)
    bar = figure.colorbar(shown, ax=list(axes), pad=0.01, aspect=40)
    bar.set_label("SNR", color=INK)
    bar.ax.tick_params(colors=INK, which="both")
    bar.outline.set_visible(False)
    saved(figure, "lights.png", colours=48)


def hut() -> None:
    """The hut of "Your own", as its files have it."""
    view = View(eye_m=(6.0, -9.0, 5.0), target_m=(20.0, 0.0, 1.2))
    with shown_files("own_mesh.md"):
        cloud = lidarscene.render("hut.toml", overrides=FINER)
        _stored(cloud, "hut.png", colour_by="intensity", height=720, view=view)


def mesh() -> None:
    """A bare mesh file, here the tree, as the command line sets it up."""
    scene = lidarscene.load_scene(SCENES.parent / "assets" / "meshes" / "tree.glb")
    view = View(eye_m=(-14.0, -9.0, 6.0), target_m=(0.0, 0.0, 3.4))
    _stored(lidarscene.render(scene, overrides=FINER), "mesh.png", colour_by="range", height=720, view=view)


def ouster() -> None:
    """The car scene as an OS1-128 sees it: its range image and its intensities."""
    cloud = lidarscene.render(SCENES / "car.toml", "os1-128")
    strips = []
    with tempfile.TemporaryDirectory() as folder:
        for name in ("range", "intensity"):
            path = Path(folder) / f"{name}.png"
            range_image(cloud, path, colour_by=name, size_px=(1920, 420))
            strips.append(Image.open(path).convert("RGB"))
    below(strips, "ouster.png", colours=48)


def classes() -> None:
    """The car scene coloured by class, the truth that datasets are written from."""
    cloud = lidarscene.render(SCENES / "car.toml", overrides=FINER)
    view = lidarscene.load_scene(SCENES / "car.toml").camera
    _stored(cloud, "classes.png", colour_by="class", height=860, view=view)


def _stored(cloud, name: str, *, height: int, **options) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        frame_picture(cloud, path, strips=(), size_px=(1920, height), **options)
        store(Image.open(path), name, colours=48, width=1000)
