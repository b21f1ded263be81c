"""Constants: each named number says whether it has a source, buys accuracy, or is a choice (CONTRIBUTING.md)."""

import gc
from functools import cache
from pathlib import Path

import pytest
from helpers.sources import module_of

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def tool():
    module = module_of(ROOT / "tools" / "constants.py")
    module.constants = cache(lambda code, read=module.constants: tuple(read(code)))
    gc.disable()  # a search for garbage in each tree takes four times as long as to make it
    yield module
    gc.enable()


def test_each_number_says_what_it_is(tool) -> None:
    silent, said = [], 0
    for path in sorted(tool.SOURCE.rglob("*.py")):
        for constant in tool.constants(path.read_text(encoding="utf-8")):
            said += constant.word is not None
            if constant.word is None or not constant.text:
                silent.append(f"{path.relative_to(ROOT)}:{constant.line}: {constant.name}")
    assert silent == [], f"the docstring below must begin with one of {tool.WORDS} and a colon"
    assert said > 300  # the package is there


@pytest.mark.parametrize(
    ("code", "word"),
    [
        ('A = 0.5\n"""Choice: half."""', "Choice"),
        ('_A: Final = -1e-9\n"""Accuracy bought: next to nothing."""', "Accuracy bought"),
        ('A, B = 1.0, 2\n"""Source: Table 1; both."""', "Source"),
        ('class C:\n    A = 0.5\n    """Choice: half."""', "Choice"),
        ('A = 7 * 86400.0\n"""Choice: a week."""', "Choice"),
        ("A = 0.5", None),
        ('A = 0.5\n"""Half of it."""', None),
        ('A = 0.5\n"""Choice, half."""', None),
        ("A = 0.5  # Choice: half", None),
        ('A = {"a": (0.5, "b")}', None),
        ("A = math.radians(-0.5)", None),
        ("A, B = 0.5, 1", None),
        ("A = np.geomspace(0.2, 1.0, 161)", None),
        ('A = 0.5\nB = 0.5\n"""Choice: half."""', None),
        ("class C:\n    A = 0.5", None),
    ],
)
def test_a_number_without_a_word_is_found(tool, code: str, word: str | None) -> None:
    assert tool.constants(code)[0].word == word


@pytest.mark.parametrize("code", ["A = 2", 'A = "0.5"', "A = 0.5 * B", "A = math.sqrt(2.0)", "a = 0.5", "A: float"])
def test_others_need_none(tool, code: str) -> None:
    assert tool.constants(code) == ()


def test_the_table_has_the_words_that_it_is_asked_for(tool) -> None:
    choices, everything = (tool.table(words).splitlines() for words in (("Choice",), tool.WORDS))
    assert len(choices) > 100
    assert set(choices) < set(everything)
    assert sum(" | `SPEED_OF_LIGHT_M_S` | `299792458.0` | source | " in line for line in everything) == 1
