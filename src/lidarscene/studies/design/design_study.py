"""Entry point of design studies: `run_study` reads a study file, searches, and returns a front of designs.

The command `design` and Python users call it.
"""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..._version import __version__
from ...errors import InputError, warn
from ...figures import pictures
from ...figures.lines import Chart, Line, Mark
from ...figures.report import Figure, Report, count_text, text_table
from ...files.atomic import put_text, require_writable
from ...files.overrides import key_path, number_list_entries
from ...files.toml import read_toml, validate
from ...files.toml_edit import put_values, remove_values
from ...maths.units import split_unit
from ...sensor.parts import is_part
from ..ranging.conditions import PROBABILITY
from .designs import Design, DesignSpace, files_of_base
from .optimum import ACTIVE, ActiveConstraints, at_an_end, limits_of
from .quantities import Evaluator, mean_power_w
from .search import EvaluateAll, Log, alone, front, is_feasible, losses, probes, record_line, search, slacks
from .slopes import SlopesOf, derivatives
from .study_file import CLASS_1, CLOSED_FORM, QUANTITIES, RANGES, UNITS, FreeFile, QuantityFile, StudyFile

EVALUATIONS = "evaluations.jsonl"
PAGES = ("index.html", "index.md", "design.json")
ALL_DIGITS = 17
"""Significant digits that give the same double back: a rounded power would miss class 1."""
MOST_FILES = 50
"""Designs of a front that become sensor files."""


def load_study(path: Path) -> tuple[StudyFile, Evaluator]:
    """Read a study file and all that it names.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    study = validate(StudyFile, read_toml(path), str(path))
    space = DesignSpace.from_study(study, path.parent, str(path))
    return study, Evaluator(study, space, path.parent, str(path))


def run_study(
    path: Path,
    folder: Path,
    *,
    evaluate: EvaluateAll | None = None,
    progress: Callable[[int, int, str], object] = lambda count, total, words: None,
) -> Report:
    """Search the designs of a study; returns the front, with charts and sensor files.

    Args:
        folder: for all evaluations; a broken run resumes from it
        evaluate: computes the quantities of several designs; by default one after the other in this process
        progress: called with the number of designs so far, the greatest number, and words on the front so far

    Raises:
        InputError: if a file, a key or a value cannot be understood
        OutputError: if a result cannot be written
    """
    study, evaluator = load_study(path)
    unmoved = _unmoved_constraints(study, evaluator, str(path))
    for text in unmoved:
        warn(f"{path}: {text}")
    require_writable(folder / EVALUATIONS)
    folder.mkdir(parents=True, exist_ok=True)
    record, head = folder / EVALUATIONS, _head(path, study, evaluator.space)
    slopes = derivatives(evaluator)
    log = Log(
        study=study, space=evaluator.space, evaluate=evaluate or alone(evaluator), slopes=slopes, progress=progress
    )
    if record.exists():
        lines = record.read_text(encoding="utf-8").splitlines()
        if lines[:1] != [head]:
            raise InputError(f"{record}: must be of this study, got another's; give another folder or remove the file")
        log.read(record)
    entries = [head, *(record_line(design) for design in log.recorded.values())]
    put_text(record, "\n".join(entries) + "\n")  # without a line that was cut off
    with record.open("a", encoding="utf-8") as file:
        log.file = file
        designs = search(log)
    best = front(study, designs)
    if not best:
        raise InputError(f"{path}: {_none_feasible(study, designs)}")
    return _report(study, evaluator, designs, best, slopes, log.ending)


def _unmoved_constraints(study: StudyFile, evaluator: Evaluator, where: str) -> list[str]:
    """Sentences on constraints that the free keys do not move, asked of some designs before the search.

    Raises:
        InputError: where such a constraint is broken, so that no design would meet it
    """
    closed = {name: entry for name, entry in study.constraints.items() if entry.quantity_name in CLOSED_FORM}
    answers = []
    for shares in probes(len(evaluator.space.free)):
        try:
            answers.append(evaluator(evaluator.space.values(shares), closed))
        except InputError:
            continue  # a design that cannot be
    texts = []
    for name, entry in closed.items() if len(answers) > 1 else ():
        values = {answer[name] for answer in answers}
        # Constraints that no user wrote are not worth a sentence where they hold.
        if len(values) > 1 or ((is_met := entry.allows(value := values.pop())) and name.startswith(CLASS_1)):
            continue
        unit = _unit(entry)
        text = f"constraints.{name}: no free key moves it: {entry.quantity_name} is {value:.4g} {unit}".rstrip()
        if not is_met:
            off = '; eye_safety = "off" leaves it out' if name.startswith(CLASS_1) else ""
            raise InputError(f"{where}: {text}, and must be {entry.bounds_text} {unit}".rstrip() + off)
        texts.append(text)
    return texts


def knee(study: StudyFile, best: Sequence[Design]) -> int:
    """Number of the design of a front that is nearest to the best of all objectives, each over its span."""
    values = np.array([losses(study, design) for design in best])
    span = np.ptp(values, axis=0)
    return int(np.argmin(np.linalg.norm((values - values.min(axis=0)) / np.where(span > 0.0, span, 1.0), axis=1)))


def _head(path: Path, study: StudyFile, space: DesignSpace) -> str:
    """First line of the record: what the evaluations depend on."""
    tables = {label: [base.tables for base in bases] for label, bases in space.bases.items()}
    text = json.dumps([study.model_dump(mode="json"), tables, __version__], sort_keys=True, default=str)
    scene = path.parent / (study.scene or "")
    content = scene.read_bytes() if study.scene and scene.is_file() else b""
    return json.dumps({"study": hashlib.sha256(text.encode() + content).hexdigest()})


def _none_feasible(study: StudyFile, designs: Sequence[Design]) -> str:
    """Line that says why no design is feasible: the bound that is broken least in the best one, or the first reason."""
    possible = [design for design in designs if not design.reason]
    if not possible:
        return f"no sensor can be built; the first: {designs[0].reason}"
    nearest = max(possible, key=lambda design: min(slacks(study, design).values()))
    bound, slack = min(slacks(study, nearest).items(), key=lambda entry: entry[1])
    return f"no design of {len(designs)} meets all constraints; the nearest misses {bound} by {-100.0 * slack:.3g} %"


def _report(
    study: StudyFile,
    evaluator: Evaluator,
    designs: Sequence[Design],
    best: Sequence[Design],
    slopes: SlopesOf,
    ending: str,
) -> Report:
    """Page, data and sensor files of the result; ``ending`` says why the search ended."""
    report = Report(study.name or "Design study", pages=PAGES, embeds=False)
    chosen = best[knee(study, best)]
    shown = {"chosen": chosen}
    if len(best) > 1:
        for place, name in enumerate(study.objectives):
            shown[f"best {name}"] = best[int(np.argmin([losses(study, design)[place] for design in best]))]
    limits = {
        words: limits_of(study, evaluator.space, design, slopes, best=words.removeprefix("best ") if place else None)
        for place, (words, design) in enumerate(shown.items())
    }
    fronts = _fronts_of_choices(study, evaluator.space, designs)
    shown |= {name: designs_of_choice[knee(study, designs_of_choice)] for name, designs_of_choice in fronts.items()}
    safety = _eye_safety(evaluator, chosen)
    # By identity: the designs that are shown are of the front, too, and each interval takes dozens of ranges.
    different = {id(design): design for design in (*shown.values(), *best)}
    of_design = {number: _intervals(evaluator, design) for number, design in different.items()}
    intervals = {words: of_design[id(design)] for words, design in shown.items()}
    ends = at_an_end(evaluator.space, chosen)
    extremes = {words: design for words, design in shown.items() if words.startswith("best ")}
    answers = {
        "Question": _question(study, evaluator.space),
        "Verdict": _verdict(study, designs, best, chosen, intervals["chosen"]),
        "What it rests on": " ".join(
            [
                *_rests_on(study, designs, ending, intervals["chosen"]),
                *safety.values(),
                *_power_texts(evaluator.space, chosen),
            ]
        ),
        "What differs": " ".join(_differences(study, chosen, extremes, fronts, best)),
        "What would change it": " ".join(_changes(study, chosen, limits["chosen"], ends)),
    }
    for lead, text in answers.items():
        if text:
            report.add_paragraph(text, lead)
    first, *others = _figures(study, designs, fronts or {"front": best}, chosen, extremes)
    report.add_figure(first)
    clouds = list(_clouds(evaluator, extremes or shown)) if study.is_traced else []
    if clouds:
        report.add_pictures(clouds)
    report.add_heading("The designs")
    report.add_table(*_designs_table(study, evaluator.space, shown, intervals))
    if study.constraints:
        report.add_heading("What each constraint costs")
        report.add_table(*_costs_table(study, shown, limits))
    if limits["chosen"] is not None:
        report.add_paragraph(_slopes_text(limits["chosen"]))
    for figure in others:
        report.add_figure(figure)
    ends_of_front = [of_design[id(design)] for design in best]
    ranged = [name for name in evaluator.entries if any(name in interval for interval in ends_of_front)]
    header = [*map(_column, evaluator.entries, evaluator.entries.values())]
    header += [free.key for free in evaluator.space.free]
    header += [f"{name} {end}" for name in ranged for end in ("low", "high")]
    rows = [
        [*_row(study, evaluator.space, design), *(end for name in ranged for end in interval.get(name, ("", "")))]
        for design, interval in zip(best, ends_of_front, strict=True)
    ]
    report.main_table = (header, rows)
    report.add_data("front", report.main_table)
    source = f"chosen by the design study {study.name}".rstrip()
    places = {best.index(design) for design in shown.values() if design in best}
    files = [
        name
        for place in _files(best, places)
        for name in _add_sensors(report, evaluator.space, best[place], place, source)
    ]
    report.numbers = {
        "study": study.name,
        "evaluations": len(designs),
        "ending": ending,
        "impossible": sum(bool(design.reason) for design in designs),
        "chosen": _numbers(chosen) | {"intervals": intervals["chosen"]},
        "question": answers["Question"],
        "verdict": answers["Verdict"],
        "limits": _limits_numbers(limits["chosen"]),
        "at_an_end": list(ends),
        "choices": {name: _numbers(shown[name]) for name in fronts},
        "eye_safety": safety,
        "front": [_numbers(design) for design in best],
        "files": files,
    }
    report.summary = _summary(report.numbers)
    return report


def _limits_numbers(limits: ActiveConstraints | None) -> dict[str, Any] | None:
    if limits is None:
        return None
    return {"costs": limits.costs, "held": limits.held, "optimum": limits.stands, "slopes": dict(limits.methods)}


def _numbers(design: Design) -> dict[str, Any]:
    return {"values": dict(design.values), "quantities": dict(design.quantities)}


def _row(study: StudyFile, space: DesignSpace, design: Design) -> list[Any]:
    quantities = [design.quantities[name] for name in (*study.objectives, *study.constraints)]
    return [*quantities, *(design.values.get(free.key, "") for free in space.free)]


def _question(study: StudyFile, space: DesignSpace) -> str:
    """What is wanted, what is free and what is allowed, in a sentence."""
    sensors = {label: " or ".join(base.name for base in bases) for label, bases in space.bases.items()}
    of = ", ".join(f"{label} ({names})" if label else names for label, names in sensors.items())
    goals = [
        f"{'the lowest' if entry.maximize is None else 'the highest'} {_with_conditions(name, entry)}"
        for name, entry in study.objectives.items()
    ]
    free = [f"{key} {_values_text(entry)}" for key, entry in study.free.items()]
    allowed = [
        name
        if name.startswith(CLASS_1)
        else f"{_with_conditions(name, entry)} {entry.bounds_text} {_unit(entry)}".rstrip()
        for name, entry in study.constraints.items()
    ]
    text = f"Which {of} has {' and '.join(goals)}"
    text += f", with {'; '.join(free)}" if free else ""
    return text + (f"? Allowed: {'; '.join(allowed)}." if allowed else "?")


def _with_conditions(name: str, entry: QuantityFile) -> str:
    """Name of an objective or a constraint, with its quantity and the conditions under which it holds."""
    is_named = name == entry.quantity_name or name.startswith(CLASS_1)
    words = ["" if is_named else entry.quantity_name, entry.words]
    text = ", ".join(filter(None, words))
    return f"{name} ({text})" if text else name


def _values_text(entry: FreeFile) -> str:
    """Values that a free key may have, in words."""
    if entry.choices is not None:
        return f"one of {', '.join(map(_short, entry.choices))}"
    step = f" in steps of {entry.step:g}" if entry.step else ""
    return f"from {entry.low:g} to {entry.high:g}{step}"


def _reached(study: StudyFile, design: Design, interval: Intervals) -> str:
    """Objectives of a design with their units, and the interval of each range that has one."""
    return ", ".join(
        f"{name} {_short(design.quantities[name])} {_unit(entry)}".rstrip()
        + (" ({} to {})".format(*map(_short, interval[name])) if name in interval else "")
        for name, entry in study.objectives.items()
    )


def _with_values(design: Design) -> str:
    return ", ".join(f"{key} = {_short(value)}" for key, value in design.values.items())


def _verdict(
    study: StudyFile, designs: Sequence[Design], best: Sequence[Design], chosen: Design, interval: Intervals
) -> str:
    """The chosen design in a sentence."""
    among = "the best" if len(best) == 1 else f"the middle of a front of {len(best)}"
    tried = f"{among} among {len(designs)} designs tried"
    text = f"{_reached(study, chosen, interval)} with {_with_values(chosen)}: {tried}."
    impossible = [design for design in designs if design.reason]
    if impossible:
        text += f" {len(impossible)} of them cannot be built or judged; the first: {impossible[0].reason}."
    idle = [name for name in study.objectives if len({design.quantities.get(name) for design in designs}) == 1]
    return f"{text} No design changes {', '.join(idle)}: are pose, class and keys as meant?" if idle else text


def _rests_on(study: StudyFile, designs: Sequence[Design], ending: str, interval: Intervals) -> list[str]:
    """Sentences on the search and on the uncertainties."""
    has_brackets = any(name in study.objectives for name in interval)
    brackets = ["Brackets: range over the stated uncertainties."] if has_brackets else []
    return [f"{count_text(len(designs), 'design')} tried. The search ended because {ending}.", *brackets]


def _differences(
    study: StudyFile,
    chosen: Design,
    extremes: Mapping[str, Design],
    fronts: Mapping[str, Sequence[Design]],
    best: Sequence[Design],
) -> list[str]:
    """Sentences on the ends of the front and on the sensors among which one was chosen."""
    texts = []
    for words, design in extremes.items():
        if design is chosen:
            texts.append(f"The chosen design is the {words}.")
            continue
        other = {key: value for key, value in design.values.items() if value != chosen.values.get(key)}
        values = ", ".join(f"{key} = {_short(value)}" for key, value in other.items())
        texts.append(f"The {words}: {_reached(study, design, {})} with {values}.")
    return texts + ([_choices_text(fronts, best)] if fronts else [])


def _changes(study: StudyFile, chosen: Design, limits: ActiveConstraints | None, ends: Sequence[str]) -> list[str]:
    """Sentences on the bounds that hold the chosen design, the ends of its keys, and whether it is an optimum."""
    texts = []
    if limits is not None and limits.stands:
        texts += [
            f"1 % of {bound} buys {cost:.3g} % of {limits.objective}."
            for bound, cost in limits.costs.items()
            if cost > 0.0
        ]
    slack = [bound for bound, share in slacks(study, chosen).items() if share > ACTIVE]
    if slack:
        texts.append(f"These bounds leave room: {', '.join(slack)}.")
    if ends:
        texts.append(f"At an end of its range: {', '.join(ends)}. A wider range may give a better design.")
    if limits is not None and not limits.stands:
        texts.append("No constraint holds this design where it is: more evaluations would find a better one.")
    return texts


def _fronts_of_choices(study: StudyFile, space: DesignSpace, designs: Sequence[Design]) -> dict[str, list[Design]]:
    """Front of the designs with each sensor that could be chosen, by its name; {} where none could."""
    fronts = {}
    for key, names in space.sensor_choices().items():
        for name in names:
            feasible = front(study, [design for design in designs if design.values.get(key) == name])
            if feasible:
                fronts[name if len(space.bases) == 1 else f"{key.partition(':')[0]} {name}"] = feasible
    return fronts


def _choices_text(fronts: Mapping[str, Sequence[Design]], best: Sequence[Design]) -> str:
    """Sentence on the sensors that are part of the front, and on those that others beat."""
    shares = {name: any(design in best for design in choices) for name, choices in fronts.items()}
    beaten = [name for name, is_ahead in shares.items() if not is_ahead]
    text = f"On the front: {', '.join(name for name, is_ahead in shares.items() if is_ahead)}."
    return f"{text} Beaten in all objectives by a design of another: {', '.join(beaten)}." if beaten else text


def _costs_table(
    study: StudyFile, shown: Mapping[str, Design], limits: Mapping[str, ActiveConstraints | None]
) -> tuple[Sequence[str], list[list[str]]]:
    """What an objective would gain if 1 % of each bound gave way, or how much is slack."""
    rows = []
    for bound in slacks(study, shown["chosen"]):
        cells = []
        for words, of_design in limits.items():
            slack = slacks(study, shown[words])[bound]
            if slack > ACTIVE:
                cells.append(f"nothing, {100.0 * slack:.3g} % slack")
            elif of_design is None or not of_design.stands:
                cells.append("not known")
            else:
                cells.append(f"{of_design.costs[bound]:.3g} % of {of_design.objective}")
        rows.append([bound, *cells])
    return ["1 % of the bound buys", *limits], rows


def _designs_table(
    study: StudyFile, space: DesignSpace, shown: Mapping[str, Design], intervals: Mapping[str, Intervals]
) -> tuple[Sequence[str], list[list[str]]]:
    header = ["", *shown]
    rows = [[key, *(_short(design.values.get(key, "-")) for design in shown.values())] for key in _keys(space)]
    for name, entry in {**study.objectives, **study.constraints}.items():
        cells = [_short(design.quantities[name]) for design in shown.values()]
        rows.append([" ".join(filter(None, [_with_conditions(name, entry), _unit(entry)])), *cells])
        ends = [intervals[words].get(name) for words in shown]
        if any(ends):
            texts = ["-" if end is None else f"{_short(end[0])} to {_short(end[1])}" for end in ends]
            rows.append([f"{name} over the stated uncertainties, {_unit(entry)}", *texts])
    return header, rows


Intervals = Mapping[str, tuple[float, float]]
"""Ends of each range by the name of its objective or constraint."""


def _intervals(evaluator: Evaluator, design: Design) -> Intervals:
    """Intervals of the ranges of a design that the uncertainties of its sensor files give."""
    ends = {
        name: evaluator.range_interval_m(entry, design.values)
        for name, entry in evaluator.entries.items()
        if entry.quantity_name == "range"
    }
    return {name: interval for name, interval in ends.items() if interval is not None}


def _unit(entry: QuantityFile) -> str:
    """Unit of a quantity, or of the key of a sensor file; "" without."""
    name = entry.quantity_name
    if name in QUANTITIES:
        return UNITS.get(name, "")
    return split_unit(name)[1]


def _label(study: StudyFile, name: str) -> str:
    entry = study.objectives[name]
    words = f"{name} at P_d {entry.probability:g}" if entry.quantity_name in RANGES else name
    return f"{words} [{unit}]" if (unit := _unit(entry)) else words


def _column(name: str, entry: QuantityFile) -> str:
    """Name of a column of the front; a range at another P_d than usual is named after it."""
    is_usual = entry.quantity_name not in RANGES or entry.probability == PROBABILITY
    return name if is_usual else f"{name} {entry.conditions().range_column}"


def _keys(space: DesignSpace) -> list[str]:
    return [free.key for free in space.free]


def _slopes_text(limits: ActiveConstraints) -> str:
    """Sentence on how slopes were found."""
    ways: dict[str, list[str]] = {}
    for name, way in limits.methods.items():
        ways.setdefault(way, []).append(name)
    return "Slopes: " + "; ".join(", ".join(names) + f" by {way}" for way, names in ways.items()) + "."


def _eye_safety(evaluator: Evaluator, chosen: Design) -> dict[str, str]:
    """Sentence on the limiting criterion of eye safety of each sensor of a design, by label."""
    texts = {}
    for label, sensor in evaluator.space.sensors(chosen.values).items():
        try:
            report = evaluator.eye_safety(sensor, "scanned")
        except InputError as error:
            texts[label] = f"Eye safety of the chosen design: {error}."
            continue
        limiting = report.limiting
        texts[label] = (
            f"Eye safety of the chosen design{f' {label}' if label else ''}, beam scanning: {report.verdict}; "
            f"{limiting.quantity} limits ({limiting.subject}), margin {report.margin:.3g}."
        )
    return texts


def _power_texts(space: DesignSpace, chosen: Design) -> list[str]:
    """Power of light and of electricity of each sensor of a design whose file has [power], with the sources."""
    texts = []
    for label, sensor in space.sensors(chosen.values).items():
        if sensor.power is None:
            continue
        light_w, power = mean_power_w(sensor), sensor.power
        source = sensor.source_of("power.driver_efficiency")
        texts.append(
            f"Power of the chosen design{f' {label}' if label else ''}: {1e3 * light_w:.3g} mW of light, "
            f"driver {power.driver_w(light_w):.3g} W ({source or 'no source'}), with {power.electronics_w:g} W of "
            f"electronics and {power.scanner_w:g} W of the scanner {power.total_w(light_w):.3g} W."
        )
    return texts


def _figures(
    study: StudyFile,
    designs: Sequence[Design],
    fronts: Mapping[str, Sequence[Design]],
    chosen: Design,
    extremes: Mapping[str, Design],
) -> list[Figure]:
    """Fronts of each pair with the first objective; of one objective, the best so far over the evaluations."""
    names = list(study.objectives)
    if len(names) == 1:
        sign = study.objectives[names[0]].sign
        feasible = [float(losses(study, design)[0]) if is_feasible(study, design) else math.inf for design in designs]
        lowest = sign * np.minimum.accumulate(feasible)
        counts = np.arange(1.0, len(designs) + 1.0)
        chart = Chart(
            lines=(Line(label="best so far", x=counts, y=lowest),),
            x_label="designs tried",
            y_label=_label(study, names[0]),
            title=study.name,
        )
        data = (("designs", names[0]), list(zip(counts.tolist(), lowest.tolist(), strict=True)))
        return [Figure("search", chart, data, "Best feasible design over the number of designs that were tried.")]
    figures = []
    for other in names[1:]:
        courses = {
            name: np.array(sorted((design.quantities[other], design.quantities[names[0]]) for design in best))
            for name, best in fronts.items()
        }
        chart = Chart(
            lines=tuple(
                Line(label=name, x=course[:, 0], y=course[:, 1], colour=number)
                for number, (name, course) in enumerate(courses.items())
                if len(course) > 1
            ),
            x_label=_label(study, other),
            y_label=_label(study, names[0]),
            title=study.name,
            marks=(
                *(
                    Mark(x=float(course[0, 0]), y=float(course[0, 1]), text=name, colour=number, offset=(8.0, -12.0))
                    for number, (name, course) in enumerate(courses.items())
                    if len(course) == 1
                ),
                *(
                    Mark(x=design.quantities[other], y=design.quantities[names[0]], text=words)
                    for words, design in {"chosen": chosen, **extremes}.items()
                    if words == "chosen" or design is not chosen
                ),
            ),
        )
        rows = [(*point.tolist(), name) for name, course in courses.items() for point in course]
        table = ((other, names[0], "of"), rows)
        whose = "" if len(fronts) == 1 else " with the same sensor"
        caption = f"No design that was tried{whose} is better in all objectives."
        figures.append(Figure(f"front-{other}", chart, table, caption))
    return figures


def _clouds(evaluator: Evaluator, shown: Mapping[str, Design]) -> Iterator[tuple[str, str, Callable[[Path], None]]]:
    """Name, caption and drawing of the clouds of the designs that the page shows, each once."""
    drawn: list[Design] = []
    for words, design in shown.items():
        if design in drawn:
            continue
        drawn.append(design)
        for label, cloud in evaluator.clouds(design.values).items():
            name = "-".join(["cloud", *words.split(), *([label] if label else [])])
            caption = f"{words}{f', {label}' if label else ''}: {len(cloud):,} points."
            yield name, caption, partial(pictures.perspective_picture, cloud, size_px=(1280, 720))


def _files(best: Sequence[Design], places: Collection[int]) -> list[int]:
    """Places of the designs that become files: all of a short front; else the named ones and others evenly between."""
    even = np.unique(np.linspace(0, len(best) - 1, min(len(best), MOST_FILES)).round().astype(int)).tolist()
    return sorted({*even, *places})


def _add_sensors(report: Report, space: DesignSpace, design: Design, place: int, source: str) -> list[str]:
    """Add the sensor files of a design, ready to render; returns their names. ``source``: of what it changes."""
    names = []
    for label, chosen in space.chosen(design.values).items():
        base = chosen.base
        assert base.path is not None
        text = base.path.read_text(encoding="utf-8")
        replaced, noted = chosen.replaced_tables(source)
        text = remove_values(text, [*((name,) for name in replaced), *noted])
        values = {(name,): table for name, table in replaced.items() if table is not None} | {
            tuple(number_list_entries(key_path(key), chosen.tables)): value
            for key, value in {**base.settings, **chosen.changes}.items()
            if not is_part(key, value)
        }
        values |= {path: value for path, value in noted.items() if value is not None}
        name = "-".join([f"designs/{place + 1:03}", *([label] if label else [])]) + ".toml"
        text = put_values(text, values, digits=ALL_DIGITS)
        report.add_file(name, partial(put_text, text=text))
        for file in files_of_base(base):
            report.add_file(f"designs/{file.name}", partial(shutil.copyfile, file))
        names.append(name)
    return names


def _short(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_short(inner)}" for key, inner in value.items()) + "}"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _summary(numbers: dict[str, Any]) -> str:
    chosen = numbers["chosen"]
    rows = [[key, _short(value)] for key, value in (chosen["values"] | chosen["quantities"]).items()]
    lines = [numbers["question"], numbers["verdict"], "", text_table(("chosen design", ""), rows, "<>"), ""]
    lines += numbers["eye_safety"].values()
    return "\n".join(lines)
