"""Accuracy with which range images are told apart."""

from typing import Any

import numpy as np
import pytest
from helpers.twins import use_few_trees

from lidarscene.maths.arrays import Numbers
from lidarscene.studies.twin.told_apart import Image, told_apart

ROWS, COLUMNS = 64, 512


@pytest.fixture(autouse=True)
def _few_trees(monkeypatch: pytest.MonkeyPatch) -> None:
    use_few_trees(monkeypatch)


def image(
    seed: int,
    *,
    sigma_m: float = 0.01,
    lost: float = 0.02,
    scale: float = 1.0,
    texture: float = 0.05,
    growth: float = 0.0,
) -> Image:
    """A ring of walls at 10 to 20 m, whose strengths grow by a share from column to column."""
    rng = np.random.default_rng(seed)
    range_m = 15.0 + 5.0 * np.sin(np.linspace(0.0, 6.0 * np.pi, COLUMNS)) + rng.normal(0.0, sigma_m, (ROWS, COLUMNS))
    strength = scale * np.exp(texture * rng.normal(0.0, 1.0, range_m.shape) + growth * np.arange(COLUMNS))
    return Image(np.where(rng.random(range_m.shape) < lost, np.nan, range_m), strength)


def accuracies(**changed: Any) -> dict[str, float]:
    pytest.importorskip("sklearn")
    results = told_apart([image(1), image(2)], [image(3, **changed), image(4, **changed)])
    assert {result.patches for result in results.values()} == {2 * ROWS * COLUMNS // (8 * 16)}
    return {name: result.accuracy for name, result in results.items()}


def test_frames_of_one_sensor_are_not_told_apart() -> None:
    """Rationale: 1,024 patches in all, of which chance names half with a sigma of 1.6 %; here 6 of it."""
    assert all(abs(accuracy - 0.5) < 0.1 for accuracy in accuracies().values())


@pytest.mark.parametrize(
    ("changed", "telling"),
    [
        ({"sigma_m": 0.02}, "range texture"),
        ({"lost": 0.1}, "holes"),
        ({"texture": 0.1}, "intensity"),
        ({"growth": 0.2}, "intensity"),
    ],
)
def test_a_difference_is_told_by_its_own_group(changed: dict[str, float], telling: str) -> None:
    found = accuracies(**changed)
    assert found["all"] > 0.9
    assert found[telling] > 0.9
    assert abs(found["edges"] - 0.5) < 0.1


def test_the_scale_of_strengths_tells_nothing() -> None:
    assert abs(accuracies(scale=7.0)["intensity"] - 0.5) < 0.1


def test_digits_below_the_steps_of_ranges_tell_nothing() -> None:
    """Rationale: both are in steps of a millimetre. Times in steps of 6.67 ps make one of 0.9998 mm, and single
    precision has digits of its own: trees told quantiles that differ by that apart, in one of four cases by 0.1.
    """
    pytest.importorskip("sklearn")

    def stepped(seed: int) -> Numbers:
        return np.rint(1e3 * image(seed, sigma_m=0.002).range_m) / 1e3

    real = [Image(stepped(seed), None) for seed in (1, 2)]
    exact = [Image(stepped(seed), None) for seed in (3, 4)]
    rounded = [Image((0.9998 * image.range_m).astype(np.float32), None) for image in exact]
    results = told_apart(real, exact)
    assert told_apart(real, rounded) == results
    assert abs(results["range texture"].accuracy - 0.5) < 0.1


def test_without_strengths_or_with_few_patches() -> None:
    pytest.importorskip("sklearn")
    bare = [Image(image(seed).range_m, None) for seed in (1, 2)]
    assert "intensity" not in told_apart(bare[:1], bare[1:])
    wider = Image(np.pad(bare[1].range_m, ((0, 0), (0, 30)), mode="wrap"), None)
    assert told_apart(bare[:1], [wider]) == told_apart(bare[:1], bare[1:])
    for rows, columns in ((8, COLUMNS), (4, COLUMNS), (ROWS, 8)):
        small = [Image(side.range_m[:rows, :columns], None) for side in bare]
        assert told_apart(small[:1], small[1:]) == {}


def test_strengths_across_an_edge_tell_nothing() -> None:
    """Rationale: steps of 1 m, on whose farther side one image is brighter: that is the scene's, not the noise's."""
    pytest.importorskip("sklearn")

    def stepped(seed: int, brighter: float) -> Image:
        flat, is_far = image(seed), np.arange(COLUMNS) // 4 % 2 == 1
        return Image(flat.range_m + is_far, flat.strength * np.where(is_far, brighter, 1.0))

    results = told_apart([stepped(1, 1.0), stepped(2, 1.0)], [stepped(3, 3.0), stepped(4, 3.0)])
    assert abs(results["intensity"].accuracy - 0.5) < 0.1
