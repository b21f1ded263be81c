"""Tuning: numbers of the histogram that no source gives, by module, and what each of them is worth."""

from __future__ import annotations

# expectation, candidates and peaks

SURE = 5.3
"""Accuracy bought: deviations of the filter's value by which an echo exceeds its highest threshold and is taken for
sure. The rest of P_d is below 6e-8, which single precision does not tell from none."""

NEVER = 1e-7
"""Accuracy bought: P_d below which the bins around a peak are not drawn: less than a point in forty frames of 262,144
pulses."""

MERGED = 0.9
"""Accuracy bought: distance in widths of the filter's response at which an echo is part of a peak. Noise splits none
off nearer ones."""

RETURNING = 2.5
"""Accuracy bought: distance in sigmas before the end of a nearer echo's dead time from which on its bins are drawn:
one in 150 of the SPADs that come back meets light that is farther ahead."""

NEIGHBOURS = 4.2
"""Accuracy bought: distance, in these widths, of two peaks between which noise may fill the valley."""

OUTWARD = 0.3
"""Choice: distance, in these widths, from an echo on a flank to the end of the valleys that lift it out."""

ASIDE = 2.5
"""Choice: distance in sigmas at which light of its own takes a hump's place."""

LOWEST_HUMP = 0.1
"""Accuracy bought: expected height, in thresholds, below which no hump of SPADs that come back is looked for: noise is
as high."""

# bins

LEAST_LEVEL = 1e-3
"""Accuracy bought: values beside the filter's peak below this share of it count as that much: their logarithm gives the
peak's place."""

# courses

FEW = 2e-3
"""Accuracy bought: share of the SPADs that may be left out when they come free again, or when earlier light fires them:
0.1 % of the noise in any light."""

NOTHING_BEFORE = 4.5
"""Accuracy bought: widths (sigmas) behind the first bin from which on an echo has no light before it."""

LEAD = 3.0
"""Accuracy bought: widths (sigmas) before the first bin from which on SPADs are followed: light there is as exact as in
the bins."""

LEAST_CHANGE = 0.01
"""Accuracy bought: change of the free share from which on an echo has its own expectation: it moves P_d by some
0.005."""

PEAK_PLACES = (-0.8, 0.0, 0.8)
"""Accuracy bought: places in sigmas about a peak, of whose expected values a parabola gives the highest."""

# column_noise

MOST_FIRED = 0.8
"""Accuracy bought: share of the SPADs up to which an echo's noise follows (T176); brighter ones keep theirs, which is
up to 1.5 times as large, with what the correction of their walk adds."""

MOST_NOISE = 3.0
"""Choice: deviations of a point's range from the true one that are taken for noise; what lies beyond is no noise and
stays."""
