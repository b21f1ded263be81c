"""The twin of a recording: its scene as small measured surfaces, and the simulation held to the recording there.

planes    a plane through each pixel and its neighbours
reflect   what a pixel's strength says of its reflectivity
surfels   quads of a sweep of rows and columns, the ground completed
listed    quads of a list of points
places    where the sensor stood in each frame
build     the files of a twin
pulses    recording and simulation of a frame, pulse by pulse
judge     how far apart they are, and what is allowed
page      the page and the JSON of it
"""
