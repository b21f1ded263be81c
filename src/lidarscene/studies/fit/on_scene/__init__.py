"""Fit with a scene: a recording before surfaces whose places are known, of a twin or of any scene and poses.

laid     each recorded pulse, and what the light of the scene says of it
checks   what was found, held to columns that were not fitted
written  the sensor file
report   page, JSON, text
study    all of it
"""
