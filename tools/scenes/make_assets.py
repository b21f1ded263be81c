"""Make every mesh of the shipped scenes: python tools/scenes/make_assets.py [--out DIR].

All is modelled here, by lofts, lathes and cuts; nothing is downloaded and nothing is drawn at random that is
not fixed by a seed, so that a second run writes the same bytes. Coordinates are written as they are, z up,
x forward, in metres, with the origin on the ground under the object (see glb.py).
"""

import argparse
import functools
import sys
from pathlib import Path

import car
import house
import people
import plants
import pram
import roadside
import vehicles
import wheelchair
from glb import glb_bytes, welded

OBJECTS = {
    "car": (car.build, car.COLOURS),
    "tree": (plants.build, plants.COLOURS),
    **{
        build.__name__: (build, plants.COLOURS)
        for build in (plants.conifer, plants.poplar, plants.birch, plants.bush, plants.juniper, plants.hedge)
    },
    **{name: (functools.partial(house.build, style), house.COLOURS) for name, style in house.STYLES.items()},
    "kerb": (roadside.kerb, {"kerb": (0.55, 0.54, 0.52, 1.0)}),
    **{name: (functools.partial(roadside.sign, *shape), roadside.COLOURS) for name, shape in roadside.SIGNS.items()},
    "lamp_post": (roadside.lamp_post, roadside.COLOURS),
    **{build.__name__: (build, roadside.COLOURS) for build in roadside.FURNITURE},
    **{name: (functools.partial(vehicles.build, size), vehicles.COLOURS) for name, size in vehicles.bodies().items()},
    "pram": (pram.build, pram.COLOURS),
    "wheelchair_user": (wheelchair.build, wheelchair.COLOURS),
    **{name: (functools.partial(people.build, name), people.COLOURS) for name in people.PEOPLE},
}


def make(folder):
    """Write all objects into `folder`; the lines of a summary."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = []
    for name, (build, colours) in OBJECTS.items():
        built = build()
        parts, skeleton = built if isinstance(built, tuple) else (built, None)
        data = glb_bytes(parts, colours, skeleton)
        (folder / f"{name}.glb").write_bytes(data)
        counts = {part: len(welded(mesh)[1]) for part, mesh in parts.items()}
        lines.append(f"{name}.glb {len(data) / 1e3:.0f} kB, {sum(counts.values())} triangles: {counts}")
    return lines


def main():
    """Run from the command line."""
    parser = argparse.ArgumentParser(description="make the meshes of the shipped scenes")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[2] / "assets" / "meshes")
    sys.stdout.write("\n".join(make(parser.parse_args().out)) + "\n")


if __name__ == "__main__":
    main()
