"""A SiPM simulated cell by cell in time.

The formulas of `physics.electronics.sipm` assume a steady state and independent cells. Here each cell fires, recovers
and triggers its neighbours in time, so that documentation and tests can say how good the formulas are. It is no part of
the product.

cells          the cells, the light on them, when one would fire
coupled        cells that fire each other: crosstalk, afterpulses
events         when the cells fire
output         what they add up to at the output
working_point  noise, detection and timing, shot by shot
table          response tables, by events and by equation
"""
