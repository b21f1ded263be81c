"""Mathematics without physics: arrays for numpy and Dr.Jit, poses, trajectories, random numbers."""
