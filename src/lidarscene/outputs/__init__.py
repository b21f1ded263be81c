"""The files of a frame.

A frame becomes clouds, labels, data sets, pictures and reports, all written while it is traced: a frame need not fit
into memory. `record` is what the command `render` calls, and what Python can call with the same result.

record       render and write frames
options      `Outputs`: which files
plan         their names, checked before any work
streams      clouds in pieces into one file
frame_files  all files of one frame
missed       pulses without a point, and why
light        ambient counts and waveforms
range_image  pictures of ring by azimuth
captures     packets of all frames in one file
live/        packets over UDP in real time
report       the summary as text and JSON
"""
