"""Everything about the keyframe odometry that was chosen by measurement: 25 quantities.

docs/direct.md shows what other values do. Kernels are compiled with these: they are no settings.
A tuple is one quantity: by level from fine to coarse; or of brightness, in gray levels, and of
depth, in 1/m, the unit of inverse depth 1/z; or of metres and radians; or from few to many. What is
derived from them is in `limits.py` or stands beside its use, as do sizes of arrays and where
iterations end.
"""

# THE POINTS OF A KEYFRAME
# One a block of so many pixels, by level: the one of the steepest brightness.
POINT_BLOCKS_PX = (5, 3, 3, 2)
# Interpolated brightness is as wrong as a shift by this many pixels of the whole image.
INTERPOLATION_PX = 0.15
# The plane around a point has depth readings up to so many pixels away, in both directions.
PLANE_RADIUS_PX = 6
# At least this share of them is of the same surface.
MIN_PLANE_SUPPORT = 0.6
# Noise of its slopes, a pixel: of brightness, gray levels, and of depth, 1/m.
SLOPE_NOISE = (0.7, 8.9e-5)

# WHAT READINGS WEIGH
# The sensor's noise: no spread is less.
SENSOR_SIGMAS = (1.0, 6e-4)
# What readings are off by before anything is known, of noise, interpolation and planes together.
INITIAL_SIGMAS = (10.0, 3e-3)
# Student's t: degrees of freedom, and what brightness weighs beside depth.
DEGREES_OF_FREEDOM = 3.0
BRIGHTNESS_WEIGHT = 0.45
# What is off by more standard deviations does not agree; or surprises; or is more than noise.
GATE_SIGMAS = 3.0
# Brightness so many times as great, or one part in so many, is another light.
MAX_BRIGHTNESS_RATIO = 1.5
# What is known of the lens, see `falloff`, fades by this factor a view; of how the camera moves, a
# frame.
DECAY = 0.9
# A cell of the image is a region that moves by itself if it fits so many times worse than others.
MAX_REGION_COST_RATIO = 1.8

# WHERE THE CAMERA IS SOUGHT
# The camera's velocity differs from the mean since the last frame by so much, in m/s and rad/s.
# What nothing in view settles is as unsure as that makes it in a second.
VELOCITY_SIGMA = (0.03, 0.1)
# It does so by this share of that at least, even when it stands; and by so many times as much where
# the last frame does not tell it.
VELOCITY_SIGMA_RANGE = (0.003, 10.0)
# In the first of these times a hand's turning changes by as much as from one frame to the next: the
# shutter's rows show it. After more seconds than the second the camera may be far from where it is
# expected, and another place near to that may fit: features tell. At the sensor's 30 Hz, this is
# two frames without a pose. After more than the third, the last frames say nothing of the velocity;
# and a view that leaves directions of motion open is not believed so long after the last one that
# did not.
TIME_SPANS_S = (0.01, 0.08, 0.4)

# SHARES
# What is worth a second look: of the view that does not fit, of a change of brightness, of a better
# fit, of a surprise. Brightness or depth of fewer points has no say. A frame of a camera that
# stands still has this share in its pose. A lens takes this from its corners, for all that is known
# before anything is seen (sigma).
SLIGHT = 0.1
# Less of a keyframe in view is not believed; nor, of a surface, that it has been seen, or has depth
# enough for a keyframe. When more of the view is hidden, it is told, and no keyframe is made of it.
# All but so much of what is read agrees; and the next keyframe is due when more is out of view.
LITTLE = 0.25
# No more of a view that is believed is hidden or does not fit; another keyframe that has a say in
# where the next one is has at least this share of its points in view. A region of less weight
# hardly counts; a change of the velocity by less of what is usual surprises nobody; no lens takes
# more light from a corner, and no gain more of it. A view that says little is followed by the next
# keyframe when it is less than so much as clear as at first.
HALF = 0.5

# WHETHER IT IS RIGHT, AND WHAT ELSE IS TRIED
# Fewer points or readings tell nothing of a motion; half as many nothing of a spread, and twice as
# many make a first keyframe.
MIN_POINTS = 100
# A feature that matches agrees with a right motion, and by chance with a wrong one, this often.
FEATURE_INLIER_SHARES = (0.2, 0.03)
# How many keyframes: have a say in where the next one is; are laid on a frame, of those that
# features have found; are searched for features; and are kept.
KEYFRAME_COUNTS = (2, 3, 8, 30)
# Patience, in frames. The first: features that changed nothing are asked again after so many odd
# frames, for blur lasts, and so does the dark; and a first keyframe is given up that so many did
# not fit. The second: so do all keyframes.
FAILURE_LIMITS_FRAMES = (3, 60)
# The next keyframe is due when the last has moved by so much in the image.
MAX_KEYFRAME_FLOW_PX = 70.0

# HOW SURE IT IS
# What all of the image is wrong about alike does not show: so many times what does.
COVARIANCE_INFLATION = 2.0
