"""Values that follow from the parameters: bounds of the residual model and of surfaces."""

from vo_service.odometry.direct.parameters import INITIAL_SIGMAS, MIN_GAIN, MIN_POINTS

# Sigmas of brightness (gray levels) and of depth (1/m): above the first pair a better motion is
# searched for; above the second the motion is wrong; the last is the upper bound of the estimate.
SUSPECT_SIGMAS = (0.8 * INITIAL_SIGMAS[0], 0.8 * INITIAL_SIGMAS[1])
MAX_VALID_SIGMAS = (1.7 * INITIAL_SIGMAS[0], 1.7 * INITIAL_SIGMAS[1])
MAX_SIGMAS = (3.0 * INITIAL_SIGMAS[0], 3.0 * INITIAL_SIGMAS[1])
# Fewest samples for an estimate of sigma.
MIN_SIGMA_SAMPLES = 0.5 * MIN_POINTS
# Bounds of the brightness gain.
GAIN_RANGE = (MIN_GAIN, 1.0 / MIN_GAIN)
# Inverse depths (1/m) that differ by more belong to two surfaces.
MAX_SURFACE_STEP_PER_M = 10.0 * INITIAL_SIGMAS[1]
