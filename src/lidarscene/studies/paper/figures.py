"""Figures 4(e), 5 and 6 of the paper, computed: charts, and the columns of their CSV files.

Solid curves are the formulas as printed. Dashed ones are the derived formulas, where the difference is visible.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...figures.lines import Chart, Level, Line, Mark
from ...figures.report import Figure
from ...maths.arrays import Numbers
from ...physics.electronics import apd, sipm
from ...sensor.sensor_model import Sensor
from ..ranging import aperture_laws, plane
from ..ranging.plane import Target
from .case import TABLE_1, apd_lidar, apd_noise, range_m, sipm_printed, sipm_steady

_DEAD_TIME_S, _DARK_HZ = 6e-9, 2007.0
"""Source: Table 1 of the paper; dead time and dark counts of a cell."""


def figures() -> list[Figure]:
    """All of them, in the paper's order."""
    return [fig_4e(), fig_5a(), fig_5b(), fig_5c(), fig_6a(), fig_6b(), fig_6c()]


def _figure(number: str, caption: str, lines: Sequence[Line], first: str, **chart: Any) -> Figure:
    """A figure whose CSV is made of the chart's own lines, which share their x values."""
    rows = zip(lines[0].x, *(line.y for line in lines), strict=True)
    name = f"fig-{number.replace('(', '').rstrip(')')}"
    drawn = Chart(lines=tuple(lines), **chart)
    return Figure(name, drawn, ((first, *(line.label for line in lines)), list(rows)), caption, number)


def fig_4e() -> Figure:
    """SNR of the APD over its gain."""
    gain = np.geomspace(1.0, 500.0, 300)
    noise = apd_noise()
    parts = {"multiplied_variance_a2": noise.multiplied_a2, "unmultiplied_variance_a2": noise.unmultiplied_a2}
    best = float(apd.best_gain(**parts, excess_noise_index=0.3))
    equal = float(apd.gain_of_equal_noise(**parts, excess_noise_index=0.3))
    lines = tuple(
        Line(label=f"{klux:g} klux", x=gain, y=apd_noise(illuminance_klux=klux).snr(gain), colour=colour)
        for colour, klux in ((0, 100.0), (5, 10.0), (2, 1.0))
    )
    marks = (
        Mark(x=equal, y=noise.snr(equal), text=f"{equal:.1f}: optical = electrical noise", offset=(9.0, -22.0)),
        Mark(x=best, y=noise.snr(best), text=f"{best:.1f}: best", offset=(2.0, -6.0)),
        Mark(x=80.0, y=noise.snr(80.0), text="80: Table 1", offset=(4.0, 9.0)),
    )
    caption = (
        "SNR against gain by (20), Table 1 at 100 m. The text puts the best gain where optical and electrical noise "
        f"are equal ({equal:.1f}); it is where the multiplied noise is 2/x times the rest ({best:.1f})."
    )
    labels = {"x_label": "multiplication factor", "y_label": "trigger SNR of the APD at 100 m"}
    return _figure("4(e)", caption, lines, "gain", marks=marks, x_log=True, y_log=True, **labels)


def _response(number: str, caption: str, lines: Sequence[Line], title: str = "") -> Figure:
    limits = {"x_limits": (0.0, float(lines[0].x[-1])), "y_limits": (0.0, None)}
    labels = {"x_label": "photons of the flash", "y_label": "triggered cells"}
    return _figure(number, caption, lines, "photons", title=title, **labels, **limits)


def _responses(photons: Numbers, cases: Sequence[tuple[str, float, float]]) -> list[Line]:
    """Lines of (22), one for each label, PDE and number of cells."""
    return [
        Line(
            label=label,
            x=photons,
            colour=i,
            y=np.asarray(sipm.fired_cells_published(photons=photons, pde=pde, cells=cells)),
        )
        for i, (label, pde, cells) in enumerate(cases)
    ]


def fig_5a() -> Figure:
    """Photon response for several PDE."""
    cases = [(f"PDE {pde:.0%}", pde, 100.0) for pde in (0.10, 0.22, 0.40, 0.60)]
    caption = (
        "Response (22) of 100 cells without background. Derived without splitting the photons evenly it is "
        "1 - exp(-n PDE / N), at most 0.3 % of the photons apart: not to be seen here."
    )
    return _response("5(a)", caption, _responses(np.linspace(0.0, 1500.0, 301), cases))


def fig_5b() -> Figure:
    """Photon response for several numbers of cells."""
    lines = _responses(
        np.linspace(0.0, 4000.0, 401), [(f"{cells:.0f} cells", 0.22, cells) for cells in (50.0, 100.0, 200.0, 400.0)]
    )
    return _response("5(b)", "Response (22) at a PDE of 22 %, without background.", lines)


def fig_5c() -> Figure:
    """Photon response under background."""
    photons = np.linspace(0.0, 1500.0, 301)
    pde, cells = 0.22, 100.0
    dark = sipm.dark_counts(cells=cells, dark_count_rate_hz=_DARK_HZ, dead_time_s=_DEAD_TIME_S)
    lines = []
    for i, background in enumerate((100.0, 300.0, 1000.0, 0.0), start=1):
        busy = sipm.fired_cells_published(photons=background, pde=pde, cells=cells)
        y = sipm.signal_cells_published(background_cells=busy, dark_counts=dark, photons=photons, pde=pde, cells=cells)
        lines.append(Line(label=f"{background:g} photons", x=photons, y=np.asarray(y), colour=i % 4))
        share = sipm.busy_share_steady_state(
            photons=background, pde=pde, cells=cells, dark_count_rate_hz=_DARK_HZ, dead_time_s=_DEAD_TIME_S
        )
        y = cells * (1.0 - share) * sipm.fired_share(photons=photons, pde=pde, cells=cells)
        if background:
            lines.append(
                Line(label=f"{background:g}, derived", x=photons, y=np.asarray(y), colour=i, style="dashed", width=1.4)
            )
    caption = (
        "Cells that the echo triggers, (24), 100 cells, PDE 22 %, background photons in a dead time. "
        "Dashed: busy cells in steady state, x / (1 + x), which leaves more cells free than (23)."
    )
    return _response("5(c)", caption, lines, "background in a dead time:")


def _of_three(x: Numbers, values: Callable[[Sensor], Numbers], steady: str) -> list[Line]:
    """Lines of the APD, the SiPM and the SiPM in steady state."""
    apd_line, sipm_line, steady_line = (values(sensor) for sensor in (apd_lidar(), sipm_printed(), sipm_steady()))
    return [
        Line(label="APD (19)", x=x, y=apd_line, colour=0),
        Line(label="SiPM (27)", x=x, y=sipm_line, colour=1),
        Line(label=f"SiPM, {steady}", x=x, y=steady_line, colour=1, style="dashed", width=1.4),
    ]


def fig_6a() -> Figure:
    """SNR over distance at 100 klux."""
    x = np.geomspace(5.0, 1000.0, 300)
    limits = [range_m(sensor) for sensor in (apd_lidar(), sipm_printed(), sipm_steady())]
    lines = _of_three(x, lambda sensor: plane.snr(sensor, TABLE_1, x), "steady state")
    marks = (
        Mark(x=limits[0], y=5.0, text=f"{limits[0]:.1f} m", colour=0, offset=(8.0, 8.0)),
        Mark(x=limits[1], y=5.0, text=f"{limits[1]:.1f} m", colour=1, offset=(-8.0, -6.0)),
    )
    chart = {
        "marks": marks,
        "levels": (Level(y=5.0, text="threshold: TNR 5"),),
        "x_label": "distance [m]",
        "y_label": "trigger SNR",
    }
    caption = (
        "Trigger SNR against distance, 100 klux, elevation 0. Limits at TNR 5: APD "
        f"{limits[0]:.3f} m, SiPM {limits[1]:.3f} m by (27) and {limits[2]:.3f} m with busy cells in steady state."
    )
    return _figure("6(a)", caption, lines, "distance_m", x_log=True, y_log=True, **chart)


def fig_6b() -> Figure:
    """Maximum range over elevation under three aperture laws."""
    angle = np.linspace(-30.0, 30.0, 121)

    def reach(sensor: Sensor, law: Callable[[Numbers], Numbers]) -> Numbers:
        found: Numbers = plane.maximum_range_m(sensor, Target(aperture_share=law(angle)))[0]
        return found

    pair = ((0, "APD", apd_lidar()), (1, "SiPM", sipm_printed()))
    lines = [Line(label=f"{n}, A cos θ", x=angle, y=reach(s, aperture_laws.cosine), colour=i) for i, n, s in pair]
    lines.append(
        Line(
            label="SiPM, A cos θ, steady state",
            x=angle,
            y=reach(sipm_steady(), aperture_laws.cosine),
            colour=1,
            style="dashed",
            width=1.4,
        )
    )
    for style, name, law in (
        ("dashdot", "mirror", aperture_laws.mirror),
        ("dotted", "A constant", aperture_laws.constant),
    ):
        lines.append(Line(label=f"APD, {name}", x=angle, y=reach(apd_lidar(), law), style=style, width=1.2))
    caption = (
        "Maximum range against elevation, 100 klux. The paper names no scanner and no law. Solid: A(θ) = A(0) cos θ, "
        "an aperture fixed in the housing, seen foreshortened; chosen because it is the one law without a further "
        "parameter that is lower at both edges, as the text has it. Dash-dotted: a scan mirror at 45° as the stop, "
        "A cos(45° + θ/2) / cos 45°, lower at one edge and higher at the other. Dotted: a rotating head, constant. "
        "(These two for the APD.)"
    )
    limits = {"x_limits": (-30.0, 30.0), "y_limits": (250.0, 390.0)}
    labels = {"x_label": "elevation of the beam [°]", "y_label": "maximum range [m]"}
    return _figure("6(b)", caption, lines, "elevation_deg", **labels, **limits)


def fig_6c() -> Figure:
    """Maximum range over illuminance."""
    x = np.geomspace(1e-3, 100.0, 251)
    target = Target(illuminance_klux=x)
    diode, printed, steady = apd_lidar(), sipm_printed(), sipm_steady()
    equal, other = (plane.equal_range_illuminance_klux(diode, sensor, TABLE_1) for sensor in (printed, steady))
    lines = _of_three(x, lambda sensor: plane.maximum_range_m(sensor, target)[0], "steady state and floor")
    mark = Mark(x=equal, y=range_m(diode, illuminance_klux=equal), text=f"equal at {equal:.2f} klux", offset=(8.0, 9.0))
    caption = (
        f"Maximum range against illuminance, elevation 0. Equal at {equal:.5f} klux by (27), at {other:.5f} klux with "
        "busy cells in steady state. In the dark (27) has the SiPM see less than one cell; with a floor of one cell "
        f"its range ends at {range_m(steady, illuminance_klux=0.0):.0f} m instead of "
        f"{range_m(printed, illuminance_klux=0.0):.0f} m."
    )
    labels = {"x_label": "illuminance of the sun [klux]", "y_label": "maximum range [m]"}
    chart = {"marks": (mark,), "x_log": True, "y_log": True, "y_limits": (200.0, 5000.0)}
    return _figure("6(c)", caption, lines, "illuminance_klux", **labels, **chart)
