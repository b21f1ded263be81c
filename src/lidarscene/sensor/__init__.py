"""Sensors: laser, optics, scanner, detector, converter.

A `Sensor` is frozen data in SI units, made from a TOML file in the units that people write. Its numbers become opaque
scalars on the device, so that a changed number compiles no kernel.

sensor_model    `Sensor` and its parts
detectors       APD and SiPM, and their working point
volleys         pulses that leave at the same instant, and their stray light
overlap         overlap of spot and field of view, as a table
sensor_file     sensor files and `load_sensor`
optics          [optics]
readout         [sampler] and [intensity]
imu             `Imu`: an inertial sensor beside the lidar
rig_file        several sensors on a vehicle, and `load_rig`
"""
