"""What the pictures have in common: dark figures, a frame of a scene, small files."""

import tempfile
from pathlib import Path

from PIL import Image

import lidarscene
from lidarscene.figures.pictures import BACKGROUND, INK, frame_picture

HERE = Path(__file__).parent
SCENES = HERE.parents[1] / "scenes"
WIDTH, COLOURS = 1200, 128
FINER = [f"scanner.{axis}_step_deg=0.1" for axis in ("azimuth", "elevation")]


def dark(rows: int, columns: int, *, height: float):
    """A figure as wide as all, and its axes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, height), dpi=100, facecolor=BACKGROUND, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for one in axes:
        one.set_facecolor(BACKGROUND)
        one.tick_params(colors=INK)
        one.spines[:].set_color(INK)
    return figure, axes


def saved(figure, name: str, *, colours: int = 64) -> None:
    """A figure, beside this file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        figure.savefig(path, facecolor=BACKGROUND)
        store(Image.open(path), name, colours=colours)


def bar_of(figure, shown, axes, label: str):
    """The scale of what is shown, beside it."""
    bar = figure.colorbar(shown, ax=axes, pad=0.01, aspect=30, shrink=0.95)
    bar.set_label(label, color=INK)
    bar.ax.tick_params(colors=INK, which="both")
    bar.outline.set_visible(False)
    return bar


def frame(name: str, *, overrides=(), colours: int = COLOURS, width: int = WIDTH, **picture) -> None:
    """A shipped scene as its own view has it, with range images below."""
    scene = lidarscene.load_scene(SCENES / f"{name}.toml")
    cloud = lidarscene.render(scene, overrides=overrides)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frame.png"
        frame_picture(cloud, path, **picture, view=scene.camera)
        store(Image.open(path), f"{name}.png", colours=colours, width=width)


def below(strips: list[Image.Image], name: str, *, colours: int = COLOURS, width: int = WIDTH) -> None:
    """Pictures, one below the other, all as wide."""
    sizes = [(WIDTH, round(WIDTH * one.height / one.width)) for one in strips]
    whole = Image.new("RGB", (WIDTH, sum(height for _, height in sizes)))
    top = 0
    for one, size in zip(strips, sizes, strict=True):
        whole.paste(one.resize(size, Image.Resampling.LANCZOS), (0, top))
        top += size[1]
    store(whole, name, colours=colours, width=width)


def store(picture: Image.Image, name: str, *, colours: int = COLOURS, width: int = WIDTH) -> None:
    """Store a picture beside this file, with fewer pixels and colours."""
    size = (width, round(width * picture.height / picture.width))
    small = picture.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    reduced = small.quantize(colours, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    reduced.save(HERE / name, optimize=True)
