"""Receivers that count photons over many shots: SPADs and the histogram that they fill.

model   `Spad`, `Histogram` and the working point that a background puts them in
file    [detector] type = "spad" and [histogram]
"""
