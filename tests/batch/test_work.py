"""What a worker does with a frame: the bits of `render`, worlds kept, failures told, nothing done twice."""

import dataclasses
import shutil
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from helpers.folders import raise_disk_full
from helpers.small_job import use_no_worlds_of_others
from helpers.walls import rig_text

from lidarscene import catalog
from lidarscene.batch import manifest, work
from lidarscene.batch.store import Store
from lidarscene.batch.tasks import FrameTask, Job
from lidarscene.cli import main
from lidarscene.cloud.point_cloud import PointCloud
from lidarscene.errors import OutputError
from lidarscene.files import atomic
from lidarscene.rendering.simulator import Simulator

COARSE = [
    f"--set=scanner.{axis}_{key}_deg={value}"
    for axis, fov in (("azimuth", 40), ("elevation", 20))
    for key, value in (("fov", fov), ("step", 2.0))
]
RIG = rig_text(("left", "table1-apd", "position_m = [0, 1, 0.3]"), ("right", "table1-apd", "position_m = [0, -1, 0.3]"))


@pytest.fixture(autouse=True)
def _fresh(mi: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker that has seen nothing yet."""
    use_no_worlds_of_others(monkeypatch)


def render_in_process(task: FrameTask, store: Store) -> Path:
    """Render a frame in this process; returns its file."""
    with work._rendered(task, store, 1):
        pass
    row = store.row(task.key)
    assert row is not None
    return store.folder / row["file"]


def cause_of(task: FrameTask, store: Store) -> str:
    """What a bundle of this frame alone says."""
    (cause,), _ = work.render_frames([task], str(store.folder), 1)
    return cause


def test_with_several_rays_too(job_file: Path, tmp_path: Path) -> None:
    """The wall stands behind a pane, which one interaction goes through."""
    pane = (tmp_path / "wall.toml").read_text().replace("wall", "pane").replace("concrete", "clear_glass")
    with (tmp_path / "wall.toml").open("a") as file:
        file.write(pane.replace("[10, 0, 1.8]", "[5, 0, 1.8]"))
    job_file.write_text("rays = 4\ninteractions = 1\n" + job_file.read_text())
    rendered_file = tmp_path / "alone.ply"
    argv = ["render", str(tmp_path / "wall.toml"), "-o", str(rendered_file), *COARSE, "--rays=4", "--interactions=1"]
    assert main.main([*argv, "--scene-set", "sun.illuminance_klux=1"]) == 0
    first = next(Job.read(job_file).tasks())
    assert render_in_process(first, Store(tmp_path / "out")).read_bytes() == rendered_file.read_bytes()


def test_of_a_rig_too(job_file: Path, tmp_path: Path) -> None:
    """Rationale: sensors of one wavelength share the world around the first; another one has other last bits."""
    (tmp_path / "rig.toml").write_text(RIG)
    job_file.write_text('rigs = ["rig.toml"]\nframes = 2\n' + job_file.read_text())
    argv = ["render", str(tmp_path / "wall.toml"), "--rig", str(tmp_path / "rig.toml"), "-o", str(tmp_path / "rig")]
    argv += [*COARSE, "--frames", "2", "--seed", "7", "--scene-set", "sun.illuminance_klux=1"]
    assert main.main(argv) == 0
    store, compared = Store(tmp_path / "out"), 0
    for task in reversed(list(Job.read(job_file).tasks())):  # the second sensor comes first
        if task.frame.seed == 7 and task.parameters["scene.sun.illuminance_klux"] == 1:
            rendered_file = tmp_path / "rig" / task.sensor.label / f"frame_{task.frame.number:04d}.ply"
            assert render_in_process(task, store).read_bytes() == rendered_file.read_bytes()
            compared += 1
    assert compared == 4


def test_a_sensor_elsewhere_has_a_world_of_its_own(
    job_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: a world's coordinates count from its sensor; from one far away they would have lost their digits."""
    compiled = []

    class Compiled:
        def __init__(self, *_: Any, world: object = None, **__: Any) -> None:
            if world is None:
                compiled.append(self)
            self.world = self if world is None else world

    monkeypatch.setattr(work, "Simulator", Compiled)
    text = job_file.read_text(encoding="utf-8")
    job_file.write_text(
        text.replace("[sweep.scene]", '[sweep.scene]\n"sensor.position_m" = [[0, 0, 1], [9e5, 0, 1]]'), encoding="utf-8"
    )
    worlds = {}
    for task in Job.read(job_file).tasks():
        place = tuple(task.parameters["scene.sensor.position_m"])
        worlds.setdefault(place, set()).add(id(work._simulator(task).world))
    assert len(compiled) == len(worlds) == 2
    assert [len(world_ids) for world_ids in worlds.values()] == [1, 1]


def test_another_scene_has_a_world_of_its_own_and_another_sun_has_not(
    job_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two scenes, or two ways to drive in one: the bodies of a compiled world stand, or move, elsewhere."""

    class Compiled:
        def __init__(self, *_: Any, world: object = None, **__: Any) -> None:
            self.world = object() if world is None else world

    monkeypatch.setattr(work, "Simulator", Compiled)
    wall = (job_file.parent / "wall.toml").read_text(encoding="utf-8")
    (job_file.parent / "far.toml").write_text(wall.replace("[10, 0, 1.8]", "[30, 0, 1.8]"), encoding="utf-8")
    drives = "".join(f'[[trajectories]]\nlabel = "{v}"\nspeed_m_s = {v}\n' for v in (5, 9))
    text = job_file.read_text(encoding="utf-8").replace('["wall.toml"]', '["wall.toml", "far.toml"]')
    job_file.write_text(text + drives, encoding="utf-8")
    tasks = list(Job.read(job_file).tasks())
    assert len({task.scene.world for task in tasks}) == 4
    assert len({task.scene.digest for task in tasks}) == 8  # under two suns
    simulators = [work._simulator(task) for task in tasks]
    assert len({id(simulator.world) for simulator in simulators}) == 4
    assert len({id(simulator) for simulator in simulators}) == 8


def test_no_more_than_a_few_things_are_kept() -> None:
    cache, made_keys = work._Cache(), []

    def get_cached(key: int) -> int:
        return cache.get(key, lambda: made_keys.append(key) or key)

    for key in range(work.CACHED):
        get_cached(key)
    assert get_cached(0) == 0
    get_cached(99)  # now 1 has waited longest
    get_cached(0)
    get_cached(1)
    assert made_keys == [*range(work.CACHED), 99, 1]
    assert len(cache._entries) == work.CACHED


@pytest.mark.parametrize("spoil", ["shorter", "longer", "gone", "flipped", "row", "empty row"])
def test_a_corrupt_file_is_rendered_again(job: Job, tmp_path: Path, spoil: str) -> None:
    """What a dying machine may leave, or a careless user; the whole file comes back."""
    task, store = next(job.tasks()), Store(tmp_path / "out")
    cloud = render_in_process(task, store)
    cloud_bytes, (row,) = cloud.read_bytes(), store.folder.glob("rows/*/*.json")
    if spoil == "gone":
        cloud.unlink()
    elif spoil == "flipped":
        cloud.write_bytes(cloud_bytes[:-7] + bytes([cloud_bytes[-7] ^ 1]) + cloud_bytes[-6:])
    elif spoil == "row":
        row.write_bytes(row.read_bytes()[:-5])
    elif spoil == "empty row":
        row.write_text("[]")
    else:
        cloud.write_bytes(cloud_bytes[:-7] if spoil == "shorter" else cloud_bytes + b"x")
    assert store.row(task.key) is None
    assert render_in_process(task, store).read_bytes() == cloud_bytes


@pytest.mark.parametrize("full_at", ["cloud", "row"])
def test_a_full_disk_loses_nothing(job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, full_at: str) -> None:
    """The write that meets it, of the cloud (when it is synced) or of its row, fails as a whole."""
    task, store = next(job.tasks()), Store(tmp_path / "out")

    with monkeypatch.context() as patch:
        patch.setattr(*((atomic, "_sync") if full_at == "cloud" else (Path, "write_text")), raise_disk_full)
        cause = cause_of(task, store)
    assert cause.endswith("cannot be written: No space left on device")
    assert "\n" not in cause
    assert store.row(task.key) is None
    assert [path.name for path in tmp_path.rglob("*.part")] == []
    assert cause_of(task, store) == ""
    assert store.row(task.key) is not None


def test_what_changed_since_it_was_asked_is_refused(job: Job, tmp_path: Path) -> None:
    """Rationale: a result under the name of other inputs would be wrong for ever."""
    task, store = next(job.tasks()), Store(tmp_path / "out")
    scene = tmp_path / "wall.toml"
    scene.write_text(scene.read_text().replace("[10, 0, 1.8]", "[11, 0, 1.8]"))
    assert "is not the one of which this frame was asked" in cause_of(task, store)
    assert cause_of(dataclasses.replace(task, version="0.0.0"), store).startswith("lidarscene 0.0.0 gave this")
    assert [path.name for path in store.folder.iterdir()] == [".claims"]


def test_so_is_another_sensor(job_file: Path, tmp_path: Path) -> None:
    shutil.copy(catalog.path_of("sensors", "table1-apd"), tmp_path / "own.toml")
    job_file.write_text('sensors = ["own.toml"]\n' + job_file.read_text())
    task = next(Job.read(job_file).tasks())
    (tmp_path / "own.toml").write_text((tmp_path / "own.toml").read_text() + "\n")
    assert "own.toml: it, or a file" in cause_of(task, Store(tmp_path / "out"))


def test_frames_of_a_bundle_are_traced_together(
    job_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: two drives of seven frames of 16 x 11 beams, the bytes those of frames one by one."""
    text = job_file.read_text(encoding="utf-8").replace('fov_deg" = [40]', 'fov_deg" = [30]').replace("[1, 100]", "[1]")
    job_file.write_text("frames = 7\n" + text, encoding="utf-8")
    tasks, start, together = list(Job.read(job_file).tasks()), Simulator._started, list[int]()

    def started(simulator: Simulator, frames: Sequence[Any], first: int) -> Any:
        together.append(len(frames))
        return start(simulator, frames, first)

    monkeypatch.setattr(Simulator, "_started", started)
    bundle, alone = (Store(tmp_path / name) for name in ("bundle", "alone"))
    causes, _ = work.render_frames(tasks, str(bundle.folder), 1)
    assert causes == [""] * 14
    assert together == [1, 6] * 2
    for task in tasks:
        paths = [render_in_process(task, store) for store in (bundle, alone)]
        assert paths[0].read_bytes() == paths[1].read_bytes()


def test_files_are_written_beside_the_next_frame(job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The claim is held until they are there, and a failure is that of the frame whose files they are."""
    first, *others = job.tasks()
    store, finish, begin = Store(tmp_path / "out"), Store.finish, work._render
    is_next, claims = threading.Event(), list[bool]()

    def rendered(task: FrameTask, *arguments: Any) -> Any:
        if task is not first:
            is_next.set()
        return begin(task, *arguments)

    def finished(own: Store, key: str, *arguments: Any) -> None:
        if key == first.key:
            assert is_next.wait(60.0)
            holder = subprocess.run([sys.executable, "-c", HOLD, str(own.folder), key], input=b"", capture_output=True)
            claims.append(holder.stdout.decode().strip() == "False")
            raise OutputError("row: no room")
        finish(own, key, *arguments)

    monkeypatch.setattr(work, "_render", rendered)
    monkeypatch.setattr(Store, "finish", finished)
    causes, _ = work.render_frames([first, *others], str(store.folder), 1)
    assert causes == ["row: no room", "", "", ""]
    assert claims == [True] or sys.platform == "win32"
    assert [store.row(task.key) is not None for task in (first, *others)] == [False, True, True, True]


HOLD = """
import sys
from pathlib import Path
from lidarscene.batch.store import Store
with Store(Path(sys.argv[1])).claim(sys.argv[2]) as is_ours:
    print(is_ours, flush=True)
    sys.stdin.read()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no such locks")
def test_a_frame_that_another_run_is_at_is_left_to_it(job: Job, tmp_path: Path) -> None:
    """And no longer: a run that is killed lets go of it."""
    (task, second, *_), store = list(job.tasks()), Store(tmp_path / "out")
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(store.folder), task.key], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert holder.stdout is not None
    assert holder.stdout.readline() == b"True\n"
    assert cause_of(task, store) == work.ELSEWHERE
    assert store.row(task.key) is None
    assert cause_of(second, store) == ""
    holder.kill()
    holder.communicate()
    assert cause_of(task, store) == ""
    assert cause_of(task, store) == work.REUSED


def test_no_truth_if_none_is_wanted(job_file: Path, tmp_path: Path) -> None:
    job_file.write_text("truth = false\n" + job_file.read_text(encoding="utf-8"), encoding="utf-8")
    task = next(iter(Job.read(job_file).tasks()))
    assert not PointCloud.load(render_in_process(task, Store(tmp_path / "out"))).has_truth


def test_the_manifest_has_the_cause_of_what_failed(job: Job) -> None:
    task = next(iter(job.tasks()))
    types = dict.fromkeys(task.parameters, "float64")
    rows = [manifest._row(task, None, failed, types) for failed in ({task.key: "no room"}, {})]
    assert [row["error"] for row in rows] == ["no room", "not rendered"]
