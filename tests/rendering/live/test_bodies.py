"""Names of spare bodies."""

import pytest

from lidarscene.rendering.live.bodies import spare_names


@pytest.mark.parametrize(("name", "taken", "names"), [
    ("car", ["car"], ["car.1", "car.2"]), ("car.0", ["car.0", "car.1"], ["car.2", "car.3"]),
    ("car.x", ["car.x.2"], ["car.x.1", "car.x.3"]),
])  # fmt: skip
def test_spares_have_names_that_are_free(name: str, taken: list[str], names: list[str]) -> None:
    assert spare_names(name, 2, taken) == names
