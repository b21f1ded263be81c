"""What the electronics report of the light: comparator, converter, samplers.

A detector's signal is noisy, so whether and when a pulse is reported is drawn: one random deviate for each echo decides
both, in closed form, and no waveform is sampled. The functions run on NumPy and Dr.Jit arrays alike, so that the range
analysis and the scene simulation share them (docs/theory.md 7 to 9, 23 and 24).

shots              what every step of the electronics knows of some pulses
returns            one echo to a pulse: detection, time, false alarms
comparator         noise on an edge, the time at which it trips
multi_echo         several sub-echoes to a pulse, and several stops
rises              the peaks of a waveform, one after the other
samplers           what measures a pulse that tripped the comparator
interference       alarms that are pulses of other lidars
intensity          the number that a maker would report
ambient            background counts of a channel
sampled_waveforms  power and signal of chosen pulses against time
"""
