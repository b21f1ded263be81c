"""Which GPUs a process may see, by lists of cards that are not there."""

import os

import pytest

from lidarscene.kernel.device import backend, gpus


@pytest.fixture(autouse=True)
def _four_cards(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(backend.VARIANT_VARIABLE, raising=False)
    monkeypatch.delenv(gpus.VISIBLE, raising=False)
    monkeypatch.setattr(gpus, "_count", lambda: 4)


@pytest.mark.parametrize(
    ("listed", "names"),
    [
        (None, ("0", "1", "2", "3")),
        ("2, 0", ("2", "0")),
        ("GPU-7f3a,MIG-1b", ("GPU-7f3a", "MIG-1b")),
        ("1,-1,0", ("1",)),
        ("", ()),
        ("-1", ()),
    ],
)
def test_the_list_is_cudas_own(monkeypatch: pytest.MonkeyPatch, listed: str | None, names: tuple[str, ...]) -> None:
    """Reference: CUDA C++ Programming Guide, CUDA_VISIBLE_DEVICES: what is behind an invalid index is not seen."""
    if listed is not None:
        monkeypatch.setenv(gpus.VISIBLE, listed)
    assert gpus.visible_gpus() == names


@pytest.mark.parametrize(("variant", "count"), [("llvm_ad_mono", 0), ("cuda_ad_mono", 4)])
def test_a_variant_of_the_cpu_sees_none(monkeypatch: pytest.MonkeyPatch, variant: str, count: int) -> None:
    monkeypatch.setenv(backend.VARIANT_VARIABLE, variant)
    assert len(gpus.visible_gpus()) == count


def test_processes_take_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    for number in range(5):
        monkeypatch.delenv(gpus.VISIBLE, raising=False)
        gpus.see_one_gpu(number)
        seen.append(os.environ[gpus.VISIBLE])
    assert seen == ["0", "1", "2", "3", "0"]


def test_only_gpus_on_which_frames_are_rendered_are_in_use(monkeypatch: pytest.MonkeyPatch) -> None:
    for is_cuda, count in ((True, 4), (False, 0)):
        monkeypatch.setattr(backend, "is_cuda", lambda is_cuda=is_cuda: is_cuda)
        assert len(gpus.gpus_in_use()) == count


def test_a_machine_without_the_library_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    monkeypatch.setattr(gpus.ctypes, "CDLL", _missing)
    assert gpus._count() == 0


def _missing(name: str) -> None:
    raise OSError(f"{name}: cannot open shared object file")
