"""Formulas with their sources: arrays in, arrays out. No files, no Mitsuba, no state.

"The paper" is X. Guo, "Ranging Performance Analysis in Automotive DToF Lidars"; (n) is its equation n.
Where the paper and its derivation differ, both exist, and the name says which. Every function takes
Python floats, numpy arrays or Dr.Jit arrays (`lidarscene.maths.arrays`).
"""
