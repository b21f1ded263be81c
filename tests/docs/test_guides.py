"""Numbers of the guides: counts, defaults and limits against the code's own constants, and what a short sum gives."""

import argparse
import ast
import math
import re
from typing import Any, get_args

import numpy as np
import pytest
from helpers.documentation import PLAIN, README, ROOT, blocks, prose, says, table, text_of
from helpers.models import MODELS

from lidarscene import catalog, load_sensor
from lidarscene.cli import main
from lidarscene.cloud.thinning import FACTOR, MOST_POINTS
from lidarscene.detection.outcomes import Outcome, Status
from lidarscene.formats import e57, las, osi, ply
from lidarscene.formats.cloud_columns import columns_of
from lidarscene.kernel.rays import trace
from lidarscene.kernel.world.mitsuba_world import build_world
from lidarscene.labels import files
from lidarscene.outputs import range_image
from lidarscene.physics import eye_safety
from lidarscene.physics.electronics import sipm
from lidarscene.physics.optics import sunlight
from lidarscene.sensor import readout
from lidarscene.sensor.electronics import MOST_STOPS
from lidarscene.studies.compare import cloud_matching
from lidarscene.studies.eye_safety.eye_safety_report import TIME_BASE_S
from lidarscene.studies.field_of_view import pattern_coverage, study_options
from lidarscene.studies.ranging.plane import RangeStatus, Target

pytestmark = pytest.mark.fixed_streams

# --- the command line -------------------------------------------------------------------------------


def options(command: str) -> dict[str, argparse.Action]:
    """The options of one command by name."""
    (chosen,) = [a for a in main._parser()._actions if isinstance(a, argparse._SubParsersAction)]
    return {name: action for action in chosen.choices[command]._actions for name in action.option_strings}


def default(command: str, option: str) -> float:
    """Default of an option, as `-h` says."""
    action = options(command)[option]
    (default_text,) = re.findall(r"default:? (-?\d+(?:\.\d+)?)", action.help or "")
    assert action.default in (None, float(default_text))
    return float(default_text)


def test_defaults_of_range() -> None:
    distance, klux, rho, tau = (
        default("range", f"--{name}") for name in ("distance", "illuminance-klux", "reflectivity", "transmittance")
    )
    says("range.md", "SNR and P_d at `--distance` ({} m)", distance)
    says("range.md", "`--to`, `--n` ({}), and `--scale`", default("range", "--n"))
    target = Target()
    assert (target.illuminance_klux, target.reflectivity, target.transmittance) == (klux, rho, tau)
    words = [
        (int(status), word.upper().split(" ")[0] or "FOUND") for status, word, *_ in table("range.md", "status | word")
    ]
    assert words == [(status, status.name.split("_")[0]) for status in RangeStatus]


def test_defaults_of_fov() -> None:
    says(
        "fov.md",
        "`--reflectivity` ({}) and `--illuminance-klux` ({} klux) describe",
        default("fov", "--reflectivity"),
        default("fov", "--illuminance-klux"),
    )
    says("fov.md", "Pulses of {} times the longest time count", pattern_coverage.LONG)
    (row,) = [r for r in table("fov.md", "time (s)") if r[0].startswith("lidarscene")]
    assert len(row) == len(study_options.TIMES_S) + 1
    assert re.findall(r"\| time \(s\) \| (.*) \|", prose(README.parent / "docs" / "fov.md")) == [
        " | ".join(f"{t:.1f}" for t in study_options.TIMES_S)
    ]


def test_defaults_of_render_and_batch() -> None:
    says("limits.md", "through at most {} panes and mirrors unless", default("render", "--interactions"))
    assert default("render", "--interactions") == trace.INTERACTIONS
    says("motion.md", "The first frame begins at `--begin` ({})", default("render", "--begin"))
    says("view.md", "(`--seed`, default {})", default("view", "--seed"))
    from lidarscene.batch import dispatch, work
    from lidarscene.cli.batch import MOST_LINES

    says("clusters.md", "on the error stream (the first {})", MOST_LINES)
    says("clusters.md", "keeps its last {} compiled worlds", work.CACHED)
    assert dispatch.BUNDLE_S == 1.0  # "frames of less than a second are given out several at a time"
    # The file above it: scenes, sensors, frames, seeds, trajectories, and three keys that are swept.
    lists = (2, 2, 10, 2, 2, 2, 2, 2)
    says("batch.md", "Those are " + " x ".join(["{}"] * 8) + " = {} frames", *lists, math.prod(lists))


# --- counts -----------------------------------------------------------------------------------------


def test_conventions() -> None:
    says(
        "conventions.md",
        "(`detection.outcomes.Status`): {} echo, {} false alarm, {} another lidar's pulse, {} light of fog",
        Status.ECHO,
        Status.FALSE_ALARM,
        Status.INTERFERENCE,
        Status.WEATHER,
    )
    says(
        "first_cloud.md",
        "| `status` | {} echo, {} false alarm, {} another lidar's pulse, {} fog",
        Status.ECHO,
        Status.FALSE_ALARM,
        Status.INTERFERENCE,
        Status.WEATHER,
    )
    rows = table("conventions.md", "value | outcome")
    assert [(int(row[0]), row[1].upper().replace(" ", "_")) for row in rows] == [(o, o.name) for o in Outcome]
    says("conventions.md", "(where infinity is {})", float(ply.LARGEST))
    says("conventions.md", "(`comment lidarscene {}`)", float(ply.VERSION_LINE.split()[1]))
    says("sensor_files.md", "the shortest range, {} ns for each metre", 2e9 / 299_792_458.0)
    says("sensor_files.md", '`"all"` is the first {}, without `stops`', MOST_STOPS)
    says("sensor_files.md", "4 us is {} m for a weak one", 0.5 * 4e-6 * 299_792_458.0)
    says("sensor_files.md", "to {} in four", readout.MOST_SAMPLES)
    says("sensor_files.md", "for eye safety; up to {} it is a point", 1e3 * eye_safety.SMALLEST_SOURCE_RAD)


def test_formats() -> None:
    says("formats.md", "steps of {} um, {} km around the sensor", 1e6 * las.STEP_M, 1e-3 * las.REACH_M)
    says("formats.md", "all, exact, infinity as {}", float(e57.LARGEST))
    says(
        "formats.md",
        "A picture of more than {} million points shows every {}rd, {}th",
        MOST_POINTS / 2**20,
        FACTOR,
        FACTOR**2,
    )
    says("formats.md", "OSI {}, with a", float(f"{osi.VERSION[0]}.{osi.VERSION[1]}"))
    says(
        "formats.md",
        "in steps of {} cm up to {} m",
        100.0 * range_image.RANGE_STEP_M,
        (2**16 - 1) * range_image.RANGE_STEP_M,
    )
    shares = sorted(100.0 * share for share, _ in files.VISIBILITY)[1:]
    says("formats.md", "bins are below {}, {}, {} percent", *shares)
    says("formats.md", "`occluded` is {} from {} percent, {} from {}", 0, shares[2], 1, shares[0])
    size = sum(np.dtype(c.dtype).itemsize for c in columns_of(truth=True, vectors=False))
    says("formats.md", "some {} bytes per point or more", 10.0 * round(size / 10.0))


def test_numbers_in_equations() -> None:
    says("theory.md", "\\beta = {}^\\circ", math.degrees(sunlight.SUN_RADIUS_RAD))
    assert pytest.approx(0.797, abs=5e-4) == sipm.MOST_TELLING_SHARE
    assert pytest.approx(1 / 20) == cloud_matching.LEAST_SHARED  # "a twentieth of its pulses"


# --- sensors ----------------------------------------------------------------------------------------


def test_sensors() -> None:
    documented_names = re.findall(r"`([\w-]+)`", " ".join(row[0] for row in table("sensors.md", "name | exact")))
    assert sorted(documented_names) == catalog.names("sensors")
    os1 = load_sensor("os1-128").scanner
    says("sensors.md", "`os1-128-rev7` | {} beams at once, {} columns", os1.lasers, os1.cycles)


def test_one_laser_at_a_time() -> None:
    scanner = load_sensor("hdl-32e").scanner
    (step_us,) = np.unique(np.round(1e6 * np.diff(np.sort(scanner.firing_s)), 6))
    says("sensors.md", "one laser at a time every {} us", step_us)
    fields = {
        "livox-mid-40": "speeds of HELIOS++, {} degrees for 38.4",
        "livox-avia": "six beams of HELIOS++, {} x {} degrees for 70.4 x 77.2",
        "livox-horizon": "fitted to the field of {} x {} degrees",
    }
    for name, words in fields.items():
        scanner = load_sensor(name).scanner
        angles = scanner.angles(np.arange(10 * scanner.pulses, dtype=np.uint32))
        across = np.degrees([np.ptp(np.asarray(angle)) for angle in angles])
        says("sensors.md", words, *(pytest.approx(a, abs=0.2) for a in across[: words.count("{}")]))


# --- eye safety -------------------------------------------------------------------------------------


def test_eye_safety() -> None:
    says("eye_safety.md", "The time base is {} s (4.3 e", TIME_BASE_S)
    for nm, ti in ((1050, 5e-6), (1400, 13e-6)):
        assert eye_safety.grouping_time_s(wavelength_m=1e-9 * (nm - 1)) == ti
    says("eye_safety.md", "| T_i | {} us up to {} nm, {} us up to {} nm |", 5, 1050, 13, 1400)
    says(
        "eye_safety.md",
        "Wavelengths outside {} to {} nm are refused",
        1e9 * eye_safety.RETINA_M[0],
        1e9 * eye_safety.LONGEST_WAVELENGTH_M,
    )
    energy = eye_safety.class_1_energy_j
    for nm, cells in (
        (905, "| 400-1050 | {} C6 below 10 ps | {} C4 C6 below 5 us | {} t^0.75 C4 C6 below T2 |"),
        (1064, "| 1050-1400 | {} C6 C7 below 10 ps | {} C6 C7 below 13 us | {} t^0.75 C6 C7 below T2 |"),
    ):
        c4 = eye_safety.c4(wavelength_m=1e-9 * nm)
        energy_by_duration = {
            t: energy(wavelength_m=1e-9 * nm, duration_s=t, source_rad=0.0) for t in (5e-12, 1e-6, 1e-2)
        }
        first = energy_by_duration[5e-12]
        says(
            "eye_safety.md",
            cells,
            first,
            energy_by_duration[1e-6] / (c4 if nm == 905 else 1.0),
            energy_by_duration[1e-2] / 1e-2**0.75 / (c4 if nm == 905 else 1.0),
        )


def test_every_choice_of_fog_is_named() -> None:
    kinds = MODELS["WeatherFile"].model_fields["fog"].annotation
    documented_kinds = re.findall(r'fog = "(\w+)"` \|', text_of(README.parent / "docs" / "weather.md"))
    assert set(documented_kinds) == set(get_args(get_args(kinds)[0]))


UNITS = {"ps": 1e-12, "ns": 1e-9, "us": 1e-6, "ms": 1e-3, "nm": 1e-9, "mrad": 1e-3, "mm": 1e-3}


@pytest.mark.parametrize("header", ["nm | shortest", "factor |", "viewer |"])
def test_limits_of_the_standard(header: str) -> None:
    """Every constant of the three tables stands in the module that computes with them, in its units."""
    source = (ROOT / "src" / "lidarscene" / "physics" / "eye_safety.py").read_text(encoding="utf-8")
    tree = ast.walk(ast.parse(source))
    written = {node.value for node in tree if isinstance(node, ast.Constant) and isinstance(node.value, int | float)}
    assert math.isclose((5e-3 / 0.2) ** 2, 625e-6)  # where alpha_max begins to grow
    for row in table("eye_safety.md", header):
        cells = re.sub(r"625 us|\(3/8\)|10 \* ", "", " ".join(row[1:]))
        for number, unit in re.findall(rf"(?<![\w.^])({PLAIN}) ?(ps|ns|us|ms|nm|mrad|mm)?\b", cells):
            limit = float(number) * UNITS.get(unit, 1.0)
            scales = (1.0, 1e-9, 1e-3) if not unit or unit == "nm" else (1.0,)
            near = any(math.isclose(limit * k, w) or math.isclose(float(number), w) for k in scales for w in written)
            assert near, f"{number} {unit} of {row[0]}"


def test_the_recipe_of_many_sensors_compiles_its_scene_once(mi: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    del mi
    (block,) = [block for block in blocks(ROOT / "docs" / "recipes.md", "python") if "world=world" in block.code]
    compiled = []

    def counted(*arguments: Any, **options: Any) -> Any:
        compiled.append(arguments)
        return build_world(*arguments, **options)

    monkeypatch.setattr("lidarscene.rendering.simulator.build_world", counted)
    exec(block.code, {"__name__": "documentation"})
    assert len(compiled) == 1
