"""Fit: what a recording says of its sensor, with uncertainties, and what it cannot say.

pulses      what is recorded of each pulse, and blocks of columns
near_field  photons of a white target over the range: K, R0, sharpness
threshold   kept and lost over SIGNAL and NEAR_IR: floor, slope, width
scatter     of the range over SIGNAL: c and floor
rows        gains of the rows
estimates   solver, Fisher matrix, block bootstrap
known_scene  a sensor before known surfaces: what is expected of each pulse
likelihood  the numbers at which that is likeliest, by exact slopes, reflectivities profiled out
products    which products of a sensor file's numbers are known, and which directions are not
unit        the sensor file
report      page, JSON, text
study       all of it
on_scene    a recording before a twin, or any scene that is known
"""
