"""What the paper's section 3 says about range, APD and SiPM: sentences in, numbers and verdicts out.

Every verdict is computed when it is asked for, so it cannot become outdated.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ...physics.electronics import sipm, tdc
from ...physics.optics import radiometry
from ...sensor.model import Sensor
from ..ranging import aperture_laws, plane
from ..ranging.plane import Target
from .case import TABLE_1, apd_lidar, apd_noise, range_m, ranges_m, sipm_counts, sipm_printed, sipm_steady
from .claims_model import FAILS, HOLDS, IN_PART, Claim

Make = Callable[..., Sensor]

# Keys that the text of 3.1 names, the sign it gives them, and their value in Table 1.
_LEVERS: tuple[tuple[str, dict[str, tuple[str, float]], int], ...] = (
    ("quantum efficiency or PDE", {"apd": ("detector.quantum_efficiency", 0.70), "sipm": ("detector.pde", 0.22)}, 1),
    ("aperture area", {"both": ("optics.aperture_radius_mm", 25.0)}, 1),
    ("target reflectivity", {}, 1),
    ("solar irradiance", {"both": ("optics.sun_irradiance_w_m2", 29.4)}, -1),
    ("excess noise index", {"apd": ("detector.excess_noise_index", 0.3)}, -1),
    ("peak power", {"both": ("laser.peak_power_w", 45.0)}, 1),
    ("field of view r_PD / f", {"both": ("detector.radius_mm", 0.1)}, -1),
)


def claims_of_the_results() -> list[Claim]:
    """Sections 3.1 and 3.2, in the paper's order."""
    return [*_levers(), _threshold(), _shorter_pulse(), *_figure_6a(), *_figure_6b(), *_figure_6c(), *_conclusions()]


def _elasticity(make: Make, key: str, value: float) -> float:
    """Percent of range per percent of a key, by a central difference of 1 %."""
    up, down = (range_m(make(f"{key}={value * factor}")) for factor in (1.01, 1.0 / 1.01))
    return math.log(up / down) / (2.0 * math.log(1.01))


def _levers() -> list[Claim]:
    claims = []
    for name, keys, sign in _LEVERS:
        found = {}
        for kind, make in (("apd", apd_lidar), ("sipm", sipm_printed)):
            key = keys.get(kind) or keys.get("both")
            if key is not None:
                scale = 2.0 if name == "aperture area" else 1.0
                found[kind] = _elasticity(make, *key) / scale
            elif not keys:
                up, down = (range_m(make(), reflectivity=0.1 * f) for f in (1.01, 1.0 / 1.01))
                found[kind] = math.log(up / down) / (2.0 * math.log(1.01))
        numbers = ", ".join(f"{kind.upper().replace('SIPM', 'SiPM')} {value:+.3f} %" for kind, value in found.items())
        good = all(value * sign > 0.0 for value in found.values())
        claims.append(
            Claim(
                place="3.1",
                says=f"The range {'grows' if sign > 0 else 'shrinks'} with the {name}.",
                found=f"Range per 1 % of it, from (19) and (27) at Table 1: {numbers}.",
                verdict=HOLDS if good else FAILS,
            )
        )
    return claims


def _threshold() -> Claim:
    strict, loose = (float(tdc.false_alarm_probability(threshold=tnr, noise=1.0)) for tnr in (5.0, 4.0))
    longer = [range_m(s("tdc.threshold_to_noise=4")) / range_m(s()) for s in (apd_lidar, sipm_printed)]
    return Claim(
        place="3.1",
        says="A lower TNR buys range at the cost of false alarms.",
        found=f"TNR 4 for 5: range x{longer[0]:.3f} (APD), x{longer[1]:.3f} (SiPM); P_f x{loose / strict:.0f}.",
        verdict=HOLDS if min(longer) > 1.0 and loose > strict else FAILS,
    )


def _shorter_pulse() -> Claim:
    change = ("laser.peak_power_w=90", "laser.pulse_fwhm_ns=3", "tdc.bandwidth_mhz=334")
    apd = range_m(apd_lidar(*change)), range_m(apd_lidar())
    sipm_ = range_m(sipm_printed(*change)), range_m(sipm_printed())
    return Claim(
        place="3.1",
        says="More peak power means a shorter pulse (laser safety), more bandwidth and so more noise.",
        found="Twice the power, half the pulse, twice the bandwidth: noise x1.41 and signal x2 for the "
        f"APD, range {apd[0]:.1f} "
        f"for {apd[1]:.1f} m. By (24) the SiPM counts energy: {sipm_[0]:.1f} for {sipm_[1]:.1f} m.",
        verdict=HOLDS,
    )


def _figure_6a() -> list[Claim]:
    r = np.geomspace(1.0, 1000.0, 400)
    apd, printed, derived = (plane.snr(s, TABLE_1, r) for s in (apd_lidar(), sipm_printed(), sipm_steady()))
    noise = apd_noise()
    optical = noise.optical_a2 * 80.0**2.3
    share = optical / (noise.multiplied_a2 * 80.0**2.3 + noise.unmultiplied_a2)
    pure = (
        float(plane.closed_form_range_m(apd_lidar(), TABLE_1))
        / float(plane.closed_form_range_m(sipm_printed(), TABLE_1))
    ) ** 2
    efficiency, excess = math.sqrt(0.70 / 0.22), math.sqrt(80.0**0.3)
    limit = range_m(sipm_printed())
    near = float(plane.snr(apd_lidar(), TABLE_1, limit)[0]) / 5.0
    close = sipm.fired_share_published(photons=1.0, pde=0.22, cells=400.0)
    photons_90 = math.log(10.0) / -math.log1p(-float(close))
    saturated_m = 100.0 * math.sqrt(sipm_counts().signal_photons / photons_90)
    slope = [_slope(s, d) for s, d in ((apd_lidar(), 280.0), (sipm_printed(), limit), (sipm_printed(), 1000.0))]
    return [
        Claim(
            place="3.2, Fig. 6(a)",
            says="At 100 klux the APD's SNR is ahead of the SiPM's throughout.",
            found=f"From 1 m to 1 km at least x{np.min(apd / printed):.3f} by (27), "
            f"x{np.min(apd / derived):.3f} with busy cells in "
            "steady state.",
            verdict=HOLDS if np.min(apd / derived) > 1.0 else FAILS,
        ),
        Claim(
            place="3.2, Fig. 6(a)",
            says="The reason is light noise, the SNR being determined by 70 % quantum efficiency against 22 % PDE.",
            found=f"Sunlight is {100 * share:.1f} % of the APD's variance. Efficiency alone gives "
            f"sqrt(70/22) = {efficiency:.3f}; "
            f"excess noise takes that by {excess:.3f}, and counting half a pulse per dead time against a "
            "bandwidth gives it "
            f"back by {pure * excess / efficiency:.3f}: {pure:.3f} far out, and busy cells make it "
            f"{near:.3f} at the SiPM's limit. "
            "The efficiency alone does not outweigh the excess noise.",
            verdict=IN_PART,
        ),
        Claim(
            place="3.2, Fig. 6(a)",
            says="Close in, the SiPM saturates.",
            found=f"Its SNR never exceeds {printed[0]:.2f}; nearer than {saturated_m:.0f} m more than 90 % "
            "of the free cells fire.",
            verdict=HOLDS,
        ),
        Claim(
            place="3.2, Fig. 6(a)",
            says="The SNR goes with the inverse square of the distance.",
            found=f"Exponent {slope[0]:.3f} (APD, everywhere); {slope[1]:.3f} (SiPM, at its limit), "
            f"{slope[2]:.3f} (at 1 km).",
            verdict="holds for the APD; for the SiPM far beyond its limit only",
        ),
    ]


def _slope(sensor: Sensor, distance_m: float) -> float:
    low, high = plane.snr(sensor, TABLE_1, np.array([distance_m / 1.01, distance_m * 1.01]))
    return float(math.log(high / low) / (2.0 * math.log(1.01)))


def _figure_6b() -> list[Claim]:
    def reach(law: str, *angles: float) -> Any:
        share = aperture_laws.LAWS[law](np.array(angles))
        return plane.maximum_range_m(apd_lidar(), Target(aperture_share=share))[0]

    cosine, mirror, constant = (reach(law, -30.0, 0.0, 30.0) for law in ("cosine", "mirror", "constant"))
    return [
        Claim(
            place="3.2, Fig. 6(b)",
            says="At the edges of the scan the range is lower than in the centre, for the aperture there is smaller.",
            found=f"APD at ∓30° for {cosine[1]:.1f} m in the centre: {cosine[0]:.1f} and {cosine[2]:.1f} m "
            "with A cos θ (a fixed "
            f"aperture); {mirror[0]:.1f} and {mirror[2]:.1f} m with a mirror at 45°, so one edge is better; "
            f"{constant[0]:.1f} m "
            "at both for a rotating head. The range goes with little more than the fourth root of the aperture.",
            verdict="holds for a fixed aperture; not for the others",
        )
    ]


def _figure_6c() -> list[Claim]:
    equal = plane.equal_range_illuminance_klux(apd_lidar(), sipm_printed(), TABLE_1)
    other = plane.equal_range_illuminance_klux(apd_lidar(), sipm_steady(), TABLE_1)
    levels = (10.0, 3.0, 1.0, 0.1, 0.01, 0.0)
    trios = [ranges_m((apd_lidar(), sipm_printed(), sipm_steady()), illuminance_klux=k) for k in levels]
    ratio = [b / a for a, b, _ in trios]
    floored = [c / a for a, _, c in trios]
    rising = all(y > x for x, y in itertools.pairwise(ratio))
    window_m = radiometry.range_from_time_of_flight_m(time_of_flight_s=4e-6)
    return [
        Claim(
            place="3.2, Fig. 6(c)",
            says="Below some background the SiPM sees farther.",
            found=f"Below {equal:.5f} klux by (27), {other:.5f} klux with busy cells in steady state.",
            verdict=HOLDS,
        ),
        Claim(
            place="3.2, Fig. 6(c)",
            says="The weaker the background, the greater the SiPM's advantage.",
            found="SiPM over APD by (27): "
            + ", ".join(f"{r:.2f} at {k:g} klux" for r, k in zip(ratio, levels, strict=True))
            + f". With a floor of one cell it ends at {floored[-1]:.2f}, reached at 0.023 klux.",
            verdict="holds; a floor of one cell ends it" if rising else FAILS,
        ),
        Claim(
            place="Fig. 6(c) with (10)",
            says="The ranges are those of a lidar that listens for 4 µs.",
            found=f"Then it stops at {window_m:.1f} m: what Fig. 6(c) shows below "
            f"{_klux_of_range(float(window_m)):.1f} klux needs a longer window, and has more false alarms.",
            verdict=IN_PART,
        ),
    ]


def _klux_of_range(range_m_: float) -> float:
    """Illuminance at which the APD has this maximum range."""
    klux = np.geomspace(0.1, 100.0, 2000)
    found = plane.maximum_range_m(apd_lidar(), Target(illuminance_klux=klux))[0]
    return float(np.interp(-range_m_, -found, klux))


def _widest(make: Make) -> tuple[float, float]:
    """Aperture radius [mm] of the longest range, and that: the vertex of a parabola through the highest three of many
    radii, along logarithms.
    """
    radii = np.geomspace(5.0, 200.0, 120)
    ranges = [range_m(make(f"optics.aperture_radius_mm={a}")) for a in radii]
    top = min(max(int(np.argmax(ranges)), 1), len(radii) - 2)
    near = slice(top - 1, top + 2)
    bend, slope, _ = np.polyfit(np.log(radii[near]), ranges[near], 2)
    best = math.exp(-0.5 * slope / bend)
    return best, range_m(make(f"optics.aperture_radius_mm={best}"))


def _conclusions() -> list[Claim]:
    dark = ranges_m((apd_lidar(), sipm_printed(), sipm_steady()), illuminance_klux=0.0)
    plain = [range_m(s()) for s in (apd_lidar, sipm_printed)]
    half = [range_m(s("optics.sun_irradiance_w_m2=14.7")) for s in (apd_lidar, sipm_printed)]
    narrow = [range_m(s("detector.radius_mm=0.05")) for s in (apd_lidar, sipm_printed)]
    best = {name: _widest(make) for name, make in (("printed", sipm_printed), ("steady", sipm_steady))}
    pde = [(p, range_m(sipm_steady(f"detector.pde={p}"))) for p in (0.4, 0.6, 0.8)]
    crowded = range_m(sipm_steady("detector.pde=0.6", "detector.cells=4000"))
    return [
        Claim(
            place="3.2, engineering",
            says="A smaller receiving angle, a narrower filter or a wavelength "
            "with less sun reduce "
            "the background and so help.",
            found=f"Half the sun in band: {half[0]:.1f} m (APD), {half[1]:.1f} m (SiPM); half the field of "
            f"view: {narrow[0]:.1f} and "
            f"{narrow[1]:.1f} m; for {plain[0]:.1f} and {plain[1]:.1f} m.",
            verdict=HOLDS,
        ),
        Claim(
            place="3.2, conclusion 1",
            says="The APD's ultimate limit is electrical noise; a SiPM has none and wins in weak light.",
            found=f"Without any light: APD {dark[0]:.1f} m, SiPM {dark[1]:.1f} m by (27), {dark[2]:.1f} m "
            "if it must see one cell.",
            verdict=HOLDS,
        ),
        Claim(
            place="3.2, conclusion 2",
            says="Given dynamic range, higher quantum or photon detection efficiency means higher SNR.",
            found="SiPM at 100 klux: "
            + ", ".join(f"{r:.1f} m at a PDE of {p:.0%}" for p, r in pde)
            + f" with 400 cells; {crowded:.1f} m at 60 % with 4000.",
            verdict=HOLDS if crowded > pde[1][1] else IN_PART,
        ),
        Claim(
            place="3.2, conclusion 3",
            says="A SiPM's optics must be kept small, lest background use up its cells.",
            found=f"At 100 klux its range peaks at an aperture radius of {best['printed'][0]:.0f} mm by (27) "
            f"({best['printed'][1]:.1f} m), of {best['steady'][0]:.0f} mm in steady state "
            f"({best['steady'][1]:.1f} m, wider than any lens of 30 mm); Table 1 has 25 mm. "
            "This limits the claim of 3.1 that more aperture means more range.",
            verdict=HOLDS if best["printed"][0] < 200.0 else IN_PART,
        ),
        Claim(
            place="3.2, last paragraph",
            says="In theory SiPM lidars see farther.",
            found=f"At Table 1 below 3.2 klux only; at 100 klux the APD sees {plain[0]:.1f} m, and a SiPM "
            "of 60 % PDE and 4000 cells "
            f"{crowded:.1f} m.",
            verdict=IN_PART,
        ),
    ]
