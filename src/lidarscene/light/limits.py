"""How many panes, mirrors and gaps a beam may meet."""

INTERACTIONS = 3
"""Unless told otherwise: through both windows of a car, and through the next one's."""

MOST_INTERACTIONS = 8
"""Each is a further ray query in the kernel, and takes its time to compile."""
