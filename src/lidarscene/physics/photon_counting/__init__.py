"""Counting photons over many shots, as arrays of single-photon avalanche diodes (SPADs) do.

dead_time       what a SPAD counts that is blind for a while after each photon; pile-up and its correction
matched_filter  noise, detection, false alarms and precision of a filter over a histogram of counts
draws           binomial counts from uniform numbers
"""
