"""Twin of a recording: its scene as small measured surfaces, and the comparison of simulation and recording there.

sensor_grid            list of points on the grid of its sensor
recorded_beams         sensor file with the beams and the turn of a list
ground                 plane of the ground, and the points on it
planes                 plane through each pixel and its neighbours
apparent_reflectivity  reflectivity from the strength of a return
reading_noise          surfaces without the noise of the sensor's readings
surfels                quads of a sweep of rows and columns, the ground completed
frame_poses            pose of the sensor in each frame
twin_files             files of a twin
matched_pulses         recording and simulation of a frame, pulse by pulse
tuning                 numbers of the twin that no source gives, and what each is worth
judge                  differences between them, and their limits
repeats                losses and noise of pixels of a sensor at rest
side_figures           losses, noise and photons of both sides as figures
told_apart             accuracy of a classifier of both sides
certificate            verdict, page and JSON
"""
