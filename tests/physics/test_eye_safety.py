"""Limits of class 1 against published figures, against the exposure limits behind them, and for their shape.

KE  Kolesar and Ehrgott, "Laser Safety Standards Update", IEEE 802.3ae, Albuquerque, March 2000 (840 nm example).
V   Velodyne HDL-64E laser safety report (IEC 60825-1, 905 nm): the limit of an 18 us group.
ICNIRP  exposure limits of 2013, by way of the tables of IEC 60825-1 annex A: the AEL is the limit times an aperture.
"""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidarscene.physics import eye_safety as iec

PUPIL_M2 = math.pi / 4 * 7e-3**2
ONE_MM_M2 = math.pi / 4 * 1e-3**2
CW_M2 = math.pi / 4 * 3.5e-3**2


def energy(nm: float, duration_s: float, source_mrad: float = 0.0) -> float:
    return iec.class_1_energy_j(wavelength_m=nm * 1e-9, duration_s=duration_s, source_rad=source_mrad * 1e-3)


def power(nm: float, duration_s: float = 100.0, source_mrad: float = 0.0) -> float:
    return energy(nm, duration_s, source_mrad) / duration_s


@pytest.mark.parametrize(
    ("nm", "expected"),
    [(840, 0.743e-3), (850, 0.778e-3), (905, 1.002e-3), (940, 1.178e-3), (1064, 1.95e-3), (1550, 10e-3)],
)
def test_continuous_light(nm: float, expected: float) -> None:
    """840 nm: KE. The others: 0.39 mW times C4 by hand, and 10 mW above 1400 nm."""
    assert power(nm) == pytest.approx(expected, rel=1e-3)


def test_visible_light() -> None:
    """Reference: the classes' well-known 0.39 mW in the red, and 0.039 mW for blue light in the long run."""
    assert power(635) == pytest.approx(0.39e-3)
    assert iec.class_1_blue_energy_j(wavelength_m=440e-9, duration_s=100.0) == pytest.approx(0.039e-3 * 100)
    assert iec.class_1_blue_energy_j(wavelength_m=550e-9, duration_s=10.0) == pytest.approx(0.39, rel=1e-12)
    assert iec.class_1_blue_energy_j(wavelength_m=440e-9, duration_s=1.0) == math.inf
    assert iec.class_1_blue_energy_j(wavelength_m=905e-9, duration_s=100.0) == math.inf


def test_group_of_18_us_at_905_nm() -> None:
    """Reference: V, 497 nJ from 7e-4 t^0.75 C4 with C4 = 2.57."""
    assert energy(905, 18e-6) == pytest.approx(497e-9, rel=2e-3)


@pytest.mark.parametrize(
    ("nm", "duration_s", "limit_j"),
    [
        (532, 6e-9, 77e-9),
        (905, 6e-9, 197.9e-9),
        (940, 1e-9, 232.5e-9),
        (1064, 6e-9, 770e-9),
        (1180, 6e-9, 770e-9 * 10**0.54),  # C7
        (1550, 6e-9, 8e-3),
        (1550, 1e-10, 8e-4),
        (1450, 6e-9, 8e-4),
        (905, 5e-12, 38e-9),
    ],
)
def test_short_pulses(nm: float, duration_s: float, limit_j: float) -> None:
    """Reference: table 3, 0.77e-7 C4 J and its neighbours; C4 = 10^0.41 at 905 nm and 10^0.48 at 940 nm."""
    assert energy(nm, duration_s) == pytest.approx(limit_j, rel=1e-3)


@pytest.mark.parametrize(
    ("nm", "duration_s", "exposure_j_m2", "area_m2"),
    [
        (600, 1e-8, 2e-3, PUPIL_M2),
        (905, 1e-8, 2e-3 * 10**0.41, PUPIL_M2),
        (1064, 1e-8, 2e-2, PUPIL_M2),
        (905, 1e-3, 18 * 10**0.41 * 1e-3**0.75, PUPIL_M2),
        (1100, 1e-3, 90 * 1e-3**0.75, PUPIL_M2),
        (905, 100.0, 10 * 10**0.41 * 100, PUPIL_M2),
        (1450, 1e-6, 1e3, ONE_MM_M2),
        (1450, 0.1, 5600 * 0.1**0.25, ONE_MM_M2),
        (1550, 1e-6, 1e4, ONE_MM_M2),
        (1550, 0.1, 1e4, ONE_MM_M2),
        (1550, 100.0, 1e3 * 100, CW_M2),
        (2000, 100.0, 1e3 * 100, CW_M2),
    ],
)
def test_limit_is_exposure_limit_times_aperture(nm, duration_s, exposure_j_m2, area_m2):
    """Reference: ICNIRP; the AEL tables round to two digits, so 4 %."""
    assert energy(nm, duration_s) == pytest.approx(exposure_j_m2 * area_m2, rel=0.04)


@given(nm=st.floats(400, 2599), t=st.floats(-12.9, 4.4))
def test_longer_emissions_may_hold_more(nm: float, t: float) -> None:
    """Apart from steps down where the two-digit figures of two ranges meet, of 6 % at most."""
    assert energy(nm, 10 ** (t + 0.05)) >= 0.94 * energy(nm, 10**t)


@given(nm=st.floats(400, 2599), t=st.floats(-12.9, 4.3))
def test_longer_emissions_may_be_weaker(nm: float, t: float) -> None:
    """The power allowed falls, once past the step up from the limit for ultrashort pulses at 10 ps.

    Apart from steps up where the two-digit figures of two ranges meet, at 0.35 s: of 3.5 % at most.
    """
    if t > -11:
        assert power(nm, 10 ** (t + 0.05)) <= 1.035 * power(nm, 10**t)


@given(nm=st.floats(400, 1399), t=st.floats(-11, 4.4), mrad=st.floats(0, 200), more=st.floats(0, 100))
def test_larger_sources_may_be_stronger(nm: float, t: float, mrad: float, more: float) -> None:
    """Up to the 1 % by which 3.9e-4 and 7e-4 * 10^-0.25 differ where a point becomes a source."""
    small, large = energy(nm, 10**t, mrad), energy(nm, 10**t, mrad + more)
    assert 0.99 * small <= large <= 1.02 * 100 / 1.5 * max(small, energy(nm, 10**t))


@pytest.mark.parametrize("nm", [700, 1050, 1150, 1200])
def test_no_steps_in_the_factors(nm: float) -> None:
    below, above = (nm - 1e-6) * 1e-9, (nm + 1e-6) * 1e-9
    assert iec.c4(wavelength_m=below) == pytest.approx(iec.c4(wavelength_m=above), rel=3e-3)
    assert iec.c7(wavelength_m=below) == pytest.approx(iec.c7(wavelength_m=above), rel=0.02)


def test_factors_at_their_ends() -> None:
    """Reference: table 9, and ICNIRP's C_A, C_C and T_2, which are C4, C7 and T2."""
    assert [iec.c4(wavelength_m=w * 1e-9) for w in (650, 905, 1064)] == pytest.approx([1, 2.5704, 5], rel=1e-4)
    assert [iec.c7(wavelength_m=w * 1e-9) for w in (905, 1180, 1250)] == pytest.approx([1, 3.4674, 9], rel=1e-4)
    assert [iec.t2_s(source_rad=a) for a in (0, 1.5e-3, 50.75e-3, 0.1, 1)] == pytest.approx(
        [10, 10, 10 * math.sqrt(10), 100, 100]
    )
    assert [iec.largest_source_rad(duration_s=t) for t in (1e-8, 625e-6, 0.01, 0.25, 10)] == pytest.approx(
        [5e-3, 5e-3, 20e-3, 0.1, 0.1]
    )
    assert iec.c6(source_rad=3e-3, duration_s=1e-8) == pytest.approx(2)
    assert iec.c6(source_rad=0.05, duration_s=1e-8) == pytest.approx(5 / 1.5)
    assert [iec.grouping_time_s(wavelength_m=w * 1e-9) for w in (905, 1064, 1450, 1550, 1900)] == [
        5e-6,
        13e-6,
        1e-3,
        10.0,
        1e-3,
    ]


def test_held_between_1250_and_1400_nm() -> None:
    """The retina's limit would rise a millionfold; the cornea's is another matter."""
    assert energy(1390, 1e-8) == pytest.approx(energy(1250, 1e-8))


@pytest.mark.parametrize(
    ("pulse_s", "pulses", "mrad", "expected"),
    [
        (6e-9, 1, 1.5, 1.0),
        (6e-9, 600, 1.5, 1.0),
        (6e-9, 1e4, 1.5, 0.5),
        (6e-9, 5e5, 1.5, 0.4),
        (6e-9, 5e5, 50, 0.4),
        (1e-4, 5e5, 5, 1.0),
        (1e-4, 16, 5.001, 0.5),
        (1e-4, 81, 50, 1 / 3),
        (1e-4, 1e6, 50, 0.2),
        (0.1, 1e3, 50, 0.4),
        (1e-4, 1e6, 101, 1.0),
        (0.3, 100, 1.5, 1.0),
    ],
)
def test_many_pulses(pulse_s: float, pulses: float, mrad: float, expected: float) -> None:
    """Reference: the rules of 4.3 f 3, third edition, by hand; 600 pulses step up to 1.01."""
    c5 = iec.c5(pulse_s=pulse_s, pulses=pulses, source_rad=mrad * 1e-3, grouping_s=5e-6, time_base_s=100.0)
    assert c5 == pytest.approx(expected)


@given(first=st.floats(1, 1e7), more=st.floats(1, 1e3))
def test_more_pulses_never_help(first: float, more: float) -> None:
    first_c5, total_c5 = (
        iec.c5(pulse_s=6e-9, pulses=n, source_rad=0.0, grouping_s=5e-6, time_base_s=100.0)
        for n in (first, first * more)
    )
    assert 0.4 <= total_c5 <= 1.02 * first_c5


def test_apertures_and_distances() -> None:
    """Reference: table 10."""
    eye = [iec.aperture_diameter_m(wavelength_m=1550e-9, duration_s=t) for t in (1e-8, 0.35, 1.0, 10.0)]
    assert eye == pytest.approx([1e-3, 1e-3, 1.5e-3, 3.5e-3])
    assert iec.aperture_diameter_m(wavelength_m=905e-9, duration_s=1e-8) == 7e-3
    assert iec.aperture_diameter_m(wavelength_m=905e-9, duration_s=1e-8, telescope=True) == 50e-3
    assert iec.aperture_diameter_m(wavelength_m=1550e-9, duration_s=10.0, telescope=True) == 24.5e-3
    assert (iec.measuring_distance_m(), iec.measuring_distance_m(telescope=True)) == (0.1, 2.0)


@pytest.mark.parametrize(("diameter_63_mm", "share"), [(3.294, 0.989), (23.53, 0.085)])
def test_share_of_a_beam(diameter_63_mm: float, share: float) -> None:
    """Reference: KE, a 7 mm aperture; a beam's 1/e^2 diameter is sqrt(2) times its 63 % diameter."""
    fraction = iec.fraction_through_aperture(beam_diameter_m=math.sqrt(2) * diameter_63_mm * 1e-3, aperture_m=7e-3)
    assert fraction == pytest.approx(share, abs=5e-4)


def test_unknown_beam_enters_whole() -> None:
    assert iec.fraction_through_aperture(beam_diameter_m=0.0, aperture_m=7e-3) == 1.0


def test_beam_grows() -> None:
    diameters_m = [iec.beam_diameter_m(exit_diameter_m=3e-3, divergence_rad=2e-3, distance_m=r) for r in (0, 2, 1000)]
    assert diameters_m == pytest.approx([3e-3, 5e-3, 2.0], rel=1e-5)


@pytest.mark.parametrize("nm", [355, 399.9, 2600, 10600])
def test_wavelengths_beyond_the_tables(nm: float) -> None:
    with pytest.raises(ValueError, match="wavelength must be 400 to 2600 nm, got"):
        energy(nm, 1e-8)


@pytest.mark.parametrize("duration_s", [1e-14, 1e5])
def test_durations_beyond_the_tables(duration_s: float) -> None:
    with pytest.raises(ValueError, match="emission duration"):
        energy(905, duration_s)
