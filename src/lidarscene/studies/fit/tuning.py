"""Tuning: numbers of the fit that no source gives, by module, and what each of them is worth."""

from __future__ import annotations

import math

import numpy as np

# binned_fit

CURVE_HUBER = 1.5
"""Choice: sigmas beyond which a bin counts less (Huber's weight): the nearest ranges follow laws of their own."""

MOST_STEPS = 20
"""Accuracy bought: most steps of the solver; fits of five numbers take up to 10, and 4 ended before."""

FIRST_MISFIT = 0.05
"""Choice: misfit of a law with expected numbers that the solver begins with: with none, it at once left the lenses of
the file."""

ROUNDS = 4
"""Accuracy bought: solutions one after the other; the last one changes by less than a tenth of its sigma."""

SCANNED, MOST_SCANNED, FAR_COST = 12, 40, 30.0
"""Accuracy bought: values of a parameter at which the others are solved for, at first and at most, and the logarithm of
the likelihood below the largest at which no minimum is followed."""

LIKELY, SMOOTH, FINEST, FINE = 6.0, 1.0, 0.02, 20
"""Accuracy bought: logarithm of the likelihood below the largest down to which it is summed, its largest and the
parameter's least difference between two values, and steps in which it is summed there."""

ABOUT = (-3.0, -1.5, -0.7, 0.0, 0.7, 1.5, 3.0)
"""Accuracy bought: places about a minimum, in its standard deviations, at which the likelihood is summed at first."""

PINNED = 1e12
"""Accuracy bought: information that stands for a parameter whose covariance is told apart."""

SLOPE_STEP = 1e-3
"""Accuracy bought: step of the differences that are the slopes of a law: it is smooth."""

# near_field

LEAST_REFLECTIVITY, MOST_REFLECTIVITY = 20.0, 100.0
"""Choice: range of REFLECTIVITY that is used: below, its whole steps are too coarse; above, its scale is
logarithmic."""

LEAST_SIGNAL = 12.0
"""Choice: least SIGNAL: photons are whole numbers, too."""

LOG_RANGE_STEP = 0.03
"""Choice: width of a bin in ln R."""

MOST_CHECK_SIGMA = 0.1
"""Choice: largest relative standard deviation of a held-out bin that judges the fit: two thirds of the limit. Noise of
REFLECTIVITY tells few bins so well."""

OUTLIER = 0.5
"""Choice: distance of ln white_m2 from the median of its bin beyond which the light is not only the return's."""

SPOT_BOUNDS = (0.1, 2.0)
"""Accuracy bought: bounds of the laser's spot radius (1/e^2) over that of the field of view; beyond them the curve
hardly changes."""

SAME_LAW = 0.01
"""Choice: largest difference of a sensor's near field from the law of one lens for it to count as one lens."""

LONGEST_STRETCH = 1.5
"""Choice: largest logarithm of the factor that stretches a sensor's own curve over the range."""

LEAST_SHARE = 1e-6
"""Accuracy bought: least share of light whose logarithm is taken."""

LENS_BOUNDS = ((0.0, 20.0), (0.0, 20.0), (0.0, 20.0), (0.0, 0.2))
"""Choice: bounds of `near_field.LENSES`."""

LENS_SIGMAS = (1.0, 0.3, 0.3, 0.03)
"""Choice: standard deviations of `near_field.LENSES` about the file's values, before a recording is seen. Without them
a recording that ends before its signals are those of far away leaves K open."""

LEAST_MISFIT = 0.02
"""Choice: least misfit of the stretched curve for which free lenses are tried."""

LEAST_GAIN = 0.2
"""Choice: least share of the error on held-out blocks by which free lenses must lower it, since they have four numbers
more."""

# threshold

LARGEST_SIGNAL_RATIO = 3.0
"""Choice: SIGNAL over the median threshold above which pulses are lost for other reasons (blanking, a window): left
out."""

RANGE_TOLERANCE = 0.1
"""Choice: largest relative difference of a neighbour's range from the neighbours' median. The pulse's own range does
not count, since a lost pulse has none."""

LARGEST_CONDITION = 1e6
"""Choice: condition number of the Fisher matrix above which the background hardly varies; pedestal in median
NEAR_IR."""

LARGEST_PEDESTAL = 20.0
"""Choice: largest pedestal in median NEAR_IR: a threshold that the background hardly moves."""

LEAST_VARIANCE = 5.0
"""Choice: least variance of the number of returns in a bin that counts for the misfit: with fewer they are not
normal."""

# threshold_ends

LEAST_RATIO = 1.2
"""Choice: SIGNAL over the median threshold above which lone pulses count: below, the law of surfaces lets none
return."""

LEASTS = np.geomspace(0.2, 1.0, 161)
"""Accuracy bought: least thresholds over the median one that are tried, a per cent apart."""

LARGEST_RATIO = 1.5
"""Choice: SIGNAL over the median threshold up to which pulses say something of the least one."""

DECISIVE = 2.0
"""Choice: least difference of ln L from that of a threshold without an end: two sigma."""

FILTER_DEVIATES = np.linspace(-4.0, 4.0, 161)
"""Accuracy bought: deviates of the filter's noise over which its density is summed, 0.05 apart."""

# scatter

PATCH_SIGNAL = 100.0
"""Choice: least harmonic mean of SIGNAL over a patch [photons]."""

SMOOTH_SHARE = 0.5
"""Choice: share of the patches, by the scatter of their neighbours, that count as smooth."""

PATCH_SIGNAL_RATIO = 2.0
"""Choice: largest ratio of the signals within a patch."""

PATCH_SQUARE = 6.0
"""Choice: sum of squares over sigma^2 above which a patch is left out: exp(-3) = 5 % of clean ones."""

LEAST_SHARED = 16.0
"""Choice: least photons of a patch that tells how much weak returns share: of weaker ones few are kept."""

SHARED_SMOOTH = 0.25
"""Choice: share of the patches of half an octave that count as smooth. Weak returns share noise, and so show more of
the roughness: halves of an OS1-128's patches tell 72 and 75 photons by two and three frames, quarters 105 and 90."""

COLUMN_PHOTONS = (20.0, 1000.0)
"""Choice: photons between which the bend of (T176b) is sought."""

# noise_photons

LEAST_READING = 2.0
"""Choice: least mean REFLECTIVITY of a patch: of fewer steps, rounding decides how it scatters."""

NOISE_RANGE_STEP, NOISE_PATCHES = 0.2, 30
"""Choice: width of a bin in ln R, and least number of patches in it, which tell photons to 18 %."""

# pixels_at_rest

LAW, LAW_SIGMAS = (1.0, 1.0, 0.0, math.log(0.05)), (3.0, 0.5, 0.3, 0.7)
"""Choice: numbers of (T185a), the last ln s, before a recording is seen, and their standard deviations. A matt surface
has 1 for a_1; asphalt of a Pandar64 falls as the cosine to 0.26 at 7 to 30 m and to 1.1 at 30 to 46 m."""

READING_SIGMA, OFF_SQUARE = 0.1, 9.0
"""Choice: steps by which the mean reading of a ring misses the law, and square of what is of another one."""

RING_STEP, LEAST_OF_RING = 0.02, 20
"""Choice: width of a ring of the ground in the logarithm of the cosine, and least number of pixels in it."""

LAWS, ADAPTIONS, WIDER = 4000, 5, 2.0
"""Accuracy bought: laws that are drawn, times that they are drawn, and their variance over that of the likeliest
before."""

# at_rest

LEAST_STEP_MM = 10.0
"""Choice: change of the range from column to column, times the root of SIGNAL, below which columns share noise as on a
level surface."""

LEAST_BROADENING = 2.0
"""Choice: least length of an echo over the pulse on some surfaces, from which on slopes tell the beam's width."""

MOST_KEPT = 0.97
"""Choice: share kept on some surfaces below which losses tell what causes them."""

LEAST_LEAN_M = 32.0
"""Choice: range times tangent of the incidence below which no beam lengthens an echo: at 4 mrad by 0.5 %."""

LEAST_OF_BIN = 100
"""Choice: least number of pixels in a bin."""

LEAST_OF_STRENGTH = 1e-3
"""Accuracy bought: least strength that is divided by: what reads 0 has no scatter of its own."""

LEAST_STEPS = 8.0
"""Accuracy bought: least strength in its steps for (T184): of fewer steps, rounded logarithms scatter by no power."""

DITHER = 0.5
"""Source: Widrow and Kollar, Quantization Noise (2008): noise of half a step or more hides where steps are."""

EXCESS_SIGMAS = 4.0
"""Choice: sigmas by which a bin scatters more than a weaker one, from which on it follows another law. Of sixteen bins
one is taken for such by chance in at most one fit of 260; of three sigmas it was one in seven."""

HEIGHT_PARTS = 8
"""Choice: largest number of parts of a bin, by the height of its echoes, for fits. The jitter changes from that of weak
returns to that of strong ones within an octave; in whole octaves a light of half the truth was told 3 sigma off it."""

PIXELS_OF_BIN = 200
"""Accuracy bought: pixels that stand for those of a bin: five times as many move a fit by 0.3 sigma at most."""

ROUNDING = 12.0**-0.5
"""Source: standard deviation of an even distribution between two whole numbers; what strengths leave open."""

LOG_STEP = 0.1
"""Choice: distance from a bound, of the logarithm of a number, within which it is not told."""

LEAST_SLOPE = 1.0
"""Choice: least information on a logarithm, one over the square of its standard deviation: a factor of e either way."""

REST_BOUNDS = {
    "laser.energy_spread": (1e-4, 0.5),
    "tdc.jitter_ps": (1.0, 1e4),
    "tdc.strong_jitter_ps": (1.0, 1e4),
    "laser.divergence_mrad": (0.05, 30.0),
    "tdc.chatter_mhz": (1.0, 1e4),
    "histogram.column_range_sigmas": (0.1, 100.0),
}
"""Choice: numbers of the sensor file that frames at rest determine -> least and largest value that is tried."""

LIGHT_ERROR = 0.05
"""Choice: relative error of the light over the noise that all boards have in common: strengths of the nearest walls are
up to 15 % off. Lights of twenty twins at 0.3 of the power are 5.7 % off, of which their own intervals are 4."""

STRENGTH_BOUNDS = (0.4, 2.5)
"""Choice: least and largest strength of surfaces of few whole numbers that is tried, over what is taken for it."""

LIGHT_BOUNDS = (0.1, 10.0)
"""Choice: least and largest light over the noise that is tried, in that of the file."""

# row_gains

GAIN_SIGNAL = 40.0
"""Accuracy bought: photons above which all pulses have a return, so that losses do not bias the median."""

SAME_RANGE = 0.02
"""Choice: largest relative difference of the ranges of two pixels whose signals are compared."""

# estimates

DOUBTFUL_RATIO = 1.3
"""Choice: ratio of the bootstrap's sigma to Fisher's above which the two differ.

The sigma of a bootstrap over 40 blocks scatters by 11 %, by 20 % where few of the blocks matter."""

UNKNOWN_SIGMA = 1.0
"""Choice: sigma of a logarithm above which the number is not known: a factor of e either way."""

# products

FAR_RATIO = 30.0
"""Accuracy bought: range over R0 beyond which the near field changes the light by less than 0.1 %."""

LEAST_EXPONENT = 0.02
"""Choice: exponent below which it counts as 0."""

# sensor_text

MOST_RELATIVE_SIGMA = 0.3
"""Choice: largest scatter of an estimate over its value; less certain estimates are not written. A file's own number is
taken to be as sure."""

CONTRADICTION = 2.0
"""Choice: sigmas of an estimate from the file's number beyond which they are blended, though it is not certain."""

MOST_MISFIT = 2.0
"""Choice: misfit of the law of the scatter above which no pulse is written from it: of right laws through two to four
octaves some one in 20 to 200."""

INFINITE = 1e-3
"""Accuracy bought: R0 over a range beyond which that counts as infinity: the near field differs by less than 0.1 %."""

# on_scene.pulses_on_scene

POWERS_W = np.geomspace(1e-16, 1e-5, 2000)
"""Accuracy bought: background powers of the table that inverts NEAR_IR counts, 1.3 % apart."""

TRACED_SURFACE_M = 1e-4
"""Accuracy bought: largest difference of two traced ranges to the same surface."""

# on_scene.known_scene

STRONG_RATIO = 3.0
"""Choice: ratio of signal to threshold above which signal and range enter the likelihood: nearly all such are kept."""

MOST_FIRED = 0.4
"""Accuracy bought: largest share of fired SPADs for which signal and range enter the likelihood. With more, SPADs fire
early and the echo gets narrower: at 0.85 this changes the signal by 0.2 % and the range by 2 mm, which the prediction
leaves out."""

LEAST_CHANCE = 1e-9
"""Accuracy bought: chances are clipped to so far from 0 and 1, where a pulse's weight 1 / (p (1 - p)) is infinite."""

# on_scene.likelihood

LONGEST_STEP = 0.5
"""Choice: largest step of a logarithm."""

LARGEST_LOGARITHM = math.log(5.0)
"""Choice: logarithm beyond which a parameter is undetermined or absorbs what is not modelled, and is reset to 0. A
scatter that falls so far is none, and stays there (`MAY_VANISH`)."""

OUTLIER_SIGMAS = 5.0
"""Choice: sigmas beyond which a range belongs to another surface; of normal errors one in 2 million is left out."""

SQUARE_CAP = 9.0
"""Choice: cap on the squared distance of a range from the surface in sigmas, since surfaces are not quite where the
scene has them. On a clean recording the cap widens sigma by 1 %."""

SIGNAL_HUBER = 4.0
"""Choice: sigmas beyond which a signal counts less (Huber's weight): an edge, or a surface other than the scene's."""

LEAST_INFORMATION = 1e-6
"""Choice: least share of a parameter's information that no other parameter has; below it, only a product is
determined."""

LAST_STEP = 1e-2
"""Accuracy bought: length of the last step, in sigmas: what noise leaves open is a hundred times as wide."""

SLOW_RATIO = 0.7
"""Choice: ratio to the step before above which a step is halved; converging Fisher scoring shrinks faster."""

# on_scene.scene_fit

REFLECTIVITY_SIGMA = 0.1
"""Choice: prior sigma of a patch's reflectivity factor: the maker's REFLECTIVITY, which a twin has, is good to some 10
%."""

LEAST_TEXTURE = 0.01
"""Choice: least relative scatter of the reflectivities within a patch."""

# published_fit

RANGE_SIGMA = 0.1
"""Choice: relative standard deviation of a published range. Makers round, and do not say at which share of the pulses;
six ranges of a Livox Avia, day and night, depart from one lidar equation by 9 % rms."""

UNDETERMINED = 0.5
"""Choice: share of what is assumed of a number, in standard deviations of its logarithm, that published ranges must
not leave open for it to be determined."""

# board_law

POWER_STEP, LENGTHS = 0.5 * math.log(2.0), 2.0 ** np.arange(0.0, 4.01, 0.5)
"""Accuracy bought: step of the logarithm of the power, and lengths over the pulse's, of the echoes that are read."""

LEAST_MARGIN, LEAST_READ = 0.5, 20
"""Accuracy bought: least height of these echoes in thresholds, and least number of readings that tell a scatter."""

SMOOTHING = 0.5
"""Accuracy bought: deviation, in steps, of the mean over neighbouring echoes."""

CLEAR_MARGIN, READINGS = 64.0, (1000, 60)
"""Accuracy bought: height in thresholds above which the clock scatters ranges more than the noise on an edge does, and
readings of an echo below and above it. By 200 a light was told 2.7 sigma off that by 1500 was 1.2 sigma off."""

SAMPLES_M = 3.0
"""Accuracy bought: difference of ranges over which echoes are read, several samples of a converter."""

BEAM_STEP = 0.05
"""Accuracy bought: step of the logarithm of the beam between which echoes are interpolated: to 3e-4 of their power."""

CLIPS = 5
"""Accuracy bought: times that what is beyond three sigmas is cut off."""
