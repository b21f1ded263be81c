"""Pictures of panes and leaves: what is behind them, what they throw back and what they let through."""

import tempfile
from pathlib import Path

import numpy as np
from drawing import BACKGROUND, FINER, INK, SCENES, below, dark
from PIL import Image

import lidarscene
from lidarscene.figures.pictures import frame_picture
from lidarscene.outputs.light import AmbientImage
from lidarscene.physics.constants import SPEED_OF_LIGHT_M_S

BOARD = "#ffc14d"
WIDE_BEAM = ["laser.divergence_mrad=3", "laser.exit_diameter_mm=10"]


def glass() -> None:
    """The glass scene, by how many panes and mirrors were on the way; below it two pulses, one with the glint."""
    scene = lidarscene.load_scene(SCENES / "glass.toml")
    cloud = lidarscene.render(scene, overrides=FINER)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "glass.png"
        frame_picture(cloud, path, colour_by="interactions", strips=("range", "interactions"), view=scene.camera)
        frame = Image.open(path).convert("RGB")
        glint(scene).savefig(path, facecolor=BACKGROUND)
        below([frame, Image.open(path).convert("RGB")], "glass.png", width=900, colours=96)


def glint(scene):
    """The power of the beam straight across the window and of one that is 0.4 degrees off, of a wide beam."""
    sensor = lidarscene.load_sensor(scene.sensor_name, overrides=WIDE_BEAM)
    azimuth, elevation = sensor.scanner.angles(np.arange(sensor.scanner.pulses, dtype=np.uint32))
    aside = np.hypot(np.asarray(azimuth), np.asarray(elevation))
    beside = np.hypot(np.asarray(azimuth) - np.radians(0.4), np.asarray(elevation))
    pulses = [int(np.argmin(aside)), int(np.argmin(beside))]
    times = np.linspace(0.0, 30.0, 3000) * 2.0 / SPEED_OF_LIGHT_M_S
    found = lidarscene.Simulator(scene, sensor).waveforms(pulses, times)
    figure, (axes,) = dark(1, 1, height=3.2)
    for row, (name, colour) in enumerate(
        (("straight across the window", "#ff9d2e"), ("0.4 degrees beside", "#5ab4ff"))
    ):
        power = found.power_w[list(found.pulse).index(pulses[row])]
        axes.semilogy(found.range_m, power, color=colour, linewidth=1.2, label=name)
    axes.set(xlim=(8, 20), ylim=(1e-8, 10))
    axes.set_xlabel("c t / 2 [m]", color=INK)
    axes.set_ylabel("power on the detector [W]", color=INK)
    axes.legend(labelcolor=INK, facecolor=BACKGROUND, edgecolor=BACKGROUND)
    return figure


def foliage() -> None:
    """Ambient counts of the foliage scene, and below them its echoes from above."""
    scene = lidarscene.load_scene(SCENES / "foliage.toml")
    sensor = lidarscene.load_sensor(scene.sensor_name, overrides=[*FINER, *WIDE_BEAM, "tdc.stops=3"])
    image = AmbientImage()
    cloud = lidarscene.Simulator(scene, sensor, rays=19).render(ambient=image)
    figure, (axes,) = dark(1, 1, height=5.4)
    x, y, z = np.asarray(cloud.xyz_m, dtype=np.float64).T
    names = [cloud.class_names[number] for number in cloud.class_id]
    for name, colour in (("vegetation", "#6fdc6f"), ("fence", BOARD), ("pole", INK), ("pedestrian", "#ff6a3d")):
        kept = (z > 0.25) & (z < 2.2) & (x < 15.0) & (np.asarray(names) == name)
        axes.scatter(-y[kept], x[kept], s=1.2, c=[colour], linewidths=0, label=name)
    axes.set(xlim=(-6.9, 6.9), ylim=(8.4, 14.4), aspect="equal")
    axes.set_xlabel("-y [m]", color=INK)
    axes.set_ylabel("x [m]", color=INK)
    axes.legend(labelcolor=INK, facecolor=BACKGROUND, edgecolor=BACKGROUND, markerscale=6, loc="upper center")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "foliage.png"
        image.save(path, sensor)
        levels = np.asarray(Image.open(path)).astype(np.float64)
        levels = np.minimum(levels / np.quantile(levels, 0.999), 1.0)
        shown = Image.fromarray(np.rint(255.0 * levels**0.5).astype(np.uint8)).crop((230, 0, 970, 251))
        figure.savefig(path, facecolor=BACKGROUND)
        below([shown.convert("RGB"), Image.open(path).convert("RGB")], "foliage.png", colours=96)
