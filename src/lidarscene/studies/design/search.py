"""Search for the designs that no other beats in all objectives.

A finite space that is no larger than the budget is tried whole. Else a Sobol sequence first. Several objectives, or
choices and whole numbers: then NSGA-II (pymoo). What is not traced is smooth: SLSQP (scipy) goes on from the best
designs, by their slopes, along the front with the other objectives as constraints. One traced objective over continuous
keys: COBYQA (scipy), which needs no slopes. Whole numbers, steps and choices are then moved to their neighbours, until
no neighbour of a best design is better. All designs that were tried count for the result, not only the last ones.

Every evaluation is written down. A search that is killed and run again meets the same designs in the same order, finds
them there, and goes on where it stopped.

Sources: Deb 2002 (NSGA-II); Ragonneau and Zhang 2023 (COBYQA); Kraft 1988 (SLSQP); Audet and Dennis 2001 (neighbours
of mixed variables).
"""

from __future__ import annotations

import contextlib
import functools
import json
import math
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import ArrayLike

from ...errors import InputError
from ...files.optional import import_optional
from ...maths.arrays import Numbers
from ...maths.special import normal_tail_inverse
from .designs import Design, DesignSpace, Values
from .slopes import SlopesOf, differences
from .study_file import StudyFile

EvaluateAll = Callable[[Sequence[Values]], Iterable["dict[str, float] | str"]]
"""Function of designs; returns the quantities of each in order, or the reason why it cannot be."""

INSIDE = 2e-6
"""Accuracy bought: share of its bound by which the search stays within each constraint: SLSQP's own tolerance is half
of that."""

_POPULATION = 64
_IDLE = 10  # generations without a new design after which NSGA-II ends

ALIKE = 1e-5
"""Choice: share of each objective within which two designs are one of a front: the digits that are printed, and SLSQP
ends a millionth beside where it began."""

_CERTAIN = 1e-15
"""Accuracy bought: probability next to 0 and 1 whose quantile, 7.9 sigma, double precision tells from infinity."""

_LEAST_PROBIT = -16.0
"""Choice: origin of probits, far below all: slacks are relative to their bounds, of which none may be near 0."""

_LARGE = 1e30
"""Choice: number in place of an infinite one: pymoo computes differences."""

_PATIENCE = 12  # new designs without a better one after which SLSQP ends
_STARTS = 4  # designs from which a search for one objective goes on
_MOST_PROMISING = 2  # neighbours of a design that are looked at on the way along a front
_PLACES_OF_FRONT = 64  # places of a front to which a search goes, while evaluations remain


@dataclass(kw_only=True)
class Log:
    """Evaluations of a search: asks for each design once, and writes it to a file as soon as it is known.

    Attributes:
        slopes: of the quantities of a design, for steps; not counted as evaluations. None: differences of ``evaluate``
        progress: called with the number of evaluations so far, the greatest number, and words on the front so far
        ending: why `search` ended
    """

    study: StudyFile
    space: DesignSpace
    evaluate: EvaluateAll
    slopes: SlopesOf | None = None
    file: IO[str] | None = None
    progress: Callable[[int, int, str], object] = lambda count, total, words: None
    designs: dict[str, Design] = field(default_factory=dict)
    recorded: dict[str, Design] = field(default_factory=dict)
    ending: str = ""
    _text: str = field(default="", init=False)
    _next_text_s: float = field(default=0.0, init=False)

    @property
    def remaining(self) -> int:
        """Number of designs that may still be tried."""
        return self.study.evaluations - len(self.designs)

    def ask(self, shares: Numbers) -> list[Design | None]:
        """Evaluate the designs at these shares, (n, keys); None for those beyond the allowed number."""
        points = [self.space.values(row) for row in np.clip(np.atleast_2d(shares), 0.0, 1.0)]
        keys = [_text(values) for values in points]
        fresh: dict[str, Values] = {}
        for key, values in zip(keys, points, strict=True):
            if key not in self.designs and key not in fresh and len(fresh) < self.remaining:
                fresh[key] = values
        unknown = [key for key in fresh if key not in self.recorded]
        answers = self.evaluate([fresh[key] for key in unknown]) if unknown else ()
        for key, answer in zip(unknown, answers, strict=True):
            self.recorded[key] = _design(fresh[key], answer)
            if self.file is not None:
                print(record_line(self.recorded[key]), file=self.file, flush=True)
            self.progress(min(len(self.recorded), self.study.evaluations), self.study.evaluations, self._front_text())
        self.designs |= {key: self.recorded[key] for key in fresh}
        return [self.designs.get(key) for key in keys]

    def _front_text(self) -> str:
        """Number of designs on the front so far and the best of each objective; worked out once a second at most."""
        now_s = time.monotonic()
        if now_s >= self._next_text_s:
            self._next_text_s = now_s + 1.0
            best = front(self.study, list(self.recorded.values()))
            if not best:
                self._text = "no design is feasible so far"
                return self._text
            values = np.array([losses(self.study, design) for design in best])
            bests = [
                f"{name} {best[place].quantities[name]:.4g}"
                for name, place in zip(self.study.objectives, np.argmin(values, axis=0), strict=True)
            ]
            self._text = f"{len(best)} on the front, best {', '.join(bests)}"
        return self._text

    def slopes_of(self, design: Design) -> dict[str, Numbers] | None:
        """Slopes of the quantities of a design by name; None if no step leaves a sensor that can be."""
        try:
            return dict((self.slopes or differences(_single(self.evaluate), self.space))(design).slopes)
        except InputError:
            return None

    def read(self, path: Path) -> None:
        """Read the evaluations of an earlier run of this study; a line that is cut off is left out."""
        for line in path.read_text(encoding="utf-8").splitlines()[1:]:
            try:
                entry = json.loads(line)
                design = Design(values=entry["values"], quantities=entry["quantities"], reason=entry["reason"])
            except (ValueError, KeyError, TypeError):
                continue
            self.recorded[_text(design.values)] = design


def search(log: Log) -> list[Design]:
    """Search by the methods that suit the study; returns all designs that were tried, in order."""
    try:
        log.ending = _search(log)
    except _NoneRemain:
        log.ending = f"all {log.study.evaluations} evaluations were used"
    return list(log.designs.values())


def _search(log: Log) -> str:
    """Search until the best designs are at rest; returns why it ended.

    Raises:
        _NoneRemain: where the evaluations end first
    """
    study, space = log.study, log.space
    everything = space.every_design(study.evaluations)
    if everything is not None:
        log.ask(everything)
        return f"all {len(log.designs)} designs of the study were tried"
    keys = len(space.free)
    alone_and_smooth = len(study.objectives) == 1 and space.is_smooth
    count = min(max(study.evaluations // 3, 2), 64 * keys)
    first = _sobol(keys, count if alone_and_smooth else min(count, _POPULATION), study.seed)
    log.ask(first)
    if not alone_and_smooth:
        # What is not traced is smooth: two thirds of the designs are left for the steps along the front.
        leaving = (
            2 * study.evaluations // 3 if not study.is_traced else 0 if space.is_smooth else study.evaluations // 3
        )
        _nsga(log, first, leaving=leaving)
    if len(study.objectives) == 1:
        for number, start in enumerate(_starts(log, _STARTS)):
            _descend(log, start)
            if number == 0 and not study.is_traced:
                # A constraint of counts, such as false alarms of SPADs, goes in steps: slopes lead nowhere there.
                _cobyqa(log, *_starts(log, 1))
    else:
        _follow_front(log)
    return f"no step from a best design gave a better one, with {log.remaining} of {study.evaluations} evaluations left"


def _descend(
    log: Log, start: Numbers, objective: int = 0, allowed: Numbers | None = None, *, thorough: bool = True
) -> None:
    """Go from a design, as shares, to the best one for an objective that steps and neighbours lead to.

    Continuous keys go by a library, the others from neighbour to neighbour. A neighbour counts with what its continuous
    keys reach from there; the most promising ones first.

    Args:
        allowed: (objectives - 1,) largest losses of the objectives after the first; None: any
        thorough: look at every neighbour before this ends, not only at the most promising ones
    """

    def rank(shares: Numbers) -> tuple[float, ...]:
        return _rank(log.study, _evaluated(log, shares), objective, allowed)

    best: Numbers | None = _refined(log, start, objective, allowed)
    while best is not None:
        neighbours = log.space.neighbours(best)
        if len(neighbours):
            log.ask(np.array(neighbours))
        promised = _promised(log, best, neighbours, objective, allowed)
        order = sorted(range(len(neighbours)), key=lambda place: promised[place])
        present, best = rank(best), None
        for place in order if thorough else order[:_MOST_PROMISING]:
            if log.study.is_traced and promised[place] >= present:
                break
            reached = _refined(log, neighbours[place], objective, allowed)
            if rank(reached) < present:
                best = reached
                break


def _promised(
    log: Log, best: Numbers, neighbours: Sequence[Numbers], objective: int, allowed: Numbers | None
) -> list[tuple[float, ...]]:
    """`_rank` that each neighbour of a design may reach by its continuous keys, were its quantities linear in them.

    With the slopes of the design itself, in proportion to the neighbour's quantities. Of what is traced, and without
    continuous keys, the neighbours as they are.
    """
    from scipy.optimize import linprog

    study, space = log.study, log.space
    ranks = [_rank(study, _evaluated(log, neighbour), objective, allowed) for neighbour in neighbours]
    free = space.continuous
    design = _evaluated(log, best)
    slopes = None if study.is_traced or not len(free) or design.reason else log.slopes_of(design)
    if slopes is None:
        return ranks
    loss, loss_slope, slack_slope = losses(study, design), loss_slopes(study, slopes), slack_slopes(study, slopes)
    for place, neighbour in enumerate(neighbours):
        near = _evaluated(log, neighbour)
        if near.reason:
            continue
        there = losses(study, near)
        scale = np.where((there * loss > 0.0) & np.isfinite(there), there / np.where(loss == 0.0, 1.0, loss), 1.0)
        downhill = loss_slope * scale[:, None]
        slack = np.array([*slacks(study, near).values()]) - INSIDE
        rows, rest = [-slack_slope], [slack]
        if allowed is not None:
            rows.append(downhill[1:])
            rest.append(allowed - there[1:])
        answer = linprog(
            downhill[objective],
            A_ub=np.concatenate(rows),
            b_ub=np.concatenate(rest),
            bounds=[(-share, 1.0 - share) for share in neighbour[free]],
        )
        if answer.success:
            ranks[place] = (0.0, float(there[objective] + answer.fun), *ranks[place][1:])
    return ranks


def _refined(log: Log, start: Numbers, objective: int, allowed: Numbers | None) -> Numbers:
    """Best design that the continuous keys reach from a design, among all that are tried on the way; as shares."""
    before = len(log.designs)
    if not log.study.is_traced:
        ftol = 1e-12 if len(log.study.objectives) == 1 else 1e-9 if allowed is None else 1e-6
        _slsqp(log, start, ftol=ftol, objective=objective, allowed=allowed)
    elif len(log.study.objectives) == 1:
        _cobyqa(log, start)
    tried = [_evaluated(log, start), *list(log.designs.values())[before:]]
    return _shares(log.space, min(tried, key=lambda design: _rank(log.study, design, objective, allowed)))


def _rank(study: StudyFile, design: Design, objective: int, allowed: Numbers | None) -> tuple[float, ...]:
    """Order of designs for an objective: the worst broken bound first, then the loss, then those of the others."""
    loss = losses(study, design)
    broken = max(float(np.max(_violations(study, design))), 0.0)
    if allowed is not None:
        broken = max(broken, *((loss[1:] - allowed) / np.where(allowed == 0.0, 1.0, np.abs(allowed))))
    return broken, float(loss[objective]), *loss.tolist()


def _starts(log: Log, count: int) -> list[Numbers]:
    """Best designs so far for the first objective, as shares: the least broken bound counts first."""
    designs = sorted(log.designs.values(), key=lambda design: _rank(log.study, design, 0, None))
    return [_shares(log.space, design) for design in designs[:count]]


def _follow_front(log: Log) -> None:
    """Go to the ends of the front, then to places between, evenly in each objective after the first.

    Of keys with finitely many values, each design of the front is moved: to its most promising neighbours, then to all.
    """
    study, is_smooth = log.study, log.space.is_smooth
    for thorough in (True,) if is_smooth else (False, True):
        for objective in range(len(study.objectives)):
            start = min(log.designs.values(), key=lambda design: _rank(study, design, objective, None))
            _descend(log, _shares(log.space, start), objective, thorough=thorough)
        before: list[Design] = []
        while not is_smooth and (best := front(study, list(log.designs.values()))) != before:
            before = best
            for place in sorted(range(len(best)), key=lambda place: min(place, len(best) - 1 - place)):  # ends first
                allowed = losses(study, best[place])[1:]
                _descend(log, _shares(log.space, best[place]), allowed=allowed, thorough=thorough)
    has_front = bool(front(study, list(log.designs.values())))
    for share in _sobol(len(study.objectives) - 1, _PLACES_OF_FRONT, study.seed) if has_front else ():
        best = front(study, list(log.designs.values()))
        values = np.array([losses(study, design) for design in best])
        low, span = values.min(axis=0)[1:], np.ptp(values, axis=0)[1:]
        allowed = low + span * share
        scaled = (values[:, 1:] - allowed) / np.where(span > 0.0, span, 1.0)
        start = best[int(np.argmin(np.linalg.norm(scaled, axis=1)))]
        _descend(log, _shares(log.space, start), allowed=allowed)


def _shares(space: DesignSpace, design: Design) -> Numbers:
    """Shares of a design's values; a half for keys that it does not have."""
    values = design.values
    return np.array([free.share(values[free.key]) if free.key in values else 0.5 for free in space.free])


def losses(study: StudyFile, design: Design | None) -> Numbers:
    """(objectives,) what the search minimizes; inf for a design that cannot be."""
    if design is None or design.reason:
        return np.full(len(study.objectives), math.inf)
    return np.array([entry.sign * design.quantities[name] for name, entry in study.objectives.items()])


def slacks(study: StudyFile, design: Design) -> dict[str, float]:
    """Slack of every bound over its size, by name; negative where it is broken."""
    result = {}
    for name, entry in study.constraints.items():
        value = design.quantities.get(name, math.nan)
        if entry.at_least is not None:
            result[f"{name} at least {entry.at_least:g}"] = (value - entry.at_least) / _size(entry.at_least)
        if entry.at_most is not None:
            result[f"{name} at most {entry.at_most:g}"] = (entry.at_most - value) / _size(entry.at_most)
    return result


def loss_slopes(study: StudyFile, slopes: Mapping[str, Numbers]) -> Numbers:
    """(objectives, keys) slopes of `losses`."""
    return np.stack([entry.sign * slopes[name] for name, entry in study.objectives.items()])


def slack_slopes(study: StudyFile, slopes: Mapping[str, Numbers]) -> Numbers:
    """(bounds, keys) slopes of `slacks`."""
    rows = [
        sign * slopes[name] / _size(bound)
        for name, entry in study.constraints.items()
        for sign, bound in ((1.0, entry.at_least), (-1.0, entry.at_most))
        if bound is not None
    ]
    return np.array(rows) if rows else np.zeros((0, *next(iter(slopes.values())).shape))


def is_feasible(study: StudyFile, design: Design) -> bool:
    """Whether a design can be and meets all constraints."""
    return not design.reason and all(slack >= 0.0 for slack in slacks(study, design).values())


def front(study: StudyFile, designs: Sequence[Design]) -> list[Design]:
    """Feasible designs that no other one beats, by the first objective, from best to worst; each (`ALIKE`) once."""
    feasible = [design for design in designs if is_feasible(study, design)]
    if not feasible:
        return []
    values = np.array([losses(study, design) for design in feasible])
    margins = ALIKE * np.nan_to_num(np.abs(values), posinf=0.0)
    _, order = np.unique(values, axis=0, return_index=True)
    best: list[int] = []
    for number in order:  # rows are sorted by the first objective: only a design before it can beat it
        others = values[best]
        if not len(best) or not np.any(np.all(others <= values[number] + margins[number], axis=1)):
            best.append(int(number))
    return [feasible[number] for number in best]


def _size(bound: float) -> float:
    return abs(bound) or 1.0


def _sobol(dimensions: int, count: int, seed: int) -> Numbers:
    """(count, dimensions) points of a scrambled Sobol sequence."""
    from scipy.stats import qmc

    power = math.ceil(math.log2(max(count, 2)))
    return np.asarray(qmc.Sobol(dimensions, rng=np.random.default_rng(seed)).random_base2(power)[:count])


def probes(keys: int) -> Numbers:
    """(n, keys) shares of a few designs: both ends of all keys, and some between."""
    return np.concatenate([np.zeros((1, keys)), np.ones((1, keys)), _sobol(keys, 6, 0)])


def _violations(study: StudyFile, design: Design | None) -> Numbers:
    """(bounds,) excess over each bound less `INSIDE`, over its size; inf for a design that cannot be."""
    count = sum((entry.at_least is not None) + (entry.at_most is not None) for entry in study.constraints.values())
    if design is None or design.reason:
        return np.full(max(count, 1), math.inf)
    return INSIDE - np.array(list(slacks(study, design).values()) or [1.0])


def _nsga(log: Log, first: Numbers, *, leaving: int) -> None:
    """NSGA-II from the first designs, until this many evaluations remain, or no generation brings a new design."""
    nsga2 = import_optional("pymoo.algorithms.moo.nsga2", extra="design")
    core = import_optional("pymoo.core.problem", extra="design")
    evaluation = import_optional("pymoo.core.evaluator", extra="design")
    static = import_optional("pymoo.problems.static", extra="design")
    study = log.study
    problem = core.Problem(
        n_var=len(log.space.free),
        n_obj=len(study.objectives),
        n_ieq_constr=len(_violations(study, None)),
        xl=0.0,
        xu=1.0,
    )
    algorithm = nsga2.NSGA2(pop_size=len(first), sampling=first, eliminate_duplicates=True)
    algorithm.setup(problem, termination=("n_gen", 100_000), seed=study.seed, verbose=False)
    idle = 0
    while log.remaining > leaving and idle < _IDLE and algorithm.has_next():
        before, generation = len(log.designs), algorithm.ask()
        answers = log.ask(generation.get("X"))
        values = {
            name: np.minimum(np.array([function(study, answer) for answer in answers]), _LARGE)
            for name, function in (("F", losses), ("G", _violations))
        }
        evaluation.Evaluator().eval(static.StaticProblem(problem, **values), generation)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of NumPy, for names that pymoo still uses
            algorithm.tell(infills=generation)
        idle = idle + 1 if len(log.designs) == before else 0


class _NoneRemain(Exception):
    """The allowed number of evaluations is used up."""


class _NoProgress(Exception):
    """A step of a library has led to nothing better for `_PATIENCE` new designs."""


def _evaluated(log: Log, shares: Numbers) -> Design:
    answer = log.ask(shares)[0]
    if answer is None:
        raise _NoneRemain
    return answer


def _slsqp(log: Log, start: Numbers, *, ftol: float, objective: int = 0, allowed: Numbers | None = None) -> None:
    """SLSQP from a design for one objective, over the continuous keys.

    Args:
        allowed: (objectives - 1,) largest losses of the objectives after the first; None: any
    """
    from scipy.optimize import minimize

    study, by_probit = log.study, _by_probit(log.study)
    free = log.space.continuous
    if not len(free):
        return
    present = losses(by_probit, _with_probits(study, _evaluated(log, start)))
    size = np.where(np.isfinite(present) & (present != 0.0), np.abs(present), 1.0)
    most = None
    if allowed is not None:
        names = list(study.objectives)[1:]
        signs = np.array([study.objectives[name].sign for name in names])
        most = np.where([name in _probabilities(study) for name in names], signs * _probit(signs * allowed), allowed)

    best, since = _rank(study, _evaluated(log, start), objective, allowed), len(log.designs)

    def design_at(shares: Numbers) -> Design:
        # Where a quantity goes in steps, SLSQP halves its step until nothing of it is left.
        nonlocal best, since
        design = _evaluated(log, _moved(start, free, shares))
        if (rank := _rank(study, design, objective, allowed)) < best:
            best, since = rank, len(log.designs)
        if len(log.designs) - since > _PATIENCE:
            raise _NoProgress
        return design

    def loss(shares: Numbers) -> float:
        return float(losses(by_probit, _with_probits(study, design_at(shares)))[objective] / size[objective])

    def bounded(shares: Numbers) -> Numbers:
        design = _with_probits(study, design_at(shares))
        within = -_violations(by_probit, design)
        return within if most is None else np.concatenate([within, (most - losses(by_probit, design)[1:]) / size[1:]])

    # SLSQP asks for the slopes of loss and bounds one after the other, at the same place.
    @functools.lru_cache(maxsize=1)
    def slopes_at(place: bytes) -> tuple[Numbers, Numbers]:
        """(objectives, keys) of the losses over their sizes, (bounds, keys) of `bounded`; 0 where there are none."""
        shares = np.frombuffer(place)
        design = design_at(shares)
        by_name = None if design.reason else log.slopes_of(design)
        if by_name is None:
            return np.zeros((len(size), len(free))), np.zeros((len(bounded(shares)), len(free)))
        for name in _probabilities(study):
            quantile = float(_probit(design.quantities[name])) + _LEAST_PROBIT
            by_name[name] *= math.sqrt(2.0 * math.pi) * math.exp(0.5 * quantile**2)
        of_losses, of_slacks = loss_slopes(by_probit, by_name) / size[:, None], slack_slopes(by_probit, by_name)
        if not len(of_slacks):
            of_slacks = np.zeros((1, len(free)))
        return of_losses, of_slacks if allowed is None else np.concatenate([of_slacks, -of_losses[1:]])

    with contextlib.suppress(_NoProgress):
        minimize(
            loss,
            start[free],
            method="SLSQP",
            jac=lambda shares: slopes_at(shares.tobytes())[0][objective],
            bounds=[(0.0, 1.0)] * len(free),
            constraints=[{"type": "ineq", "fun": bounded, "jac": lambda shares: slopes_at(shares.tobytes())[1]}],
            options={"ftol": ftol, "maxiter": 100},
        )


def _probabilities(study: StudyFile) -> list[str]:
    """Names of the objectives and constraints that are a probability of detection."""
    entries = {**study.objectives, **study.constraints}
    return [name for name, entry in entries.items() if entry.quantity_name == "detection_probability"]


def _by_probit(study: StudyFile) -> StudyFile:
    """The study with its probabilities as probits: about SNR less TNR, hence nearly linear in the keys.

    A probability itself is flat where detection is certain: a step along its slope leaves the allowed designs.
    """
    bounds = {
        name: entry.model_copy(
            update={
                key: float(_probit(bound))
                for key in ("at_least", "at_most")
                if (bound := getattr(entry, key)) is not None
            }
        )
        for name, entry in study.constraints.items()
        if name in _probabilities(study)
    }
    return study.model_copy(update={"constraints": {**study.constraints, **bounds}})


def _with_probits(study: StudyFile, design: Design) -> Design:
    probits = {name: float(_probit(design.quantities[name])) for name in _probabilities(study) if not design.reason}
    return replace(design, quantities={**design.quantities, **probits})


def _probit(probability: ArrayLike) -> Numbers:
    """Quantile of the standard normal distribution less `_LEAST_PROBIT`, at most that of `_CERTAIN`."""
    tail = np.clip(np.asarray(probability, float), _CERTAIN, 1.0 - _CERTAIN)
    return -np.asarray(normal_tail_inverse(tail)) - _LEAST_PROBIT


def _cobyqa(log: Log, start: Numbers) -> None:
    """COBYQA from a design, over the continuous keys."""
    from scipy.optimize import Bounds, NonlinearConstraint, minimize

    study = log.study
    free = log.space.continuous
    if not len(free):
        return
    size = abs(float(losses(study, _evaluated(log, start))[0])) or 1.0

    def design_at(shares: Numbers) -> Design:
        return _evaluated(log, _moved(start, free, shares))

    minimize(
        lambda shares: min(float(losses(study, design_at(shares))[0]) / size, 1e6),
        start[free],
        method="COBYQA",
        bounds=Bounds(np.zeros(len(free)), np.ones(len(free))),
        constraints=[
            NonlinearConstraint(lambda shares: np.minimum(_violations(study, design_at(shares)), 1e6), -np.inf, 0.0)
        ],
        options={"initial_tr_radius": 0.1, "final_tr_radius": 1e-4},
    )


def _moved(start: Numbers, free: Numbers, shares: Numbers) -> Numbers:
    """Design with other shares of its continuous keys."""
    moved = np.array(start)
    moved[free] = shares
    return moved


def _design(values: Values, answer: dict[str, float] | str) -> Design:
    if isinstance(answer, str):
        return Design(values=values, quantities={}, reason=answer)
    return Design(values=values, quantities=answer)


def _text(values: Values) -> str:
    """Text of a design, equal for equal ones."""
    return json.dumps(values, sort_keys=True)


def record_line(design: Design) -> str:
    """Line of the record of evaluations."""
    return json.dumps({"values": design.values, "quantities": design.quantities, "reason": design.reason})


def _single(evaluate: EvaluateAll) -> Callable[[Values], dict[str, float]]:
    """Evaluate one design.

    Raises:
        InputError: for one that cannot be
    """

    def quantities_of(values: Values) -> dict[str, float]:
        (answer,) = evaluate([values])
        if isinstance(answer, str):
            raise InputError(answer)
        return answer

    return quantities_of


def alone(evaluator: Callable[[Values], dict[str, float]]) -> EvaluateAll:
    """Evaluate one design after the other, in this process."""

    def evaluate(designs: Sequence[Values]) -> Iterable[dict[str, float] | str]:
        for values in designs:
            try:
                yield evaluator(values)
            except InputError as error:
                yield str(error)

    return evaluate
