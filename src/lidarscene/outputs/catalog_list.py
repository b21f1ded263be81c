"""Lists of the catalogue, a line for each entry.

No sensor is built and no simulator imported, so that they come at once.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .. import catalog
from ..files.toml import read_toml
from ..materials.material_file import catalogue_material
from ..scene.bare_mesh import mesh_description
from ..scene.scene_file import scene_description


def catalog_text(kind: str, entries: Mapping[str, Mapping[str, Any]]) -> str:
    """Text of `catalog_entries`, a line each."""
    lines = [f"{kind}:"]
    for name, entry in entries.items():
        columns = [f"{name:<26}"]
        if kind == "materials":
            share = f"{entry['reflectivity_905_nm']:.1%} at 905 nm"
            columns += [f"{share:<18}", f"{entry['bsdf']:<15}"]
        lines.append(f"  {' '.join([*columns, entry['description']])}")
    return "\n".join(lines)


def catalog_entries(kind: str) -> dict[str, dict[str, Any]]:
    """Name -> file and description of the catalogue's entries of one kind, of materials also BSDF and reflectivity."""
    entries = {name: {"file": str(path)} for name, path in catalog.files(kind).items()}
    return {name: entry | _described(kind, name) for name, entry in entries.items()}


def _described(kind: str, name: str) -> dict[str, Any]:
    path = catalog.path_of(kind, name)
    match kind:
        case "sensors" | "imus":
            return {"description": read_toml(path).get("description", "")}
        case "meshes":
            return {"description": mesh_description(path)}
        case "examples":
            return {"description": _example_description(path)}
        case "designs":
            return {"description": read_toml(path).get("name", "")}
        case "scenes":
            return {"description": scene_description(path)}
    material = catalogue_material(name)
    return {
        "description": material.description,
        "bsdf": material.bsdf,
        "reflectivity_905_nm": float(material.reflectivity.at(905e-9)),
    }


def _example_description(path: Path) -> str:
    """Description or first line of a TOML file, or which sensor recorded a capture with its metadata beside it."""
    if path.suffix == ".toml":
        return read_toml(path).get("description") or path.read_text("utf-8").splitlines()[0].lstrip("# ")
    return f"recording of an Ouster {json.loads(path.with_suffix('.json').read_text('utf-8'))['prod_line']}"
