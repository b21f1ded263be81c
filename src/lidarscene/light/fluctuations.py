"""Fluctuations: echoes that scatter about their mean, by speckle, by turbulence, and with the energy of the pulses.

One draw for each pulse moves all of its light together, and so the time at which it crosses a threshold. The
comparator sees the power that was drawn; SNR and P_d of a point are those of the mean echo and of all echoes
(docs/theory_light.md 10). Where a pulse meets no surface, the light
of the air comes from many particles at all ranges, and does not fluctuate.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..maths import random
from ..maths.arrays import Lanes
from ..maths.random import Seed
from ..physics.optics import receiver, scintillation
from ..physics.optics.radiometry import disc_radius_m
from ..scene.scene import Air
from ..sensor.sensor_model import Sensor, Speckle
from .echoes import Echoes, Fluctuation


@dataclass(frozen=True, slots=True, kw_only=True)
class FluctuationLaw:
    """Numbers of laser and air that say how much echoes fluctuate.

    Attributes:
        half_divergence_rad: half divergence of the beam
        exit_radius_m: radius of the beam at the exit
        sweep_rad: angle over which it turns while the shots of a point are summed
        speckle: None: the surface has no speckle
        structure_constant: C_n^2 of the air [m^(-2/3)]; None: it is calm
        energy_variance: relative variance of the energy of a point's pulses; None: all have the same
    """

    wavelength_m: Lanes
    half_divergence_rad: Lanes
    exit_radius_m: Lanes
    sweep_rad: Lanes
    speckle: Speckle | None
    structure_constant: Lanes | None
    energy_variance: Lanes | None

    @classmethod
    def of(cls, sensor: Sensor, air: Air) -> FluctuationLaw | None:
        """Gather the numbers; None if nothing fluctuates."""
        laser = sensor.laser
        if laser.speckle is None and laser.energy_spread is None and not air.structure_constant:
            return None
        energy_variance = None if laser.energy_spread is None else laser.energy_spread * laser.energy_spread
        if energy_variance is not None and sensor.histogram is not None:
            energy_variance = energy_variance / sensor.histogram.shots
        return cls(
            wavelength_m=laser.wavelength_m,
            half_divergence_rad=laser.spot.half_divergence_rad,
            exit_radius_m=laser.spot.exit_radius_m,
            sweep_rad=sensor.sweep_rad,
            speckle=laser.speckle,
            structure_constant=air.structure_constant or None,
            energy_variance=energy_variance,
        )

    def variance(self, *, range_m: Lanes, cos_incidence: Lanes, aperture_m2: Lanes) -> Lanes:
        """Relative variance of echoes' powers, (n,): that of energy, speckle and turbulence together."""
        radius_m, variance = disc_radius_m(area_m2=aperture_m2), 0.0 * range_m
        if self.structure_constant is not None:
            variance = scintillation.turbulence_variance(
                structure_constant=self.structure_constant,
                range_m=range_m,
                wavelength_m=self.wavelength_m,
                aperture_radius_m=radius_m,
            )
        if self.speckle is not None:
            spot_rad = receiver.spot_radius_rad(
                exit_radius_m=self.exit_radius_m, half_divergence_rad=self.half_divergence_rad, range_m=range_m
            )
            cells = scintillation.speckle_cells(
                spot_rad=spot_rad,
                range_m=range_m,
                aperture_radius_m=radius_m,
                wavelength_m=self.wavelength_m,
                linewidth_m=self.speckle.linewidth_m,
                cos_incidence=cos_incidence,
            ) * scintillation.swept_patterns(spot_rad=spot_rad, sweep_rad=self.sweep_rad)
            # Independent factors: (1 + v_1)(1 + v_2) - 1.
            variance = variance + (1.0 + variance) / cells
        if self.energy_variance is not None:
            variance = variance + (1.0 + variance) * self.energy_variance
        return variance


def fluctuate(light: Echoes, variance: Lanes, *, seed: Seed, pulse: Lanes) -> Echoes:
    """Draw the powers of echoes about their means.

    Args:
        variance: (n,) `FluctuationLaw.variance`
        pulse: (n,) pulse number of each ray: rays of one pulse share the draw
    """
    deviate, _ = random.normal_pair(random.words(seed=seed, stage=random.Stage.FLUCTUATION, pulse=pulse))
    drawn = scintillation.relative_power(deviate, variance)
    return replace(
        light, peak_power_w=light.peak_power_w * drawn, fluctuation=Fluctuation(variance=variance, relative_power=drawn)
    )
