"""Render many frames on many processes.

Training data need thousands of frames, with changed scenes, sensors and seeds. A frame is named by a hash of everything
it depends on, and written whole or not at all. So any process may render any frame at any time, a finished frame is
never rendered again, and neither a data base nor the scheduler holds any state.

job_file  the job file: what to render
tasks     the frames of a job, each named by its hash
dataset   data sets: parts, places, tables
drives    whole drives: their frames in one file
store     the folder of a job: clouds and a row for each
work      one frame in a worker process
cluster   processes on this machine, or a Dask scheduler
dispatch  `run_job`: hand out the frames that are missing
job_run   `batch`: a job file and a folder in, its progress out
manifest  one Parquet table of all frames
"""

from ..rendering.option_fields import Whole

WORKERS = Whole(1, 1024)
"""Numbers of processes of this machine."""
