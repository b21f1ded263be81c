"""Formulas with their sources: arrays in, arrays out. No files, no Mitsuba, no state.

"The paper" is X. Guo, "Ranging Performance Analysis in Automotive DToF Lidars"; (n) is its equation n.
Where the paper and its derivation differ, both exist, and the name says which. Every function takes
Python floats, numpy arrays or Dr.Jit arrays (`lidarscene.maths.arrays`).

constants    physical constants
optics       pulse, beam, surfaces, air, receiver, sun
electronics  detectors, comparators and clocks
amplifier    frequency response
weather      fog, rain and snow
road         roughness of roads, and how vehicles ride over it
reference    formulas that no render and no study runs, to compare with
inertial     what IMUs measure, and their noise
eye_safety   emission limits of IEC 60825-1:2014
"""
