"""How many frames go out at once, without a cluster: by hand, and a job given out to its end."""

from types import SimpleNamespace

import pytest

from lidarscene.batch import manifest
from lidarscene.batch.dispatch import BUNDLES_FOR_EACH, _Dispatcher


def bundle_size(frames_left: int, *, threads: int, frame_s: float) -> int:
    return _Dispatcher.share(SimpleNamespace(_frame_s=frame_s, _count=lambda: threads), frames_left)


@pytest.mark.parametrize(
    ("frame_s", "threads", "frames_left", "frames"),
    [
        (1.0, 4, 10**6, 1),  # a second of work
        (0.25, 4, 10**6, 4),
        (0.021, 4, 10**6, 47),
        (0.005, 4, 10**6, 100),  # never more than 100
        (1e-9, 4, 10**6, 100),
        (30.0, 4, 10**6, 1),  # never less than one
        (0.02, 4, 200, 25),  # near the end half of what each thread would get
        (0.02, 4, 80, 10),
        (0.02, 1, 80, 40),
        (0.02, 4, 15, 1),
        (0.02, 4, 1, 1),
    ],
)
def test_share_by_hand(frame_s: float, threads: int, frames_left: int, frames: int) -> None:
    assert bundle_size(frames_left, threads=threads, frame_s=frame_s) == frames


@pytest.mark.parametrize("threads", [1, 3, 16])
def test_no_thread_waits_long_for_the_last_bundle(threads: int) -> None:
    """Rationale: what is given out last is what the others wait for. Whatever is left, a bundle is half of a thread's
    even part of it at most, or a single frame; and bundles become smaller to the end.
    """
    frames_left, before = 5000, 100
    while frames_left:
        frames = bundle_size(frames_left, threads=threads, frame_s=1e-3)
        assert 1 <= frames <= before
        assert frames == 1 or frames <= 0.5 * frames_left / threads
        frames_left, before = frames_left - frames, frames
    assert before == 1


def test_each_thread_has_one_bundle_waiting() -> None:
    dispatcher = SimpleNamespace(bundles={}, _count=lambda: 3)
    for number in range(2 * 3):
        assert not _Dispatcher.is_enough(dispatcher)
        dispatcher.bundles[number] = []
    assert _Dispatcher.is_enough(dispatcher)
    assert BUNDLES_FOR_EACH == 2


def test_the_time_of_a_frame_is_that_of_its_bundle_over_its_frames() -> None:
    """Three frames in 0.6 s: 0.2 s each, and five of these are a second."""
    future = SimpleNamespace(key="render-1", cancelled=lambda: False, status="finished")
    bundle = [SimpleNamespace(frame_count=1) for _ in range(3)]
    dispatcher = SimpleNamespace(
        bundles={"render-1": bundle},
        _waiting=iter([(future, (["", "broken", ""], 0.6))]),
        _frame_s=1.0,
        _count=lambda: 4,
        _futures={},
        _since_s={},
        _late={},
        _longest_s=0.3,
    )
    assert _Dispatcher.next(dispatcher) == list(zip(bundle, ("", "broken", ""), strict=True))
    assert dispatcher.bundles == {}
    assert dispatcher._frame_s == pytest.approx(0.2)
    assert dispatcher._longest_s == 0.3
    assert _Dispatcher.share(dispatcher, 1000) == 5


@pytest.mark.parametrize(
    ("values", "kind"),
    [([1, 2.5], "float64"), ([1, 2], "int64"), ([True, False], "bool_"), ([True, 1], "string"), (["a", 1], "string")],
)
def test_columns_have_the_type_of_what_is_swept(values: list[object], kind: str) -> None:
    assert manifest._type_of(values) == kind
