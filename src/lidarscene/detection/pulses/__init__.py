"""Pulses that a converter finds: which of them it keeps, and at which time it reports them."""
