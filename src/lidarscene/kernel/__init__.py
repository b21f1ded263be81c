"""All code that uses Mitsuba and Dr.Jit: scenes in, geometry and scattering out.

A ray tracer on a just-in-time compiler has special rules: what is a number in a kernel, what is memory, how many
scenes one kernel may ask. They are kept here, so that physics and electronics are plain formulas on arrays. No module
elsewhere imports Mitsuba (`maths.arrays` calls functions of Dr.Jit).

device  choose a back end, move numbers, record kernels
world   a scene as Mitsuba scenes and tables
rays    the ray queries of a frame, and the points off the device
"""
