"""What a newcomer adds is one module and one line: a scanner, a weather, a column, a format, all in one copy.

A detector has a test of its own (`tests/sensor/detectors/test_new_detector.py`).
"""

import numpy as np
import pytest
from helpers.newcomer import changed_sources, command_lines

from lidarscene.formats.cloud_columns import DTYPES

SPIRAL = '''"""Spiral scanner: the beam goes round, farther from the axis with each turn."""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from ..maths.arrays import Lanes, xp
from ..maths.units import Quantity
from .base import GivenAngles
from .clock import PulseClock
from .scanner_file import ScannerFile


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spiral(GivenAngles):
    """From the axis to the rim, at a constant rate."""

    rate_hz: float
    pulses: Annotated[int, Quantity(ge=1, le=2**24, about="of one spiral")]
    turns: Annotated[float, Quantity(gt=0, le=1e4, about="from the axis to the rim")]
    rim_rad: Annotated[Lanes, Quantity("deg", gt=0, le=80, about="largest angle to the axis")]

    @property
    def frame_s(self) -> float:
        return self.pulses / self.rate_hz

    def _mechanism(self, pulse: Lanes) -> tuple[Lanes, Lanes]:
        ops = xp(pulse)
        share = ops.float32(pulse % self.pulses) / self.pulses
        angle = 2.0 * np.pi * self.turns * share
        return self.rim_rad * share * ops.cos(angle), self.rim_rad * share * ops.sin(angle)

    @property
    def clock(self) -> PulseClock:
        return PulseClock(rate_hz=self.rate_hz)


class SpiralFile(ScannerFile[Spiral]):
    """[scanner] type = "spiral"."""

    type: Literal["spiral"]
'''
XYZ = '''"""Lines of x, y, z and intensity."""

import numpy as np

from ..files.atomic import atomic_output


def write_xyz(path, cloud):
    with atomic_output(path) as temporary:
        np.savetxt(temporary, np.column_stack([cloud.xyz_m, cloud.column("intensity")]), fmt="%.9g")
'''
DUST = """    dust_per_km: Annotated[
        float, Quantity(ge=0, le=100, about="extinction of dust"), Slider("dust", "1/km", 0.0, 20.0)
    ] = 0.0

    def _dust(self) -> Medium | None:
        extinction = 1e-3 * self.dust_per_km
        dust = Medium(name="dust", extinction_per_m=extinction, backscatter_per_m_sr=extinction / 45.0)
        return dust if extinction else None

"""
XYZ_LINE = """    "xyz": Format(suffix=".xyz", columns="`intensity`", **_functions("xyz", "write")),
"""
PULSE = """    pulse: Annotated[Measured, Column("pulse", "uint32", "1", "number of the pulse in the frame")]
""" + "".join(
    f'    as_{dtype}: Annotated[Measured, Column("as_{dtype}", "{dtype}", "1", "last digits of it")]\n'
    for dtype in DTYPES
)
MADE = "".join(f'        "as_{dtype}": of_pulse & 127,\n' for dtype in DTYPES) + '        "pulse": of_pulse,\n'
NEW = {"scan/spiral.py": SPIRAL, "formats/xyz.py": XYZ}
LINES = (
    ("scan/__init__.py", "AnyScannerFile = (", "from .spiral import SpiralFile\n\nAnyScannerFile = SpiralFile | ("),
    ("formats/registry.py", '    "npz": Format(', XYZ_LINE + '    "npz": Format('),
    ("scene/weather.py", "    def extinction_at_per_m(", DUST + "    def extinction_at_per_m("),
    ("scene/weather.py", "media = (", "media = (self._dust(), "),
    ("formats/cloud_columns.py", "    true_range_m:", PULSE + "    true_range_m:"),
    ("kernel/rays/point_columns.py", '        "channel": ', MADE + '        "channel": '),
)
SENSOR = """
name = "spiral"
laser = {wavelength_nm = 905, peak_power_w = 450, pulse_fwhm_ns = 6, repetition_rate_khz = 50}
optics = {aperture_radius_mm = 25, focal_length_mm = 30, efficiency_laser = 0.7, efficiency_sun = 0.8, \
sun_irradiance_w_m2 = 29.4}
tdc = {window_us = 4, bandwidth_mhz = 167, threshold_to_noise = 5}
detector = {type = "apd", radius_mm = 0.1, quantum_efficiency = 0.7, circuit_noise_na = 20, gain = 100, \
excess_noise_index = 0.3, surface_dark_current_na = 5, bulk_dark_current_na = 1, load_resistance_ohm = 1000}
scanner = {type = "spiral", pulses = 6000, turns = 40, rim_deg = 30}
"""


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    folder = tmp_path_factory.mktemp("newcomer")
    run = changed_sources(folder, new=NEW, lines=LINES, docs=True)
    (folder / "spiral.toml").write_text(SENSOR, encoding="utf-8")
    return folder, run


RENDER = """
from lidarscene import PointCloud, load_scene, render
from lidarscene.errors import LidarSceneError
from lidarscene.formats.registry import FORMATS
from lidarscene.rendering.render_options import FrameOptions
from lidarscene.view.live_conditions import controls

cloud = render("car", "spiral.toml", seed=1)
for name, one in FORMATS.items():
    try:
        one.require()
    except LidarSceneError:
        continue
    cloud.save(f"{name}{one.suffix}", format=name)
    for options in ({}, {"ascii": True})[: 1 + one.text] if one.read else ():
        cloud.save(f"{name}{one.suffix}", format=name, **options)
        read = PointCloud.load(f"{name}{one.suffix}", format=name)
        for column in cloud.columns[3:]:
            values = read.column(column.name)
            assert values.dtype == column.dtype and (values == cloud.column(column.name)).all(), (name, column.name)
assert len(cloud) > 1000 and (cloud.pulse[1:] > cloud.pulse[:-1]).all()
dusty = render(load_scene("car", overrides={"weather.dust_per_km": 20}), "spiral.toml", seed=1)
assert (dusty.status == 3).sum() > 100 and "dust" in dusty.class_names
print([control.label for control in controls(load_scene("car"), FrameOptions())])
"""


def test_all_four_go_through_every_format_and_the_page(copy):
    folder, run = copy
    checked, _, printed = command_lines(run, "check spiral.toml", "render car -o a.xyz --sensor spiral.toml", RENDER)
    assert "spiral" in checked
    assert "'dust'" in printed
    assert np.loadtxt(folder / "xyz.xyz").shape[1] == 4


def test_the_documentation_writes_itself(copy):
    folder, run = copy
    run("-c", "import runpy; runpy.run_path('tests/docs/test_docs.py')['refresh_tables']()")
    rows = {
        "conventions": "| `pulse` | uint32 | 1 | number of the pulse in the frame |",
        "formats": "| `xyz` | `.xyz` |",
        "scene_files": "| `dust_per_km` | `0.0` | 0 to 100 | extinction of dust |",
        "scanners": "| `rim_deg` | required | above 0 to 80 | largest angle to the axis |",
    }
    for page, row in rows.items():
        assert row in (folder / "docs" / f"{page}.md").read_text(encoding="utf-8")
