"""Render frames: a scene and a sensor in, point clouds out.

A `Simulator` compiles a scene once and renders frames of it. The chain of stages is written down in `stages`, as it is
in docs/architecture.md; the other modules take it through a frame in chunks, so that memory does not grow with it.

api        `render` and `render_frames`: names or files in
options    `TraceOptions`, `FrameOptions`, `Observers`
simulator  `Simulator`: frames, chunk by chunk
stages     the chain on the device
frame      pulses, times and places of one frame
tiles      the order in which pulses are traced
chunk      some pulses after all stages
summary    what happened, counted
metadata   what a cloud says of its frame
rig        a simulator for each sensor of a rig
live       a simulator whose world is changed from frame to frame
"""
