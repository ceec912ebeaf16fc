"""Direct odometry that learns the focal length of the color camera while it runs.

A wrong focal length magnifies the keyframe's points and the frame alike, so that it leaves
residuals as soon as the points have moved in the image. One more column of the normal equations
measures it; pose and brightness are marginalized, as they are estimated with it. Brightness and
depth have equations of their own: if they do not agree, the camera is not well calibrated.

The frames' focal length, or what an earlier run has learned of it, is a prior. Each tracked view
adds to the estimate, once the timing of the sensor is certain: a wrong readout looks like a wrong
focal length. Focal lengths are logarithms of the ratio to that of the frames. Information is a
(2, 2) array, by brightness and by depth: A and the product A x with the best focal length x.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import exp, hypot, log, sqrt

import numpy as np

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.direct import DirectOdometry
from vo_service.odometry.direct.factor import (
    Jacobian,
    jacobian,
    student_curvature,
    student_weight,
)
from vo_service.odometry.direct.gauss_newton import add_residual, marginalize
from vo_service.odometry.direct.image_pyramid import ALL_STATIC
from vo_service.odometry.direct.keyframe import DirectKeyframe, make_keyframe
from vo_service.odometry.direct.online_timing import OnlineTimingOdometry
from vo_service.odometry.direct.parameters import (
    FOCAL_DECAY,
    FOCAL_NONLINEARITY,
    FOCAL_POINT_STRIDE,
    FOCAL_PRIOR_SIGMA,
    FOCAL_STEP_RATIO,
    FOCAL_VIEW_ERROR,
    KEYFRAME_FOCAL_SIGMA,
    MAX_FOCAL_CORRECTION,
    MAX_FOCAL_SIGMAS,
    MIN_FOCAL_CHANGE,
    MIN_FOCAL_CHANGE_SIGMAS,
    MIN_FOCAL_DISAGREEMENT_SHARE,
    SETTLED_FOCAL_SIGMA,
    SETTLED_FOCAL_STRIDE,
)
from vo_service.odometry.direct.points import (
    HAS_SHAPE,
    HAS_TEXTURE,
    POINT_BRIGHTNESS,
    POINT_BRIGHTNESS_GRADIENT,
    POINT_BRIGHTNESS_VARIANCE,
    POINT_DEPTH_GRADIENT,
    SAMPLE_BRIGHTNESS,
    SAMPLE_CELL,
    SAMPLE_DEPTH_RESIDUAL,
    SAMPLE_U,
    SAMPLE_V,
)
from vo_service.odometry.direct.residuals import (
    GAIN,
    WEIGHT_BRIGHTNESS,
    residual_variances,
)
from vo_service.types import Estimate, NullStageTimer, OnlineFocalLength, StageTimer

# Pose (6), gain, focal length.
_NUM_UNKNOWNS = 8
_FOCAL = 7
# Rows of the information about the focal length.
BY_BRIGHTNESS, BY_DEPTH = 0, 1


@kernel
def measure_focal_length(
    points: Array,
    samples: Array,
    cell_weights: Array,
    residual_model: Array,
    intrinsics: Array,
    T_camera_keyframe: Array,
) -> Array:
    """Information about the focal length of one view, by brightness and by depth.

    Args:
        points: (N, COLUMNS) of the keyframe's finest level.
        samples: (N, COLUMNS) of the view.
        cell_weights: (2, CELLS).
        residual_model: (6,), see `residuals`.
        intrinsics: (4,) of the whole image.
        T_camera_keyframe: 4x4.

    Returns:
        (2, 2), for each the information A and the product A x with the best change x of the
        logarithm of the focal length.
    """
    H, g = np.zeros((2, _NUM_UNKNOWNS, _NUM_UNKNOWNS)), np.zeros((2, _NUM_UNKNOWNS))
    row = np.zeros(_NUM_UNKNOWNS)
    gain = residual_model[GAIN]
    variance, variance_depth = residual_variances(residual_model)
    for i in range(0, len(points), FOCAL_POINT_STRIDE):
        brightness, depth = samples[i, SAMPLE_BRIGHTNESS], samples[i, SAMPLE_DEPTH_RESIDUAL]
        if np.isnan(brightness):
            continue
        point, cell = points[i], int(samples[i, SAMPLE_CELL])
        magnified = _magnify(
            point, samples[i, SAMPLE_U], samples[i, SAMPLE_V], intrinsics, T_camera_keyframe
        )
        if point[HAS_TEXTURE] > 0:
            residual = brightness - gain * point[POINT_BRIGHTNESS]
            sample_variance = variance + point[POINT_BRIGHTNESS_VARIANCE]
            w = student_weight(residual, sample_variance)
            w *= residual_model[WEIGHT_BRIGHTNESS] * cell_weights[0, cell]
            _fill_row(jacobian(point, POINT_BRIGHTNESS_GRADIENT, gain), magnified, row)
            row[6] = -point[POINT_BRIGHTNESS]
            curvature = w * student_curvature(residual, sample_variance)
            add_residual(H[BY_BRIGHTNESS], g[BY_BRIGHTNESS], row, curvature, w * residual)
        if not np.isnan(depth) and point[HAS_SHAPE] > 0:
            w = student_weight(depth, variance_depth) * cell_weights[1, cell]
            _fill_row(jacobian(point, POINT_DEPTH_GRADIENT, 1.0), magnified, row)
            row[6] = 0.0
            curvature = w * student_curvature(depth, variance_depth)
            add_residual(H[BY_DEPTH], g[BY_DEPTH], row, curvature, w * depth)
    information = np.empty((2, 2))
    for k in range(2):
        of_view = marginalize(H[k], g[k], 1)
        information[k, 0], information[k, 1] = max(of_view[0, 0], 0.0), of_view[0, 1]
    return information


@inline_kernel
def _fill_row(J: Jacobian, magnified: tuple[float, float, float], row: Array) -> None:
    """Fill in the derivatives by pose and focal length."""
    for k in range(6):
        row[k] = J[k]
    row[_FOCAL] = J[0] * magnified[0] + J[1] * magnified[1] + J[2] * magnified[2]


@inline_kernel
def _magnify(
    point: Array, u: float, v: float, intrinsics: Array, T_camera_keyframe: Array
) -> tuple[float, float, float]:
    """Motion of a point in the keyframe's axes, m, by the logarithm of the focal length.

    It moves sideways in the frame's axes, where it is seen at (u, v), and in the keyframe's.
    """
    T, (x, y, z) = T_camera_keyframe, (point[0], point[1], point[2])
    z_there = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
    x_there = (u - intrinsics[2]) / intrinsics[0] * z_there
    y_there = (v - intrinsics[3]) / intrinsics[1] * z_there
    return (
        T[0, 0] * x_there + T[1, 0] * y_there - x,
        T[0, 1] * x_there + T[1, 1] * y_there - y,
        T[0, 2] * x_there + T[1, 2] * y_there,
    )


class FocalEstimator:
    """Information about the focal length, summed over keyframes, and the focal length in use.

    Brightness alone gives the estimate. Depth is only compared with it: the focal length in use is
    kept if brightness is not clearly further away from it than depth.

    Attributes:
        in_use: Focal length in use.
        estimate: Focal length by the prior and brightness.
        sigma: Its standard deviation.
        source: Source of the one in use, see `OnlineFocalLength`.
        disagreement: Focal length by depth minus that by brightness, and its sigma; None while
            unsure.

    Args:
        prior: Focal length in use at the start.
        prior_sigma: Its standard deviation.
        source: Its source.
    """

    def __init__(
        self,
        prior: float = 0.0,
        prior_sigma: float = FOCAL_PRIOR_SIGMA,
        source: str = "intrinsics",
    ) -> None:
        self.source = source
        self.in_use = self.estimate = prior
        self.sigma = prior_sigma
        self._prior = (prior, prior_sigma)
        # Of former keyframes; of the views of the current one.
        self._former, self._current = np.zeros((2, 2)), np.zeros((2, 2))
        self._keyframe_stamp_s = np.nan
        self.disagreement: tuple[float, float] | None = None

    def add(self, keyframe_stamp_s: float, view: Array) -> bool:
        """Add a view; return whether the focal length in use has changed.

        Args:
            keyframe_stamp_s: Stamp of the view's keyframe.
            view: (2, 2) information of the view about the change of the one in use.
        """
        if keyframe_stamp_s != self._keyframe_stamp_s:
            self._former = FOCAL_DECAY * self._from_views()
            self._current = np.zeros((2, 2))
            self._keyframe_stamp_s = keyframe_stamp_s
        self._current += _information_at(view, self.in_use)
        mean, sigma = self._prior
        from_views = self._from_views()
        self.disagreement = _disagreement(from_views)
        information, product = from_views[BY_BRIGHTNESS].tolist()
        self.sigma = 1.0 / sqrt(information + sigma**-2.0)
        self.estimate = (product + mean * sigma**-2.0) * self.sigma**2
        return self._update_in_use()

    def _from_views(self) -> Array:
        """(2, 2) information without the prior; views of one keyframe share an error."""
        return _add_keyframe(self._former, self._current)

    def _update_in_use(self) -> bool:
        target = min(max(self.estimate, -MAX_FOCAL_CORRECTION), MAX_FOCAL_CORRECTION)
        change = abs(target - self.in_use)
        disagreement = self.disagreement
        if disagreement is None or change <= max(
            MIN_FOCAL_CHANGE,
            MIN_FOCAL_CHANGE_SIGMAS * self.sigma,
            MIN_FOCAL_DISAGREEMENT_SHARE * abs(disagreement[0]),
        ):
            return False
        self._prior = (target, hypot(self.sigma, FOCAL_NONLINEARITY * change))
        self.in_use, self.source = target, "learned"
        # Former views are not linear in the change.
        self._former, self._current = np.zeros((2, 2)), np.zeros((2, 2))
        self.disagreement = None
        return True


@kernel
def _information_at(view: Array, in_use: float) -> Array:
    """(2, 2) information about the focal length of a view (2, 2) that is about its change."""
    information = np.empty((2, 2))
    for k in range(2):
        A = FOCAL_STEP_RATIO * view[k, 0]
        information[k, 0], information[k, 1] = A, view[k, 1] + A * in_use
    return information


@kernel
def _add_keyframe(former: Array, views: Array) -> Array:
    """(2, 2) information of former keyframes and of the views of one, which share an error."""
    total = former.copy()
    for k in range(2):
        total[k] += views[k] / (FOCAL_VIEW_ERROR + KEYFRAME_FOCAL_SIGMA**2 * views[k, 0])
    return total


def _disagreement(from_views: Array) -> tuple[float, float] | None:
    (A, b), (A_depth, b_depth) = from_views.tolist()
    if A * MAX_FOCAL_SIGMAS[0] ** 2 < 1.0 or A_depth * MAX_FOCAL_SIGMAS[1] ** 2 < 1.0:
        return None
    return b_depth / A_depth - b / A, sqrt(1.0 / A + 1.0 / A_depth)


class OnlineFocalOdometry:
    """Direct odometry with learned timing and focal length.

    Args:
        odometry: Learns the timing.
        timer: Times the stages; not timed if None.
    """

    def __init__(self, odometry: OnlineTimingOdometry, timer: StageTimer | None = None) -> None:
        self._odometry = odometry
        self._timer = timer or NullStageTimer()
        self._estimator = FocalEstimator()
        self._camera: PinholeCamera | None = None
        self._serial = ""
        self._view_count = 0

    @property
    def keyframes(self) -> Sequence[DirectKeyframe]:
        """The keyframes, the most recently used one last."""
        return self._odometry.tracker.keyframes

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Estimate the camera's pose, see `DirectOdometry.estimate`, and learn from it."""
        if frame.timing_prior is None:
            return self._odometry.estimate(frame)
        # Another sensor has been plugged in: it has its own focal length.
        if frame.camera != self._camera or frame.serial != self._serial:
            self._camera, self._serial = frame.camera, frame.serial
            self._estimator = _start_estimator(frame)
        estimate = self._odometry.estimate(self._correct(frame))
        if estimate.ok and self._odometry.is_timing_certain:
            with self._timer.stage("focal length"):
                self._learn(frame)
        return replace(estimate, focal_length=self._report())

    def _report(self) -> OnlineFocalLength:
        estimator = self._estimator
        disagreement = estimator.disagreement
        return OnlineFocalLength(
            exp(estimator.in_use),
            estimator.sigma,
            disagreement[0] if disagreement else None,
            estimator.source,
        )

    def _correct(self, frame: RgbdFrame) -> RgbdFrame:
        if self._estimator.in_use == 0.0:
            return frame
        return replace(frame, camera=self._correct_camera(frame.camera))

    def _correct_camera(self, camera: PinholeCamera) -> PinholeCamera:
        scale = exp(self._estimator.in_use)
        return replace(camera, fx=scale * camera.fx, fy=scale * camera.fy)

    def _learn(self, frame: RgbdFrame) -> None:
        tracker = self._odometry.tracker
        tracked = tracker.last_frame
        if tracked is None or tracked.images.stamp_s != frame.stamp_s:
            return
        keyframe, alignment = tracked.result.keyframe, tracked.result.alignment
        if keyframe.images.camera != tracked.images.camera:
            return
        self._view_count += 1
        is_settled = self._estimator.sigma < SETTLED_FOCAL_SIGMA
        if is_settled and self._view_count % SETTLED_FOCAL_STRIDE:
            return
        view = measure_focal_length(
            keyframe.points[0],
            alignment.samples,
            alignment.cell_weights,
            alignment.residual_model,
            keyframe.images.intrinsics[0],
            alignment.T_camera_keyframe,
        )
        if self._estimator.add(keyframe.images.stamp_s, view):
            self._replace_keyframes(tracker, self._correct_camera(frame.camera))

    def _replace_keyframes(self, tracker: DirectOdometry, camera: PinholeCamera) -> None:
        """Rebuild the active keyframe with another camera, and forget the others."""
        active = tracker.active_keyframe
        assert active is not None
        rebuilt = _rebuild(active, camera)
        tracker.replace_keyframes([rebuilt], rebuilt)


def _start_estimator(frame: RgbdFrame) -> FocalEstimator:
    prior = frame.focal_prior
    if prior is None:
        return FocalEstimator()
    return FocalEstimator(log(prior.scale), prior.sigma, "memory")


def _rebuild(keyframe: DirectKeyframe, camera: PinholeCamera) -> DirectKeyframe:
    return make_keyframe(
        replace(keyframe.frame, camera=camera),
        replace(keyframe.images, camera=camera),
        keyframe.T_world_keyframe,
        keyframe.motion,
        ALL_STATIC,
    )
