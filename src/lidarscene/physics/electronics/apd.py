"""Linear-mode avalanche photodiode with a transimpedance amplifier: signal and noise, (12)-(20).

The signal is proportional to the light. The noise is the sum of five independent sources; the avalanche multiplies
the shot noise more than the signal, so there is a gain of best signal-to-noise ratio (20). All currents are at the
amplifier's input, after multiplication.

Symbols: K responsivity [A/W], M gain, F excess noise factor, x its index, k ionisation ratio, B bandwidth [Hz].
"""

from __future__ import annotations

from ...maths.arrays import Lanes, xp
from ..constants import BOLTZMANN_J_K, ELEMENTARY_CHARGE_C


def responsivity_a_w(*, quantum_efficiency: Lanes, photon_energy_j: Lanes) -> Lanes:
    """K_PD = e eta_d / (h nu), ampere per watt before multiplication, (12)."""
    return ELEMENTARY_CHARGE_C * quantum_efficiency / photon_energy_j


def gain_from_bias(*, bias_v: Lanes, breakdown_v: Lanes, exponent: Lanes) -> Lanes:
    """Multiplication factor from the bias, (1 - V_bias / V_bd)^-n as the text under (12) prints it.

    Miller's published formula is 1 / (1 - (V / V_bd)^n): see `gain_from_bias_miller`.
    """
    ops = xp(bias_v, breakdown_v, exponent)
    return ops.exp(-exponent * ops.log(1.0 - bias_v / breakdown_v))


def gain_from_bias_miller(*, bias_v: Lanes, breakdown_v: Lanes, exponent: Lanes) -> Lanes:
    """M = 1 / (1 - (V / V_bd)^n), S. L. Miller, Phys. Rev. 99, 1234 (1955)."""
    ops = xp(bias_v, breakdown_v, exponent)
    return 1.0 / (1.0 - ops.exp(exponent * ops.log(bias_v / breakdown_v)))


def excess_noise_power_law(*, gain: Lanes, index: Lanes) -> Lanes:
    """F = M^x, the approximation that the paper uses."""
    ops = xp(gain, index)
    return ops.exp(index * ops.log(gain))


def excess_noise_mcintyre(*, gain: Lanes, ionisation_ratio: Lanes) -> Lanes:
    """F = k M + (1 - k)(2 - 1 / M), with k the ratio of the ionisation rates, hole over electron.

    R. J. McIntyre, IEEE Trans. Electron Devices 13, 164 (1966).
    """
    return ionisation_ratio * gain + (1.0 - ionisation_ratio) * (2.0 - 1.0 / gain)


def light_shot_variance_a2(
    *, responsivity_a_w: Lanes, gain: Lanes, excess_noise: Lanes, bandwidth_hz: Lanes, power_w: Lanes
) -> Lanes:
    """Variance of the shot noise of light, 2 e K P M^2 F B: (14) for the echo, (15) for the background."""
    return 2.0 * ELEMENTARY_CHARGE_C * responsivity_a_w * power_w * gain * gain * excess_noise * bandwidth_hz


def dark_shot_variance_a2(
    *, surface_dark_current_a: Lanes, bulk_dark_current_a: Lanes, gain: Lanes, excess_noise: Lanes, bandwidth_hz: Lanes
) -> Lanes:
    """Variance of the shot noise of the dark currents, (16): surface (not multiplied) and bulk (multiplied)."""
    multiplied = surface_dark_current_a + bulk_dark_current_a * gain * gain * excess_noise
    return 2.0 * ELEMENTARY_CHARGE_C * multiplied * bandwidth_hz


def thermal_variance_a2(*, temperature_k: Lanes, load_resistance_ohm: Lanes, bandwidth_hz: Lanes) -> Lanes:
    """Variance of the Johnson noise of the load, 4 k_B T B / R, (17)."""
    return 4.0 * BOLTZMANN_J_K * temperature_k * bandwidth_hz / load_resistance_ohm


def shot_variance_per_ampere_a(*, gain: Lanes, excess_noise: Lanes, bandwidth_hz: Lanes) -> Lanes:
    """kappa = 2 e M F B: the echo's shot noise at a signal current i_s is sigma_s^2 = kappa i_s, (14) over (12)."""
    return 2.0 * ELEMENTARY_CHARGE_C * gain * excess_noise * bandwidth_hz


def snr_of_gain(
    *,
    signal_at_unit_gain_a: Lanes,
    optical_variance_a2: Lanes,
    bulk_dark_variance_a2: Lanes,
    unmultiplied_variance_a2: Lanes,
    gain: Lanes,
    excess_noise_index: Lanes,
) -> Lanes:
    """SNR_APD as a function of the gain, (20), with F = M^x.

    The paper's a K P_rs, b and c are variances: of the background's shot noise at gain one, of the bulk dark
    current's shot noise at gain one, and of everything that is not multiplied (surface dark current, load, circuit).
    """
    ops = xp(gain, excess_noise_index, optical_variance_a2)
    grown = ops.exp((2.0 + excess_noise_index) * ops.log(gain))
    variance = (optical_variance_a2 + bulk_dark_variance_a2) * grown + unmultiplied_variance_a2
    return signal_at_unit_gain_a * gain / ops.sqrt(variance)


def gain_of_equal_noise(
    *, multiplied_variance_a2: Lanes, unmultiplied_variance_a2: Lanes, excess_noise_index: Lanes
) -> Lanes:
    """Gain at which multiplied and unmultiplied noise are equal, M^(2+x) = c / (a + b).

    The text after (20) calls this the best gain. It is the best only for x = 2; see `best_gain`. At Table 1 it is
    13.5, where the best gain is 30.9.
    """
    ratio = unmultiplied_variance_a2 / multiplied_variance_a2
    ops = xp(ratio)
    return ops.exp(ops.log(ratio) / (2.0 + excess_noise_index))


def best_gain(*, multiplied_variance_a2: Lanes, unmultiplied_variance_a2: Lanes, excess_noise_index: Lanes) -> Lanes:
    """Gain of the best SNR, from d SNR / dM = 0: M^(2+x) = 2 c / (x (a + b)).

    The text after (20) says that multiplied and unmultiplied noise are equal there. The derivative says that the
    multiplied noise is 2/x times the other (6.7 times at x = 0.3).

    Args:
        multiplied_variance_a2: a + b: shot noise of background and bulk dark current at gain one
        unmultiplied_variance_a2: c: noise that is not multiplied
    """
    ratio = 2.0 * unmultiplied_variance_a2 / (excess_noise_index * multiplied_variance_a2)
    ops = xp(ratio)
    return ops.exp(ops.log(ratio) / (2.0 + excess_noise_index))


def best_gain_mcintyre(
    *, multiplied_variance_a2: Lanes, unmultiplied_variance_a2: Lanes, ionisation_ratio: Lanes
) -> Lanes:
    """Gain of the best SNR with McIntyre's F: the root of k M^3 + (1 - k) M = 2 c / (a + b).

    Variances as in `best_gain`; 0 < k < 1. A result below one means a gain of one.
    """
    k = ionisation_ratio
    linear = (1.0 - k) / k
    constant = 2.0 * unmultiplied_variance_a2 / (multiplied_variance_a2 * k)
    ops = xp(constant, linear)
    scale = ops.sqrt(linear / 3.0)
    x = 0.5 * constant / (scale * scale * scale)
    # The cubic M^3 + p M = q has one real root, 2 s sinh(asinh(x) / 3) with s = sqrt(p / 3), x = q / (2 s^3).
    # asinh(x) = log(x + sqrt(1 + x^2)); the difference of exponentials is 2 sinh.
    third = ops.log(x + ops.sqrt(1.0 + x * x)) / 3.0
    return scale * (ops.exp(third) - ops.exp(-third))
