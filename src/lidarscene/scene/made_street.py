"""`street`: the scene of a street that is made from a seed, or of the roads of a map."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ..errors import OptionError
from ..files.arguments import checks_arguments
from ..files.overrides import to_builtin, toml_text
from ..files.toml import validate
from .scene import Scene
from .scene_file import scene_from_model
from .street import TOWN_STREETS
from .street.network_tables import NetworkKind, network_scene
from .street.pieces import Tables
from .street.street_file import StreetFile
from .street.street_tables import street_tables
from .tables import SceneFile

NETWORK_KEYS = {"seed", "house_share", "setback_m", "lamp_spacing_m", "oncoming_gap_m", "shown_m"}
"""Keys of [street] that a road network takes: what stands along roads, and how many drive there."""

Networks = dict[NetworkKind, str | os.PathLike[str] | int | None]
"""Kind of a road network -> its source."""


@checks_arguments
def street(
    seed: int = 1,
    *,
    opendrive: str | os.PathLike[str] | None = None,
    osm: str | os.PathLike[str] | None = None,
    sumo: str | os.PathLike[str] | None = None,
    town: int | None = None,
    ego: str | None = None,
    left_hand: bool = False,
    **keys: Any,
) -> Scene:
    """Make the scene of a street with houses, trees and traffic from a seed, or of the roads of a map.

    `Scene.save` writes it, `lidarscene street` writes it with its meshes and motions beside it.

    Args:
        seed: of all random choices
        opendrive: OpenDRIVE file with the roads
        osm: OpenStreetMap file with the roads
        sumo: SUMO configuration with roads and traffic
        town: number of streets in each direction of a drawn town, 3 to 12
        ego: vehicle of ``sumo`` that carries the sensor; the one with the longest drive if None
        left_hand: whether the traffic of ``osm`` keeps to the left, which maps do not say
        keys: other keys of ``[street]``, such as ``length_m=200, lanes=2``

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    given = {key: to_builtin(value) for key, value in ({"seed": seed} | keys).items()}
    file = validate(StreetFile, given, "street")
    networks: Networks = {"opendrive": opendrive, "osm": osm, "sumo": sumo, "town": to_builtin(town)}
    tables, _ = made_tables(file, networks, ego=ego, left_hand=left_hand)
    path = Path("street.toml")
    return scene_from_model(validate(SceneFile, {"name": path.stem} | tables, path.name), path=path)


def made_tables(
    file: StreetFile, networks: Networks, *, ego: str | None, left_hand: bool = False
) -> tuple[Tables, str]:
    """Make the tables of a scene file of a street or of a road network, and a text that says what they are made of.

    Args:
        networks: kind of a road network -> its source; None for all but one at most

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    given = [(kind, source) for kind, source in networks.items() if source is not None]
    if len(given) > 1:
        raise OptionError(f"{{{given[0][0]}}} and {{{given[1][0]}}}: must be only one of them, got both")
    if ego is not None and [kind for kind, _ in given] != ["sumo"]:
        raise OptionError("{ego} needs {sumo}")
    if left_hand and [kind for kind, _ in given] != ["osm"]:
        raise OptionError("{left_hand} needs {osm}")
    if not given:
        return street_tables(file), ", ".join(f"{key} = {toml_text(value)}" for key, value in file.model_dump().items())
    ((kind, source),) = given
    if unused := sorted(file.model_fields_set - NETWORK_KEYS - ({"slope_percent"} if kind == "town" else set())):
        raise OptionError(f"{{0}}: cannot be combined with {{{kind}}}, which has its own roads and routes", unused[0])
    if kind == "town":
        assert isinstance(source, int)
        if not TOWN_STREETS[0] <= source <= TOWN_STREETS[1]:
            raise OptionError("{town}: must be a whole number from {0} to {1}, got {2}", *TOWN_STREETS, source)
        return network_scene(source, kind, file), f"{kind} {source}, seed = {file.seed}"
    assert not isinstance(source, int)
    path = Path(source)
    tables = network_scene(path, kind, file, ego=ego, left_hand=left_hand)
    return tables, f"{kind} {path.name}, seed = {file.seed}"
