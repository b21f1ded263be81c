"""Electronics: comparator, converter and samplers turn received light into returns.

A detector's signal is noisy, so chance decides whether and when a pulse is reported. One random deviate for each echo
decides both, in closed form; the waveform is not sampled. The functions run on NumPy and Dr.Jit arrays alike, so the
range analysis and the scene simulation share them (docs/theory.md 7 to 9).

receiver           the whole of it on a page: a finder, then all that a converter does with what it finds
single_echo        finder: a lone echo in closed form
multi_echo         finder: the rises of a waveform
photon_counting    finder: the peaks of a histogram
stops              returns that a converter keeps, and their order
alarms             false alarms among the stops
withholding        returns that a sensor leaves out, since light of other channels may have caused them
report             what is reported of a pulse, and the outcome of its echo
outcomes           causes of points and outcomes of pulses
shots              the inputs that every step of the electronics takes
comparator         noise on an edge, the time at which the edge trips, the converter's clock
rises              the peaks of a waveform, in order of time
sources            the sub-echo with the most light
pulses             what a converter measures of a rise
samplers           time, amplitude and width of a pulse that tripped the comparator
interference       false alarms by pulses of other lidars
reported_intensity an amplitude on the maker's scale
ambient            background counts of each pulse
sampled_waveforms  power and signal of chosen pulses over time
"""
