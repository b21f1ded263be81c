"""What the paper's section 2 says about its own formulas, checked one by one: sentences in, numbers and verdicts out.

Every verdict is computed when it is asked for, so it cannot become outdated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...physics.electronics import apd, sipm, tdc
from ..ranging import plane
from .case import TABLE_1, apd_lidar, apd_noise, range_m, sipm_counts, sipm_in_time, sipm_printed, sipm_steady, snr_at

HOLDS, IN_PART, FAILS = "holds", "holds in part", "does not hold"


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """A sentence of the paper (in our words), its place, what we find, and the verdict."""

    place: str
    says: str
    found: str
    verdict: str


def claims_of_the_model() -> list[Claim]:
    """Sections 2.2 and 2.3, in the paper's order."""
    return [*_light(), *_detection(), *_apd(), *_response(), *_sipm_snr()]


def _verdict(good: bool) -> str:
    return HOLDS if good else FAILS


def _light() -> list[Claim]:
    near, far = (plane.echoes_of_plane(apd_lidar(), TABLE_1, r) for r in (10.0, 500.0))
    tilted = plane.echoes_of_plane(apd_lidar(), replace(TABLE_1, cos_incidence=0.5), 10.0)
    near_w, far_w, tilted_w = (float(np.ravel(one.background_power_w)[0]) for one in (near, far, tilted))
    same = near_w == far_w == tilted_w
    return [
        Claim(
            place="(8)",
            says="Sunlight on the detector depends on neither range nor angle of incidence.",
            found=f"{near_w:.5e} W at 10 m, {far_w:.5e} W at 500 m, {tilted_w:.5e} W at 60° of incidence.",
            verdict=_verdict(same),
        )
    ]


def _detection() -> list[Claim]:
    p_false = float(tdc.false_alarm_probability(threshold=5.0, noise=1.0))
    correct = {m: float(tdc.correct_probability(p_false=p_false, p_detect=0.5, comparisons=m)) for m in (1, 400, 668)}
    at_threshold = float(tdc.detection_probability(signal=5.0, threshold=5.0, noise_at_peak=1.0))
    return [
        Claim(
            place="after (10)",
            says="TNR 5 makes the false alarm rate of each comparison less than 3e-7.",
            found=f"P_f = {p_false:.5e} by (9).",
            verdict=_verdict(p_false < 3e-7),
        ),
        Claim(
            place="after (10)",
            says="At the limit the detection probability is 50 %, at a peak of 5 sigma.",
            found=f"P_d = {at_threshold:.3f}, whatever the echo's own noise.",
            verdict=_verdict(abs(at_threshold - 0.5) < 1e-9),
        ),
        Claim(
            place="after (10)",
            says="P_correct is 99.977 % for a window of 4 µs and 100 MHz.",
            found=f"{100 * correct[400]:.5f} %; with Table 1's own 167 MHz it is {100 * correct[668]:.5f} %.",
            verdict=_verdict(round(100 * correct[400], 3) == 99.977),
        ),
        Claim(
            place="before (10)",
            says="False alarms do most harm with the pulse at the end of the window.",
            found=f"P_correct is {correct[1]:.1f} after 1 comparison and {correct[400]:.7f} after 400.",
            verdict=_verdict(correct[1] > correct[400]),
        ),
    ]


def _apd() -> list[Claim]:
    noise = apd_noise()
    best = float(
        apd.best_gain(
            multiplied_variance_a2=noise.multiplied_a2,
            unmultiplied_variance_a2=noise.unmultiplied_a2,
            excess_noise_index=0.3,
        )
    )
    equal = float(
        apd.gain_of_equal_noise(
            multiplied_variance_a2=noise.multiplied_a2,
            unmultiplied_variance_a2=noise.unmultiplied_a2,
            excess_noise_index=0.3,
        )
    )
    at_best = noise.multiplied_a2 * best**2.3 / noise.unmultiplied_a2
    electrical = noise.unmultiplied_a2 / (noise.unmultiplied_a2 + noise.multiplied_a2)
    gains = np.array([10.0, 30.0, 80.0, 200.0])
    base = 2.0 - 1.0 / 80.0
    k = (80.0**0.3 - base) / (80.0 - base)
    errors = gains**0.3 / apd.excess_noise_mcintyre(gain=gains, ionisation_ratio=k) - 1.0
    changes = ("detector.quantum_efficiency=0.77", "laser.peak_power_w=49.5", "optics.efficiency_sun=0.71874")
    better = [snr_at(apd_lidar(change), 100.0) for change in changes]
    steps = [100.0 * (value / snr_at(apd_lidar(), 100.0) - 1.0) for value in better]
    return [
        Claim(
            place="2.3",
            says="Without gain (a plain photodiode) a weak echo drowns in electrical noise.",
            found=f"At gain 1 the unmultiplied noise is {100 * electrical:.2f} % of the variance; SNR at 100 m "
            f"{noise.snr(1.0):.2f} instead of {noise.snr(80.0):.1f}, range "
            f"{range_m(apd_lidar('detector.gain=1')):.0f} m.",
            verdict=_verdict(electrical > 0.9),
        ),
        Claim(
            place="after (15)",
            says="F is approximately M^x.",
            found=f"McIntyre's F with the k = {k:.4f} that agrees at M = 80 differs by "
            + ", ".join(f"{100 * e:+.0f} % at {g:.0f}" for e, g in zip(errors, gains, strict=True) if g != 80.0)
            + ": good near the gain at which x was fitted.",
            verdict=IN_PART,
        ),
        Claim(
            place="after (20)",
            says="More P_r and K_PD and less P_rs improve the APD's SNR.",
            found=f"10 % more quantum efficiency: {steps[0]:+.1f} %; 10 % more power: {steps[1]:+.1f} %; "
            f"10 % less sunlight: {steps[2]:+.1f} %.",
            verdict=_verdict(min(steps) > 0.0),
        ),
        Claim(
            place="after (20), Fig. 4(e)",
            says="There is a multiplication factor that maximises the SNR.",
            found=f"M = {best:.2f}, SNR {noise.snr(best):.2f} at 100 m and 100 klux; Table 1's 80 gives "
            f"{noise.snr(80.0):.2f}.",
            verdict=HOLDS,
        ),
        Claim(
            place="after (20), again in 3.2",
            says="At the best gain optical noise equals electrical noise.",
            found=f"There the multiplied variance is {at_best:.3f} = 2/x times the rest. Equality comes at "
            f"M = {equal:.2f}, "
            f"where the SNR is {noise.snr(equal):.2f}, {100 * (1 - noise.snr(equal) / noise.snr(best)):.0f} "
            "% below the best.",
            verdict=FAILS,
        ),
    ]


def _response() -> list[Claim]:
    few = [float(sipm.fired_cells_published(photons=200.0, pde=p, cells=100.0)) for p in (0.1, 0.6)]
    linear = [n / (200.0 * p) for n, p in zip(few, (0.1, 0.6), strict=True)]
    # 10 % below the straight line, 1 - exp(-u) = 0.9 u, is at u = 0.21456.
    reach = [0.21456 * cells / 0.22 for cells in (100.0, 400.0)]
    dark = sipm_counts().dark
    free = [100.0 - float(sipm.fired_cells_published(photons=b, pde=0.22, cells=100.0)) for b in (0.0, 100.0, 1000.0)]
    return [
        Claim(
            place="after (22), Fig. 5(a)",
            says="The larger the PDE, the better sensitivity and linearity.",
            found=f"200 photons on 100 cells fire {few[0]:.1f} at 10 % and {few[1]:.1f} at 60 %: more "
            "sensitive. But that "
            f"is {100 * linear[0]:.0f} % and {100 * linear[1]:.0f} % of the straight line: less linear.",
            verdict=IN_PART,
        ),
        Claim(
            place="after (22), Fig. 5(b)",
            says="More cells: more dynamic range, and more dark counts.",
            found=f"The response is 10 % short of linear at {reach[0]:.0f} photons with 100 cells and at "
            f"{reach[1]:.0f} with 400; "
            "both this and N_d go with N.",
            verdict=HOLDS,
        ),
        Claim(
            place="under (23)",
            says="Dark counts in a dead time are very small, below 1e-2.",
            found=f"N_d = 400 x 2007 cps x 6 ns = {dark:.3e} for the whole device.",
            verdict=_verdict(dark < 1e-2),
        ),
        Claim(
            place="under (24), Fig. 5(c)",
            says="The stronger the background, the less dynamic range.",
            found=f"Of 100 cells {free[0]:.0f}, {free[1]:.1f} and {free[2]:.1f} are free at 0, 100 and 1000 "
            "background "
            "photons by (23).",
            verdict=_verdict(free[0] > free[1] > free[2]),
        ),
    ]


def _sipm_snr() -> list[Claim]:
    counts = sipm_counts()
    limit = range_m(sipm_printed())
    edge = sipm_counts(distance_m=limit)
    rough = [
        float(sipm.snr_approximate(signal_photons=c.signal_photons, background_photons=c.background_photons, pde=c.pde))
        for c in (counts, edge)
    ]
    bound = float(plane.closed_form_range_m(sipm_printed(), TABLE_1))
    share = counts.variance / (counts.variance + counts.dark)
    steady = {
        k: (range_m(sipm_printed(), illuminance_klux=k), range_m(sipm_steady(), illuminance_klux=k))
        for k in (100.0, 1.0)
    }
    snrs = snr_at(sipm_printed(), 100.0), snr_at(sipm_steady(), 100.0)
    in_time = range_m(sipm_in_time())
    load = edge.signal_photons * edge.pde / edge.cells
    dim = snr_at(sipm_printed(), 900.0, illuminance_klux=1.0) / float(_rough_snr(900.0, 1.0)) - 1.0
    return [
        Claim(
            place="(28)",
            says="(27) is approximated by N_s sqrt(PDE / N_b), small quantities neglected.",
            found=f"{rough[0]:.2f} for {snr_at(sipm_printed(), 100.0):.2f} at 100 m, {rough[1]:.2f} for 5 "
            "at the limit, where "
            f"N_s PDE is {100 * load:.0f} % of the cells and {100 * counts.busy / counts.cells:.0f} % are "
            "busy. In range "
            f"{bound:.1f} m for {limit:.1f} m. At 1 klux and 900 m (27) differs by {100 * dim:+.1f} %.",
            verdict="holds within 21 % in SNR and 10 % in range at the limit; a factor 2.1 at 100 m",
        ),
        Claim(
            place="after (28)",
            says="The SiPM's SNR is dominated by optical noise.",
            found=f"Background is {100 * share:.3f} % of the variance at 100 klux.",
            verdict=_verdict(share > 0.99),
        ),
        Claim(
            place="after (28)",
            says="Valid where the background triggers far fewer cells than there are, "
            "and the pulse is "
            "far shorter than the dead time.",
            found=f"At Table 1 {counts.busy:.1f} of {counts.cells:.0f} cells are busy by (23), and pulse "
            "and dead time are both "
            "6 ns: the paper's own case meets neither condition.",
            verdict="stated rightly, not met",
        ),
        Claim(
            place="after (28)",
            says="What triggered cells do in their dead time has minimal impact on the results.",
            found=f"Busy cells in steady state: SNR at 100 m {snrs[1]:.2f} for {snrs[0]:.2f} "
            f"({100 * (snrs[1] / snrs[0] - 1):+.0f} %), "
            + ", ".join(
                f"range at {k:g} klux {b:.1f} for {a:.1f} m ({100 * (b / a - 1):+.2f} %)"
                for k, (a, b) in steady.items()
            )
            + ". The whole pulse followed in time, not only its half by (24), with cells that recover: "
            f"{in_time:.1f} m at 100 klux "
            f"({100 * (in_time / steady[100.0][0] - 1):+.0f} %).",
            verdict=f"busy cells are worth {100 * (steady[100.0][1] / steady[100.0][0] - 1):.0f} % of range "
            "at 100 klux, the course in "
            f"time {100 * (in_time / steady[100.0][0] - 1):.0f} %: minimal in weak light only",
        ),
    ]


def _rough_snr(distance_m: float, illuminance_klux: float) -> float:
    c = sipm_counts(distance_m=distance_m, illuminance_klux=illuminance_klux)
    return float(
        sipm.snr_approximate(signal_photons=c.signal_photons, background_photons=c.background_photons, pde=c.pde)
    )
