"""Tuning: numbers of the twin that no source gives, by module, and what each of them is worth."""

from __future__ import annotations

import math

import numpy as np

# planes

MOST_TURNS = 1.5
"""Choice: most turns that a row of a grid goes around: one and a piece of the next; a row of two rings goes two."""

REACH_RAD = math.radians(0.5)
"""Choice: reach of a window to each side, but at least to the next ring and the second next column."""

SMOOTH_COS = math.cos(math.radians(8.0))
"""Choice: least length of the mean normal of a pixel and its neighbours on a smooth surface."""

SCALES_M = (0.5, 0.2, 0.1, 0.05)
"""Choice: distance from the plane at which a neighbour counts half, for each step of the fit."""

NEAR_SHARE = 0.2
"""Choice: largest relative difference of the ranges of neighbours in the first step of the fit."""

MOST_OFF_M = 0.1
"""Choice: largest distance of a pixel from the plane of its neighbours, along the normal: as large as the 1-sigma range
error of an OS1's weakest returns (datasheet)."""

MOST_BEAM_M = 0.1
"""Choice: largest distance along the beam that a return of a twin keeps from its plane; what is twice as far off stands
on the plane, and between them the distance falls in proportion."""

LEAST_SHARE = 0.5
"""Choice: least mean weight of a window's neighbours that makes a plane."""

LEAST_COS = 0.03
"""Accuracy bought: least cosine of incidence: on flatter planes 0.01 degrees move the pixel by more than 0.6 % of its
range."""

# apparent_reflectivity

SLOPE_DEG = 45.0
"""Choice: slope of the facets of all measured surfaces, that of the catalogue's asphalt."""

LEAST_REFLECTIVITY = 1e-5
"""Choice: least reflectivity; lower ones are unknown surfaces, taken as black: 0.1 photons of an OS0 at 0.7 m."""

ASSUMED_MEDIAN = 0.2
"""Choice: median apparent reflectivity assumed where the recording's intensity has no known unit."""

STEEPEST = 4.0
"""Choice: largest exponent of the range in the extrapolation of a table to near ranges."""

LOSS_SIGMAS = 2.0
"""Choice: sigmas above the threshold from which on a lost pulse was not lost for lack of light: one pulse in 44 is."""

DETECTED = 1.25
"""Choice: least height in thresholds of the echo of a return that reads 0: at a TNR of 6 nine in ten such are kept."""

DIM = 1e-3
"""Choice: reflectivity of the target whose photons, over it, are those of a white one."""

FAR_M = 30.0
"""Choice: range at which a sensor's photons calibrate signals without reflectivities; its near field continues them."""

LEAST_COUNTS = 5.0
"""Choice: least reflectivity of a return that calibrates photons: below, its whole steps are too coarse."""

COMPANY = 0.05
"""Choice: largest relative difference of the ranges of two neighbours of one surface."""

LEAST_PHOTONS = 1e-12
"""Accuracy bought: least photons whose logarithm is taken."""

# sensor_grid

LEAST_IN_ORDER = 0.98
"""Choice: share of steps of the azimuth in one direction, from which on a list goes ring by ring."""

LEAST_RINGS = 0.25
"""Choice: share of the sensor's rings that a part which was cut out of a file ring by ring has at least."""

LONGEST_STEP = 1.5
"""Choice: longest way between two firings of a row over the median; beyond it one or more were lost."""

SAME_TURN = 0.05
"""Choice: largest relative difference of the firings in a turn from a usual number that is an error of the count."""

DUPLICATE_STEPS = 0.3
"""Choice: distance in steps within which two points of a row are returns of one pulse."""

LEAST_COHERENCE = 0.5
"""Choice: least length of the mean of e^(2 pi i azimuth / step) of a row whose azimuths have steps."""

LEAST_GAP_RAD = math.radians(30.0)
"""Choice: width of an empty sector from which on it was cut out, or is not of the sensor's field."""

POINTS_PER_PIXEL = 2.0
"""Choice: mean number of points in a pixel of a raster, of which then 14 % are empty by chance."""

# surfels

QUAD_OVERLAP = 1.04
"""Choice: width of a quad over that of its pixel, so that no beam slips between two."""

OVERLAP = 0.02
"""Choice: half widths of a pixel by which the quads to either side of its middle overlap, as `QUAD_OVERLAP`."""

STEEPEST_SLOPE = 2.0
"""Choice: largest change of the range from one return of a row to the next on one surface, over the way across the
beam: incidence at 63 degrees."""

LARGEST_STRETCH = 1.6
"""Choice: largest ratio of the ranges of corner and middle, either way."""

GROUND_BEYOND = 1.3
"""Choice: range up to which ground is completed, over that of its farthest return (99 %)."""

ON_GROUND_M = 0.1
"""Choice: largest distance of a return on the ground from its plane, as `MOST_OFF_M`."""

BEHIND_M = 0.3
"""Choice: least distance of ground behind a return, so that noise of the range puts none before it."""

SURE = 0.99
"""Choice: P_d of ground beyond which a lost pulse met something else; 1 of 100 losses is then the detector's."""

LOST_SHARE = 0.5
"""Choice: share of the echo in a lost pulse's highest peak, which may be all echo or all noise."""

RANGES_M = (0.1, 1000.0)
"""Choice: ranges between which the photons of a white surface are computed; planes meet beams anywhere."""

EDGE = 0.5
"""Choice: distance from the pixel's middle at which a surface ends beside a lost neighbour, in half widths of the
pixel. As far beyond the pixel's edge it has the mean strength of the two."""

BORDER = 0.5
"""Choice: largest distance, in half widths of the pixel, of the border between two returns from half way, in a twin of
every second column. Where between them one surface ends is not recorded; half way, the nearer one would hide each beam
of a held-out column."""

BEAM_SHARE = 0.5
"""Choice: share of a pixel that the nearer of two returns covers."""

# reading_noise

ALONG = (5, 15)
"""Choice: pixels of a row whose mean is smooth, and of those means whose mean is smoother."""

MOST_BY_CHANCE = 3.0
"""Choice: mean square of fifteen deviations over the noise's that is of a surface, however quiet all others are: of
eight independent ones a thousandth exceed it."""

NOISE_SHOTS, NOISE_BINS = 8192, 16
"""Accuracy bought: pairs of shots that tell a sensor's noise to 3 % in each bin of the power, and the bins."""

# clusters

VOXEL_M, REACH_M = 0.15, 0.6
"""Choice: edge of the voxels, and the distance within which they are neighbours."""

LEAST_OVERLAP = 0.5
"""Choice: least intersection over union of two clusters that are the same."""

ABOVE_GROUND_M = 0.3
"""Choice: height above the ground's plane above which points are clustered, for roads are no planes."""

# frame_poses

REGISTRATION_VOXEL_M = 0.3
"""Choice: edge of the cubes in which points are thinned to one before registration."""

LARGEST_PAIR_DISTANCE_M = (2.0, 0.5)
"""Choice: largest distance of paired points in the first and the second round of registration."""

LEAST_FIT = 0.6
"""Choice: share of a frame's points that must have a partner in the last round: of frames up to 8 m apart .74 to .95
have, of others .14 to .45."""

LARGEST_CHANGE_M = 0.1
"""Choice: change of a pixel's range beyond which it met another surface."""

LARGEST_SHIFT_M = 3e-3
"""Choice: shift between two frames below which the sensor was at rest: 3 cm/s at 10 Hz. Registration is good to a
centimetre, which is three columns of a surface at 0.6 m."""

# daylight

BRIGHTEST_KLUX = 130.0
"""Choice: largest illuminance of the ground by sun and sky: 133 klux from the sun beyond the air, 100 to 120 on clear
days."""

# twin_files

BRIGHT_STEP = 1.15
"""Accuracy bought: largest ratio of the apparent reflectivities of bright quads that share a material."""

BRIGHT_DIFFUSE = 0.8
"""Choice: diffuse reflectivity of bright quads, which sunlight sees; the rest is retro-reflected."""

LEAST_RETRO, MOST_RETRO = 1e-3, 1e7
"""Choice: bounds of a material file's retro-reflection [cd/lx/m2]; the least one is for quads no brighter than matt
white."""

RETRO_HALF_ANGLE_DEG = 5.0
"""Choice: half width of the retro-reflection, far above the beam's parallax: only light straight back was recorded."""

ASSUMED_KLUX = 20.0
"""Choice: illuminance assumed for recordings without background light; near targets scatter alike at any."""

# matched_pulses

LARGEST_ANGLE_RAD = np.radians(0.5)
"""Choice: largest median angle between recorded and simulated beams of the same sensor."""

DIFFERENCE_STEP_RAD = np.radians(1.4)
"""Choice: angle between the ranges of a second difference: in recordings, columns up to four of 1024 apart share
noise."""

# judge

OCTAVES_M = 2.0 ** np.arange(-1.0, 10.0)
"""Choice: edges of fixed bins of range [m], 0.5 to 512: far bins of many returns do not hide the near ones of few."""

SAME_SURFACE_M = 0.3
"""Choice: distance from the twin's surface beyond which a recorded return is another one's, at an edge or of another
frame: 30 times the largest bias that is allowed."""

CLIP_SIGMAS = 3.0
"""Choice: distance from the mean, in sigmas, beyond which a value is of an edge and not of the noise."""
