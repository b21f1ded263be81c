"""Charts of the guides: range, the sun's spectrum, busy cells, eye safety, formats, a sweep, published ranges."""

import dataclasses
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from drawing import BACKGROUND, HERE, INK, SCENES, WIDTH, dark, saved, store
from PIL import Image

import lidarscene
from lidarscene import catalog
from lidarscene.figures import lines
from lidarscene.files.pvlib import reference_spectrum
from lidarscene.physics.optics import solar_spectrum
from lidarscene.studies import published_values
from lidarscene.studies.eye_safety.criteria import margin_of
from lidarscene.studies.eye_safety.eye_safety_report import eye_safety_report
from lidarscene.studies.paper import figures as paper_figures
from lidarscene.studies.ranging import plane
from lidarscene.studies.ranging.conditions import PROBABILITY

APD, SIPM, THIRD = "#ffc14d", "#5ec8f2", "#80ed99"
PAPER = {"table1-apd": APD, "table1-sipm": SIPM}
DASHED = (0, (4, 4))


def labelled(axes: Any, along: str, title: str) -> None:
    """The axis along the bottom, and what is drawn over it."""
    axes.set_xlabel(along, color=INK)
    axes.set_title(title, color=INK, loc="left", fontsize=11)


def range_() -> None:
    """SNR over distance and range over illuminance of the paper's two detectors."""
    figure, (left, right) = dark(1, 2, height=4.6)
    distances, klux = np.geomspace(20.0, 600.0, 200), np.geomspace(0.1, 150.0, 80)
    for name, colour in PAPER.items():
        sensor = lidarscene.load_sensor(name)
        left.loglog(distances, plane.snr(sensor, plane.Target(), distances), color=colour, label=name)
        reach = [plane.detection_range_m(sensor, plane.Target(illuminance_klux=one), PROBABILITY)[0] for one in klux]
        right.semilogx(klux, reach, color=colour, label=name)
    left.set(xlim=(20, 600), xticks=(20, 50, 100, 200, 500))
    left.set_xticklabels(("20", "50", "100", "200", "500"))
    left.minorticks_off()
    labelled(left, "distance [m]", "SNR at 100 klux, 10 % wall")
    right.set(xlim=(0.1, 150), ylim=(0, None), xticks=(0.1, 1, 10, 100))
    right.set_xticklabels(("0.1", "1", "10", "100"))
    labelled(right, "illuminance [klux]", f"range at P_d {PROBABILITY:g} [m], 10 % wall")
    for one in (left, right):
        one.legend(frameon=False, labelcolor=INK)
    saved(figure, "range.png")


def own_sensor() -> None:
    """SNR over distance of the recipe's APD sensor, as its file has it, on three walls."""
    text = (HERE.parent / "recipes.md").read_text(encoding="utf-8")
    file = HERE / "my-apd.toml"
    file.write_text(text.split("```toml\n# my-apd.toml\n")[1].split("```")[0], encoding="utf-8")
    try:
        mine = lidarscene.load_sensor(file)
    finally:
        file.unlink()
    figure, (axes,) = dark(1, 1, height=4.2)
    distances = np.geomspace(20.0, 1200.0, 200)
    for reflectivity, colour in ((0.8, APD), (0.3, THIRD), (0.1, SIPM)):
        wall = plane.Target(reflectivity=reflectivity)
        reach = float(plane.detection_range_m(mine, wall, PROBABILITY)[0])
        ends = plane.snr(mine, wall, np.array([reach]))
        axes.loglog(distances, plane.snr(mine, wall, distances), color=colour, label=f"{reflectivity:.0%} wall")
        axes.plot([reach], ends, "o", color=colour)
    axes.set(xlim=(20, 1200), xticks=(20, 50, 100, 200, 500, 1000))
    axes.set_xticklabels(("20", "50", "100", "200", "500", "1000"))
    axes.minorticks_off()
    labelled(axes, "distance [m]", f"SNR of my-apd at 100 klux; dots: range at P_d {PROBABILITY:g}")
    axes.legend(frameon=False, labelcolor=INK)
    saved(figure, "own_sensor.png")


def sun() -> None:
    """The standard spectra at 100 klux each, what the eye sees of them, and the lasers' wavelengths."""
    figure, (axes,) = dark(1, 1, height=4.4)
    names = {"global": APD, "direct": SIPM, "extraterrestrial": THIRD}
    for name, colour in names.items():
        spectrum = reference_spectrum(name)
        per_nm = 1e-9 * 1e5 / solar_spectrum.illuminance_lux(spectrum) * spectrum.value
        axes.plot(1e9 * spectrum.wavelength_m, per_nm, color=colour, linewidth=1.0, label=name)
    nm = np.linspace(380.0, 760.0, 200)
    eye = solar_spectrum.photopic_efficiency(wavelength_m=1e-9 * nm)
    axes.fill_between(nm, 0.0, 0.4 * eye, color=INK, alpha=0.25, linewidth=0, label="V(λ), what klux count")
    for wavelength in (850, 905, 940, 1064, 1550):
        axes.axvline(wavelength, color=INK, linewidth=0.7, linestyle=DASHED)
        height = 1.68 if wavelength == 905 else 1.78  # between its neighbours there is no room
        axes.text(wavelength + 4, height, f"{wavelength}", color=INK, fontsize=9, va="top")
    axes.set(xlim=(300, 1700), ylim=(0, 1.85))
    labelled(axes, "wavelength [nm]", "sunlight of 100 klux [W/m² per nm]")
    axes.legend(frameon=False, labelcolor=INK, loc=(0.71, 0.58))
    saved(figure, "sun.png")


def sipm() -> None:
    """SNR of the paper's SiPM over the photons of an echo, as printed and by the equation, for two suns."""
    sys.path.append(str(HERE.parents[1] / "tests"))
    from validation.sipm_events.cells import CellArray
    from validation.sipm_events.table import published_snr, response_by_equation

    figure, (axes,) = dark(1, 1, height=4.4)
    sensor = lidarscene.load_sensor("table1-sipm")
    array = CellArray.from_detector(sensor.detector)
    photons = np.geomspace(30.0, 3e4, 60)
    for background, name, colour in ((686.093, "100 klux", APD), (6.86093, "1 klux", SIPM)):
        table = response_by_equation(
            array, background_photons=[background], signal_photons=photons, pulse_fwhm_s=sensor.laser.pulse_fwhm_s
        )
        printed = published_snr(array, background_photons=[background], signal_photons=photons)
        axes.loglog(photons, table.snr[0], color=colour, label=f"cells followed in time, {name}")
        axes.loglog(photons, printed[0], color=colour, linestyle=DASHED, label=f"(27) as printed, {name}")
    labelled(axes, "photons of the echo, as in (24)", "SNR of table1-sipm")
    axes.legend(frameon=False, labelcolor=INK)
    saved(figure, "sipm.png")


def eye_safety() -> None:
    """Margin of each criterion of class 1 for the paper's laser, at rest and scanned."""
    figure, (axes,) = dark(1, 1, height=3.6)
    sensor = lidarscene.load_sensor("table1-apd")
    at_rest, scanned = (eye_safety_report(sensor, scanned=one) for one in (False, True))
    names = [one for one in at_rest.criteria if one.subject == at_rest.limiting.subject]
    for number, (report, colour, label) in enumerate(((at_rest, APD, "standing still"), (scanned, SIPM, "as scanned"))):
        margins = {(one.subject, one.quantity): margin_of(one) for one in report.criteria}
        heights = np.arange(len(names))[::-1] + 0.2 - 0.4 * number
        axes.barh(
            heights, [margins[one.subject, one.quantity] for one in names], height=0.36, color=colour, label=label
        )
    axes.set_yticks(np.arange(len(names))[::-1], [one.quantity for one in names])
    axes.axvline(1.0, color=INK, linewidth=0.9, linestyle=DASHED)
    axes.text(1.05, 3.2, "from here on it passes", color=INK, fontsize=9)
    axes.set(xscale="log")
    labelled(axes, "margin: limit / emission", "class 1, table1-apd, the eye at 100 mm")
    axes.legend(frameon=False, labelcolor=INK)
    saved(figure, "eye_safety.png")


def scaling() -> None:
    """What a point costs on the disk and what a frame costs to write, from the table of the page."""
    figure, (axes,) = dark(1, 1, height=4.2)
    table = (HERE.parent / "clusters.md").read_text(encoding="utf-8").split("| format | bytes per point |")[1]
    for line in table.split("\n\n")[0].splitlines()[2:]:
        name, size, _, _, seconds = (cell.strip() for cell in line.strip("|").split("|"))
        x, y = float(size), float(seconds.split()[0])
        plain = "without" in name or "(" in name
        axes.plot([x], [y], "o", color=SIPM if plain else APD)
        axes.annotate(name, (x, y), xytext=(7, -3), textcoords="offset points", color=INK, fontsize=10)
    axes.axhline(0.34, color=INK, linewidth=0.7, linestyle=DASHED)
    axes.text(78, 0.345, "rendering the frame", color=INK, fontsize=9, va="bottom")
    axes.set(xlim=(10, 100), ylim=(0.015, 1.0), yscale="log", yticks=(0.02, 0.05, 0.1, 0.2, 0.5, 1))
    axes.set_yticklabels(("0.02", "0.05", "0.1", "0.2", "0.5", "1"))
    axes.minorticks_off()
    labelled(axes, "bytes a point", "seconds of a core to write 261,277 points")
    saved(figure, "scaling.png")


def batch() -> None:
    """Points of the frames that the shipped job renders, over its suns."""
    figure, (axes,) = dark(1, 1, height=3.8)
    scene = lidarscene.load_scene(SCENES / "car.toml")
    klux = (1.0, 10.0, 100.0)
    for number, (name, colour) in enumerate(PAPER.items()):
        points = [
            [
                len(lidarscene.render(dataclasses.replace(scene, sun=sun_), name, seed=seed).range_m)
                for sun_ in (dataclasses.replace(scene.sun, illuminance_klux=one) for one in klux)
            ]
            for seed in (0, 1)
        ]
        places = np.arange(3) + 0.38 * number - 0.19
        axes.bar(places, np.mean(points, axis=0), width=0.34, color=colour, label=name)
        for seed in points:
            axes.plot(places, seed, "_", color=BACKGROUND, markersize=14)
    axes.set_xticks(range(3), [f"{one:g} klux" for one in klux])
    axes.set_ylabel("points of a frame", color=INK)
    labelled(axes, "", "job: twelve frames")
    axes.set_ylim(0, 62_000)
    axes.legend(frameon=False, labelcolor=INK, loc="upper right", ncols=2)
    saved(figure, "batch.png")


def sensors() -> None:
    """Simulated ranges over published ones, beyond the first of each sensor."""
    figure, (axes,) = dark(1, 1, height=5.0)
    names: dict[tuple[float, float], list[str]] = {}
    for name in catalog.names("sensors"):
        _, *further_ranges = (row for row in published_values.compare_ranges(name))
        for one in further_ranges:
            if one.reference and one.simulated:
                place = one.reference, one.simulated
                # One label for points that lie on each other.
                same = (other for other in names if np.allclose(other, place, rtol=0.02))
                names.setdefault(next(same, place), []).append(name)
    for place, there in names.items():
        axes.plot(*place, "o", color=APD)
        above = place[1] > place[0] or len(there) > 1
        axes.annotate(
            ", ".join(there),
            place,
            xytext=(-7, 5) if above else (7, -11),
            textcoords="offset points",
            color=INK,
            fontsize=9,
            ha="right" if above else "left",
        )
    line = np.array([10.0, 600.0])
    axes.loglog(line, line, color=INK, linewidth=0.9)
    axes.fill_between(line, line / 1.5, line * 1.5, color=INK, alpha=0.12, linewidth=0)
    axes.set(xlim=(60, 600), ylim=(60, 600), xticks=(100, 200, 300, 500), yticks=(100, 200, 300, 500))
    axes.set_xticklabels(("100", "200", "300", "500"))
    axes.set_yticklabels(("100", "200", "300", "500"))
    axes.minorticks_off()
    labelled(axes, "published range [m]", "simulated range [m]; the band is a factor of 1.5")
    saved(figure, "sensors.png")


def paper() -> None:
    """Figures 6(a) and 6(c) of the paper, as the command draws them."""
    with tempfile.TemporaryDirectory() as folder:
        halves = []
        for figure in (paper_figures.fig_6a(), paper_figures.fig_6c()):
            path = Path(folder) / f"{figure.name}.png"
            assert isinstance(figure.drawing, lines.Chart)
            lines.save(figure.drawing, [path])
            halves.append(Image.open(path).convert("RGB"))
    half = WIDTH // 2
    sizes = [(half, round(half * one.height / one.width)) for one in halves]
    whole = Image.new("RGB", (WIDTH, max(height for _, height in sizes)), "white")
    for number, (one, size) in enumerate(zip(halves, sizes, strict=True)):
        whole.paste(one.resize(size, Image.Resampling.LANCZOS), (number * half, 0))
    store(whole, "paper.png", colours=64)
