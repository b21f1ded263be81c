"""Studies of sensors for their designers, as numbers, charts and pages.

The studies use the very stages of the simulation, on NumPy and mostly without tracing: a range limit and a rendered
board cannot drift apart.

ranging           range limits, SNR and their statistics over any axis
field_of_view     what a scan pattern covers, how densely, how soon
eye_safety        class 1 by IEC 60825-1
compare           different sensors on one scene
design            the best values of free keys, under constraints
paper             the claims of the paper, recomputed
budget            the link budget of points
held              quantities held to limits, the table of all limits
published_values  catalogue sensors against published figures
"""
