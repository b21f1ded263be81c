"""Detection by SPADs whose shots are summed into a histogram.

peaks         the finder: the counterpart of `detection.multi_echo`
candidates    places at which a histogram is searched
expectation   photons, P_d and threshold that are expected there
bins          counts of the bins around an echo, and the filter over them
courses       SPADs that are free when the bins begin, and come free within them
shadows       how many SPADs light of the last dead times has fired
folding       light that comes back after the next pulse has left
column_noise  noise of the range that neighbouring columns share
histograms    whole histograms of chosen pulses
tuning        numbers that no source gives, and what each is worth
"""
