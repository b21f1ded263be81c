"""Render frames: a scene and a sensor in, point clouds out.

A `Simulator` compiles a scene once and renders frames of it. The chain of stages is written down in `stages`, as it is
in ARCHITECTURE.md; the other modules take it through a frame in chunks, so that memory does not grow with it.

api             `render` and `render_frames`: names or files in
render_options  `TraceOptions`, `FrameOptions`, `Observers`
simulator       `Simulator`: frames, chunk by chunk, and the metadata of their clouds
option_fields   an option's values, help and name, declared on its field
stages          the chain on the device
frame           pulses, times and places of one frame
tiles           the order in which pulses are traced
chunk           the pulses of a chunk after all stages
frame_summary   `Summary`: pulses by outcome, points, seconds by stage
rig_simulators  a simulator for each sensor of a rig
live_simulator  `LiveSimulator`: its world is changed between frames
surroundings    one line on the scene around the sensor, and warnings
import_report   what a mesh file, a stage or a Mitsuba scene holds
extremes        the input to blame for a frame with NaN
"""
