"""A machine without LLVM: one error with what to type, exit code 3, nothing written; and a report of doctor.

What traces no rays needs none.
"""

from pathlib import Path

import pytest
from helpers.child import assert_ended
from helpers.run_seed import chosen

RUN = """
import sys
from lidarscene.cli.main import main
from lidarscene.kernel.device import llvm
for place in ("environment", "wheel", "system"):
    setattr(llvm, "_in_" + place, lambda: iter({found}))
sys.exit(main({argv}))
"""
MACHINES = {
    "no library at all": (None, [], "no LLVM library found; try: "),
    "a path to nothing": ("/nowhere/libLLVM.so", [], "=/nowhere/libLLVM.so: no such file; try: "),
    "only an old one": (None, ["{folder}/libLLVM-15.so.1"], "no LLVM 17 or newer found; try: "),
}


@pytest.fixture
def lidarscene(machine: str, run_python, tmp_path):
    """The command line on such a machine in a process of its own, and what it must tell."""
    path, libraries, message = MACHINES[machine]
    libraries = [name.format(folder=tmp_path) for name in libraries]
    for name in libraries:
        open(name, "w").close()

    def run_lidarscene(*argv: str):
        code = RUN.format(found=libraries, argv=argv)
        return run_python(code, DRJIT_LIBLLVM_PATH=path, LIDARSCENE_VARIANT=None, CUDA_VISIBLE_DEVICES="")

    return run_lidarscene, message


@pytest.mark.parametrize("machine", ["only an old one"])
def test_render_is_one_error(lidarscene, wall: str, tmp_path) -> None:
    run, message = lidarscene
    ran = run("render", str(tmp_path / wall), "-o", str(tmp_path / "new" / "out.ply"))
    assert_ended(ran, 3, stdout="", stderr=None)
    assert ran.stderr.startswith("lidarscene: error: no usable Mitsuba back end\n")
    assert ran.stderr.count(message) == 1
    assert "Traceback" not in ran.stderr
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("machine", chosen(1, list(MACHINES)))
def test_doctor_reports(lidarscene) -> None:
    """Here what is told of each machine, by the lines that `render` ends with too."""
    run, message = lidarscene
    ran = run("doctor")
    assert_ended(ran, 1)
    assert message in ran.stdout
    assert ran.stdout.endswith("lidarscene cannot trace rays here\n")


STUDIES = """
import sys
from lidarscene import load_sensor
from lidarscene.studies.ranging import plane

def print_loaded(*names):
    print([name for name in names if name in sys.modules])

print(round(plane.maximum_range_m(load_sensor("table1-apd"), plane.Target())[0], 3))
print_loaded("mitsuba", "drjit", "matplotlib")
sys.path.append(TESTS)
import pytest
from helpers import in_this_process, paper_results
from lidarscene.cli.main import main
patch = pytest.MonkeyPatch()
in_this_process.draw_nothing(patch)
paper_results.use(patch, paper_results.results())
for command in (
    "range table1-apd table1-sipm --over illuminance_klux --plot o.png -q",
    "fov table1-apd table1-sipm -o fov --set=scanner.azimuth_step_deg=2 --time 0.001 --cell 2 -q",
    "paper -o paper -q",
):
    assert main(command.split()) == 0
print_loaded("mitsuba", "drjit", "lidarscene.kernel")
"""


def test_studies_load_no_back_end(run_python, tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    code = STUDIES.replace("TESTS", repr(str(Path(__file__).parents[1])))
    ran = run_python(code, LIDARSCENE_VARIANT="nonsense", DRJIT_LIBLLVM_PATH="/nowhere/libLLVM.so")
    assert_ended(ran, stdout="350.605\n[]\n[]\n")
    assert {path.name for path in tmp_path.iterdir()} == {"o.png", "fov", "paper"}
