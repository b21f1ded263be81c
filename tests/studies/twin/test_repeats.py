"""Losses and noise of pixels at rest, on pixels made by hand."""

from typing import Any

import numpy as np
import pytest
from helpers.twins import pulses

from lidarscene.studies.held import Held
from lidarscene.studies.twin.repeats import Repeats, kept_at_rest, kept_by_bin, on_surfaces

FRAMES, PIXELS = 4, 8000


def repeats(sigma_m: float = 0.01, simulated_sigma_m: float = 0.01, **changed: Any) -> Repeats:
    """Pixels at 10 to 20 m, those of weak returns with three times the noise, on both sides."""
    rng = np.random.default_rng(4)
    true_m = np.linspace(10.0, 20.0, PIXELS)
    strength = np.where(np.arange(PIXELS) % 2 == 0, 5.0, 50.0)
    noise = rng.normal(0.0, 1.0, (2, FRAMES, PIXELS)) * np.where(strength < 10.0, 3.0, 1.0)
    every = np.broadcast_to(strength, (FRAMES, PIXELS))
    fields = {
        "range_m": true_m + sigma_m * noise[0],
        "simulated_range_m": true_m + simulated_sigma_m * noise[1],
        "strength": every * (1.0 + 0.02 * rng.normal(0.0, 1.0, every.shape)),
        "simulated_strength": every,
        "is_smooth": np.ones(every.shape, bool),
    }
    return Repeats(**{name: changed.get(name, values) for name, values in fields.items()})


def rows_of(pixels: Repeats) -> dict[str, Held]:
    return {row.quantity: row for row in pixels.quantities()}


def test_scatter_is_that_of_a_pixel_by_range_and_strength() -> None:
    """Rationale: 12,000 differences of which 8 bins are made: 1.5 of their 2.6 % is far below the limits."""
    rows = rows_of(repeats())
    assert rows["range, scatter at rest, worst bin"].verdict
    assert rows["range, scatter at rest, bins within the limits"].value == 1.0
    rows = rows_of(repeats(simulated_sigma_m=0.02))
    worst = rows["range, scatter at rest, worst bin"]
    assert worst.value == pytest.approx(2.0, rel=0.1)
    assert worst.verdict is False
    assert worst.reference in (pytest.approx(10.0, rel=0.1), pytest.approx(30.0, rel=0.1))
    assert rows["range, scatter at rest, bins within the limits"].value == 0.0
    rough = repeats(is_smooth=np.zeros((FRAMES, PIXELS), bool))
    assert rows_of(rough)["range, scatter at rest, worst bin"].value is None


def test_strengths_scatter_around_their_own() -> None:
    row = rows_of(repeats())["strength, relative scatter"]
    assert row.reference == pytest.approx(0.02, rel=0.1)
    assert row.simulated == 0.0


def test_pixels_that_flicker_or_jump_are_counted_and_scatter_does_not_see_them() -> None:
    """Every tenth pixel is lost once; every twentieth is a metre on in the last of four frames."""
    pixels = repeats()
    range_m = pixels.range_m.copy()
    range_m[1, ::10] = np.nan
    range_m[3, 5::20] += 1.0
    rows = rows_of(repeats(range_m=range_m))
    flicker, jump = rows["pixels that return now and then"], rows["pixels that jump by 0.3 m"]
    assert (flicker.reference, flicker.simulated) == (pytest.approx(0.1), 0.0)
    changes = 3 * PIXELS - 2 * PIXELS // 10
    assert jump.reference == pytest.approx(PIXELS / 20 / changes)
    assert rows["range, scatter at rest, worst bin"].verdict


def test_frames_are_ordered_by_the_number_of_the_pulse() -> None:
    first = pulses()
    backwards = first.select(np.arange(len(first.range_m))[::-1][:100])
    pixels = Repeats.from_frames([first, backwards], len(first.range_m))
    assert np.array_equal(pixels.range_m[0, -100:], pixels.range_m[1, -100:])
    assert np.isnan(pixels.range_m[1, :-100]).all()
    assert Repeats.from_frames([pulses(strength=None)], len(first.range_m)).strength is None


def test_a_lost_pulse_was_kept_as_often_as_in_the_other_frames() -> None:
    first, number = pulses(), np.arange(len(pulses().range_m))
    lost = first.range_m * np.where(number < 10, np.nan, 1.0)
    frames = [pulses(range_m=lost), first, pulses(range_m=lost), first]
    again = Repeats.from_frames(frames, len(number)).kept_again(frames[0])
    assert again[:10] == pytest.approx(2.0 / 3.0)


def test_the_share_that_is_kept_is_that_of_the_worst_octave() -> None:
    """A tenth is lost beyond 32 m in the recording alone; of what was lost in the twin's frame nothing is said."""
    base = pulses()
    lost = (base.true_range_m > 32.0) & (np.arange(len(base.ring)) % 10 == 0)
    recorded = pulses(range_m=np.where(lost, np.nan, base.range_m))
    row = kept_at_rest(recorded, on_surfaces(recorded))
    assert row.condition == "32 to 64 m"
    assert row.value == pytest.approx(0.1, abs=0.01)
    assert row.verdict is False
    assert kept_at_rest(recorded, ~lost).verdict
    assert kept_at_rest(recorded, np.zeros(len(lost), bool)).value is None
    met = recorded.select(~lost)
    shares = kept_by_bin(met.has_return, met.has_simulated_return, met.true_range_m, np.array([5.0, 41.0]))
    assert shares == [(5.0, 41.0, 1.0, 1.0)]
