"""Receivers that count photons over many shots: SPADs and the histogram that they fill.

spad       `Spad`, `Histogram` and their working point under a background
spad_file  [detector] type = "spad" and [histogram]
"""
