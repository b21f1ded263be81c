"""Eye safety: the class 1 accessible emission limit (AEL) of IEC 60825-1:2014 and its factors.

Written from public accounts of the standard, not from its text (docs/eye_safety.md names them): an aid to design, not
a certification. Tables are those of IEC 60825-1:2014 (third edition). Wavelengths 400 to 2600 nm, emission durations
0.1 ps to 30 000 s; ranges include their lower end.

Symbols: as in the standard, C3 ... C7 correction factors, T_i grouping time, T2, alpha angle of the apparent source.
"""

from __future__ import annotations

import math

RETINA_M = (400e-9, 1400e-9)
"""Source: IEC 60825-1:2014; wavelengths that reach the retina."""

LONGEST_WAVELENGTH_M = 2600e-9
"""Choice: end of the wavelengths that are covered here; the standard goes on to 1 mm."""

SHORTEST_S, LONGEST_S = 1e-13, 3e4
"""Source: IEC 60825-1:2014; emission durations of its tables."""

SMALLEST_SOURCE_RAD = 1.5e-3
"""Source: IEC 60825-1:2014; alpha_min: a source of a smaller angle counts as a point."""

_HELD_C7_M = 1250e-9
"""Source: IEC 60825-1:2014; C7 is held at its value here up to 1400 nm."""


def reaches_retina(wavelength_m: float) -> bool:
    """True if the eye focuses this wavelength on the retina (400 to 1400 nm). ValueError outside 400-2600 nm."""
    if not RETINA_M[0] <= wavelength_m < LONGEST_WAVELENGTH_M:
        raise ValueError(f"wavelength must be 400 to 2600 nm, got {wavelength_m * 1e9:g} nm")
    return wavelength_m < RETINA_M[1]


def c3(*, wavelength_m: float) -> float:
    """C3 (table 9): lower photochemical harm of longer blue wavelengths, 450 to 600 nm; 1 below."""
    return float(10.0 ** (0.02 * max(wavelength_m * 1e9 - 450.0, 0.0)))


def c4(*, wavelength_m: float) -> float:
    """C4 (table 9): lower absorption in the retina, 10^(0.002 (lambda - 700)), and 5 from 1050 nm."""
    nm = wavelength_m * 1e9
    return 5.0 if nm >= 1050.0 else float(10.0 ** (0.002 * max(nm - 700.0, 0.0)))


def c7(*, wavelength_m: float) -> float:
    """C7 (table 9): absorption before the retina. 1; from 1150 nm 10^(0.018 (lambda - 1150)); from 1200 nm
    8 + 10^(0.04 (lambda - 1250)).
    """
    nm = wavelength_m * 1e9
    if nm < 1150.0:
        return 1.0
    return float(10.0 ** (0.018 * (nm - 1150.0)) if nm < 1200.0 else 8.0 + 10.0 ** (0.04 * (nm - 1250.0)))


def largest_source_rad(*, duration_s: float) -> float:
    """alpha_max (table 9): 5 mrad below 625 us, 200 sqrt(t) mrad up to 0.25 s, then 100 mrad."""
    return min(max(0.2 * math.sqrt(duration_s), 5e-3), 0.1)


def c6(*, source_rad: float, duration_s: float) -> float:
    """C6 (table 9): larger images on the retina, alpha / alpha_min for alpha from alpha_min to alpha_max."""
    counted_rad = min(source_rad, largest_source_rad(duration_s=duration_s))
    return max(counted_rad / SMALLEST_SOURCE_RAD, 1.0)


def t2_s(*, source_rad: float) -> float:
    """T2 (table 9): beyond it the thermal limit is a power, as the eye moves; 10 s (point) to 100 s (100 mrad)."""
    milli = min(max(source_rad * 1e3, 1.5), 100.0)
    return float(10.0 * 10.0 ** ((milli - 1.5) / 98.5))


def grouping_time_s(*, wavelength_m: float) -> float:
    """T_i (table 2): pulses closer than this count as one."""
    if reaches_retina(wavelength_m):
        return 5e-6 if wavelength_m < 1050e-9 else 13e-6
    return 10.0 if 1500e-9 <= wavelength_m < 1800e-9 else 1e-3


def c5(*, pulse_s: float, pulses: float, source_rad: float, grouping_s: float, time_base_s: float) -> float:
    """C5 (4.3 f 3): reduction of each pulse's limit for many pulses; thermal damage at 400 to 1400 nm only.

    Pulses up to T_i: 1 for up to 600 of them, else 5 N^-0.25, at least 0.4. Longer pulses: 1 for sources up to 5 mrad
    and above 100 mrad, else N^-0.25, at least 0.4, or 0.2 for sources above alpha_max.

    Args:
        pulses: effective number in T2 or the time base, whichever is shorter; pulses within T_i count as one
    """
    if pulse_s > 0.25 or time_base_s <= 0.25 or pulses <= 1.0:
        return 1.0
    if pulse_s <= grouping_s:
        return 1.0 if pulses <= 600.0 else max(5.0 * math.pow(pulses, -0.25), 0.4)
    if source_rad <= 5e-3 or source_rad > 0.1:
        return 1.0
    floor = 0.4 if source_rad <= largest_source_rad(duration_s=pulse_s) else 0.2
    return max(math.pow(pulses, -0.25), floor)


def aperture_diameter_m(*, wavelength_m: float, duration_s: float, telescope: bool = False) -> float:
    """Aperture stop for the measurement (table 10, conditions 3 and 1).

    Up to 1400 nm: the pupil of 7 mm, or 50 mm with a telescope. Above: 1 mm up to 0.35 s, then 1.5 t^(3/8) mm, 3.5 mm
    from 10 s; seven times as much with a telescope.
    """
    if reaches_retina(wavelength_m):
        return 50e-3 if telescope else 7e-3
    times = 7.0 if telescope else 1.0
    if duration_s <= 0.35:
        return times * 1e-3
    return times * (1.5e-3 * math.pow(duration_s, 0.375) if duration_s < 10.0 else 3.5e-3)


def measuring_distance_m(*, telescope: bool = False) -> float:
    """Distance of the aperture stop (table 10): 100 mm, or 2 m with a telescope."""
    return 2.0 if telescope else 0.1


def class_1_energy_j(*, wavelength_m: float, duration_s: float, source_rad: float = SMALLEST_SOURCE_RAD) -> float:
    """AEL of class 1 for one emission of this duration, as an energy (tables 3 and 4), thermal limits.

    Divide by the duration for a power. From 1250 to 1400 nm C7 is held at 9: the retina would allow more, but the
    cornea then needs limits of its own.

    Raises:
        ValueError: for a duration or wavelength out of range
    """
    if not SHORTEST_S <= duration_s <= LONGEST_S:
        raise ValueError(f"emission duration must be 0.1 ps to 30000 s, got {duration_s:g} s")
    if reaches_retina(wavelength_m):
        return _retina_energy_j(wavelength_m, duration_s, source_rad)
    return _cornea_energy_j(wavelength_m, duration_s)


def _retina_energy_j(wavelength_m: float, t: float, source_rad: float) -> float:
    below_1050_nm = wavelength_m < 1050e-9
    water = c7(wavelength_m=min(wavelength_m, _HELD_C7_M))
    size = c6(source_rad=source_rad, duration_s=t)
    absorbed = c4(wavelength_m=wavelength_m) * water
    longest_s = t2_s(source_rad=source_rad)
    if t < 1e-11:
        return 3.8e-8 * water * size
    if t < grouping_time_s(wavelength_m=wavelength_m):
        return (7.7e-8 * absorbed if below_1050_nm else 7.7e-7 * water) * size
    if t < longest_s:
        return 7e-4 * absorbed * size * math.pow(t, 0.75)
    if source_rad <= SMALLEST_SOURCE_RAD:
        return 3.9e-4 * absorbed * t
    return 7e-4 * absorbed * size * math.pow(longest_s, -0.25) * t


def _cornea_energy_j(wavelength_m: float, t: float) -> float:
    deep = 1500e-9 <= wavelength_m < 1800e-9  # absorbed in a thicker layer, which heats less
    if t < 1e-9:
        return (8e6 if deep else 8e5) * t
    if deep and t < 10.0:
        return 8e-3 if t < 0.35 else 1.8e-2 * math.pow(t, 0.75)
    if t < 1e-3:
        return 8e-4
    return 4.4e-3 * math.pow(t, 0.25) if t < 0.35 else 1e-2 * t


def class_1_blue_energy_j(*, wavelength_m: float, duration_s: float) -> float:
    """Photochemical AEL of class 1 (table 3), 400 to 600 nm, from 10 s; inf elsewhere.

    3.9e-3 C3 J up to 100 s, then 3.9e-5 C3 W, for light from within 11 mrad.
    """
    if not RETINA_M[0] <= wavelength_m < 600e-9 or duration_s < 10.0:
        return math.inf
    return 3.9e-5 * c3(wavelength_m=wavelength_m) * max(duration_s, 100.0)


def fraction_through_aperture(*, beam_diameter_m: float, aperture_m: float) -> float:
    """Share of a centred Gaussian beam (1/e^2 diameter) that passes a round aperture."""
    if beam_diameter_m <= 0.0:
        return 1.0
    return -math.expm1(-2.0 * (aperture_m / beam_diameter_m) ** 2)


def beam_diameter_m(*, exit_diameter_m: float, divergence_rad: float, distance_m: float) -> float:
    """1/e^2 diameter of a Gaussian beam with its waist at the exit, sqrt(D^2 + (2 R tan(theta / 2))^2)."""
    return math.hypot(exit_diameter_m, 2.0 * distance_m * math.tan(0.5 * divergence_rad))
