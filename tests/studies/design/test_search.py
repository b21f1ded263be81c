"""Search of design studies, on functions whose optimum is known."""

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.run_seed import chosen, run_seed

from lidarscene.errors import InputError
from lidarscene.studies.design.designs import Base, Design, DesignSpace, Free
from lidarscene.studies.design.optimum import at_an_end, limits_of
from lidarscene.studies.design.quantities import probability_of_points
from lidarscene.studies.design.search import Log, alone, front, losses, search, slacks
from lidarscene.studies.design.slopes import differences
from lidarscene.studies.design.study_file import ConstraintFile, ObjectiveFile, StudyFile

Function = Callable[[dict[str, float]], dict[str, float]]


def study(objectives: dict[str, str], bounds: dict[str, dict[str, float]], **settings: int) -> StudyFile:
    """A study of one sensor whose quantities the tests compute themselves."""
    return StudyFile.model_validate(
        {
            "sensor": "table1-apd",
            "free": {"x": {"low": 0.0, "high": 1.0}},
            "objectives": {name: ObjectiveFile(**{goal: "snr"}) for name, goal in objectives.items()},
            "constraints": {name: ConstraintFile(quantity="snr", **limits) for name, limits in bounds.items()},
            "evaluations": 400,
            "eye_safety": "off",
            **settings,
        }
    )


def run(study_file: StudyFile, free: tuple[Free, ...], function: Function, bases: str = "") -> list[Design]:
    named = {"": [Base(name=name, settings={}) for name in bases]} if bases else {}
    return search(Log(study=study_file, space=DesignSpace(bases=named, free=free), evaluate=alone(function)))


def test_slsqp_finds_a_corner_of_two_constraints() -> None:
    """x^2 + y^2 with x + y >= 1 and x >= 0.7 is 0.58 at (0.7, 0.3), and 0.5 without the second bound."""
    free = (Free(key="x", high=2.0), Free(key="y", low=-1.0, high=2.0))

    def function(values: dict[str, float]) -> dict[str, float]:
        x, y = values["x"], values["y"]
        return {"size": x * x + y * y, "sum": x + y, "first": x}

    bounds = {"sum": {"at_least": 1.0}, "first": {"at_least": 0.7}}
    study_file = study({"size": "minimize"}, bounds)
    (best,) = front(study_file, run(study_file, free, function))
    assert best.quantities["size"] == pytest.approx(0.58, rel=1e-5)
    space = DesignSpace(bases={}, free=free)
    limits = limits_of(study_file, space, best, differences(function, space))
    assert limits is not None
    assert limits.stands
    # Lagrange: (2 x, 2 y) = a (1, 1) + b (1, 0), so a = 0.6 and b = 0.8; a bound gives way by 1 % of itself.
    costs = {bound.split()[0]: cost * 0.58 for bound, cost in limits.costs.items()}
    assert costs == pytest.approx({"sum": 0.6 * 1.0, "first": 0.8 * 0.7}, rel=1e-3)
    assert limits.held == ()


def test_a_key_at_the_end_of_its_range_is_named() -> None:
    free = (Free(key="x", low=1.0, high=10.0, log=True),)
    study_file = study({"size": "maximize"}, {})

    def function(values: dict[str, float]) -> dict[str, float]:
        return {"size": values["x"]}

    (best,) = front(study_file, run(study_file, free, function))
    assert best.values["x"] == 10.0
    space = DesignSpace(bases={}, free=free)
    limits = limits_of(study_file, space, best, differences(function, space))
    assert limits is not None
    assert limits.held == at_an_end(space, best) == ("x",)


def test_a_choice_at_the_end_of_its_numbers_is_named() -> None:
    """The least and the largest of numbers are ends, also of two; those between are none, and words have no ends."""
    free = (Free(key="n", values=(1, 2, 3)), Free(key="kind", values=("a", "b")), Free(key="x", low=1.0, high=2.0))
    space = DesignSpace(bases={}, free=free)
    for n, x, ends in ((1, 1.5, ("n",)), (2, 1.5, ()), (3, 2.0, ("n", "x"))):
        assert at_an_end(space, Design(values={"n": n, "kind": "a", "x": x}, quantities={})) == ends


@pytest.mark.parametrize("seed", chosen(1, range(2)))
def test_the_front_of_two_objectives(seed: int) -> None:
    """f = x^2 + y^2, g = (x - 1)^2 + y^2: the front is y = 0, sqrt f + sqrt g = 1, its volume below (1, 1) 5/6."""
    indicator = pytest.importorskip("pymoo.indicators.hv")
    free = (Free(key="x"), Free(key="y"))

    def function(values: dict[str, float]) -> dict[str, float]:
        x, y = values["x"], values["y"]
        return {"f": x * x + y * y, "g": (x - 1.0) ** 2 + y * y}

    study_file = study({"f": "minimize", "g": "minimize"}, {}, evaluations=1500, seed=seed)
    best = front(study_file, run(study_file, free, function))
    volume = indicator.HV(ref_point=np.ones(2))(np.array([losses(study_file, design) for design in best]))
    assert 0.99 * 5.0 / 6.0 < volume <= 5.0 / 6.0


def test_whole_numbers_and_choices() -> None:
    """The best of 10 x 3 x continuous is at n = 7, "b", x = 0.25; every design has whole numbers, and no key of another
    base than its own.
    """
    pytest.importorskip("pymoo")
    whole, of_a = Free(key="n", values=tuple(range(10))), Free(key="a:m", values=(1, 2))
    free = (whole, Free(key="sensor", values=("a", "b", "c")), of_a, Free(key="x"))

    def function(values: dict[str, float]) -> dict[str, float]:
        assert isinstance(values["n"], int)
        assert ("a:m" in values) == (values["sensor"] == "a")
        return {"size": (values["n"] - 7) ** 2 + (values["sensor"] != "b") + (values["x"] - 0.25) ** 2}

    study_file = study({"size": "minimize"}, {})
    (best,) = front(study_file, run(study_file, free, function, "abc"))
    assert (best.values["n"], best.values["sensor"]) == (7, "b")
    assert best.values["x"] == pytest.approx(0.25, abs=1e-6)


@pytest.mark.parametrize("choices", [(30, 5, 100, 60, 45), ("b", "a", "c", "e", "d")])
def test_a_space_no_larger_than_the_budget_is_tried_whole(choices: tuple[int | str, ...]) -> None:
    """Five choices with five evaluations: all are tried; with four the budget ends, and the search says so."""
    free = (Free(key="x", values=choices),)

    def function(values: dict[str, float]) -> dict[str, float]:
        return {"size": float(choices.index(values["x"]))}

    for count, ending in ((5, "all 5 designs of the study were tried"), (4, "all 4 evaluations were used")):
        log = Log(
            study=study({"size": "maximize"}, {}, evaluations=count),
            space=DesignSpace(bases={}, free=free),
            evaluate=alone(function),
        )
        assert len(search(log)) == count
        assert log.ending == ending


def test_a_front_of_whole_and_continuous_keys_is_that_of_brute_force() -> None:
    """SNR of a receiver of gain n, lens m and power x: each lens within 1 % of the best of all gains and powers."""
    pytest.importorskip("pymoo")
    free = (
        Free(key="n", values=tuple(range(1, 121))),
        Free(key="m", values=tuple(range(1, 11))),
        Free(key="x", low=1.0, high=100.0, log=True),
    )

    def snr(n: Any, m: Any, x: Any) -> Any:
        return 10.0 * x * m**2 * n / np.sqrt(400.0 + m**2 * n**2.5)

    def function(values: dict[str, float]) -> dict[str, float]:
        n, m, x = values["n"], values["m"], values["x"]
        return {"snr": float(snr(n, m, x)), "area": m * m, "eye": x * np.sqrt(n)}

    seed = run_seed() % 2**31
    study_file = study(
        {"snr": "maximize", "area": "minimize"}, {"eye": {"at_most": 150.0}}, evaluations=1200, seed=seed
    )
    found = {
        design.values["m"]: design.quantities["snr"] for design in front(study_file, run(study_file, free, function))
    }
    gains = np.arange(1, 121)
    for lens in range(1, 11):
        best = snr(gains, lens, np.minimum(100.0, 150.0 / np.sqrt(gains))).max()
        assert found[lens] == pytest.approx(best, rel=0.01), (lens, seed)


def test_designs_that_cannot_be_are_passed_over() -> None:
    """Half of the range has no sensor; the best of the rest lies at its edge."""

    def function(values: dict[str, float]) -> dict[str, float]:
        if values["x"] > 0.5:
            raise InputError("too large")
        return {"size": values["x"]}

    study_file = study({"size": "maximize"}, {})
    tried = run(study_file, (Free(key="x"),), function)
    (best,) = front(study_file, tried)
    assert best.quantities["size"] == pytest.approx(0.5, abs=0.02)
    assert {design.reason for design in tried} == {"", "too large"}


def test_the_front_is_what_no_other_beats() -> None:
    """60 designs of three objectives on a coarse lattice, so that many are equal, against every pair compared.

    Each stands there once more, worse by a ten millionth in one and better in another, as SLSQP ends beside a start.
    """
    study_file = study({"a": "minimize", "b": "maximize", "c": "minimize"}, {"low": {"at_most": 0.8}})
    rng = np.random.default_rng(1)
    fifths = rng.integers(1, 7, (60, 4))
    fifths[:, 2] = 7 - fifths[:, 0] + rng.integers(0, 2, 60)  # no design is the best in both
    tried = [
        Design(values={"x": float(k)}, quantities=dict(zip("abc", row[:3], strict=True)) | {"low": row[3]})
        for k, row in enumerate(fifths / 5.0)
    ]
    nudge = {"a": 1.0 + 1e-7, "b": 1.0, "c": 1.0 - 1e-7, "low": 1.0}
    beside = [
        replace(design, quantities={name: nudge[name] * value for name, value in design.quantities.items()})
        for design in tried
    ]
    feasible = [design for design in tried if slacks(study_file, design)["low at most 0.8"] >= 0.0]
    points = {tuple(losses(study_file, design)) for design in feasible}

    def is_beaten(point: tuple[float, ...]) -> bool:
        return any(other != point and all(b <= a for a, b in zip(point, other, strict=True)) for other in points)

    best = [tuple(np.round(losses(study_file, design), 5)) for design in front(study_file, tried + beside)]
    assert len(best) > 3
    assert best == sorted(set(best)), "by the first objective"
    assert set(best) == {point for point in points if not is_beaten(point)}


def test_probability_of_points_against_all_outcomes() -> None:
    """Eight pulses of unequal probability: the sum over all 256 outcomes."""
    share = np.random.default_rng(1).random(8)
    for least in (1, 3, 8, 9):
        outcomes = itertools.product((0, 1), repeat=8)
        exact = sum(
            float(np.prod(np.where(outcome, share, 1.0 - share))) for outcome in outcomes if sum(outcome) >= least
        )
        assert probability_of_points(share, least) == pytest.approx(exact, abs=1e-12)
