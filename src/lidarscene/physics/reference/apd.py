"""Avalanche photodiode: the paper's noise and SNR as it writes them, (12), (13), (18), (19).

Nothing in a render or a study runs this: tests compare with it what does (`lidarscene.physics.reference`).
"""

from __future__ import annotations

from dataclasses import dataclass

from ...maths.arrays import Lanes, xp
from ..electronics.apd import dark_shot_variance_a2, light_shot_variance_a2, thermal_variance_a2


def signal_a(*, responsivity_a_w: Lanes, gain: Lanes, power_w: Lanes) -> Lanes:
    """Peak signal current i_s = K M P_r, (12)."""
    return responsivity_a_w * gain * power_w


def total_noise_a(
    *,
    signal_variance_a2: Lanes,
    background_variance_a2: Lanes,
    dark_variance_a2: Lanes,
    thermal_variance_a2: Lanes,
    circuit_noise_a: Lanes,
) -> Lanes:
    """sigma_APD, (13): root of the sum of five independent variances. Without signal variance it is (18)."""
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
    """Amplifier behind the diode: load, bandwidth and the noise of the rest of the circuit."""

    bandwidth_hz: Lanes
    temperature_k: Lanes
    load_resistance_ohm: Lanes
    circuit_noise_a: Lanes = 0.0


def noise_without_echo_a(diode: Diode, amplifier: Amplifier, *, background_power_w: Lanes) -> Lanes:
    """sigma_APD(i(P_rs)), (18): (13) with (15)-(17) and without (14). Noise is white within the bandwidth."""
    avalanche = {"gain": diode.gain, "excess_noise": diode.excess_noise, "bandwidth_hz": amplifier.bandwidth_hz}
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
    """SNR_APD, (19): signal (12) over noise without echo (18)."""
    return signal_a(responsivity_a_w=responsivity_a_w, gain=gain, power_w=echo_power_w) / noise_a
