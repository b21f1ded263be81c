"""Is a sensor class 1? IEC 60825-1:2014, pulse by pulse.

A scanning beam crosses an eye as a train of pulses. The limits for one pulse, for their mean and for the train are
asked at every distance, and the smallest margin counts.

exposure           the pulses that an eye receives
criteria           the limits and their margins
eye_safety_report  all margins as text and table
"""
