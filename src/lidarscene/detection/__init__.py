"""Electronics: comparator, converter and samplers turn received light into returns.

A detector's signal is noisy, so chance decides whether and when a pulse is reported. One random deviate for each echo
decides both, in closed form; the waveform is not sampled. The functions run on NumPy and Dr.Jit arrays alike, so the
range analysis and the scene simulation share them (docs/theory.md 7 to 9, 17 and 34).

shots              the inputs that every step of the electronics takes
outcomes           causes of points and outcomes of pulses
returns            pulses with one echo each: detection, time, false alarms
comparator         noise on an edge, the time at which the edge trips, false alarms
multi_echo         pulses with several sub-echoes, and several stops
rises              the peaks of a waveform, in order of time
pulses             pulses that a converter finds, keeps and times
samplers           time, amplitude and width of a pulse that tripped the comparator
interference       false alarms by pulses of other lidars
reported_intensity an amplitude on the maker's scale
ambient            background counts of each pulse
sampled_waveforms  power and signal of chosen pulses over time
"""
