"""Render many frames on many processes.

Training data need thousands of frames, with changed scenes, sensors and seeds. A frame is named by a hash of everything
it depends on, and written whole or not at all. So a frame may be done twice, anywhere, at any time, what is done is
never done again, and neither a data base nor the scheduler holds any state.

file      the job file: what to render
tasks     the frames of a job, each named by its hash
store     the folder of a job: clouds and a row for each
work      what a worker process does with one frame
cluster   processes on this machine, or a Dask scheduler
run       hand out the frames that are missing
manifest  one Parquet table of all frames
"""
