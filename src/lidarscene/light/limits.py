"""How many panes, mirrors and gaps a beam may meet."""

INTERACTIONS = 3
"""Default: enough for both windows of a car and one of the next car."""

MOST_INTERACTIONS = 8
"""Largest allowed number: each is one more ray query in the kernel, which takes time to compile."""
