"""Make the pictures of the documentation again: `python docs/images/make.py [NAME ...]`, from the repository's root."""

import sys
import tempfile
from pathlib import Path

import charts
import counting
import effects
import leaves
import live
import looks
import numpy as np
import patterns
import recorded
import response
import retro
import surfaces
from drawing import BACKGROUND, FINER, HERE, INK, SCENES, WIDTH, store
from PIL import Image

import lidarscene
from lidarscene import PointCloud
from lidarscene.cloud.deskew import deskewed
from lidarscene.scene.saving import write_street
from lidarscene.scene.street.network_tables import network_scene
from lidarscene.scene.street.street_file import StreetFile
from lidarscene.studies.compare.bench import Bench
from lidarscene.studies.compare.comparison_study import compare_sensors

sys.path.insert(0, str(HERE.parents[1] / "tests"))
from helpers.chromium import Chromium, executable
from helpers.networks import sumo_town
from helpers.served import served

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
    """Every picture, or those that are named, small enough for a repository."""
    for name in sys.argv[1:] or PICTURES:
        PICTURES[name]()


def car() -> None:
    """The car scene, as `make car` renders it, with finer steps."""
    with tempfile.TemporaryDirectory() as folder:
        picture = Path(folder) / "car.png"
        outputs = lidarscene.Outputs(Path(folder) / "car.ply", picture=picture)
        lidarscene.record("car", outputs=outputs, overrides=FINER)
        store(Image.open(picture), "car.png", width=900)


def compare() -> None:
    """Picture of the comparison in docs/compare.md: the difference cloud, below it rate over range and over
    illuminance.
    """
    scene = lidarscene.load_scene(SCENES / "street.toml")
    sensors = [
        (name, lidarscene.load_sensor(name, overrides=["laser.peak_power_w=1"]))
        for name in ("table1-apd", "table1-sipm")
    ]
    with tempfile.TemporaryDirectory() as folder:
        compare_sensors(Bench(scene), sensors, illuminances_klux=(0.1, 1.0, 10.0, 100.0)).save(folder)
        top, left, right = (
            Image.open(Path(folder) / f"{name}.png").convert("RGB")
            for name in ("difference-table1-sipm", "rate-range", "illuminance")
        )
    half = WIDTH // 2
    charts = [
        one.resize((half, round(half * one.height / one.width)), Image.Resampling.LANCZOS) for one in (left, right)
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
    )
    axes.axvline(50.0, color=INK, linewidth=0.6, linestyle=(0, (4, 4)))
    axes.set(xlim=(44, 92), ylim=(-10, 10), aspect="equal", facecolor=BACKGROUND)
    axes.set_ylabel("y [m]", color=INK)
    axes.set_title(name, color=INK, loc="left", fontsize=11)
    axes.tick_params(colors=INK)
    axes.spines[:].set_visible(False)
    return shown


def streets() -> None:
    """Streets of four seeds, the first frame of each."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in (5, 4, 6, 8):
            scene, picture = Path(folder) / f"{seed}.toml", Path(folder) / f"{seed}.png"
            scene.write_text(f"[street]\nseed = {seed}\nlength_m = 100\n")
            lidarscene.record(scene, outputs=lidarscene.Outputs(Path(folder) / "street.ply", picture=picture))
            whole = Image.open(picture).convert("RGB")
            rows.append(whole.crop((0, 80, whole.width, 1020)))
    tiled = Image.new("RGB", (2 * rows[0].width, 2 * rows[0].height))
    for number, row in enumerate(rows):
        tiled.paste(row, (number % 2 * row.width, number // 2 * row.height))
    store(tiled, "streets.png")


def hills() -> None:
    """A street of a seed with hills."""
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "hills.toml"
        scene.write_text("[street]\nseed = 8\nlength_m = 200\nslope_percent = [7, 10]\n")
        _from_above(scene, "hills.png")


def network() -> None:
    """Four streets of a network whose junctions are at four heights."""
    with tempfile.TemporaryDirectory() as folder:
        scenario = sumo_town(Path(folder), (0.0, 6.0, 3.0, -5.0))
        tables = network_scene(scenario, "sumo", StreetFile(), ego="first")
        _from_above(write_street(tables, Path(folder) / "town", origin="a town"), "network.png")


def _from_above(path: Path, name: str) -> None:
    """Store the picture of a frame at 6 s from behind and above the vehicle."""
    scene = lidarscene.load_scene(path, overrides=["picture.eye_m=[-22, 5, 13]", "picture.target_m=[18, 0, 0]"])
    picture = path.parent / "picture.png"
    outputs = lidarscene.Outputs(path.parent / "cloud.ply", picture=picture)
    lidarscene.record(scene, outputs=outputs, begin_s=6.0)
    whole = Image.open(picture).convert("RGB")
    store(whole.crop((0, 80, whole.width, 1020)), name, colours=48)


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


PICTURES = {
    "car": car,
    "live": live.live,
    "glass": leaves.glass,
    "compare": compare,
    "drive": drive,
    "streets": streets,
    "hills": hills,
    "network": network,
    "edges": effects.edges,
    "response": response.response,
    "photon_counting": counting.photon_counting,
    "parallax": effects.parallax,
    "weather": effects.weather,
    "interference": effects.interference,
    "waveforms": effects.waveforms,
    "low_sun": effects.low_sun,
    "foliage": leaves.foliage,
    "retro": retro.retro,
    "intensity": retro.intensity,
    "bloom": retro.bloom,
    "surfaces": surfaces.surfaces,
    "twin": recorded.twin,
    "fit": recorded.fit,
    "view": view,
    "range": charts.range_,
    "own_sensor": charts.own_sensor,
    "sun": charts.sun,
    "sipm": charts.sipm,
    "eye_safety": charts.eye_safety,
    "scaling": charts.scaling,
    "batch": charts.batch,
    "sensors": charts.sensors,
    "paper": charts.paper,
    "patterns": patterns.patterns,
    "scanners": patterns.scanners,
    "lights": looks.lights,
    "hut": looks.hut,
    "mesh": looks.mesh,
    "ouster": looks.ouster,
    "classes": looks.classes,
}

if __name__ == "__main__":
    main()
