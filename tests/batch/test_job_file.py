"""Job files: what is refused, in one line that names the key."""

from pathlib import Path

import pytest

from lidarscene.batch.job_file import JobFile, read_job
from lidarscene.errors import InputError

SCENES = 'scenes = ["a.toml"]\n'


def test_dotted_and_nested_keys_are_the_same(tmp_path: Path) -> None:
    path = tmp_path / "job.toml"
    path.write_text(SCENES + '[sweep.scene]\n"a.b" = [1]\na.c = [[1, 2], [3, 4]]\n[sweep.sensor.d]\ne = ["x"]\n')
    sweep = read_job(path).sweep
    assert sweep.scene_values() == {"a.b": (1,), "a.c": ((1, 2), (3, 4))}
    assert sweep.sensor_values() == {"d.e": ("x",)}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "key 'scenes' is missing"),
        ("scenes = []", "scenes: must be a list of at least 1, got []"),
        ('scenes = ["a", "a"]', 'scenes: values must be unique, got "a" (2 times)'),
        (SCENES + "seeds = [1, 1]", "seeds: values must be unique, got 1 (2 times)"),
        (SCENES + "seeds = [-1]", "seeds[0]: must be >= 0, got -1"),
        (SCENES + "seeds = [1]\nseed_count = 2", "must have only one of seeds and seed_count, got both"),
        (SCENES + "frames = 0", "frames: must be >= 1, got 0"),
        (SCENES + 'format = "docx"', "format: must be one of ply"),
        (SCENES + "sweeps = 1", "unknown key 'sweeps'; did you mean sweep? all known here: name, scenes"),
        (
            SCENES + "[sweep.scene]\nsun.illuminance_klux = 5",
            "scene.sun.illuminance_klux: must be a list of values, got 5",
        ),
        (SCENES + "[sweep.sensor]\na = []", "sensor.a: must be a list of values, got []"),
        (SCENES + "[sweep.sensor]\na = [1, 1]", "sensor.a: values must be unique, got 1 (2 times)"),
        (SCENES + "[[trajectories]]\nspeed_m_s = 1.0", "key 'trajectories[0].label' is missing"),
        (
            SCENES + "[[trajectories]]\nlabel = 'a'\n[[trajectories]]\nlabel = 'a'",
            "trajectories: values must be unique",
        ),
    ],
)
def test_mistakes(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "job.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_job(path)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_seeds_are_counted_from_nought_and_frames_begin_when_they_should() -> None:
    job = JobFile(scenes=("a.toml",), seed_count=3, begin_s=2.5)
    assert list(job.all_seeds()) == [0, 1, 2]
    assert (job.frame_options(2, 7).seed, job.frame_options(2, 7).number, job.frame_options(2, 7).begin_s) == (
        2,
        7,
        2.5,
    )
