"""What looks at the scene: laser, optics, scanner, detector, converter.

A `Sensor` is frozen data in SI units, made from a TOML file in the units that people write. Its numbers become opaque
scalars on the device, so that a changed number compiles no kernel.

model           `Sensor` and its parts
detectors       APD and SiPM, and their working point
overlap         overlap of spot and field of view, as a table
file            sensor files
optics          [optics]
scanners        [scanner], one model for each mechanism
scanner_tables  what these models share
pattern         files of scan patterns
readout         [sampler] and [intensity]
catalogue       `load_sensor`
rig             several sensors on a vehicle
rig_file        `load_rig`
"""
