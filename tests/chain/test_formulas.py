"""Each formula of `physics` is run by the code around it; what only tests and pages name stands in `physics/reference`.

A reader who edits an equation in `physics` changes a render or a study, and one in `physics/reference` changes neither.
"""

import ast
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path

from helpers.sources import parsed

SOURCE = Path(__file__).parents[2] / "src" / "lidarscene"

Module = tuple[str, ...]
Formula = tuple[Module, str]


def module_of(file: Path) -> Module:
    return file.parts[:-1] if file.stem == "__init__" else file.with_suffix("").parts


def is_formulas(module: Module) -> bool:
    return module[:1] == ("physics",)


def definitions(tree: ast.Module) -> Iterator[tuple[str, ast.stmt]]:
    """Yield the names that a file defines at its top, and how."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name, node
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                yield from ((part.id, node) for part in ast.walk(target) if isinstance(part, ast.Name))


def unused(sources: dict[Path, ast.Module]) -> list[str]:
    """Public functions and classes of `physics`, but for `physics/reference`, that nothing outside of it runs."""
    trees = {module_of(file): (file, tree) for file, tree in sources.items()}
    bodies: dict[Formula, list[ast.stmt]] = defaultdict(list)
    for module, (_, tree) in trees.items():
        for name, node in definitions(tree) if is_formulas(module) else ():
            bodies[module, name].append(node)

    def imported(module: Module) -> dict[str, Module | Formula]:
        """What the names that a file imports from `physics` mean: modules and formulas."""
        file, tree = trees[module]
        meaning: dict[str, Module | Formula] = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.level:
                folder = file.parts[: len(file.parts) - node.level]
                origin = (*folder, *(node.module.split(".") if node.module else ()))
                for alias in node.names:
                    deeper = (*origin, alias.name)
                    if is_formulas(deeper):
                        meaning[alias.asname or alias.name] = deeper if deeper in trees else (origin, alias.name)
        return meaning

    def used(module: Module, code: Iterable[ast.AST]) -> Iterator[Formula]:
        meaning = imported(module)
        for node in (node for part in code for node in ast.walk(part)):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in meaning:
                yield meaning[node.value.id], node.attr
            elif isinstance(node, ast.Name):
                yield meaning.get(node.id, (module, node.id))

    found: set[Formula] = set()
    ahead = [
        formula for module, (_, tree) in trees.items() if not is_formulas(module) for formula in used(module, [tree])
    ]
    while ahead:
        formula = ahead.pop()
        if formula in bodies and formula not in found:
            found.add(formula)
            ahead += used(formula[0], bodies[formula])
    return sorted(
        ".".join((*module, name))
        for (module, name), nodes in bodies.items()
        if module[1] != "reference" and (module, name) not in found
        if not name.startswith("_") and isinstance(nodes[0], ast.FunctionDef | ast.ClassDef)
    )


def test_each_formula_is_run() -> None:
    assert unused({file.relative_to(SOURCE): tree for file, tree in parsed(SOURCE).items()}) == []


def test_what_only_formulas_of_reference_run_is_found() -> None:
    """`chained` is run by what a stage runs, `lonely` by nothing, and `bounded` by a formula of reference alone."""
    sources = {
        Path("light/stage.py"): "from ..physics import optics\nfrom ..physics.lens import share\noptics.echo(share)",
        Path("physics/optics.py"): "from .lens import chained\ndef echo(x): return chained(x)\ndef lonely(): pass",
        Path("physics/lens.py"): "def share(): pass\ndef chained(x): pass\ndef bounded(): pass",
        Path("physics/reference/lens.py"): "from ..lens import bounded\ndef bound(): return bounded()",
    }
    assert unused({file: ast.parse(code) for file, code in sources.items()}) == [
        "physics.lens.bounded",
        "physics.optics.lonely",
    ]
