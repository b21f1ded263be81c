"""Pictures of what light does on its way, one for each scene that shows it."""

import dataclasses

import numpy as np
from drawing import BACKGROUND, FINER, INK, SCENES, bar_of, dark, frame, saved

import lidarscene
from lidarscene.detection.outcomes import Outcome
from lidarscene.physics.constants import SPEED_OF_LIGHT_M_S
from lidarscene.scene.weather import Weather

BOARD = "#ffc14d"
PULSE, SEED = 44_739, 3
"""Of the fog scene: meets the car at 30 m, and with this seed a drop or flake before it."""
BLIND_M, WHOLE_M = 3.0, 13.3
"""Of biaxial-905; `tests/chain/test_parallax_scene.py` has them by hand."""


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


def parallax() -> None:
    """Range over azimuth of posts around a bumper, with laser and receiver on one axis and 30 mm apart."""
    from matplotlib.colors import LogNorm

    figure, axes = dark(1, 2, height=5.2)
    told = {"laser and receiver on one axis": 0, "the laser 30 mm above the receiver": 30}
    for one, (title, offset_mm) in zip(axes, told.items(), strict=True):
        overrides = [f"optics.overlap.transmitter_offset_mm=[0,{offset_mm}]"]
        cloud = lidarscene.render(SCENES / "parallax.toml", overrides=overrides)
        level = np.abs(cloud.elevation_rad) < np.radians(1.0)
        shown = one.scatter(
            np.degrees(cloud.azimuth_rad[level]),
            cloud.range_m[level],
            s=3.0,
            c=cloud.snr[level],
            cmap="plasma",
            norm=LogNorm(3.0, 1e4),
            linewidths=0,
        )
        for limit_m, name in ((BLIND_M, "blind below 3.0 m"), (WHOLE_M, "all seen from 13.3 m on")):
            if offset_mm:
                one.axhline(limit_m, color=INK, linewidth=0.7, linestyle=(0, (4, 4)))
                one.text(58.0, 0.96 * limit_m, name, color=INK, fontsize=9, va="top")
        one.set(xlim=(60, -60), ylim=(0.2, 40.0), yscale="log", yticks=(0.3, 1, 3, 10, 30))
        one.set_yticklabels(("0.3", "1", "3", "10", "30"))
        one.set_xlabel("azimuth [°]  (left is positive)", color=INK)
        one.set_title(title, color=INK, loc="left", fontsize=11)
    axes[0].set_ylabel("range [m]", color=INK)
    bar_of(figure, shown, axes, "SNR")
    saved(figure, "parallax.png")


def weather() -> None:
    """Fog, rain and snow by the class of what sent the light back."""
    last = ["tdc.stops=1", "tdc.keep='last'"]
    for name, overrides in (("fog", last), ("rain", []), ("snow", [])):
        frame(name, overrides=overrides, colour_by="class", strips=("range",), colours=64, width=900)


def interference() -> None:
    """Points by their status: ours, noise, another lidar's."""
    frame("interference", colour_by="status", strips=("range", "status"), colours=64, width=900)


def waveforms() -> None:
    """The signal of one pulse in clear air, rain, snow and fog."""
    figure, (axes,) = dark(1, 1, height=4.2)
    scene = lidarscene.load_scene(SCENES / "fog.toml")
    sensor = lidarscene.load_sensor(scene.sensor_name)
    times = np.linspace(0.0, 45.0, 3000) * 2.0 / SPEED_OF_LIGHT_M_S
    kinds = {
        "clear air": Weather(),
        "rain": Weather(rain_mm_h=50.0),
        "snow": Weather(snow_mm_h=0.5),
        "fog": scene.air.weather,
    }
    for (name, kind), colour in zip(kinds.items(), ("#e8e8e8", "#5ab4ff", "#80ed99", "#ff9d2e"), strict=True):
        here = dataclasses.replace(scene, air=dataclasses.replace(scene.air, weather=kind))
        found = lidarscene.Simulator(here, sensor).waveforms([PULSE], times, seed=SEED)
        axes.semilogy(found.range_m, 1e6 * found.signal[0], color=colour, linewidth=1.2, label=name)
    axes.axhline(1e6 * found.threshold[0], color="#ff2fd0", linewidth=0.8, linestyle=(0, (4, 4)), label="threshold")
    axes.set(xlim=(0, 45), ylim=(0.02, 200))
    axes.set_xlabel("c t / 2 [m]", color=INK)
    axes.set_ylabel("signal [uA]", color=INK)
    axes.legend(labelcolor=INK, facecolor=BACKGROUND, edgecolor=BACKGROUND)
    saved(figure, "waveforms.png")


def low_sun() -> None:
    """Ambient counts of the low sun scene, and the echoes that are lost in its light."""
    from matplotlib.colors import ListedColormap, LogNorm
    from matplotlib.patches import Patch

    scene = lidarscene.load_scene(SCENES / "low_sun.toml")
    sensor = lidarscene.load_sensor(scene.sensor_name, overrides=FINER)
    night = dataclasses.replace(scene, sun=dataclasses.replace(scene.sun, illuminance_klux=0.0))
    (counts, by_day), (_, by_night) = (of_pulses(one, sensor) for one in (scene, night))
    lost = (by_day != Outcome.KEPT) & (by_night == Outcome.KEPT)
    blind = counts > 30.0 * np.median(counts)
    kinds = np.select([blind, lost, by_day == Outcome.KEPT], [3, 2, 1], 0)
    shape = (sensor.scanner.rows, sensor.scanner.columns)
    pixels = counts.reshape(shape)[20:, 300:901]
    extent = (30.05, -30.05, -12.55, 10.55)
    figure, axes = dark(2, 1, height=9.2)
    norm = LogNorm(np.quantile(pixels, 0.002), 3.0 * np.quantile(pixels, 0.99))
    shown = axes[0].imshow(pixels, cmap="gray", norm=norm, extent=extent)
    bar_of(figure, shown, [axes[0]], "background counts in 4 us")
    colours = (BACKGROUND, "#33597f", "#ff9d2e", "#ff2fd0")
    axes[1].imshow(kinds.reshape(shape)[20:, 300:901], cmap=ListedColormap(colours), vmin=0, vmax=3, extent=extent)
    named = zip(colours[1:], ("echo", "echo lost in sunlight", "blind: the sun's disc"), strict=True)
    axes[1].legend(
        handles=[Patch(color=colour, label=label) for colour, label in named],
        loc="upper right",
        labelcolor=INK,
        facecolor=BACKGROUND,
        edgecolor=INK,
    )
    for one in axes:
        one.set_ylabel("elevation [°]", color=INK)
    axes[1].set_xlabel("azimuth [°]  (left is positive)", color=INK)
    saved(figure, "low_sun.png")


def of_pulses(scene, sensor):
    """Ambient counts and what became of the echo, of every pulse of a frame."""
    counts = np.zeros(sensor.scanner.pulses)
    outcomes = np.zeros(sensor.scanner.pulses, dtype=int)

    def counted(pulse, found) -> None:
        counts[pulse] = found

    def missed(pulse, found) -> None:
        outcomes[pulse] = found

    lidarscene.Simulator(scene, sensor, background_rays=19).render(ambient=counted, missed=missed)
    return counts, outcomes
