"""Direct odometry that learns the focal length of the color camera while it runs.

The frames' focal length, or what an earlier run has learned of it, is a prior. Each tracked view
adds to the estimate, once the timing of the sensor is certain: a wrong readout looks like a wrong
focal length.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import exp, log

from drivers.camera import PinholeCamera, RgbdFrame
from vo_service.odometry.direct.focal_equations import measure_focal_length
from vo_service.odometry.direct.focal_estimate import FocalEstimator
from vo_service.odometry.direct.image_pyramid import ALL_STATIC
from vo_service.odometry.direct.keyframe import DirectKeyframe, make_keyframe
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.online_timing import OnlineTimingOdometry
from vo_service.odometry.profiling import NullStageTimer, StageTimer
from vo_service.types import Estimate, OnlineFocalLength


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
            exp(estimator.in_use), estimator.sigma, disagreement[0] if disagreement else None
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
    return FocalEstimator(log(prior.scale), prior.sigma) if prior else FocalEstimator()


def _rebuild(keyframe: DirectKeyframe, camera: PinholeCamera) -> DirectKeyframe:
    return make_keyframe(
        replace(keyframe.frame, camera=camera),
        replace(keyframe.images, camera=camera),
        keyframe.T_world_keyframe,
        keyframe.motion,
        ALL_STATIC,
    )
