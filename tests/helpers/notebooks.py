"""Run a notebook in this process, and keep what it shows: as Jupyter would, without its server.

It runs in an empty folder that is gone afterwards, so that what it saves is nowhere else. Cells share one namespace.
What a cell prints, the value of its last expression and its Matplotlib figures are its outputs.
"""

import ast
import base64
import contextlib
import io
import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def run(path: Path, changes: Mapping[str, str] | None = None) -> dict[str, Any]:
    """The notebook with the outputs of a run, from top to bottom; what a cell raises is raised.

    Args:
        changes: pieces of its code, and by what they are replaced for the run; each must be there
    """
    notebook: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    namespace: dict[str, Any] = {"__name__": "__main__"}
    pending = dict(changes or {})
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for number, cell in enumerate(cells, start=1):
            where = f"{path.name}, cell {number}"
            source = "".join(cell["source"])
            for piece in [piece for piece in pending if piece in source]:
                source = source.replace(piece, pending.pop(piece))
            cell |= {"execution_count": number, "outputs": _outputs(source, namespace, where, number)}
    assert not pending, f"{path.name} has no {', '.join(pending)}"
    return notebook


def written(notebook: dict[str, Any]) -> str:
    """Text of the file, the same on every run with the same outputs."""
    return json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"


def _outputs(source: str, namespace: dict[str, Any], where: str, number: int) -> list[dict[str, Any]]:
    from matplotlib import pyplot

    tree = ast.parse(source, where)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, where, "exec"), namespace)
        value = (
            eval(compile(ast.Expression(last.value), where, "eval"), namespace) if isinstance(last, ast.Expr) else None
        )
    outputs: list[dict[str, Any]] = []
    if printed.getvalue():
        outputs.append({"name": "stdout", "output_type": "stream", "text": printed.getvalue().splitlines(True)})
    if value is not None and not source.rstrip().endswith(";"):
        data: dict[str, Any] = {"text/plain": repr(value).splitlines(True)}
        if hasattr(value, "_repr_html_"):
            data["text/html"] = value._repr_html_().splitlines(True)
        elif hasattr(value, "_repr_png_"):  # Jupyter shows the first of the two
            data["image/png"] = base64.b64encode(value._repr_png_()).decode()
        outputs.append({"data": data, "execution_count": number, "metadata": {}, "output_type": "execute_result"})
    for figure in map(pyplot.figure, pyplot.get_fignums()):
        image = io.BytesIO()
        figure.savefig(image, format="png", dpi=72, bbox_inches="tight", metadata={"Software": None})
        drawn = {"image/png": base64.b64encode(image.getvalue()).decode(), "text/plain": ["<Figure>"]}
        outputs.append({"data": drawn, "metadata": {}, "output_type": "display_data"})
    pyplot.close("all")
    return outputs
