"""Range, detection probability and range error of a sensor, and what limits them.

A target at a distance is one pulse with a known echo: SNR, detection and range error follow in closed form from the
stages of the simulation, over any axis and for any sensor.

plane          SNR and range limit of a flat target
statistics     false alarms among the points of a frame
conditions     target, light and air, their bounds and defaults
sweep_axes     what can be varied
subjects       which sensors, with which changes
curves         values over an axis, and their crossings
gain           the best gain of an APD
sensitivities  what a change of each number costs
aperture_laws  what is left of the receiver off its axis
sweep_report   table, CSV, JSON and chart of a sweep
range_summary  range without a sweep
"""
