"""`--part`: which tests are quick, and which more where something is changed."""

import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest
from helpers import part

COSTS = {
    "light/test_echoes.py": {"test_long": 9.0, "test_short": 1.0},
    "light/test_beams.py": {"test_beams": 2.0},
    "studies/test_budget.py": {"test_of_echoes": 3.0},
    "chain/test_fog_scene.py": {"test_fog": 0.5},
    "view/test_serve.py": {"test_page": 0.5},
}
ECHOES = "src/lidarscene/light/echoes.py"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    tests = tmp_path / "tests"
    for file, functions in COSTS.items():
        (tests / file).parent.mkdir(parents=True, exist_ok=True)
        (tests / file).write_text("".join(f"def {name}(): pass\n" for name in functions))
    (tests / "studies" / "test_budget.py").write_text("from lidarscene.light import beams, echoes\n")
    monkeypatch.setattr(part, "TESTS", tests)
    return tests


def test_a_file_of_costs_is_read_as_it_is_written(tmp_path: Path) -> None:
    part.write_costs(tmp_path / "costly", COSTS | {"test_none.py": {}})
    assert part.read_costs(tmp_path / "costly") == COSTS


@pytest.mark.parametrize(
    ("changed", "limit_s", "names"),
    [
        ([], 30.0, []),
        ([ECHOES], 1.5, ["test_short"]),
        ([ECHOES], 5.0, ["test_short", "test_of_echoes"]),
        ([ECHOES], 14.0, ["test_short", "test_of_echoes", "test_long"]),
        ([ECHOES], 15.2, ["test_short", "test_of_echoes", "test_long", "test_beams"]),
        ([ECHOES], 30.0, ["test_short", "test_of_echoes", "test_long", "test_beams", "test_fog"]),
        (["tests/view/test_serve.py"], 30.0, ["test_page"]),
        (["tests/conftest.py"], 30.0, []),
    ],
)
def test_tests_of_a_change_come_by_their_nearness_and_time(folder, changed, limit_s, names):
    """Those that are named after the module or import it, of its folder, of the chain."""
    chosen = part.of_changes(changed, COSTS, limit_s)
    assert sorted(name for functions in chosen.values() for name in functions) == sorted(names)


def test_a_deleted_file_of_tests_has_no_functions(folder: Path) -> None:
    (folder / "light" / "test_beams.py").unlink()
    chosen = part.of_changes([ECHOES, "tests/light/test_beams.py"], COSTS)
    assert set(chosen) == COSTS.keys() - {"light/test_beams.py", "view/test_serve.py"}


def test_what_differs_from_the_last_commit_is_changed(folder: Path) -> None:
    """Files that git does not know yet, too; without a repository nothing is."""
    root = folder.parent
    assert part.changed_files() == []

    def git(*words: str) -> None:
        subprocess.run(["git", "-c", "user.name=a", "-c", "user.email=a", *words], cwd=root, check=True)

    source = root / ECHOES
    source.parent.mkdir(parents=True)
    source.write_text("")
    git("init", "--quiet")
    git("add", ".")
    git("commit", "--quiet", "--message=a")
    assert part.changed_files() == []
    source.write_text("x = 1\n")
    (folder / "test_new.py").write_text("")
    (root / "elsewhere").write_text("")
    assert part.changed_files() == [ECHOES, "tests/test_new.py"]


def test_each_test_is_of_one_part(folder: Path) -> None:
    """A costly one of the rest, where nothing is changed. Files of which all functions are costly are not imported."""
    quick, rest = part._Part(True, COSTS), part._Part(False, COSTS)
    item = lambda file, name: SimpleNamespace(path=folder / file, name=name)  # noqa: E731
    for one in (quick, rest):
        assert not one._is_quick(item("light/test_echoes.py", "test_long[case]"))
        assert one._is_quick(item("light/test_echoes.py", "test_else"))
    assert quick.pytest_ignore_collect(folder / "light" / "test_echoes.py")
    assert rest.pytest_ignore_collect(folder / "light" / "test_echoes.py") is None
    (folder / "light" / "test_echoes.py").write_text("def test_long(): pass\ndef test_else(): pass\n")
    assert quick.pytest_ignore_collect(folder / "light" / "test_echoes.py") is None
