"""Limits on the number of panes, mirrors and gaps that a beam may meet.

The kernel unrolls the steps of a path, so their number is code. The command line names these limits too, and must not
load the light for it.
"""

INTERACTIONS = 3
"""Default: enough for both windows of a car and one of the next car."""

MOST_INTERACTIONS = 8
"""Largest allowed number: each is one more ray query in the kernel, which takes time to compile."""
