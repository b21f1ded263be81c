"""tools/mutants.py: changes that a file can have, and that a test's verdict is that of the changed file."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.child import FEW_PLUGINS
from helpers.sources import module_of

ROOT = Path(__file__).parents[1]
CODE = '''"""A module."""

LIMIT = 3


def clipped(value: int = 2, *, low: float) -> float:
    """Value, at least low."""
    if value < low and not LIMIT:
        raise ValueError(f"clipped: {value + 1}")
    value = pow(value, low)
    return max(value, low) - list(zip([1], strict=True))[0]
'''


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setitem(sys.modules, "mutants", None)
    module = module_of(ROOT / "tools" / "mutants.py")
    monkeypatch.setattr(module, "ROOT", tmp_path)
    monkeypatch.setattr(module, "KEPT", tmp_path / "out")
    return module


def test_changes_of_a_file(tool, tmp_path: Path) -> None:
    """Code that decides is changed; messages, annotations and what a module holds are not, and each change compiles."""
    path = tmp_path / "module.py"
    path.write_text(CODE, encoding="utf-8")
    found = tool.mutants(path)
    assert {(mutant.line, mutant.old, mutant.new) for mutant in found} == {
        (6, "2", "3"),
        (8, "value < low", "(value <= low)"),
        (8, "value < low and not LIMIT", "(value < low or not LIMIT)"),
        (8, "value < low and not LIMIT", "(value < low)"),
        (8, "not LIMIT", "(LIMIT)"),
        (10, "pow(value, low)", "pow(low, value)"),
        (11, "max(value, low)", "min(value, low)"),
        (11, "max(value, low) - list(zip([1], strict=True))[0]", "(max(value, low) + list(zip([1], strict=True))[0])"),
        (11, "max(value, low) - list(zip([1], strict=True))[0]", "(max(value, low))"),
        (11, "0", "1"),
        (11, "1", "2"),
    }
    assert {mutant.function for mutant in found} == {"clipped"}
    for mutant in found:
        ast.parse(mutant.text(path.read_bytes()))


def test_a_run(tool, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Killed is what a test notices, or what cannot be imported; what no test runs has no test. The files stay as they
    are.
    """
    source = tmp_path / "src" / "lidarscene" / "room" / "module.py"
    source.parent.mkdir(parents=True)
    source.write_text(
        "def tens():\n    return 10\n\n\ndef held():\n    return 1\n\n\ndef idle():\n    return 4\n"
        "\n\ndef first():\n    return [1][0]\n\n\nFIRST = first()\n"
    )
    test = tmp_path / "test_module.py"
    test.write_text(
        "import sys\nsys.path.insert(0, 'src/lidarscene/room')\nimport module\n\n\n"
        "def test_held():\n    assert module.held() == module.FIRST == 1\n\n\n"
        "def test_tens():\n    assert module.tens() > 9\n"
    )
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    for command in (["init", "-q"], ["add", "."]):
        subprocess.run(["git", *command], cwd=tmp_path, check=True)
    (tmp_path / "out" / "map").mkdir(parents=True)
    name = "src/lidarscene/room/module.py"
    (tmp_path / "out" / "map" / "1.jsonl").write_text(
        f'["test_module.py::test_held", 0.1, ["{name}:held", "{name}:first"]]\n'
        f'["test_module.py::test_tens", 0.1, ["{name}:tens"]]\n'
    )
    for variable, value in FEW_PLUGINS.items():
        monkeypatch.setenv(variable, value)
    tool.run([str(source)], 10, seed=1, jobs=2, limit_s=100)
    printed = capsys.readouterr().out
    assert f"survived: {name}:2 tens\n    -    return 10\n    +    return 11\n" in printed
    assert f"no test: {name}:10 idle\n" in printed
    assert printed.endswith("| room | 5 | 3 | 1 | 0 | 1 |\n| all | 5 | 3 | 1 | 0 | 1 |\n")
    assert "return 10" in source.read_text()
