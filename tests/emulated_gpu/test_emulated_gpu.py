"""What a GPU computes, on an emulated one: frames are those of the CPU, and what no card runs is told in a line."""

import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from emulated_gpu import emulator, ptx
from helpers.child import assert_ended
from helpers.run_seed import chosen

from lidarscene.cli import main
from lidarscene.files.cache_folder import VARIABLE
from lidarscene.kernel.device import trial
from lidarscene.kernel.device.trial import Verdict

TESTS = Path(__file__).parents[1]

ON_A_CARD = (
    "cloud/test_device_cloud.py::test_columns_on_the_device_are_those_of_the_cloud[10000]",
    "cloud/test_device_cloud.py::test_every_way_to_render_leaves_columns_there",
    "cloud/test_device_cloud.py::test_frames_of_a_run_are_each_their_own",
    "batch/test_dataset.py::test_a_sequence_is_that_of_render",
    "kernel/rays/test_nearby_bodies.py::test_one_kernel_asks_all_scenes",
    "kernel/rays/test_onward.py::test_against_a_ray_tracer_of_planes",
    "outputs/test_streams.py::test_no_chunk_is_kept[single]",
)
"""Tests of what a card does in its own way: columns that stay there, frames that share a launch, labelled sequences,
one kernel that asks all scenes, mirrors that rounding takes nothing from, and chunks whose columns are one array."""


@pytest.fixture
def card(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes that a test starts have the emulated card."""
    try:
        card = emulator.environment()
    except emulator.NoEmulatorError as error:
        pytest.skip(str(error))
    for name, value in card.items():
        monkeypatch.setenv(name, value)


on_card = pytest.mark.usefixtures("card")


def run(*arguments: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True)


@on_card
def test_frames_are_those_of_the_cpu(mi: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The trial that a real card passes before its first use: moving bodies, glass, fog and several rays.

    Those of the CPU are rendered in this process.
    """
    in_process = trial._run

    def render(words: Sequence[str], variant: str) -> str:
        return in_process(words, variant) if variant == "cuda_ad_mono" else "failed" * main.main(words[2:])

    monkeypatch.setenv(VARIABLE, "")
    monkeypatch.setattr(trial, "_run", render)
    assert trial.verdict("cuda_ad_mono", "llvm_ad_mono") == Verdict()


@on_card
def test_what_a_card_does_in_its_own_way(monkeypatch: pytest.MonkeyPatch) -> None:
    names = chosen(1, ON_A_CARD)
    monkeypatch.setenv("EVERY_CASE", "1")  # a case that is named here may not be among those drawn
    tests = run("-m", "pytest", "-n", "0", "-q", "-p", "no:cacheprovider", *(str(TESTS / name) for name in names))
    assert_ended(tests, stdout=None)
    assert f"{len(names)} passed" in tests.stdout


ONE_LANE = """
import ctypes, os, sys
cuda, start, module, kernel = ctypes.CDLL(os.environ["DRJIT_LIBCUDA_PATH"]), *(ctypes.c_void_p() for _ in range(3))
cuda.cuInit(0)
cuda.cuMemAlloc_v2(ctypes.byref(start), ctypes.c_size_t(64))
cuda.cuModuleLoadData(ctypes.byref(module), sys.argv[1].encode())
cuda.cuModuleGetFunction(ctypes.byref(kernel), module, b"drjit_1")
extra = (ctypes.c_void_p * 3)(1, ctypes.addressof(start), None)
cuda.cuLaunchKernel(kernel, 1, 1, 1, 1, 1, 1, 0, None, None, extra)
"""
"""A launch of one lane, whose parameter is where 64 bytes begin."""

ENTRY = """.entry drjit_1(.param .align 8 .b8 params[8]) {{
    ld.param.u64 %rd0, [params];
    {};
    ret;
}}
"""


@on_card
@pytest.mark.parametrize(
    ("statement", "told"),
    [
        ("ld.global.v4.b32 {%r1, %r2, %r3, %r4}, [%rd0+48]", ""),
        ("ld.global.v4.b32 {%r1, %r2, %r3, %r4}, [%rd0+4]", "misaligned address * of 16 bytes"),
        ("ld.global.b32 %r1, [%rd0+64]", "4 bytes at * are not allocated"),
        ("red.global.add.f32 [%rd0+60], 0f3f800000", ""),
        ("st.global.b32 [%rd0+256], 0", "4 bytes at * are not allocated"),
    ],
)
def test_what_reads_or_writes_elsewhere_is_told(statement: str, told: str) -> None:
    ended = run("-c", ONE_LANE, ENTRY.format(statement))
    assert ended.returncode == (-6 if told else 0), ended.stderr
    assert re.fullmatch(f"emulated GPU: {told}\n".replace("*", "[0-9a-f]+") if told else "", ended.stderr)


TWO_SCENES = """
import mitsuba as mi, drjit as dr
mi.set_variant("cuda_ad_mono")
scenes = [mi.load_dict({"type": "scene", "shape": {"type": kind}}) for kind in KINDS]
ray = mi.Ray3f(mi.Point3f(dr.arange(mi.Float, 8) / 8, 0, 5), mi.Vector3f(0, 0, -1))
print(sum(scene.ray_intersect_preliminary(ray).t for scene in scenes))
"""


@on_card
@pytest.mark.parametrize(
    ("kinds", "line"),
    [
        (["sphere", "cube"], "cannot run mov.b32 * (a ray that Dr.Jit left out: *)"),
        (["disk"], "has no __intersection__disk"),
    ],
)
def test_what_no_pipeline_answers_is_told(kinds: list[str], line: str) -> None:
    """A kernel that asks two scenes, of which Dr.Jit leaves out one; a shape that the emulated card does not have."""
    ended = run("-c", TWO_SCENES.replace("KINDS", repr(kinds)))
    assert ended.returncode == -6
    assert f"emulated GPU: {line.partition('*')[0]}" in ended.stderr, ended.stderr


def test_what_is_no_instruction_of_dr_jit_is_told() -> None:
    assert "return;" in ptx.translate(ENTRY.format("add.f32 %f1, %f1, 0f3f800000"))
    for statement in ("wmma.mma.f32 %f1, %f2", "add.f16 %h1, %h2, %h3", "add.f32 %f1, %f2, here"):
        with pytest.raises(ptx.Untranslatable):
            ptx.translate(ENTRY.format(statement))


@on_card
def test_folders_have_any_name(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A kernel and the driver itself are compiled in a folder whose name means something to shells, C and printf."""
    monkeypatch.setenv(VARIABLE, str(tmp_path / 'it\'s "100 %s", $HOME'))
    monkeypatch.setenv("DRJIT_LIBCUDA_PATH", emulator.environment()["DRJIT_LIBCUDA_PATH"])
    assert_ended(run("-c", ONE_LANE, ENTRY.format("ld.global.b32 %r1, [%rd0]")))
    assert len(list(tmp_path.rglob("*.so"))) == 2


@on_card
def test_what_no_emulated_card_is_made_from_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No cache, a folder of someone else, and a compiler that compiles nothing."""
    monkeypatch.setenv(VARIABLE, "")
    with pytest.raises(emulator.NoEmulatorError, match=f"{VARIABLE} is empty"):
        emulator.environment()
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    with monkeypatch.context() as other:
        other.setattr("os.getuid", lambda: -1)
        with pytest.raises(emulator.NoEmulatorError, match="another user's folder"):
            emulator.environment()
    (tmp_path / "cc").symlink_to("/bin/false")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(emulator.NoEmulatorError, match="cc does not compile"):
        emulator.environment()


@pytest.mark.parametrize(("arguments", "line"), [((), "usage: "), (("no-such-command",), "error: ")])
def test_a_wrong_command_is_told_in_a_line(arguments: tuple[str, ...], line: str) -> None:
    ended = run(emulator.__file__, *arguments)
    assert (ended.returncode, ended.stderr[: len(line)], ended.stderr.count("\n")) == (1, line, 1)


SHAPES = """
import drjit as dr, numpy as np
from mitsuba import ScalarTransform4f as Place
ball = {"type": "shapegroup", "ball": {"type": "sphere", "center": [0.3, 0, 0], "radius": 0.8}}
place = Place().translate([0, 0, 1]).rotate([0, 1, 0], 30).scale([1, 2, 1.5])
scene = mi.load_dict({
    "type": "scene", "ball": ball,
    "one": {"type": "instance", "to_world": place, "group": {"type": "ref", "id": "ball"}},
    "floor": {"type": "rectangle", "to_world": Place().translate([0, 0, -1]).scale(3)},
})
x, y = (mi.Float(values) for values in np.random.default_rng(1).uniform(-3, 3, (2, 2000)))
hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(x, y, 5), mi.Vector3f(0.1, 0, -1)))
values = [hit.t, *hit.n, *hit.p]
for wrap in (dr.WrapMode.Repeat, dr.WrapMode.Clamp, dr.WrapMode.Mirror):
    image = mi.TensorXf(np.random.default_rng(2).uniform(size=(5, 7, 3)).astype(np.float32))
    values.extend(mi.Texture2f(image, wrap_mode=wrap).eval(mi.Point2f(x, y)))
values = np.array([value.numpy() for value in values])
"""


@on_card
def test_spheres_and_textures_are_those_of_the_cpu(mi, tmp_path: Path) -> None:
    """A turned and stretched instance of a shape that no triangles make. Texels are mixed by weights of 8 bits: each of
    two is at most 1/512 off, of values between 0 and 1.
    """
    there: dict[str, Any] = {"mi": mi}
    exec(SHAPES, there)
    end = f"np.save({str(tmp_path / 'values.npy')!r}, values)"
    assert_ended(run("-c", f"import mitsuba as mi; mi.set_variant('cuda_ad_mono')\n{SHAPES}\n{end}"))
    values = np.load(tmp_path / "values.npy")
    np.testing.assert_allclose(values[:7], there["values"][:7], atol=2e-5, rtol=1e-6)
    np.testing.assert_allclose(values[7:], there["values"][7:], atol=2 / 512 + 1e-5)
