"""Everything about the keyframe odometry that was chosen by measurement, in one place.

docs/keyframe.md shows the sweeps. Kernels are compiled with these values: they are no settings.
Pairs and tuples by level go from fine to coarse; "1/m" is the unit of inverse depth, 1/z.
"""

# Points of a keyframe: one a block of so many pixels, by level; where brightness changes by at
# least so many grey levels a pixel, it is the steepest one.
BLOCKS_PX = (5, 3, 3, 2)
LEAST_GRADIENT = 3.0
# Regions that move by themselves are told on so many levels, and a motion that is nearly right is
# made exact on them.
FINE_LEVELS = 2
# The plane around a point: over (2 RADIUS + 1)^2 readings, every second pixel; readings within so
# much (1/m) of the middle's are of the same surface; they are at least this share; and the plane
# leaves over at most this root mean square (1/m), thrice the noise.
PLANE_RADIUS = 4
SURFACE_STEP_PER_M = 0.03
LEAST_SUPPORT = 0.6
MOST_RMS_PER_M = 4e-3
# Interpolated brightness is as wrong as a shift by this many pixels of the whole image.
INTERPOLATION_PX = 0.15
# Student's t: degrees of freedom, and what brightness weighs beside depth.
FREEDOM = 4.0
BRIGHTNESS_SHARE = 0.5
# What is off by more standard deviations than this does not agree, or surprises.
SIGMAS = 3.0
# Spreads are sought between these, of brightness (grey levels) and of depth (1/m).
BRIGHTNESS_SPREAD = (1.0, 30.0)
DEPTH_SPREAD_PER_M = (6e-4, 1e-2)
# Gains of brightness are sought between these; beyond, the light is another.
GAINS = (0.5, 2.0)
# Gauss-Newton: steps at most, by level.
STEPS = (24, 24, 15, 12)
# The camera's velocity differs from the mean since the last frame by so much at most: m/s, rad/s.
VELOCITY_SIGMA = (0.03, 0.1)
# The next keyframe is due when less than this share of the last is in view, or it has moved by
# more than this in the image; an older one is used again if it is this near.
KEYFRAME_OVERLAP = 0.75
KEYFRAME_FLOW_PX = 60.0
REUSE_FLOW_PX = 42.0
# So many others have a say where the next keyframe is.
JOINT_KEYFRAMES = 2
# Spreads (grey levels, 1/m) beyond which a better motion is looked for, and beyond which it is
# wrong; and the shares of depth and brightness readings that agree where it is right.
ODD_SPREADS = (8.0, 2.4e-3)
WRONG_SPREADS = (17.0, 4e-3)
LEAST_AGREEING = (0.8, 0.7)
# A direction of motion is known if the readings say so many times more of it than their noise.
KNOWN = 3.0
# A better motion is looked for also where regions that do not fit are this share of the view.
ODD_SHARE = 0.1
# A cell of the image is a region that moves by itself if it fits so many times worse than others.
ODD_REGION = 1.8
