"""The detector and its electronics: photodiodes, amplifier, comparator, time and amplitude measurement."""
