"""How far a sensor sees, how well, and what limits it.

A target at a distance is one pulse with a known echo: SNR, detection and range error follow in closed form from the
stages of the simulation, over any axis and for any sensor.

plane          SNR and range limit of a flat target
statistics     detection, false alarms and range error
axes           what can be varied
subjects       which sensors, with which changes
curves         values over an axis, and their crossings
gain           the best gain of an APD
derivatives    derivatives by Dr.Jit, or by differences
sensitivities  what a change of each number costs
aperture       what is left of the receiver off its axis
report         the report of `range`
summary        its summary
"""
