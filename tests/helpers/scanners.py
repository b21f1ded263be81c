"""One scanner of each kind, as a sensor file would make it."""

import dataclasses
import math
from collections.abc import Callable
from functools import partial
from typing import Any, get_args

import numpy as np

from lidarscene import scan
from lidarscene.maths.arrays import Numbers
from lidarscene.scan.base import Scanner

PI = math.pi
DEG = math.pi / 180.0

VLP16_FIRING_ORDER_DEG = (-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15)
VLP16_HEIGHT_MM = (11.2, -0.7, 9.7, -2.2, 8.1, -3.7, 6.6, -5.1, 5.1, -6.6, 3.7, -8.1, 2.2, -9.7, 0.7, -11.2)
"""The user manual has those of lasers 7 to 15; the others by their symmetry."""


def part(kind: Any, numbers: dict[str, Any]) -> Any:
    """Take those of a part of a scanner out of flat numbers."""
    names = {field.name for field in dataclasses.fields(kind)} & numbers.keys()
    return kind(**{name: numbers.pop(name) for name in names})


def vlp16(**changes: Any) -> scan.Spinning:
    """VLP-16 user manual 63-9243: a laser every 2.304 us, a cycle every 55.296 us."""
    numbers: dict[str, Any] = {
        "rotation_hz": -10.0,
        "cycle_s": 55.296e-6,
        "cycles_per_turn": None,
        "elevation_rad": [e * DEG for e in VLP16_FIRING_ORDER_DEG],
        "azimuth_rad": [0.0] * 16,
        "firing_s": [2.304e-6 * n for n in range(16)],
        "start_m": ([0.0] * 16, [0.0] * 16, [1e-3 * h for h in VLP16_HEIGHT_MM]),
    }
    numbers |= changes
    return scan.Spinning.create(bank=part(scan.Bank, numbers), **numbers)


def encoder_clocked() -> scan.Spinning:
    """Lasers in no order, fired in groups of two, clocked by the encoder."""
    return scan.Spinning.create(
        rotation_hz=20.0,
        cycle_s=None,
        cycles_per_turn=1024,
        bank=scan.Bank(
            elevation_rad=[0.1, 0.05, -0.05, -0.1],
            azimuth_rad=[0.05, -0.02, 0.02, -0.05],
            firing_s=[3e-6, 0.0, 3e-6, 0.0],
        ),
        sweep=scan.AzimuthSweep(start_azimuth_rad=PI),
    )


def gimbal(**changes: Any) -> scan.Gimbal:
    numbers: dict[str, Any] = {"incidence_rad": 0.6, "side": "below", "outer": "elevation"}
    return scan.Gimbal(**(numbers | changes))


def mirror(**changes: Any) -> scan.MirrorRaster:
    numbers: dict[str, Any] = {
        "columns": 120,
        "rows": 41,
        "mirrors": gimbal(),
        "fast_turn_rad": 15 * DEG,
        "slow_turn_rad": 6 * DEG,
        "rate_hz": 100e3,
        "line_duty": 0.8,
        "frame_duty": 0.9,
    }
    return scan.MirrorRaster(**(numbers | changes))


def lissajous(**changes: Any) -> scan.Lissajous:
    numbers: dict[str, Any] = {
        "rate_hz": 200e3,
        "frame_hz": 10.0,
        "mirrors": gimbal(incidence_rad=0.3, side="left"),
        "azimuth": scan.Swing(frequency_hz=1310.0, phase_rad=0.3, turn_rad=12 * DEG),
        "elevation": scan.Swing(frequency_hz=1190.0, phase_rad=1.2, turn_rad=8 * DEG),
    }
    return scan.Lissajous.create(**(numbers | changes))


def polygon(**changes: Any) -> scan.Polygon:
    numbers: dict[str, Any] = {
        "rate_hz": 150e3,
        "rotation_hz": 30.0,
        "tilt_rad": [-4 * DEG, -1 * DEG, 2 * DEG, 5 * DEG],
        "duty": 0.6,
        "incidence_rad": 40 * DEG,
        "side": "left",
        "inradius_m": 0.03,
        "lens_radius_m": 0.012,
    }
    numbers |= changes
    return scan.Polygon.create(facets=part(scan.Facets, numbers), **numbers)


def mid40(**changes: Any) -> scan.Risley:
    """HELIOS++'s prisms for the Livox Mid-40; 100 000 points per second."""
    numbers: dict[str, Any] = {
        "rate_hz": 100e3,
        "frame_hz": 10.0,
        "angle_rad": [18.7481 * DEG, 17.9634 * DEG],
        "index": [1.51, 1.51],
        "rotation_hz": [-121.5657, 77.7430],
        "phase_rad": [0.0, 0.0],
        "tilted": ["out", "in"],
    }
    numbers |= changes
    lists = {name: numbers.pop(name) for name in ("angle_rad", "index", "rotation_hz", "phase_rad", "tilted")}
    wedges = [
        scan.Wedge.create(rate_hz=numbers["rate_hz"], **dict(zip(lists, values, strict=True)))
        for values in zip(*lists.values(), strict=True)
    ]
    return scan.Risley.create(wedges=wedges, **numbers)


def mirror_behind_prisms() -> scan.Risley:
    """A scanner as the Livox Mid-360, with a second prism."""
    turning = scan.TurningMirror.create(rate_hz=100e3, tilt_rad=0.97, rotation_hz=-182.4, phase_rad=0.4)
    return mid40(beam_elevation_rad=[-0.02, 0.0, 0.03], mirror=turning)


def six_beams() -> scan.Risley:
    """Several lasers before the prisms, as the Livox Avia has them."""
    return mid40(tilted=["in", "in"], beam_elevation_rad=[e * DEG for e in (-3.0, -1.8, -0.6, 0.6, 1.8, 3.0)])


def three_wedges() -> scan.Risley:
    return mid40(
        angle_rad=[0.1, 0.12, 0.08],
        index=[1.5, 1.51, 1.6],
        rotation_hz=[100.3, -70.1, 11.7],
        phase_rad=[0.1, 0.2, 0.3],
        tilted=["in", "out", "in"],
    )


def flash(**changes: Any) -> scan.Flash:
    numbers: dict[str, Any] = {"columns": 61, "rows": 41, "pitch": 0.02, "frame_rate_hz": 25.0}
    return scan.Flash(**(numbers | changes))


def pattern(**changes: Any) -> scan.Pattern:
    t = np.linspace(0.0, 0.05, 5000, endpoint=False)
    numbers: dict[str, Any] = {
        "azimuth_rad": 0.5 * np.cos(2 * PI * 100 * t),
        "elevation_rad": 0.3 * np.sin(2 * PI * 60 * t),
        "time_s": t,
        "channel": np.arange(5000) % 3,
        "frame_s": 0.05,
    }
    return scan.Pattern.create(**(numbers | changes))


def raster(**changes: Any) -> scan.Raster:
    numbers: dict[str, Any] = {
        "columns": 101,
        "rows": 21,
        "azimuth_step_rad": 0.01,
        "elevation_step_rad": 0.02,
        "rate_hz": 50e3,
    }
    return scan.Raster(**(numbers | changes))


ALL: dict[str, Callable[[], Any]] = {
    "raster": raster,
    "vlp16": vlp16,
    "encoder_clocked": encoder_clocked,
    "sweeping": lambda: vlp16(
        cycle_s=None, cycles_per_turn=360, sweep=scan.AzimuthSweep(start_azimuth_rad=1.0, sweep_rad=2.0, frame_hz=25.0)
    ),
    "mirror_step": mirror,
    "mirror_sine_ramp": lambda: mirror(waveform="sine", slow="ramp", fast="elevation"),
    "mirror_triangle_pair": lambda: mirror(waveform="triangle", mirrors=scan.MirrorPair(last="elevation")),
    "mirror_round": lambda: mirror(mirrors=gimbal(mirror_radius_m=0.006, lens_radius_m=0.005)),
    "lissajous": lissajous,
    "lissajous_pair": lambda: lissajous(mirrors=scan.MirrorPair(last="azimuth")),
    "polygon": polygon,
    "polygon_backwards": lambda: polygon(rotation_hz=-30.0, side="right", inradius_m=None),
    "mid40": mid40,
    "six_beams": six_beams,
    "three_wedges": three_wedges,
    "mirror_behind_prisms": mirror_behind_prisms,
    "flash": flash,
    "flash_in_groups": lambda: flash(rows_at_once=4, row_step_s=1e-3, first_row="bottom"),
    **{
        f"flash_{name}": partial(flash, projection=name, falloff="pupil_and_pixel")
        for name in ("equidistant", "equisolid", "stereographic", "orthographic")
    },
    "pattern": pattern,
}


KINDS = [get_args(table.model_fields["type"].annotation)[0] for table in get_args(scan.AnyScannerFile)]
"""Values of `type` in a sensor file."""


def frame(scanner: Scanner) -> Numbers:
    """All pulse numbers of a frame."""
    return np.arange(scanner.pulses, dtype=np.uint32)


PULSES = np.array([0, 1, 17, 130, 1201, 2077, 2400, 2999], dtype=np.uint32)
"""Some of a frame."""


def directions(scanner: Scanner, pulse: Numbers) -> Numbers:
    """(n, 3) of these pulses."""
    return np.stack(np.broadcast_arrays(*scanner.direction(pulse)), axis=1)


def shares(scanner: Scanner, pulse: Numbers) -> Numbers:
    """(n,) shares of the aperture."""
    return np.broadcast_to(scanner.aperture_share(pulse), len(pulse))
