"""Units: what a maker says of one sensor (its beams, exits and modes) in, a sensor file of it out.

beams     the bank of beams of one unit, and who reads which file
ouster    metadata, json
velodyne  calibration, YAML and XML
hesai     table of angles, CSV
written   the catalogue's file of the model with the unit's beams in place
"""
