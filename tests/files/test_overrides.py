"""Values that `--set` puts in place of a file's; tests/cli/test_mistakes.py has what is refused."""

import copy

import pytest
from helpers.mistakes import told

from lidarscene.files.overrides import assignments, split_sensor, toml_text, with_overrides

TABLES = {"a": {"b": 1, "c": [1, 2]}, "name": "x"}


@pytest.mark.parametrize(
    ("assignment", "changed"),
    [
        ("a.b=2", {"a": {"b": 2, "c": [1, 2]}, "name": "x"}),
        ("a.b = 2.5e3 ", {"a": {"b": 2500.0, "c": [1, 2]}, "name": "x"}),
        ("a.c=[3, 4, 5]", {"a": {"b": 1, "c": [3, 4, 5]}, "name": "x"}),
        ("a={ d = true }", {"a": {"d": True}, "name": "x"}),
        ("e.f.g=1", {"a": {"b": 1, "c": [1, 2]}, "name": "x", "e": {"f": {"g": 1}}}),
        ("name=two words", {"a": {"b": 1, "c": [1, 2]}, "name": "two words"}),
        ('name="1"', {"a": {"b": 1, "c": [1, 2]}, "name": "1"}),
        ("name=a=b", {"a": {"b": 1, "c": [1, 2]}, "name": "a=b"}),
        ("name=1\ny=2", {"a": {"b": 1, "c": [1, 2]}, "name": "1\ny=2"}),
    ],
)
def test_override(assignment: str, changed: dict[str, object]) -> None:
    original = copy.deepcopy(TABLES)
    assert with_overrides(original, [assignment]) == changed
    assert original == TABLES


def test_last_override_holds() -> None:
    assert with_overrides({}, ["a=1", "a=2"]) == {"a": 2}


BODIES = {"bodies": [{"name": "a", "x": 1, "motion": {"v": 2}}, {"name": "b"}]}


@pytest.mark.parametrize(
    ("assignment", "changed"),
    [
        ("bodies.a.x=3", [{"name": "a", "x": 3, "motion": {"v": 2}}, {"name": "b"}]),
        ("bodies.1.x=3", [{"name": "a", "x": 1, "motion": {"v": 2}}, {"name": "b", "x": 3}]),
        ("bodies.a.motion.v=3", [{"name": "a", "x": 1, "motion": {"v": 3}}, {"name": "b"}]),
        ("bodies.b.motion.v=3", [{"name": "a", "x": 1, "motion": {"v": 2}}, {"name": "b", "motion": {"v": 3}}]),
    ],
)
def test_override_in_a_list_of_tables(assignment: str, changed: list[object]) -> None:
    original = copy.deepcopy(BODIES)
    assert with_overrides(original, [assignment]) == {"bodies": changed}
    assert original == BODIES


@pytest.mark.parametrize("assignment", ["bodies.c.x=1", "bodies.2.x=1", "bodies.-1.x=1", "bodies.a=1"])
def test_override_of_a_table_that_is_not_there(assignment: str) -> None:
    with told(f"scene_overrides {assignment} | bodies.NAME.KEY | a, b"):
        with_overrides(BODIES, [assignment], option="scene_overrides")


@pytest.mark.parametrize("value", [1, 2.5, 1e-9, True, 'x "y"', [1, [2.5, "z"]], {"a b": {"c": [1, {"d": False}]}}])
def test_toml_text_is_read_back(value: object) -> None:
    assert with_overrides({}, [f"a={toml_text(value)}"]) == {"a": value}


def test_overrides_of_python_are_those_of_the_command_line() -> None:
    expected = ("a.b=1", "a.c=[1, 2]")
    assert assignments(list(expected)) == assignments({"a": {"b": 1, "c": (1, 2)}}) == expected
    assert assignments("a.b=1") == assignments({"a.b": 1}) == expected[:1]
    with told("overrides | 3"):
        assignments(3)


def test_a_value_may_be_of_one_sensor_alone() -> None:
    assert split_sensor("x:a.b=c:1", ("x", "y")) == ("x", "a.b=c:1")
    assert split_sensor("a.b=c:1", ("x", "y")) == (None, "a.b=c:1")
    with told("'z' | x, y"):
        split_sensor("z:a.b=1", ("x", "y"))
