"""Names of spare bodies."""

import dataclasses

import pytest
from helpers import chain

from lidarscene.rendering.live.bodies import live_scene, spare_names


@pytest.mark.parametrize(
    ("name", "taken", "names"),
    [
        ("car", ["car"], ["car.1", "car.2"]),
        ("car.0", ["car.0", "car.1"], ["car.2", "car.3"]),
        ("car.x", ["car.x.2"], ["car.x.1", "car.x.3"]),
    ],
)
def test_spares_have_names_that_are_free(name: str, taken: list[str], names: list[str]) -> None:
    assert spare_names(name, 2, taken) == names


def test_spares_of_two_bodies_have_names_of_their_own() -> None:
    both = [dataclasses.replace(chain.box(at=(0, 0, 0)), name=name) for name in ("car.0", "car.1")]
    scene, pools = live_scene(chain.scene(*both), (), {"car.0": 1, "car.1": 2})
    assert pools == {"car.0": ("car.0", "car.2"), "car.1": ("car.1", "car.3", "car.4")}
    assert [body.name for body in scene.bodies] == ["car.0", "car.1", "car.2", "car.3", "car.4"]
    assert [body.away for body in scene.bodies] == [False, False, True, True, True]
