"""Parameters of the direct odometry: every threshold has one name here and one purpose.

Kernels are compiled with these values, so they are no settings. A tuple is one quantity: by pyramid
level from fine to coarse; or for brightness in gray levels and for depth in 1/m (inverse depth
1/z); or for translation in m and rotation in rad. Where no source is named, the value was chosen by
measurement; docs/design/direct.md shows the effect of other values. Sizes of arrays (cells of the
image, bands of rows, columns) stand beside their arrays.
"""

# IMAGE PYRAMID
# Images with a longer side than this are halved before all else. A plane is fitted to a window of
# pixels, small in a large image: room_rolling at 1280x960 is off by 464 mm, halved by 5 mm.
MAX_IMAGE_PX = 960
# Images are also halved if depth then covers this many times as much of them: it is a grid with
# holes where a smaller depth image is registered to a larger color image, pixel by pixel. The gain
# is at most 1.14 for sensors at hand; with a limit of 1.5, room_rolling with half of its depth
# pixels missing is off by 355 mm instead of 5.
MIN_COVERAGE_GAIN = 1.2
# Smaller levels than this are omitted, except the largest one.
MIN_IMAGE_PX = 12
# Number of the finest levels on which moving regions are detected and a good motion is refined.
NUM_FINE_LEVELS = 2
# Added to a mean brightness (gray levels) before a ratio is formed, so that black images have one.
DARK_BRIGHTNESS = 1.0
# Smallest gain of the affine brightness model; the largest one is its inverse.
MIN_GAIN = 0.5

# DEPTH NOISE
# Sigma of the inverse depth of a pixel before the first frame, 1/m: that of a Kinect. Also the
# smallest one in use: registration and the motion within a frame have errors as well.
DEPTH_NOISE_PER_M = 1.5e-3
# Planes are fitted in this many windows along the longer side of an image. In these fits neighbors
# may differ by this, 1/m, as the noise is not known yet.
NOISE_WINDOWS = 40
MAX_NOISE_STEP_PER_M = 0.03

# KEYFRAME POINTS
# The longer side of an image is divided into at most this many blocks, by level; of each, the pixel
# with the steepest brightness is a point. Engel, Koltun and Cremers, "Direct Sparse Odometry" (PAMI
# 40, 2018), Section 3.2, for one point per block. Blocks of 5, 3, 3 and 2 pixels of a Kinect.
POINT_BLOCKS = (64, 54, 27, 20)
# Smallest share of the pixels with depth for blocks of this size; with less they are smaller.
MIN_DEPTH_SHARE = 0.2
# The same of the profile `small`, for a small board: half the points, and a level less.
SMALL_POINT_BLOCKS = (46, 40, 20)
# Smallest brightness gradient of a point with texture, as a multiple of the noise of a pixel; and
# its range, gray levels per pixel: where all is texture, as on a carpet, it passes for noise.
MIN_TEXTURE_SIGMAS = 3.0
MIN_TEXTURE_GRADIENTS = (3.0, 6.0)
# Interpolated brightness has the error of an image shifted by this many pixels.
INTERPOLATION_PX = 0.15
# The plane around a point is fitted to depth pixels up to this far away in both directions,
PLANE_RADIUS_PX = 6
# at this distance from each other.
PLANE_STEP_PX = 2
# Smallest share of those pixels that belong to the same surface.
MIN_PLANE_SUPPORT = 0.6
# Largest root mean square residual of a plane, as a multiple of the noise.
MAX_PLANE_RMS_RATIO = 2.2
# Pixels up to PLANE_RADIUS_PX apart belong to one surface if their inverse depths differ by no more
# than this share, that of a surface seen at 6 degrees, and this multiple of the noise.
MAX_SURFACE_STEP_SHARE = 0.05
MAX_SURFACE_STEP_SIGMAS = 4.0

# SAMPLES
# Nearest point that is projected, m.
MIN_DEPTH_M = 0.05
# Two views see the same surface if its inverse depths differ by no more than this multiple of the
# step within a surface: the motion is not exact yet.
MAX_SAME_SURFACE_RATIO = 2.0

# RESIDUALS
# Sigmas of residuals, brightness in gray levels and depth as a multiple of its noise: their lower
# bound; before the first step, with interpolation and plane fit.
MIN_SIGMAS = (1.0, 0.4)
INITIAL_SIGMAS = (10.0, 2.0)
# Upper bound of the estimated sigmas, as a multiple of the initial ones: no timing is better by
# how badly another one fits.
MAX_SIGMA_RATIO = 3.0
# Fewest samples, or planes, for an estimate of sigma.
MIN_SIGMA_SAMPLES = 50.0
# Degrees of freedom of the residuals' Student's t. Kerl, Sturm and Cremers, "Robust Odometry
# Estimation for RGB-D Cameras" (ICRA 2013) use 5.
DEGREES_OF_FREEDOM = 3.0
# Weight of brightness relative to depth before any view; of brightness whose samples do not share
# errors.
BRIGHTNESS_WEIGHT = 0.45
INDEPENDENT_BRIGHTNESS_WEIGHT = 1.5
# Forgetting factor per view of the errors that brightness samples share.
SHARED_ERROR_DECAY = 0.99
# A sample within this many sigmas agrees with its point; larger residuals cost no more.
INLIER_GATE_SIGMAS = 3.0
# A cell of the image moves independently if its cost is this many times the median cost.
MAX_REGION_COST_RATIO = 1.8
# Cells with fewer samples keep their weight.
MIN_CELL_SAMPLES = 10
# A cell of less weight is moving.
MIN_STATIC_WEIGHT = 0.5

# ALIGNMENT
# Largest number of Gauss-Newton steps, by level.
MAX_STEPS = (24, 24, 15, 12)
# A smaller step (m and rad) is the last one of its level: at the finest level it is well below the
# noise, at the others below what the next finer level corrects.
MIN_STEP_SIZES = (2e-4, 7e-4, 2e-3, 4e-3)
# Updates of the residual model in the first step; later steps have one.
INITIAL_MODEL_UPDATES = 3
# Sigma that damps directions without constraint, m and rad.
DAMPING_SIGMAS = (0.03, 0.1)

# MOTION PREDICTION
# Sigma of the camera's velocity against its mean since the last frame, m/s and rad/s.
VELOCITY_SIGMA = (0.03, 0.1)
# Range of that sigma as a multiple of it: the minimum at rest; the maximum where the last frame
# gives no velocity.
VELOCITY_SIGMA_RANGE = (0.003, 10.0)
# Within this time hand tremor changes the angular velocity as much as from one frame to the next.
TREMOR_SPAN_S = 0.01
# After this time the predicted pose may be far off: the alignment also starts at rest and from
# features. At the sensor's 30 Hz, this is two frames without a pose.
MAX_PREDICTION_S = 0.08
# After this time the last frames give no velocity, and a degenerate view is no longer accepted.
MAX_EXTRAPOLATION_S = 0.4
# Shortest time over which a mean velocity is formed: two frames may have nearly the same stamp.
MIN_FRAME_INTERVAL_S = 1e-3
# Forgetting factor per frame of the velocity noise and of the normalized innovation.
MOTION_DECAY = 0.9
# Share of the measured pose's covariance that differs from frame to frame; the rest is that of the
# keyframe, which a filter does not average out.
FRAME_COVARIANCE_SHARE = 0.1
# Smallest covariance of the prediction, as a share of that of the measured pose.
MIN_PREDICTION_SHARE = 0.01

# RECOVERY
# A pose by features confirms that of an alignment, and the motion in a degenerate view is as
# predicted, if their squared difference, relative to the covariance, is smaller: 99.9 % of the
# chi-square distribution with six degrees of freedom.
MAX_SQUARED_POSE_DIFFERENCE = 22.5
# Number of keyframes that are searched for features: the active one, then the last used ones.
MAX_SEARCHED_KEYFRAMES = 3
# The lighting has changed where brightness differs by more than this factor.
MAX_BRIGHTNESS_RATIO = 1.5
# After more failures the first keyframe is dropped, as a fast turn may have distorted it, and all
# keyframes if the last pose is older than this.
MAX_FAILURES, MAX_LOST_S = 3, 2.0

# QUALITY
# Fewest points of the keyframe in view, and fewest samples of them, that give a motion.
MIN_SAMPLES = 100
# Smallest share of the keyframe's points in view, also of one that another is aligned with.
MIN_IN_VIEW_SHARE = 0.25
# Smallest share of the samples that agree with the keyframe.
MIN_CONSISTENT_SHARE = 0.75
# If the last pose is old, a motion with a larger sigma, as a share of the largest valid one, or
# with a smaller observability, may be at another place: of 175 alignments over 0.2 to 1.3 s, 30 of
# the 35 wrong ones, but only 4 % of the right ones.
SUSPECT_SIGMA_SHARE = 0.9
MIN_DISTANT_OBSERVABILITY = 6.5
# A motion with a larger sigma, as a multiple of the initial one, is wrong. Brightness may also fit
# as badly as this share of the contrast: it is registered to depth within a pixel or two.
MAX_VALID_RATIOS = (2.0, 1.7)
MAX_VALID_CONTRAST_SHARE = 0.35
# A frame with a larger share of moving or occluded view is rejected.
MAX_MOVING_OR_OCCLUDED_SHARE = 0.5
# A frame with a larger share of occluded view is degraded, and no keyframe.
MAX_OCCLUDED_SHARE = 0.25
# Brightness or depth of a smaller share of the view does not constrain the motion.
MIN_MODALITY_SHARE = 0.1

# COVARIANCE AND DEGENERATE VIEWS
# Noise of the slopes per pixel: of brightness in gray levels; of depth as a multiple of its noise,
# with PLANE_RADIUS_PX.
SLOPE_NOISE = (0.7, 0.06)
# Smallest ratio of a direction's information to that of noise; a smaller one is unconstrained.
MIN_VIEW_OBSERVABILITY = 3.0
# A view of one plane leaves three directions weak: the third smallest ratio is 4.5 to 11 before a
# bare wall, and at least 16 elsewhere.
MIN_PLANE_OBSERVABILITY = 12.0
# Below this ratio a constrained direction is weak: noise pulls each pose towards its keyframe, so
# errors of successive keyframes have one sign. 3.7 to 7 at the edge of a bare wall; at least 36 in
# redkitchen and room_desk.
MIN_UNBIASED_OBSERVABILITY = 7.5
# Factor for errors that are common to the whole image, which the residuals do not show.
COVARIANCE_INFLATION = 2.0
# Lower bound of the pose's sigmas, m and rad: errors of the lens and of the depth's registration.
MIN_POSE_SIGMAS = (1.1e-4, 1.1e-4)

# VIGNETTING
# Sigma of the vignetting before any view, and its largest value.
VIGNETTING_PRIOR_SIGMA = 0.1
MAX_VIGNETTING = 0.5
# Sigma of a single view, however many samples it has: surfaces are shiny, and lamps are near.
VIGNETTING_VIEW_SIGMA = 0.05

# KEYFRAMES
# Fewest points of a keyframe.
MIN_KEYFRAME_POINTS = 200
# Forgetting factor per keyframe of the noise of depth and of the vignetting.
KEYFRAME_DECAY = 0.8
# The first keyframe of a rolling shutter is rebuilt this many times, by the velocity that the one
# before gives: with one, the second pose of a fast start is off by 0.8 mm instead of 0.2 mm.
REINITIALIZATIONS = 2
# Largest number of keyframes that are kept.
MAX_KEYFRAMES = 30
# The next keyframe is due when the flow against the last one is larger, as a share of the longer
# side of the image: 70 pixels of a Kinect;
MAX_KEYFRAME_FLOW = 7 / 64
# or a smaller share of its points is in view.
MIN_KEYFRAME_OVERLAP = 0.75
# Number of other keyframes that the next one is aligned with.
MAX_JOINT_KEYFRAMES = 2
# Steps of that alignment.
NUM_JOINT_STEPS = 2

# DYNAMIC POINTS
# The view is divided into blocks of this size; the pixel in the center stands for the block.
DYNAMIC_BLOCK_PX = 8
# A block is in free space if everything a block around it is further away: edges move by some
# pixels, and rows have different times. Dynamic points are removed if other keyframes have observed
# at least this share of the view; a surface is static if they have observed this share of it.
MIN_OBSERVED_SHARE = 0.25

# ROBOT BODY
# A block belongs to the robot's body if it was at rest in so many keyframes in a row.
MIN_BODY_VIEWS = 2
# Two views show the same texture if their brightness correlates by this much, and its standard
# deviation is at least this, gray levels.
MIN_BODY_CORRELATION = 0.8
MIN_BODY_CONTRAST = 5.0

# CALIBRATION
# Several values are of readout time and delay of depth after color, s, then of the logarithm of the
# focal length (0.01 is 1 % longer), then of the disagreement of depth with brightness about it.
# Every view, and every point, of this many is used for the calibration.
CALIBRATION_STRIDE = 2
# Information of the depth camera's turn against the color camera, 1/rad^2: that of 3 px or 6 mrad,
# times the error of a view, as the view's information is too large by that factor.
TURN_INFORMATION = 4e5
# Slower views are not used, and the search for the timing begins there. In rad/s, as if everything
# were SCENE_DEPTH_M away.
MIN_CALIBRATION_SPEED = 0.15
SCENE_DEPTH_M = 2.0
# The largest interval between poses that a velocity is computed from, s.
MAX_POSE_INTERVAL_S = 0.2
# Squared error of a view, relative to its information: forgetting factor of its mean, and value
# before the first view. It is 2 of smooth motions and 120 of room_rolling: with 20 there, the
# timing jumps by several ms, and the focal length is learned 2 % wrong.
VIEW_ERROR_DECAY = 0.95
INITIAL_VIEW_ERROR = 100.0
# Sigmas of the error that all views of one keyframe share.
KEYFRAME_CALIBRATION_SIGMAS = (0.004, 0.002, 0.015, 0.020)
# Forgetting factor per keyframe.
CALIBRATION_DECAY = 0.99
# Sigma of the frames' focal length: a Kinect's usual intrinsics are 1 to 3 % off.
FOCAL_PRIOR_SIGMA = 0.02
# Largest sigmas of an estimate that is used.
MAX_CALIBRATION_SIGMAS = (0.005, 0.003, 0.009, 0.020)
# The calibration in use changes by at least this much, and by its sigma.
MIN_CALIBRATION_CHANGES = (0.001, 0.0005, 0.004)
# If so many last keyframes differ from all before by so many sigmas, the timing has changed, and
# all before is forgotten. The frames contradict what they tell if they differ by as much.
NUM_RECENT_KEYFRAMES = 4
CALIBRATION_CHANGE_SIGMAS = 3.5
# Frames are compared with and without what was learned: the first ones, then one of every so many.
# A learned value is used if the last ones together fit better with it, by this much of the negative
# log-likelihood each: a needed timing gains 0.2 (redkitchen) to 1 (room_rolling), and of a global
# shutter (room_desk) it is 0.00 +- 0.03.
TRIAL_INTERVAL = 30
NUM_TRIAL_FRAMES = 4
MIN_TRIAL_GAIN = 0.02
# The search for the timing takes at most this many frames.
NUM_SEARCHED_FRAMES = 8
# Its steps in readout and delay: three values each.
SEARCH_STEPS_S = (0.015, 0.008)
# Difference of the summed logarithms of the residuals' sigmas that halves a timing's weight thrice.
SEARCH_SCORE_SCALE = 0.5
# The best timing is used if its score, in that scale, is lower by this much than without a
# correction; before the last frame of the search, and if most frames are degraded, if it is lower
# by the second value.
MIN_SEARCH_SCORE_GAIN = 1.0
SUFFICIENT_SEARCH_SCORE_GAIN = 4.0
