"""Fit: numbers of a sensor from its recordings, with uncertainties, and the directions that they leave open.

recorded_pulses       recorded pulses side by side, and blocks of columns
near_field            photons of a white target over the range: K, R0, sharpness
threshold             chance of a return over SIGNAL and NEAR_IR: floor, slope, width
scatter               scatter of the range over SIGNAL: c and floor
row_gains             gains of the rows
pixels_at_rest        pixels of frames of a sensor at rest, on surfaces whose lean is known
board_law             what a sensor reads of boards, without chance, over power and length of the echo
at_rest               noise and losses at rest: energy, jitter, beam on slopes, chatter, columns that share noise
tuning                numbers of the fit that no source gives, and what each is worth
estimates             Fisher matrix, block bootstrap
products              products of a sensor file's numbers that are known, and directions that are not
published_fit         power, noise and background by all ranges that a maker publishes
sensor_text           sensor file of the fitted unit
recording_fit         all of these for one recording
fit_report            page, JSON, text
on_scene              fit with a twin, or any known scene

Fits with and without a scene are two, since the likelihood of a known surface does not apply to an unknown one. Were
every pulse its own surface, its range and reflectivity would take up scatter and near field, which patches and the
maker's REFLECTIVITY determine instead. The filter's output scatters by some 0.9 photons at a recorded SIGNAL, and by
2.9 at an expected one (OS1, 400 counts of background): most of the threshold's width would be taken for the filter's.
"""
