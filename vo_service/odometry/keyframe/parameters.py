"""Everything about the keyframe odometry that was chosen by measurement, in one place.

docs/keyframe.md shows the sweeps. Kernels are compiled with these values: they are no settings.
A tuple is one quantity: by level from fine to coarse; or of brightness, in grey levels, and of
depth, in 1/m, the unit of inverse depth 1/z; or of metres and radians. What stands beside its use
elsewhere is derived from these, or a size of arrays, or where iterations end.
"""

# THE POINTS OF A KEYFRAME
# One a block of so many pixels, by level; where brightness changes by at least so many grey levels
# a pixel, it is the steepest one.
BLOCKS_PX = (5, 3, 3, 2)
LEAST_GRADIENT = 3.0
# Interpolated brightness is as wrong as a shift by this many pixels of the whole image.
INTERPOLATION_PX = 0.15
# The plane around a point: over (2 RADIUS + 1)^2 readings, so many pixels apart; readings within so
# much (1/m) of the middle's are of the same surface; they are at least this share; and the plane
# leaves over at most this root mean square (1/m), twice the noise.
PLANE_RADIUS = 4
PLANE_STEP_PX = 2
SURFACE_STEP_PER_M = 0.03
LEAST_SUPPORT = 0.6
MOST_RMS_PER_M = 3e-3
# Noise of a point's slopes, a pixel of its level or of the depth image.
SLOPE_NOISE = (0.7, 5e-5)

# WHAT READINGS WEIGH
# Student's t: degrees of freedom, and what brightness weighs beside depth.
FREEDOM = 4.0
BRIGHTNESS_SHARE = 0.5
# What is off by more standard deviations does not agree; or surprises.
SIGMAS = 3.0
# Spreads begin at the first, and are sought between the other two.
START_SPREADS = (10.0, 3e-3)
LEAST_SPREADS, MOST_SPREADS = (1.0, 6e-4), (30.0, 1e-2)
# Gains of brightness are sought between these; beyond, the light is another.
GAINS = (0.5, 2.0)
# Light that the lens loses towards the corners, see `falloff`: before anything is seen, there is
# none but for the first of these (sigma); a single view is off by the second, how many readings it
# may have, for surfaces shine and lamps are near. What was known fades by this factor a view; and
# there is never more than this.
FALLOFF_SIGMAS = (0.1, 0.05)
FALLOFF_FADING = 0.9
MOST_FALLOFF = 0.5
# A cell of the image is a region that moves by itself if it fits so many times worse than others.
ODD_REGION = 1.8

# WHERE THE CAMERA IS SOUGHT
# Gauss-Newton: steps at most, by level.
STEPS = (24, 24, 15, 12)
# Regions that move by themselves are told on so many levels, and a motion that is nearly right is
# made exact on them.
FINE_LEVELS = 2
# Directions that nothing in view settles are left alone: steps along them cost as if they were
# known to this, in m and rad.
LOOSE = (0.05, 0.1)
# The camera's velocity differs from the mean since the last frame by so much at most, in m/s and
# rad/s; by so many times as much where the last frame does not tell it; and even when it stands, by
# this share of that. How much it did of late fades by this factor a frame.
VELOCITY_SIGMA = (0.03, 0.1)
UNSURE = 10.0
CALM = 0.003
FADING = 0.9
# Changes of the velocity by less than this share of the usual surprise nobody.
LEAST_AGITATION = 0.5
# After more seconds than the first the camera may be far from where it is expected, and another
# place near to that may fit: features tell. At the sensor's 30 Hz, this is two frames without a
# pose. After more than the second, the last frames say nothing of the velocity.
LONGEST_S = (0.08, 0.4)
# A mean brightness that is off by more than this share has changed at once.
LIGHT_JUMP = 0.08

# WHETHER IT IS RIGHT
# Spreads beyond which a better motion is looked for, and beyond which it is wrong.
ODD_SPREADS = (8.0, 2.4e-3)
WRONG_SPREADS = (17.0, 4e-3)
# A better motion is looked for also where regions that do not fit are this share of the view.
ODD_SHARE = 0.1
# The shares of brightness and of depth readings that agree where it is right.
LEAST_AGREEING = (0.7, 0.8)
# Fewer points or readings than this tell nothing: of a spread, of a motion, as a first keyframe.
FEWEST_POINTS = (50, 100, 200)
# It is not believed when less than this share of a keyframe is in view; and when more of the view
# is hidden, it is told, and no keyframe is made of it.
LITTLE = 0.2
# Less than this share of the points in view has no say.
LEAST_SAY = 0.05
# Of a surface that has not come by itself, other keyframes have seen this share at least; and of a
# view in which such surfaces can be told.
LEAST_SEEN = 0.25
# A place is seen through if all that is so many pixels around it is further away: edges are not
# where they were by some pixels, and rows are not of one instant.
AROUND_PX = 6
# Of a view that is believed, at most this share does not fit; and does not fit or is hidden.
MOST_MOVING, MOST_COVERED = 0.45, 0.5

# WHAT ELSE IS TRIED
# A feature that matches agrees with a right motion, and by chance with a wrong one, this often.
SIGHTED = (0.2, 0.03)
# Another motion is better if the keyframe fits this much better.
CLEARLY = 0.9
# A mean brightness so many times that of the keyframe, or one part in so many, is another light.
OTHER_LIGHT = 1.5
# So many keyframes are searched for features, and so many that are found are followed up: a thing
# that moves may be seen in the best of them.
SEARCHED_KEYFRAMES = 8
MOST_SIGHTINGS = 3
# Patience, in frames. The first: features that changed nothing are asked again after so many odd
# frames, for blur lasts, and so does the dark; and a first keyframe is given up that so many did
# not fit. The second: so do all keyframes.
PATIENCE_FRAMES = (3, 30)
# What a surprise costs, beside the mean cost of a reading.
SURPRISE_SHARE = 0.1

# THE NEXT KEYFRAME
# It is due when less than the first share of the last is in view; another has a say in where it is
# if at least the second is.
KEYFRAME_OVERLAP = (0.75, 0.5)
# It is due when the last has moved by more than the first in the image; an older one is used again
# if it has by less than the second.
KEYFRAME_FLOW_PX = (60.0, 42.0)
# With less depth than this share of the points of the last, a frame is no good keyframe.
LEAST_DEPTH = 0.3
# So many others have a say; and so many are kept.
JOINT_KEYFRAMES = 2
KEYFRAMES = 30

# HOW SURE IT IS
# A direction of motion is known if the readings say so many times more of it than their noise.
KNOWN = 3.0
# What all of the image is wrong about alike does not show: so many times what shows.
SHARED = 2.0
# How far the camera strays between rows, times the time between them and its agitation.
STRAY = 0.3
# Nothing is surer than this: what calibration and timing leave over, in m and rad.
SUREST = (1e-4, 1e-4)
