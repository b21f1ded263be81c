"""Pulses that a converter finds in a waveform.

timing            time that the TDC reports
edges             places where a pulse falls below a level
crossing_sources  light that causes a crossing
echo_memory       residues of earlier echoes in the detector
samples           samples of an ADC around a crossing
"""
