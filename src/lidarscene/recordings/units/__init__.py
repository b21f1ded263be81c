"""Units: a maker's description of one sensor (its beams, exits and modes) in, a sensor file of it out.

unit_beams     bank of beams of one unit
ouster_unit    Ouster: metadata, json
velodyne_unit  Velodyne: calibration, YAML and XML
hesai_unit     Hesai: table of angles, CSV, or an AT128's file of corrections
unit_file      the catalogue's file of the model with the unit's beams in place
"""
