"""The light of a pulse: from the laser to the power on the detector.

Each step is a frozen type (`Beams`, `Hits`, `Echoes`, `EchoTrain`) and a function that makes it from the step before.
`Hits` has geometry and no watts, `Echoes` has watts and no electronics. So a user can see whether a missing point
had light. All of it runs on NumPy and Dr.Jit arrays alike (docs/theory.md 1 to 4, docs/theory_light.md 1 to 5).

beams             origin and direction of each pulse
footprint         rays over the cross section of a beam
hits              the surface that each ray met
limits            how many panes, mirrors and gaps a beam may meet
echoes            signal and background power of each ray
field_background  background over the receiver's field of view
air_light         light of fog, rain and snow
pulse_train       all sub-echoes of a pulse
stray_light       echoes of other channels that fire at the same instant
waveform          the power on the detector as a function of time
"""
