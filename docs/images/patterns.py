"""Scan patterns: of the recipe's three sensors within two times, and of each kind of scanner."""

import sys

import numpy as np
from drawing import HERE, INK, dark, saved

import lidarscene

sys.path.insert(0, str(HERE.parents[1] / "tests"))
from helpers import scanners as examples

TIMES_S = (0.1, 1.0)
RECIPE = ("livox-mid-40", "livox-avia", "vlp-16")
KINDS = {
    "spinning": lambda: lidarscene.load_sensor("vlp-16").scanner,
    "mirror": examples.mirror,
    "lissajous": examples.lissajous,
    "polygon": examples.polygon,
    "risley": lambda: lidarscene.load_sensor("livox-mid-40").scanner,
    "flash": examples.flash,
}


def angles(scanner, time_s: float, most: int = 40_000):
    """Azimuth and elevation [degrees] and time [s] of the pulses before this time, evenly thinned."""
    pulses = np.arange(int(np.ceil(scanner.pulses * time_s / scanner.frame_s)), dtype=np.uint32)
    pulses = pulses[:: max(1, len(pulses) // most)]
    x, y, z = (np.asarray(one, dtype=np.float64) for one in scanner.direction(pulses))
    azimuth, elevation = np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))
    return azimuth, elevation, np.asarray(scanner.time_s(pulses))


def bright(seconds: float) -> dict[str, object]:
    """Colours from blue to red over this time, without the dark ends of the map."""
    return {"cmap": "turbo", "vmin": -0.15 * seconds, "vmax": 1.15 * seconds}


def patterns() -> None:
    """Where three sensors look within a tenth of a second and within one."""
    figure, axes = dark(2, 3, height=6.6)
    for number, (seconds, name) in enumerate((s, n) for s in TIMES_S for n in RECIPE):
        azimuth, elevation, time = angles(lidarscene.load_sensor(name).scanner, seconds)
        axes[number].scatter(azimuth, elevation, c=time, s=0.5, linewidths=0, **bright(seconds))
        axes[number].set(xlim=(42, -42), ylim=(-42, 42), aspect="equal")
        axes[number].set_title(f"{name}, {seconds:g} s", color=INK, loc="left", fontsize=11)
        if number > 2:
            axes[number].set_xlabel("azimuth [°]", color=INK)
        if number % 3 == 0:
            axes[number].set_ylabel("elevation [°]", color=INK)
    saved(figure, "patterns.png", colours=32)


def scanners() -> None:
    """A frame of each kind of scanner, coloured by time."""
    figure, axes = dark(2, 3, height=6.2)
    for one, (name, made) in zip(axes, KINDS.items(), strict=True):
        scanner = made()
        azimuth, elevation, time = angles(scanner, scanner.frame_s)
        size = 4.0 if len(time) < 10_000 else 0.9
        one.scatter(azimuth, elevation, c=time, s=size, linewidths=0, **bright(scanner.frame_s))
        one.invert_xaxis()
        one.set_title(name, color=INK, loc="left", fontsize=11)
    for one in axes[3:]:
        one.set_xlabel("azimuth [°]", color=INK)
    for one in axes[::3]:
        one.set_ylabel("elevation [°]", color=INK)
    saved(figure, "scanners.png", colours=32)
