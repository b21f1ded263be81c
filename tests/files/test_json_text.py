"""JSON of reports."""

import json
import math

import numpy as np
import pytest

from lidarscene.files.json_text import json_text
from lidarscene.files.overrides import toml_text, with_overrides


def refuse(constant: str) -> float:
    raise AssertionError(f"{constant} is no JSON")


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan, np.float64("inf")])
def test_what_is_not_finite_is_null(value: float) -> None:
    """Strict readers, such as browsers and `jq`, take neither NaN nor Infinity."""
    text = json_text({"a": value, "b": [1.5, (value, {"c": value})], "d": "inf", "e": True})
    assert json.loads(text, parse_constant=refuse) == {
        "a": None,
        "b": [1.5, [None, {"c": None}]],
        "d": "inf",
        "e": True,
    }


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_toml_has_words_of_its_own(value: float) -> None:
    """Rationale: as a text, the value would be refused for its type, and not for what it is."""
    changed = with_overrides({}, [f"a={toml_text(value)}"])["a"]
    assert repr(changed) == repr(value)
