"""Mathematics without physics.

The chain of the simulation is written once and runs on NumPy and on Dr.Jit arrays. The functions that make this
possible are here, with the geometry, the trajectories and the random numbers that everything else stands on.

arrays        the functions that NumPy and Dr.Jit share
lanes         types of their arrays, masks and functions
vectors       reflection, refraction and angles on tuples (x, y, z)
pose          rigid poses and directions
rotations     quaternions and angles
trajectory    smooth rigid motions, in double precision
motion_table  the same as tables for the device
box_tree      boxes around what moves, in a tree
random        random numbers keyed by pulse
units         the unit, bounds and name in files of a number
attributes    names that objects of all classes lack, and what does it
special       special functions with accurate tails
"""
