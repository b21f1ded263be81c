"""Detection by SPADs whose shots are summed into a histogram.

histogram_receiver  peaks, false alarms and returns: the counterpart of `detection.multi_echo`
histograms          whole histograms of chosen pulses
bins                counts of the bins around an echo, and the filter over them
folding             light that comes back after the next pulse has left
"""
