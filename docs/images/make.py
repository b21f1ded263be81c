"""Make the pictures of the documentation again: `python docs/images/make.py`, from the repository's root."""

import dataclasses
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

import lidarscene
from lidarscene import PointCloud
from lidarscene.analysis import compare_study
from lidarscene.constants import SPEED_OF_LIGHT_M_S
from lidarscene.deskew import deskewed
from lidarscene.io.light_files import AmbientImage
from lidarscene.plots import BACKGROUND, INK, frame_picture, range_image
from lidarscene.weather import Weather

HERE = Path(__file__).parent
SCENES = HERE.parents[1] / "scenes"
WIDTH, COLOURS = 1200, 256
FINER = [f"scanner.{axis}_step_deg=0.1" for axis in ("azimuth", "elevation")]
CLIPPING = ["detector.saturation_ua=10000", "detector.recovery_ns=5"]
BOARD = "#ffc14d"
PULSE = 44_739
"""Of the fog scene: meets the car at 30 m."""

sys.path.insert(0, str(HERE.parents[1] / "tests" / "view"))
from chromium import Chromium, executable  # noqa: E402
from served import served  # noqa: E402

# The point of the car's paint that is nearest to this place in the picture.
CLICK = """(() => {
    const { frame, renderer, matrix } = viewer, { xyz, material, incidence_angle } = frame.arrays;
    const paint = frame.fields.find(field => field.name === "material").names.indexOf("car_paint_white");
    let nearest = [-1, Infinity];
    for (let i = 0; i < frame.count; i++) {
        if (material[i] !== paint || incidence_angle[i] > 70) continue;
        const seen = renderer.project(matrix, ...xyz.subarray(3 * i, 3 * i + 3));
        const away = Math.hypot(seen[0] - 560, seen[1] - 470);
        if (away < nearest[1]) nearest = [i, away];
    }
    viewer.select(nearest[0]);
})()"""


def main() -> None:
    """Every picture, small enough for a repository."""
    car()
    glass()
    compare()
    drive()
    edges()
    weather()
    waveforms()
    low_sun()
    retro()
    intensity()
    bloom()
    view()


def car() -> None:
    """The car scene, as `make car` renders it."""
    scene = lidarscene.load_scene(SCENES / "car.toml")
    cloud = lidarscene.render(scene, overrides=FINER)
    view = dataclasses.asdict(scene.view) if scene.view else {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "car.png"
        frame_picture(cloud, path, **view)
        store(Image.open(path), "car.png")


def glass() -> None:
    """The glass scene, coloured by how many panes and mirrors were on the way."""
    scene = lidarscene.load_scene(SCENES / "glass.toml")
    cloud = lidarscene.render(scene, overrides=FINER)
    view = dataclasses.asdict(scene.view) if scene.view else {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "glass.png"
        frame_picture(cloud, path, colour_by="interactions", strips=("range", "interactions"), **view)
        store(Image.open(path), "glass.png")


def retro() -> None:
    """The retro scene, coloured by the width of the pulses behind an amplifier that clips."""
    scene = lidarscene.load_scene(SCENES / "retro.toml")
    cloud = lidarscene.render(scene, overrides=[*FINER, *CLIPPING, "intensity.kind='reflectivity'"])
    view = dataclasses.asdict(scene.view) if scene.view else {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "retro.png"
        frame_picture(cloud, path, colour_by="pulse_width", strips=("intensity", "pulse_width"), **view)
        store(Image.open(path), "retro.png")


def intensity() -> None:
    """The same cloud by raw, range-corrected and calibrated intensity, one below the other."""
    scene = lidarscene.load_scene(SCENES / "retro.toml")
    kinds = [[], ["intensity.kind='range_corrected'"], ["intensity.kind='reflectivity'"]]
    with tempfile.TemporaryDirectory() as folder:
        strips = []
        for kind in kinds:
            path = Path(folder) / "strip.png"
            cloud = lidarscene.render(scene, overrides=[*FINER, *CLIPPING, *kind])
            range_image(cloud, path, colour_by="intensity", size_px=(1920, 520))
            strips.append(Image.open(path).convert("RGB"))
    below(strips, "intensity.png")


def bloom() -> None:
    """The rows at 10 and 20 m of the retro scene by range, with a halo around the beam and without."""
    scene = lidarscene.load_scene(SCENES / "retro.toml")
    halo = ["optics.halo.share=1e-3", "optics.halo.divergence_mrad=20"]
    strips = []
    with tempfile.TemporaryDirectory() as folder:
        for keys in (halo, []):
            path = Path(folder) / "strip.png"
            cloud = lidarscene.render(scene, overrides=[*FINER, "laser.divergence_mrad=2", *keys], rays=32)
            left, up = np.degrees(cloud.azimuth_rad), np.degrees(cloud.elevation_rad)
            near = cloud.select((np.abs(left - 6.0) < 29.0) & (np.abs(up) < 9.0) & (cloud.range_m < 45.0))
            range_image(near, path, size_px=(1920, 700))
            strips.append(Image.open(path).convert("RGB"))
    below(strips, "bloom.png")


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


def drive() -> None:
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
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drive.png"
        figure.savefig(path, facecolor=BACKGROUND)
        store(Image.open(path), "drive.png")


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


def saved(figure, name: str) -> None:
    """A figure, beside this file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        figure.savefig(path, facecolor=BACKGROUND)
        store(Image.open(path), name, colours=64)


def edges() -> None:
    """Boards before a wall from above, with one ray and with nineteen."""
    figure, axes = dark(2, 1, height=6.4)
    wide = ["laser.divergence_mrad=3", "laser.exit_diameter_mm=10"]
    for one, rays in zip(axes, (1, 19), strict=True):
        cloud = lidarscene.render(SCENES / "edges.toml", rays=rays, overrides=wide)
        x, y, z = np.asarray(cloud.xyz_m, dtype=np.float64).T
        kept = (z > 0.6) & (z < 1.9) & (x > 17.0) & (x < 20.6)
        one.scatter(-y[kept], x[kept], s=1.6, c=[BOARD], linewidths=0)
        one.set(xlim=(-6.5, 6.5), ylim=(17.6, 20.4), aspect="equal")
        one.set_ylabel("x [m]", color=INK)
        one.set_title("one ray" if rays == 1 else f"{rays} rays", color=INK, loc="left", fontsize=11)
    axes[-1].set_xlabel("-y [m]", color=INK)
    saved(figure, "edges.png")


def weather() -> None:
    """The fog scene and the rain scene, by the class of what sent the light back."""
    apart = ["tdc.stops=3", "optics.overlap.transmitter_offset_mm=[0,60]"]
    for name, overrides in (("fog", apart), ("rain", [])):
        scene = lidarscene.load_scene(SCENES / f"{name}.toml")
        cloud = lidarscene.render(scene, overrides=overrides)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "frame.png"
            own = dataclasses.asdict(scene.view) if scene.view else {}
            frame_picture(cloud, path, colour_by="class", strips=("range",), **own)
            store(Image.open(path), f"{name}.png", colours=48, width=900)


def waveforms() -> None:
    """The signal of one pulse in clear air, rain and fog."""
    figure, (axes,) = dark(1, 1, height=4.2)
    scene = lidarscene.load_scene(SCENES / "fog.toml")
    sensor = lidarscene.load_sensor(scene.sensor_name)
    times = np.linspace(0.0, 45.0, 3000) * 2.0 / SPEED_OF_LIGHT_M_S
    kinds = {"clear air": Weather(), "rain": Weather(rain_mm_h=50.0), "fog": scene.air.weather}
    for (name, kind), colour in zip(kinds.items(), ("#e8e8e8", "#5ab4ff", "#ff9d2e"), strict=True):
        here = dataclasses.replace(scene, air=dataclasses.replace(scene.air, weather=kind))
        found = lidarscene.Simulator(here, sensor).waveforms([PULSE], times)
        axes.semilogy(found.range_m, 1e6 * found.signal[0], color=colour, linewidth=1.2, label=name)
    axes.axhline(
        1e6 * found.threshold[0], color="#ff2fd0", linewidth=0.8, linestyle=(0, (4, 4)), label="threshold"
    )
    axes.set(xlim=(0, 45), ylim=(0.1, 1e3))
    axes.set_xlabel("c t / 2 [m]", color=INK)
    axes.set_ylabel("signal [uA]", color=INK)
    axes.legend(labelcolor=INK, facecolor=BACKGROUND, edgecolor=BACKGROUND)
    saved(figure, "waveforms.png")


def low_sun() -> None:
    """Ambient counts of the low sun scene, and its range image with the blind spot."""
    scene = lidarscene.load_scene(SCENES / "low_sun.toml")
    sensor = lidarscene.load_sensor(scene.sensor_name, overrides=FINER)
    image = AmbientImage()
    lidarscene.Simulator(scene, sensor, background_rays=19).render(ambient=image)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ambient.png"
        image.save(path, sensor)
        levels = np.asarray(Image.open(path)).astype(np.float64) / 65535.0
    shown = Image.fromarray(np.rint(255.0 * levels**0.5).astype(np.uint8)).crop((300, 20, 900, 251))
    store(shown, "low_sun.png")


def view() -> None:
    """The page of the car scene, with a point clicked; as it is where there is no Chromium."""
    if not executable():
        return
    with (
        tempfile.TemporaryDirectory() as folder,
        served(SCENES / "car.toml") as page,
        Chromium(Path(folder) / "profile", width=1280, height=860) as browser,
    ):
        browser.open(page.url)
        browser.value("viewer.camera.zoom(0.72), viewer.draw()")
        browser.value(CLICK)
        browser.value("new Promise(done => setTimeout(done, 500))")
        browser.screenshot(Path(folder) / "view.png")
        store(Image.open(Path(folder) / "view.png"), "view.png")


def below(strips: list[Image.Image], name: str) -> None:
    """Pictures of one size, one below the other."""
    whole = Image.new("RGB", (strips[0].width, sum(one.height for one in strips)))
    for number, one in enumerate(strips):
        whole.paste(one, (0, number * one.height))
    store(whole, name)


def store(picture: Image.Image, name: str, *, colours: int = COLOURS, width: int = WIDTH) -> None:
    """Beside this file, with fewer pixels and colours."""
    size = (width, round(width * picture.height / picture.width))
    small = picture.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    reduced = small.quantize(colours, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    reduced.save(HERE / name, optimize=True)


if __name__ == "__main__":
    main()
