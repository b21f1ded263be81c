"""Which frames a job has, and that a frame's name changes with what its cloud follows from, and with nothing else."""

import itertools
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
from helpers.mistakes import mistakes, told
from helpers.walls import rig_text

from lidarscene import catalog, load_scene, load_sensor
from lidarscene.batch import tasks
from lidarscene.batch.tasks import Job, scene_content

WALL = """
[sensor]
name = "own.toml"
[[bodies]]
name = "wall"
mesh = "wall.obj"
material = "concrete"
"""
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
POSES = "time_s,x_m,y_m,z_m,yaw_deg,pitch_deg,roll_deg\n0,0,0,0,0,0,0\n1,1,0,0,0,0,0\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A scene with a mesh and a sensor of its own, and a rig."""
    (tmp_path / "scene.toml").write_text(WALL)
    (tmp_path / "wall.obj").write_text(OBJ)
    (tmp_path / "poses.csv").write_text(POSES)
    shutil.copy(catalog.path_of("sensors", "table1-apd"), tmp_path / "own.toml")
    (tmp_path / "rig.toml").write_text(rig_text(("a", "own.toml"), ("b", "table1-sipm")))
    return tmp_path


def keys(folder: Path, text: str = "") -> list[str]:
    """Keys of the frames of a job over the one scene."""
    path = folder / "job.toml"
    path.write_text('scenes = ["scene.toml"]\n' + text)
    return [task.key for task in Job.read(path).tasks()]


def test_the_product(folder: Path) -> None:
    """Every value of every list with every other, once each, those of one scene together."""
    path = folder / "job.toml"
    path.write_text(
        'scenes = ["scene.toml"]\nsensors = ["own.toml", "table1-sipm"]\nrigs = ["rig.toml"]\nframes = 3\n'
        "seed_count = 2\nbegin_s = 0.1\n"
        "[[trajectories]]\nlabel = 'slow'\nspeed_m_s = 1.0\n"
        "[[trajectories]]\nlabel = 'file'\nposes_file = 'poses.csv'\n"
        "[sweep]\nscene.sun.illuminance_klux = [1, 100]\n"
        '[sweep.sensor]\n"laser.peak_power_w" = [50, 75.5, 80]\n'
    )
    job = Job.read(path)
    tasks = list(job.tasks())
    assert len(tasks) == len(job) == 2 * 2 * (2 + 2) * 3 * 3 * 2
    assert len({task.key for task in tasks}) == len(tasks)
    assert len(
        {(t.scene.trajectory, *t.parameters.items(), t.sensor, t.frame.seed, t.frame.number) for t in tasks}
    ) == len(tasks)
    assert {task.frame.begin_s for task in tasks} == {0.1}
    worlds = [task.scene.world for task in tasks]
    changes = sum(world != next_world for world, next_world in itertools.pairwise(worlds))
    assert changes == 1  # two trajectories; the sun's values share a world


def test_the_scenes_own_sensor_is_the_default(folder: Path) -> None:
    keys(folder)
    (task,) = Job.read(folder / "job.toml").tasks()
    assert task.sensor.name == str(folder / "own.toml")


@pytest.mark.parametrize(
    "more",
    [
        "seeds = [1]",
        "begin_s = 0.5",
        'coordinates = "sensor"',
        "truth = false",
        "rays = 2",
        "interactions = 0",
        '[sweep.scene]\n"sun.illuminance_klux" = [1]',
        '[sweep.sensor]\n"laser.peak_power_w" = [50]',
        "[[trajectories]]\nlabel = 'a'\nspeed_m_s = 1.0",
    ],
)
def test_what_is_asked_is_in_the_name(folder: Path, more: str) -> None:
    assert keys(folder, more) != keys(folder)


@pytest.mark.parametrize("name", ["scene.toml", "wall.obj", "own.toml"])
def test_the_content_of_every_file_is_in_the_name(folder: Path, name: str) -> None:
    before = keys(folder)
    (folder / name).write_text((folder / name).read_text() + "\n# more\n")
    assert keys(folder) != before


def test_so_is_that_of_poses_and_rigs(folder: Path) -> None:
    more = "rigs = ['rig.toml']\n[[trajectories]]\nlabel = 'a'\nposes_file = 'poses.csv'\n"
    before = keys(folder, more)
    assert len(before) == 2
    for name in ("poses.csv", "rig.toml", "own.toml"):
        (folder / name).write_text((folder / name).read_text() + "\n")
        after = keys(folder, more)
        assert not set(after) & set(before)
        before = after


def test_so_is_that_of_a_sensor_whose_part_is_taken(folder: Path) -> None:
    """The donor lies beside the job; another threshold in its file is another frame."""
    donor = folder / "theirs.toml"
    shutil.copy(catalog.path_of("sensors", "table1-sipm"), donor)
    job = '[sweep.sensor]\ndetector = ["table1-apd", "theirs.toml"]\n'
    before = keys(folder, job)
    text = donor.read_text(encoding="utf-8")
    donor.write_text(text.replace("threshold_to_noise = 5", "threshold_to_noise = 6"), encoding="utf-8")
    after = keys(folder, job)
    assert [old == new for old, new in zip(before, after, strict=True)] == [True, False]


def test_the_version_is_in_the_name(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = keys(folder)
    monkeypatch.setattr(tasks, "__version__", "99.0")
    assert keys(folder) != before


def test_nothing_else_is(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Folder, time of the files, labels, names of the job, how many others there are, the chunk."""
    more = "[[trajectories]]\nlabel = '{}'\nposes_file = 'poses.csv'\n"
    before = keys(folder, more.format("a"))
    moved = tmp_path_factory.mktemp("elsewhere") / "deeper"
    shutil.copytree(folder, moved)
    for file in moved.iterdir():
        os.utime(file, (1, 1))
    assert keys(moved, "name = 'x'\nchunk = 1000\n" + more.format("b")) == before
    assert keys(moved, "seeds = [3, 0]\nframes = 2\n" + more.format("b"))[2] == before[0]


@mistakes(
    r"""
    scenes = ["none.toml"] | none.toml | no such file
    scenes = ["scene.toml"]\nsensors = ["table1-apt"] | sensor 'table1-apt' | table1-apd?
    ONE"sun.illuminance_klux" = [1, -1] | scene.toml | scene_overrides sun.illuminance_klux=-1 | >= 0 | got -1
    scenes = ["scene.toml"]\n[sweep.sensor]\n"laser.power" = [1] | own.toml | overrides laser.power=1 | 'laser.power'
    scenes = ["a.xml"]\n[sweep.scene]\n"sun.illuminance_klux" = [1] | a TOML file | a.xml
    ONE"weather.rain" = [1] | scene.toml | scene_overrides weather.rain=1 | 'weather.rain' | weather.rain_mm_h
    ONE"wether.rain_mm_h" = [1] | scene_overrides wether.rain_mm_h=1 | 'wether' | weather?
    ONE"bodies.wal.yaw_deg" = [1] | bodies.NAME.KEY | wall
    ONE"sun.azimuth_deg" = [0, "east"] | sun.azimuth_deg | number | "east"
    """,
    ONE='scenes = ["scene.toml"]\n[sweep.scene]\n',
)
def test_mistakes_are_found_before_anything_is_rendered(folder: Path, given: str, named: str) -> None:
    (folder / "job.toml").write_text(given)
    with told(f"job.toml | {named}"):
        Job.read(folder / "job.toml")


@pytest.mark.parametrize(
    ("kind", "swept", "part_of"),
    [
        ("scene", '"weather.rain_mm_h" = [0, 50]', lambda frame: str(frame[0].air)),
        ("scene", '"bodies.wall.yaw_deg" = [0, 50]', lambda frame: str(frame[0].bodies[0].pose)),
        ("scene", '"sensor.position_m" = [[0, 0, 1], [0, 0, 2]]', lambda frame: str(frame[0].sensor_pose)),
        ("scene", '"ego.speed_m_s" = [0, 50]', lambda frame: str(frame[0].ego)),
        ("sensor", '"detector.gain" = [50, 60]', lambda frame: frame[1].detector.gain),
        ("sensor", '"scanner.azimuth_step_deg" = [1, 2]', lambda frame: frame[1].scanner.pulses),
    ],
)
def test_any_key_is_swept(folder: Path, kind: str, swept: str, part_of: Any) -> None:
    """Weather, light, places, motions, detectors, scanners: what a worker reads is another scene, or sensor."""
    keys(folder, f"[sweep.{kind}]\n{swept}\n")
    first, second = (
        (
            load_scene(task.scene.path, overrides=task.scene.overrides),
            load_sensor(task.sensor.name, overrides=task.sensor.overrides),
        )
        for task in Job.read(folder / "job.toml").tasks()
    )
    assert part_of(first) != part_of(second)


def test_a_scenes_content_is_without_its_sensor(folder: Path) -> None:
    """Rationale: a task names its sensor beside its scene; another sensor must not make the scene another."""
    sensor, scene = folder / "own.toml", folder / "scene.toml"
    before = scene_content(scene, ())
    sensor.write_text(sensor.read_text(encoding="utf-8") + "\n# another\n", encoding="utf-8")
    assert scene_content(scene, ()) == before
    scene.write_text(scene.read_text(encoding="utf-8") + "\n# another\n", encoding="utf-8")
    assert scene_content(scene, ()) != before
