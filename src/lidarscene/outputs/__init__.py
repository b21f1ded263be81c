"""The files of a frame.

A frame becomes clouds, labels, data sets, pictures and reports, all written while it is traced: a frame need not fit
into memory. The command `render` calls `record`, and Python can call it with the same result.

record          `record`: render and write frames
output_options  `Outputs`: the choice of files
plan            names of all files, checked before any work
size            warning of the time, disk and memory of a large run
streams         clouds, data sets, missed pulses and packets, chunk by chunk
frame_files     all files of one frame
light           ambient counts and waveforms
run_motion      IMUs and poses of all frames
catalog_list    lists of the catalogue
range_image     images of ring by azimuth
live/           packets over UDP in real time
run_report      the summary of a run as text and JSON
"""
