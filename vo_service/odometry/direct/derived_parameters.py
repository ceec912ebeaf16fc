"""What follows from the parameters: between what the fit is sought, and where it is wrong."""

from vo_service.odometry.direct.parameters import HALF, INITIAL_SIGMAS, LITTLE

# Spreads of brightness, gray levels, and of depth, 1/m: beyond the first a better motion is looked
# for; beyond the second it is wrong; and they are sought up to the last.
SUSPECT_SIGMAS = (0.8 * INITIAL_SIGMAS[0], 0.8 * INITIAL_SIGMAS[1])
MAX_VALID_SIGMAS = (1.7 * INITIAL_SIGMAS[0], 1.7 * INITIAL_SIGMAS[1])
MAX_SIGMAS = (3.0 * INITIAL_SIGMAS[0], 3.0 * INITIAL_SIGMAS[1])
# Gains of brightness are sought between these.
GAIN_RANGE = (HALF, 1.0 / HALF)
# Depths (1/m) that differ by more are of two surfaces.
MAX_SURFACE_STEP_PER_M = 10.0 * INITIAL_SIGMAS[1]
# All but a little.
MIN_CONSISTENT_SHARE = 1.0 - LITTLE
