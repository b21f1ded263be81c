"""Tuning: numbers of the search for peaks that no source gives, and what each of them is worth."""

from __future__ import annotations

SURE = 5.3
"""Accuracy bought: deviations of the filter's value by which an echo exceeds its highest threshold and is taken for
sure. The rest of P_d is below 6e-8, which single precision does not tell from none."""

NEVER = 1e-7
"""Accuracy bought: P_d below which the bins around a peak are not drawn: less than a point in forty frames of 262,144
pulses."""

MERGED = 0.9
"""Accuracy bought: distance in widths of the filter's response at which an echo is part of a peak. Noise splits none
off nearer ones."""

NEIGHBOURS = 4.2
"""Accuracy bought: distance, in these widths, of two peaks between which noise may fill the valley."""

OUTWARD = 0.3
"""Choice: distance, in these widths, from an echo on a flank to the end of the valleys that lift it out."""

ASIDE = 2.5
"""Choice: distance in sigmas at which light of its own takes a hump's place."""

LOWEST_HUMP = 0.1
"""Accuracy bought: expected height, in thresholds, below which no hump of SPADs that come back is looked for: noise is
as high."""
