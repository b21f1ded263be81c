"""Eye safety: class 1 of IEC 60825-1:2014 for a sensor, standing still and scanning."""
