"""Pulses that a converter finds in a waveform.

stops    which of them it keeps, and in which order it reports them
timing   at which time it reports them
edges    where they leave a level
sources  which light they are of
memory   what earlier ones leave in the detector
samples  what an ADC reads of them
alarms   the false ones among them
"""
