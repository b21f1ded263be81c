"""The light of a pulse: from the laser to the power on the detector.

Each step is a frozen type named after what it holds (`Beams`, `Hits`, `Echoes`, `EchoTrain`) and a function that makes
it from the step before. `Hits` has geometry and no watts, `Echoes` has watts and no electronics: so a missing point can
be asked whether there was light. All of it runs on NumPy and Dr.Jit arrays alike (docs/theory.md 1 to 4, 17 to 23).

beams          where each pulse leaves, and where it goes
footprint      rays over the cross section of a beam
hits           what each ray met
limits         how many panes, mirrors and gaps a beam may meet
echoes         signal and background power of each ray
field_of_view  background over all that the receiver sees
air_light      light of fog, rain and snow
pulse_train    all sub-echoes of a pulse, together
waveform       the power on the detector as a function of time
"""
