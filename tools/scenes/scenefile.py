"""Scene files: headers and bodies in, TOML text out. Metres and degrees, as people edit them."""

import tomllib
from pathlib import Path

MESHES = "../assets/meshes"
KINDS = tomllib.loads((Path(__file__).parents[2] / "src/lidarscene/catalog/meshes.toml").read_text(encoding="utf-8"))


def value(item):
    """One TOML value; numbers to 1e-12, which any machine's cosines give alike."""
    if isinstance(item, str):
        return f'"{item}"'
    if isinstance(item, bool):
        return str(item).lower()
    if isinstance(item, dict):
        if not item:
            return "{}"
        return "{ " + ", ".join(f"{key} = {value(entry)}" for key, entry in item.items()) + " }"
    if isinstance(item, list | tuple):
        return "[" + ", ".join(value(entry) for entry in item) + "]"
    return repr(round(item, 12) + 0.0) if isinstance(item, float) else repr(item)


def table(title, /, **entries):
    """A TOML table; instances and poses stand one to a line."""
    lines = [title]
    for key, entry in entries.items():
        if key in ("instances", "poses"):
            lines += [f"{key} = [", *(f"    {value(one)}," for one in entry), "]"]
        else:
            lines.append(f"{key} = {value(entry)}")
    return "\n".join(lines) + "\n"


def place(x, y, z=0.0, yaw_deg=0.0):
    """One instance."""
    where = {"position_m": [float(x), float(y), float(z)]}
    return where | ({"yaw_deg": float(yaw_deg)} if yaw_deg else {})


APART_M = 0.002
"""Least distance between neighbouring houses of a row, in all three directions."""


def in_row(number):
    """(along, back, up): how far to shift a house of a row, so that no wall, roof or gutter lies in its neighbour's.

    Which of two surfaces at one place a beam meets depends on rounding, and so on the machine.
    """
    return APART_M * number, APART_M * (number % 2), APART_M * (number % 2)


def objects(name, mesh, instances, *, on_ground=False, **paint):
    """A body of one of our meshes, placed once per instance; `paint` gives or changes a part's material."""
    return table("[[bodies]]", name=name, **_shape(mesh, paint), **_standing(on_ground), instances=instances)


def sheet(name, kind, material, size_m, position_m=None, **keys):
    """A sheet of uneven ground, or one for each instance."""
    return primitive(name, "ground", kind, material, size_m=size_m, position_m=position_m, **keys)


def paint(name, size_m, places):
    """Lane markings, 3 mm thick."""
    return sheet(name, "lane_marking", "lane_marking", size_m, instances=places, spacing_m=0.2, on_ground=True)


def mover(name, mesh, where, motion, *, on_ground=False, **paint):
    """A body of one of our meshes that moves from `where`, or there in the frame that the poses are of; people walk."""
    walk = {key: KINDS[mesh][key] for key in ("animation", "standing") if key in KINDS[mesh]}
    body = table("[[bodies]]", name=name, **_shape(mesh, paint), **walk, **_standing(on_ground), **where)
    return "\n".join([body, table("[bodies.motion]", **motion)])


def _standing(on_ground):
    return {"on_ground": True} if on_ground else {}


def _shape(mesh, paint):
    return {
        "mesh": f"{MESHES}/{mesh}.glb",
        "class": KINDS[mesh]["class"],
        "materials": paint | {part: name for part, name in KINDS[mesh]["materials"].items() if part not in paint},
    }


def primitive(name, shape, kind, material, *, position_m=None, instances=None, **size):
    """A body made of a plane, a ground, a box, a sphere or a cylinder, at one place or at several."""
    where = {"instances": instances} if instances else {"position_m": [float(x) for x in position_m]}
    return table("[[bodies]]", name=name, primitive=shape, **{"class": kind}, material=material, **size, **where)


def header(name, description, *, made_by, sun, sky, air, sensor, picture, weather=None, ground=None, ego=None):
    """What stands above the bodies: the tables of numbers."""
    first = f"# Made by tools/scenes/{made_by}; change it there and run it again.\n"
    first += table(f"name = {value(name)}", description=description)
    parts = {"sun": sun, "sky": sky, "air": air, "weather": weather, "ground": ground, "ego": ego}
    parts |= {"sensor": sensor, "picture": picture}
    return "\n".join([first, *(table(f"[{key}]", **entries) for key, entries in parts.items() if entries)])
