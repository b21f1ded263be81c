"""Numbers of the guides: counts, defaults and limits against the code's own constants, and what a short sum gives."""

import ast
import math
import re
from typing import Any, get_args

import numpy as np
import pytest
from helpers.documentation import PLAIN, README, ROOT, blocks, prose, says, table, text_of
from helpers.models import MODELS
from helpers.page_numbers import default

from lidarscene import catalog, load_sensor
from lidarscene.detection.outcomes import Outcome
from lidarscene.formats import e57, las, osi, ply
from lidarscene.kernel.world.mitsuba_world import build_world
from lidarscene.physics import eye_safety
from lidarscene.physics.electronics import sipm
from lidarscene.physics.optics import sunlight
from lidarscene.sensor import readout
from lidarscene.sensor.electronics import MOST_STOPS
from lidarscene.studies.compare import cloud_matching
from lidarscene.studies.field_of_view import study_options
from lidarscene.studies.ranging.plane import RangeStatus, Target

pytestmark = pytest.mark.fixed_streams


def test_words_and_defaults_of_range() -> None:
    words = [
        (int(status), word.upper().split(" ")[0] or "FOUND") for status, word, *_ in table("range.md", "status | word")
    ]
    assert words == [(status, status.name.split("_")[0]) for status in RangeStatus]
    options = {"illuminance-klux": "illuminance_klux", "reflectivity": "reflectivity", "transmittance": "transmittance"}
    for option, name in options.items():
        assert default("range", f"--{option}") == getattr(Target(), name)


def test_default_times_of_fov() -> None:
    assert re.findall(r"\| time \(s\) \| (.*) \|", prose(README.parent / "docs" / "fov.md")) == [
        " | ".join(f"{t:.1f}" for t in study_options.TIMES_S)
    ]


# --- counts -----------------------------------------------------------------------------------------


def test_conventions() -> None:
    rows = table("conventions.md", "value | outcome")
    assert [(int(row[0]), row[1].upper().replace(" ", "_")) for row in rows] == [(o, o.name) for o in Outcome]
    says("conventions.md", "(`comment lidarscene {}`)", float(ply.VERSION_LINE.split()[1]))
    says("sensor_files.md", "the shortest range, {} ns for each metre", 2e9 / 299_792_458.0)
    says("sensor_files.md", '`"all"` is the first {}, without `stops`', MOST_STOPS)
    says("sensor_files.md", "4 us is {} m for a weak one", 0.5 * 4e-6 * 299_792_458.0)
    says("sensor_files.md", "to {} in four", readout.MOST_SAMPLES)
    says("sensor_files.md", "for eye safety; up to {} it is a point", 1e3 * eye_safety.SMALLEST_SOURCE_RAD)


def test_formats() -> None:
    says("formats.md", "steps of {} um, {} km around the sensor", 1e6 * las.STEP_M, 1e-3 * las.REACH_M)
    says("formats.md", "all, exact, infinity as {}", float(e57.LARGEST))
    says("formats.md", "OSI {}, with a", float(f"{osi.VERSION[0]}.{osi.VERSION[1]}"))


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
