"""Fog, rain and snow: particle sizes, extinction, and the light they send back."""
