"""A SiPM simulated avalanche by avalanche: validation of the equations in `physics.electronics.sipm_response`."""
