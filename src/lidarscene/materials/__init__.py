"""Materials: how surfaces reflect light, by wavelength; their files, and those of the catalogue."""
