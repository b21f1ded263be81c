"""Detectors, comparators and clocks, as formulas.

Noise, gain and saturation decide which pulses become points. Each module is one device or effect, with equations,
sources and ranges of validity.

apd            avalanche photodiode: noise, SNR, best gain
mcintyre       the distribution of avalanche gain, and its tails
sipm           silicon photomultiplier: busy cells and their variance
sipm_response  busy cells while a pulse passes, and a table of the peak
counting       background counts in a time window
pulse_sums     sums of shifted Gaussian pulses, and their peaks
saturation     an amplifier that clips: height, width, timing
crosstalk      how strong pulses of other lidars are
tdc            comparator and time-to-digital converter
sampling       how well the time of a pulse is known, and samples of it
intensity      intensity as makers report it
range_limit    the range at which a target is lost
"""
