"""An option is declared on its field: its check, its line in the docstring and its default come from there."""

from dataclasses import dataclass, field, fields
from typing import Any

import pytest
from helpers.mistakes import refused

from lidarscene import FrameOptions, Outputs, TraceOptions
from lidarscene.errors import OptionError
from lidarscene.rendering.option_fields import OneOf, Whole, check_options, declared, list_options, option, options_of


@list_options
@dataclass(frozen=True, kw_only=True)
class Cake:
    """A cake."""

    plate: str = field(metadata=declared("where it stands"))
    layers: int = option(2, Whole(1, 3), help="one on the other (default {default})")
    icing: str | None = option(None, OneOf(("sugar", "chocolate")), help="on top")
    is_cut: bool = option(False, help="ready to eat")
    candles: int = 0

    def __post_init__(self) -> None:
        check_options(self)


def test_the_docstring_lists_the_options() -> None:
    """Options stand in the order of the fields; what is no option is not there."""
    assert (Cake.__doc__ or "").splitlines() == [
        "A cake.",
        "",
        "Attributes:",
        "    plate: where it stands",
        "    layers: one on the other (default 2)",
        "    icing: on top",
        "    is_cut: ready to eat",
    ]


@pytest.mark.parametrize("kind", [TraceOptions, FrameOptions, Outputs])
def test_every_field_of_the_library_is_an_option(kind: Any) -> None:
    assert list(options_of(kind)) == [entry.name for entry in fields(kind)]
    for name, (entry, declaration) in options_of(kind).items():
        if declaration.values is not None and entry.default is not None:
            declaration.values.check(name, entry.default)  # `check_options` takes the default as it is
        assert f"\n    {name}: " in (kind.__doc__ or "")
        assert declaration.help[-1] not in ".;"


test_a_value_is_checked_by_its_declaration = refused(
    lambda options: Cake(plate="blue", **options),
    ({"layers": 4}, "layers | whole number | 1 | 3 | 4"),
    ({"layers": None}, "layers | whole number | 1 | 3 | None"),
    ({"icing": "salt"}, "icing | sugar, chocolate | 'salt'"),
    ({"is_cut": 1}, "is_cut | True or False | 1"),
    error=OptionError,
)


def test_an_option_that_may_be_left_out_may_be_none() -> None:
    assert Cake(plate="blue", icing=None) == Cake(plate="blue")
