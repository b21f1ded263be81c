"""Physical constants, CODATA 2018 (exact since the 2019 revision of the SI)."""

SPEED_OF_LIGHT_M_S = 299_792_458.0
"""Source: the SI's definition of the metre; exact."""

PLANCK_J_S = 6.626_070_15e-34
"""Source: the SI's definition of the kilogram; exact."""

ELEMENTARY_CHARGE_C = 1.602_176_634e-19
"""Source: the SI's definition of the ampere; exact."""

BOLTZMANN_J_K = 1.380_649e-23
"""Source: the SI's definition of the kelvin; exact."""

REFERENCE_ILLUMINANCE_KLUX = 100.0
"""Source: Table 1 of the paper; illuminance at which a sensor file states its in-band solar irradiance."""

SUN_KLUX = 140.0
"""Source: Darula, Kittler and Gueymard, Solar Energy 79, 2005; no sun is brighter: outside of the atmosphere it has 133
klux at the mean distance, 138 at the least distance."""
