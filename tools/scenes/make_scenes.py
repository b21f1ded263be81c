"""Write the shipped scenes: python tools/scenes/make_scenes.py [--out DIR]."""

import argparse
import sys
from pathlib import Path

import car_scene
import drive_scene
import edges_scene
import fog_scene
import foliage_scene
import garage_scene
import glass_scene
import interference_scene
import low_sun_scene
import make_range_scene
import parallax_scene
import rain_scene
import retro_scene
import snow_scene
import street_scene
import town_scene

SCENES = {
    "car": car_scene.text,
    "range": make_range_scene.text,
    "street": street_scene.text,
    "drive": drive_scene.text,
    "garage": garage_scene.text,
    "fog": fog_scene.text,
    "foliage": foliage_scene.text,
    "glass": glass_scene.text,
    "rain": rain_scene.text,
    "retro": retro_scene.text,
    "edges": edges_scene.text,
    "low_sun": low_sun_scene.text,
    "snow": snow_scene.text,
    "parallax": parallax_scene.text,
    "interference": interference_scene.text,
    "town": town_scene.text,
}


def make(folder):
    """Write all scenes into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in SCENES.items():
        (folder / f"{name}.toml").write_text(text(), encoding="utf-8", newline="\n")


def main():
    """Run from the command line."""
    parser = argparse.ArgumentParser(description="write the shipped scenes")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[2] / "scenes")
    make(parser.parse_args().out)
    sys.stdout.write(f"{', '.join(SCENES)} written\n")


if __name__ == "__main__":
    main()
