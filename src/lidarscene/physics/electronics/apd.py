"""Linear-mode avalanche photodiode with a transimpedance amplifier: signal and noise, (12)-(20).

All currents are at the amplifier's input, after multiplication.
"""

from __future__ import annotations

from dataclasses import dataclass

from ...maths.arrays import Lanes, xp
from ..constants import BOLTZMANN_J_K, ELEMENTARY_CHARGE_C


def responsivity_a_w(*, quantum_efficiency: Lanes, photon_energy_j: Lanes) -> Lanes:
    """K_PD = e eta_d / (h nu), ampere per watt before multiplication, (12)."""
    return ELEMENTARY_CHARGE_C * quantum_efficiency / photon_energy_j


def gain_from_bias(*, bias_v: Lanes, breakdown_v: Lanes, exponent: Lanes) -> Lanes:
    """Multiplication factor from the bias (Miller).

    The text under (12) prints (1 - V_bias / V_bd)^-n; Miller's formula is 1 / (1 - (V / V_bd)^n), see
    `gain_from_bias_miller`. This is the form as printed.
    """
    ops = xp(bias_v, breakdown_v, exponent)
    return ops.exp(-exponent * ops.log(1.0 - bias_v / breakdown_v))


def gain_from_bias_miller(*, bias_v: Lanes, breakdown_v: Lanes, exponent: Lanes) -> Lanes:
    """M = 1 / (1 - (V / V_bd)^n), S. L. Miller, Phys. Rev. 99, 1234 (1955)."""
    ops = xp(bias_v, breakdown_v, exponent)
    return 1.0 / (1.0 - ops.exp(exponent * ops.log(bias_v / breakdown_v)))


def excess_noise_power_law(*, gain: Lanes, index: Lanes) -> Lanes:
    """F = M^x, the approximation the paper computes with."""
    ops = xp(gain, index)
    return ops.exp(index * ops.log(gain))


def excess_noise_mcintyre(*, gain: Lanes, ionisation_ratio: Lanes) -> Lanes:
    """F = k M + (1 - k)(2 - 1 / M), McIntyre (1966), for the ratio k of the ionisation rates."""
    return ionisation_ratio * gain + (1.0 - ionisation_ratio) * (2.0 - 1.0 / gain)


def signal_a(*, responsivity_a_w: Lanes, gain: Lanes, power_w: Lanes) -> Lanes:
    """Peak signal current, (12)."""
    return responsivity_a_w * gain * power_w


def light_shot_variance_a2(
    *, responsivity_a_w: Lanes, gain: Lanes, excess_noise: Lanes, bandwidth_hz: Lanes, power_w: Lanes
) -> Lanes:
    """Shot noise of light on the diode: (14) for the echo, (15) for the background."""
    return 2.0 * ELEMENTARY_CHARGE_C * responsivity_a_w * power_w * gain * gain * excess_noise * bandwidth_hz


def dark_shot_variance_a2(
    *,
    surface_dark_current_a: Lanes,
    bulk_dark_current_a: Lanes,
    gain: Lanes,
    excess_noise: Lanes,
    bandwidth_hz: Lanes,
) -> Lanes:
    """Shot noise of the surface (not multiplied) and bulk (multiplied) dark currents, (16)."""
    multiplied = surface_dark_current_a + bulk_dark_current_a * gain * gain * excess_noise
    return 2.0 * ELEMENTARY_CHARGE_C * multiplied * bandwidth_hz


def thermal_variance_a2(*, temperature_k: Lanes, load_resistance_ohm: Lanes, bandwidth_hz: Lanes) -> Lanes:
    """Johnson noise of the load, (17)."""
    return 4.0 * BOLTZMANN_J_K * temperature_k * bandwidth_hz / load_resistance_ohm


def shot_variance_per_ampere_a(*, gain: Lanes, excess_noise: Lanes, bandwidth_hz: Lanes) -> Lanes:
    """kappa with sigma_s^2 = kappa i_s: (14) against (12). The echo's own noise at a signal level i_s."""
    return 2.0 * ELEMENTARY_CHARGE_C * gain * excess_noise * bandwidth_hz


def total_noise_a(
    *,
    signal_variance_a2: Lanes,
    background_variance_a2: Lanes,
    dark_variance_a2: Lanes,
    thermal_variance_a2: Lanes,
    circuit_noise_a: Lanes,
) -> Lanes:
    """sigma_APD, (13): all five sources, which are independent. With no signal variance it is (18)."""
    variance = (
        signal_variance_a2 + background_variance_a2 + dark_variance_a2 + thermal_variance_a2
    ) + circuit_noise_a * circuit_noise_a
    return xp(variance).sqrt(variance)


@dataclass(frozen=True, slots=True, kw_only=True)
class Diode:
    """An avalanche photodiode; the bulk dark current is multiplied, the surface's is not."""

    responsivity_a_w: Lanes
    gain: Lanes
    excess_noise: Lanes
    surface_dark_current_a: Lanes
    bulk_dark_current_a: Lanes


@dataclass(frozen=True, slots=True, kw_only=True)
class Amplifier:
    """What follows the diode: its load, its bandwidth and the noise of the rest of the circuit."""

    bandwidth_hz: Lanes
    temperature_k: Lanes
    load_resistance_ohm: Lanes
    circuit_noise_a: Lanes = 0.0


def noise_without_echo_a(diode: Diode, amplifier: Amplifier, *, background_power_w: Lanes) -> Lanes:
    """sigma_APD(i(P_rs)), (18): (13) with (15)-(17) and without (14). White noise within the bandwidth."""
    avalanche = {
        "gain": diode.gain,
        "excess_noise": diode.excess_noise,
        "bandwidth_hz": amplifier.bandwidth_hz,
    }
    return total_noise_a(
        signal_variance_a2=0.0,
        background_variance_a2=light_shot_variance_a2(
            responsivity_a_w=diode.responsivity_a_w, power_w=background_power_w, **avalanche
        ),
        dark_variance_a2=dark_shot_variance_a2(
            surface_dark_current_a=diode.surface_dark_current_a,
            bulk_dark_current_a=diode.bulk_dark_current_a,
            **avalanche,
        ),
        thermal_variance_a2=thermal_variance_a2(
            temperature_k=amplifier.temperature_k,
            load_resistance_ohm=amplifier.load_resistance_ohm,
            bandwidth_hz=amplifier.bandwidth_hz,
        ),
        circuit_noise_a=amplifier.circuit_noise_a,
    )


def snr(*, responsivity_a_w: Lanes, gain: Lanes, echo_power_w: Lanes, noise_a: Lanes) -> Lanes:
    """SNR_APD, (19): (12) over (18), which is ``noise_a``."""
    return signal_a(responsivity_a_w=responsivity_a_w, gain=gain, power_w=echo_power_w) / noise_a


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

    The paper's a K P_rs, b and c are the variances of the background's and of the bulk dark current's shot
    noise at gain one, and of all that is not multiplied: surface dark current, load, circuit.
    """
    ops = xp(gain, excess_noise_index, optical_variance_a2)
    grown = ops.exp((2.0 + excess_noise_index) * ops.log(gain))
    variance = (optical_variance_a2 + bulk_dark_variance_a2) * grown + unmultiplied_variance_a2
    return signal_at_unit_gain_a * gain / ops.sqrt(variance)


def gain_of_equal_noise(
    *, multiplied_variance_a2: Lanes, unmultiplied_variance_a2: Lanes, excess_noise_index: Lanes
) -> Lanes:
    """Gain at which the multiplied noise equals the rest: the best gain as the text after (20) states it.

    It is not the best one unless x = 2: `best_gain`. 13.5 at Table 1 where 30.9 is best.
    """
    ratio = unmultiplied_variance_a2 / multiplied_variance_a2
    ops = xp(ratio)
    return ops.exp(ops.log(ratio) / (2.0 + excess_noise_index))


def best_gain(
    *, multiplied_variance_a2: Lanes, unmultiplied_variance_a2: Lanes, excess_noise_index: Lanes
) -> Lanes:
    """Gain of the best SNR, from d SNR / dM = 0: M^(2+x) = 2 c / (x (a + b)).

    multiplied_variance_a2 is (a + b): background and bulk-dark shot noise at gain one; unmultiplied is c.
    The text after (20) says that optical and electrical noise are equal there; the derivative says that the
    multiplied noise is 2/x times the unmultiplied one (6.7 times at x = 0.3).
    """
    ratio = 2.0 * unmultiplied_variance_a2 / (excess_noise_index * multiplied_variance_a2)
    ops = xp(ratio)
    return ops.exp(ops.log(ratio) / (2.0 + excess_noise_index))


def best_gain_mcintyre(
    *, multiplied_variance_a2: Lanes, unmultiplied_variance_a2: Lanes, ionisation_ratio: Lanes
) -> Lanes:
    """Gain of the best SNR with McIntyre's F: the root of k M^3 + (1 - k) M = 2 c / (a + b), by a hyperbolic sine.

    Variances as in `best_gain`. 0 < k < 1; the gain may come out below one, which means one.
    """
    k = ionisation_ratio
    linear = (1.0 - k) / k
    constant = 2.0 * unmultiplied_variance_a2 / (multiplied_variance_a2 * k)
    ops = xp(constant, linear)
    scale = ops.sqrt(linear / 3.0)
    x = 0.5 * constant / (scale * scale * scale)
    # asinh(x) = log(x + sqrt(1 + x^2)), x > 0; sinh(y) of a third of it.
    third = ops.log(x + ops.sqrt(1.0 + x * x)) / 3.0
    return scale * (ops.exp(third) - ops.exp(-third))
