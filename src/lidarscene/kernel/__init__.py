"""The only files that know Mitsuba and Dr.Jit: scenes in, geometry and scattering out."""
