"""Job files: what is refused, in one line that names the key."""

from pathlib import Path

from helpers.mistakes import mistakes, told

from lidarscene.batch.job_file import JobFile, read_job

SCENES = 'scenes = ["a.toml"]\n'


def test_dotted_and_nested_keys_are_the_same(tmp_path: Path) -> None:
    path = tmp_path / "job.toml"
    path.write_text(SCENES + '[sweep.scene]\n"a.b" = [1]\na.c = [[1, 2], [3, 4]]\n[sweep.sensor.d]\ne = ["x"]\n')
    sweep = read_job(path).sweep
    assert sweep.scene_values() == {"a.b": (1,), "a.c": ((1, 2), (3, 4))}
    assert sweep.sensor_values() == {"d.e": ("x",)}


@mistakes(
    r"""
    | 'scenes'
    scenes = [] | scenes | at least 1 | []
    scenes = ["a", "a"] | scenes | unique | "a" (2 times)
    AND seeds = [1, 1] | seeds | unique | 1 (2 times)
    AND seeds = [-1] | seeds[0] | >= 0 | -1
    AND seeds = [1]\nseed_count = 2 | seeds and seed_count | both
    AND frames = 0 | frames | >= 1 | 0
    AND format = "docx" | format | ply | docx
    AND sweeps = 1 | 'sweeps' | sweep? | name, scenes
    AND [sweep.scene]\nsun.illuminance_klux = 5 | scene.sun.illuminance_klux | list of values | 5
    AND [sweep.sensor]\na = [] | sensor.a | list of values | []
    AND [sweep.sensor]\na = [1, 1] | sensor.a | unique | 1 (2 times)
    AND [[trajectories]]\nspeed_m_s = 1.0 | 'trajectories[0].label'
    AND [[trajectories]]\nlabel = 'a'\n[[trajectories]]\nlabel = 'a' | trajectories | unique
    """,
    AND=SCENES,
)
def test_mistakes(tmp_path: Path, given: str, named: str) -> None:
    path = tmp_path / "job.toml"
    path.write_text(given)
    with told(f"job.toml | {named}"):
        read_job(path)


def test_seeds_are_counted_from_nought_and_frames_begin_when_they_should() -> None:
    job = JobFile(scenes=("a.toml",), seed_count=3, begin_s=2.5)
    assert list(job.all_seeds()) == [0, 1, 2]
    assert (job.frame_options(2, 7).seed, job.frame_options(2, 7).number, job.frame_options(2, 7).begin_s) == (
        2,
        7,
        2.5,
    )
