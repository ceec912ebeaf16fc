"""What follows from the parameters: between what the fit is sought, and where it is wrong."""

from vo_service.odometry.keyframe.parameters import HALF, LITTLE, SPREADS

# Spreads of brightness, grey levels, and of depth, 1/m: beyond the first a better motion is looked
# for; beyond the second it is wrong; and they are sought up to the last.
ODD_SPREADS = (0.8 * SPREADS[0], 0.8 * SPREADS[1])
WRONG_SPREADS = (1.7 * SPREADS[0], 1.7 * SPREADS[1])
MOST_SPREADS = (3.0 * SPREADS[0], 3.0 * SPREADS[1])
# Gains of brightness are sought between these.
GAINS = (HALF, 1.0 / HALF)
# Depths (1/m) that differ by more are of two surfaces.
SURFACE_STEP_PER_M = 10.0 * SPREADS[1]
# All but a little.
MOST = 1.0 - LITTLE
