"""A small head whose 16 lasers fire at once, 64 columns to a turn, and see each other's light."""

import tomllib

from lidarscene import Sensor
from lidarscene.sensor.sensor_file import sensor_from_tables

LASERS, COLUMNS = 16, 64

TABLES = tomllib.loads(f"""
name = "volley"
laser = {{wavelength_nm = 905, peak_power_w = 20.0, pulse_fwhm_ns = 4.0}}
optics = {{aperture_radius_mm = 10, focal_length_mm = 30, efficiency_laser = 0.7, efficiency_sun = 0.7, \
sun_irradiance_w_m2 = 5.0, stray = {{share = 1e-3, half_angle_deg = 2.0, veil = 1e-4}}}}
scanner = {{type = "spinning", rotation_hz = 10, columns_per_turn = {COLUMNS}, start_azimuth_deg = 0, \
elevation_deg = {[float(row) for row in range(LASERS)]}}}
detector = {{type = "apd", gain = 80, radius_mm = 0.1, quantum_efficiency = 0.7, surface_dark_current_na = 0.1, \
bulk_dark_current_na = 0.1, excess_noise_index = 0.3, load_resistance_ohm = 10000, temperature_k = 300}}
tdc = {{window_us = 2.0, bandwidth_mhz = 110, threshold_to_noise = 8.0, stops = 3}}
""")


def sensor(*overrides: str) -> Sensor:
    return sensor_from_tables(TABLES, where="volley", overrides=overrides)
