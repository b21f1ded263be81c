"""Mistakes of a file, all at once, and doubts about a scene or a sensor.

file_check  `check`: a line for each
"""
