"""Pictures of retro-reflectors: pulses that clip, the makers' intensities, bloom."""

import tempfile
from pathlib import Path

import numpy as np
from drawing import FINER, SCENES, below, frame
from PIL import Image

import lidarscene
from lidarscene.figures.pictures import range_image

CLIPPING = ["detector.saturation_ua=10000", "detector.recovery_ns=5"]


def retro() -> None:
    """The retro scene, coloured by the width of the pulses behind an amplifier that clips."""
    frame(
        "retro",
        overrides=[*FINER, *CLIPPING, "intensity.kind='reflectivity'"],
        colour_by="pulse_width",
        strips=("intensity", "pulse_width"),
        width=900,
    )


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
