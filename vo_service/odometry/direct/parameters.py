"""Tuning parameters of the direct odometry: 50 values chosen by measurement.

docs/direct.md shows the effect of other values. Kernels are compiled with these
values, so they are no settings. A tuple is one quantity: by level from fine to coarse; or for
brightness in gray levels and depth in 1/m (inverse depth 1/z); or in meters and radians. Values
that follow from these are in `derived_parameters.py` or beside their use, as are array sizes and
convergence limits.
"""

# KEYFRAME POINTS
# One point per block of this size, by level: the pixel with the steepest brightness.
POINT_BLOCKS_PX = (5, 3, 3, 2)
# Interpolated brightness has the error of an image shifted by this many pixels.
INTERPOLATION_PX = 0.15
# The plane around a point is fitted to depth pixels up to this far away in both directions.
PLANE_RADIUS_PX = 6
# Smallest share of those pixels that belong to the same surface.
MIN_PLANE_SUPPORT = 0.6
# Noise of the slopes per pixel: of brightness in gray levels, of depth in 1/m.
SLOPE_NOISE = (0.7, 8.9e-5)

# SAMPLE WEIGHTS
# Noise of the sensor: lower bound of the residuals' sigma.
SENSOR_SIGMAS = (1.0, 6e-4)
# Initial sigma of the residuals: noise, interpolation and plane fit together.
INITIAL_SIGMAS = (10.0, 3e-3)
# Degrees of freedom of Student's t, and the weight of brightness relative to depth.
DEGREES_OF_FREEDOM = 3.0
BRIGHTNESS_WEIGHT = 0.45
# Gate in standard deviations for inliers, innovations, observability and texture.
GATE_SIGMAS = 3.0
# The lighting has changed where brightness differs by more than this factor.
MAX_BRIGHTNESS_RATIO = 1.5
# Forgetting factor: of the vignetting estimate per view, of the motion statistics per frame.
DECAY = 0.9
# A cell of the image moves independently if its cost is this many times the median cost.
MAX_REGION_COST_RATIO = 1.8

# MOTION PREDICTION
# Sigma of the camera's velocity against its mean since the last frame, in m/s and rad/s. Directions
# without constraint are as uncertain as this velocity makes them in a second.
VELOCITY_SIGMA = (0.03, 0.1)
# Range of that sigma as a multiple of it: the minimum at rest; the maximum where the last frame
# gives no velocity.
VELOCITY_SIGMA_RANGE = (0.003, 10.0)
# Within this time hand tremor changes the angular velocity as much as from one frame to the next.
TREMOR_SPAN_S = 0.01
# After this time the predicted pose may be far off, and a similar place may fit: features decide.
# At the sensor's 30 Hz, this is two frames without a pose.
MAX_PREDICTION_S = 0.08
# After this time the last frames give no velocity. A degenerate view is accepted for this time
# after the last well constrained one.
MAX_STEP_S = 0.4
# The innovation is relative to the velocity noise, or to at least this share of the usual sigma.
MIN_VELOCITY_NOISE_RATIO = 0.5
# The last gain and offset are kept if the mean brightness changes by no more than this share.
MAX_STEADY_BRIGHTNESS_CHANGE = 0.1
# Smallest gain of the affine brightness model; the largest is its inverse.
MIN_GAIN = 0.5
# Smallest gain of the pose filter: a frame's share in the pose of a camera at rest.
MIN_POSE_GAIN = 0.1
# Sigma of the vignetting before any view, and its largest value.
VIGNETTING_PRIOR_SIGMA = 0.1
MAX_VIGNETTING = 0.5

# VALIDITY AND RECOVERY
# Fewest points or samples for a motion; half as many give a sigma, twice as many a first keyframe.
MIN_POINTS = 100
# Smallest share of the keyframe's points in view.
MIN_IN_VIEW_SHARE = 0.25
# Smallest share of the samples that agree with the keyframe.
MIN_CONSISTENT_SHARE = 0.75
# A region of less weight is moving.
MIN_STATIC_WEIGHT = 0.5
# A frame with a larger share of moving regions is retried.
MAX_MOVING_SHARE = 0.1
# A frame with a larger share of moving or occluded view is rejected.
MAX_MOVING_OR_OCCLUDED_SHARE = 0.5
# Brightness or depth of a smaller share of the view does not constrain the motion.
MIN_MODALITY_SHARE = 0.1
# Another motion replaces the first one if its score is lower by at least this share.
MIN_SCORE_GAIN = 0.1
# Weight of the innovation in the cost by which the motions of masked views are compared.
INNOVATION_COST_WEIGHT = 0.1
# Probability that a feature match agrees with the right motion, and with a wrong one.
FEATURE_INLIER_SHARES = (0.2, 0.03)
# Number of keyframes that are searched for features, and of matches that are aligned: the best
# match may be on a moving object.
MAX_SEARCHED_KEYFRAMES = 8
MAX_FEATURE_MATCHES = 3
# Features are not searched for in this many doubtful frames after a search without success: motion
# blur and darkness last.
RETRY_INTERVAL_FRAMES = 3
# The first keyframe is dropped after this many failures, as it may be distorted by a fast turn;
# later ones after more.
MAX_INITIAL_FAILURES = 3
MAX_FAILURES = 60

# KEYFRAMES
# Largest number of keyframes that are kept.
MAX_KEYFRAMES = 30
# The next keyframe is due when the flow against the last one is larger,
MAX_KEYFRAME_FLOW_PX = 70.0
# or a smaller share of its points is in view,
MIN_KEYFRAME_OVERLAP = 0.75
# or the observability falls below this share of its first value.
MIN_OBSERVABILITY_RATIO = 0.5
# Number of other keyframes that the next one is aligned with, and the share of their points in
# view.
MAX_JOINT_KEYFRAMES = 2
MIN_JOINT_OVERLAP = 0.5
# A frame with more occlusion is no keyframe.
MAX_KEYFRAME_OCCLUDED_SHARE = 0.25
# A keyframe has at least this share of the points of the one before.
MIN_KEYFRAME_POINT_SHARE = 0.25
# Dynamic points are removed if other keyframes know at least this share of the view,
MIN_KNOWN_SHARE = 0.25
# and a surface is static if they have observed at least this share of it.
MIN_OBSERVED_SHARE = 0.25

# COVARIANCE
# Factor for errors that are common to the whole image, which the residuals do not show.
COVARIANCE_INFLATION = 2.0
