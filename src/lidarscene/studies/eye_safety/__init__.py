"""Eye safety: class 1 of IEC 60825-1:2014 for a scanning sensor.

A scanning beam crosses an eye as a train of pulses. The limits for one pulse, for the average and for the train are
applied at every distance, and the smallest margin counts.

exposure           the pulses that an eye receives
criteria           the limits and their margins
eye_safety_report  all margins as text and table
"""
