"""Physical constants, CODATA 2018 (exact since the 2019 revision of the SI)."""

import math

SPEED_OF_LIGHT_M_S = 299_792_458.0
"""Source: the SI's definition of the metre; exact."""

PLANCK_J_S = 6.626_070_15e-34
"""Source: the SI's definition of the kilogram; exact."""

ELEMENTARY_CHARGE_C = 1.602_176_634e-19
"""Source: the SI's definition of the ampere; exact."""

BOLTZMANN_J_K = 1.380_649e-23
"""Source: the SI's definition of the kelvin; exact."""

STANDARD_GRAVITY_M_S2 = 9.80665
"""Source: BIPM, 3rd CGPM, 1901; gravity by definition. On the ground it is 9.780 to 9.832 m/s2."""

NEPERS_PER_DECIBEL = math.log(10.0) / 10.0
"""ln(power ratio) of one decibel."""

KOSCHMIEDER = 3.912
"""Source: Koschmieder, -ln(0.02): the 2 % contrast that defines meteorological visibility. V times the extinction."""

REFERENCE_ILLUMINANCE_KLUX = 100.0
"""Source: Table 1 of the paper; illuminance at which a sensor file states its in-band solar irradiance."""

SUN_KLUX = 140.0
"""Source: Darula, Kittler and Gueymard, Solar Energy 79, 2005; no sun is brighter: outside of the atmosphere it has 133
klux at the mean distance, 138 at the least distance."""
