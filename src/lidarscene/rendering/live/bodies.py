"""Which bodies of a scene can be placed, and the spare ones that wait to be added."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace

from ...errors import InputError
from ...maths.trajectory import Course
from ...scene.scene import Body, Scene

_SHOWN = 8
"""Names in an error, at most."""


def live_scene(
    scene: Scene, movable: Iterable[str], spares: Mapping[str, int]
) -> tuple[Scene, dict[str, tuple[str, ...]]]:
    """The scene with an ego vehicle, bodies that can be placed, and spare ones that are away; and a body's copies.

    What can be placed has a motion: at first one that rests, where it has none of its own. Spare bodies come last, so
    that the others keep their numbers. Raises InputError for a name that is no body, or a number that is none.
    """
    if isinstance(movable, str):
        raise InputError(f"movable: must be several names, got '{movable}'")
    bodies = {body.name: body for body in scene.bodies}
    for name in (*movable, *spares):
        if (body := known(bodies, name)).motion is None:
            bodies[name] = replace(body, motion=Course(start=body.pose))
    pools: dict[str, tuple[str, ...]] = {}
    for name, count in spares.items():
        if not isinstance(count, int) or isinstance(count, bool) or count < 0:
            raise InputError(f"spares: '{name}': must be a whole number >= 0, got {count!r}")
        pools[name] = (name, *spare_names(name, count, bodies))
        for spare in pools[name][1:]:
            # The same parts: they share what is compiled.
            bodies[spare] = replace(bodies[name], name=spare, away=True)
    return replace(scene, bodies=tuple(bodies.values()), ego=scene.ego or Course()), pools


def spare_names(name: str, count: int, taken: Iterable[str]) -> list[str]:
    """Names of copies of a body "car" or "car.0" that no other body has: "car.1", "car.2", ..."""
    found: list[str] = []
    number, taken, base = 1, set(taken), re.sub(r"\.\d+$", "", name)
    while len(found) < count:
        if (one := f"{base}.{number}") not in taken:
            found.append(one)
        number += 1
    return found


def known(bodies: Mapping[str, Body], name: str, why: str = "not in the scene", what: str = "its bodies") -> Body:
    """The body of this name. Raises InputError where there is none: why, and what there is."""
    if name in bodies:
        return bodies[name]
    names = [f"'{one}'" for one in bodies]
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    raise InputError(f"body '{name}': {why}; {what}: {(', '.join(names[:_SHOWN]) or 'none') + more}")
