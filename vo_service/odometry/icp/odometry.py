"""Odometry by depth only: point-to-plane ICP with projective association.

Chen and Medioni (1991) for the distance, Besl and McKay (1992) for the iteration, Rusinkiewicz and
Levoy (2001) for the sampling of points and the projection. It needs shape, and no light.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, transport_covariance
from vo_service.odometry.icp.alignment import (
    COARSE_TO_FINE,
    FINE_ONLY,
    MIN_PLANES,
    IcpAlignment,
    PlanePyramid,
    align,
    evaluate_alignment,
)
from vo_service.odometry.icp.depth_pyramid import DepthLevel, DepthPyramid, build_depth_pyramid
from vo_service.odometry.icp.planes import find_planes
from vo_service.odometry.icp.residuals import compute_residuals
from vo_service.odometry.motion_model import ConstantVelocityModel
from vo_service.odometry.uncertainty import MIN_OBSERVABILITY
from vo_service.types.estimate import Estimate, TrackingDebug
from vo_service.types.odometry import NullStageTimer, StageTimer

# Smallest share of the reference's planes in the gate.
MIN_IN_GATE_SHARE = 0.3
# Smallest share of inliers among the planes with a reading. Measured: at least 0.62 where the
# motion is right, at most 0.52 where it is wrong.
MIN_INLIER_SHARE = 0.6
# Largest sigma of the residuals, 1/m. Measured: at most 3.6e-3 where the motion is right.
MAX_SIGMA_PER_M = 5e-3
# Factor for correlated errors: neighboring readings share the sensor's quantization, and all share
# the noise of the reference.
COVARIANCE_INFLATION = 15.0


def rejection_reason(alignment: IcpAlignment) -> str:
    """Why an alignment is rejected; "" if it is valid."""
    if alignment.num_in_gate < max(MIN_PLANES, MIN_IN_GATE_SHARE * alignment.num_planes):
        return f"only {alignment.num_in_gate} of {alignment.num_planes} surface points are in view"
    if not alignment.has_converged:
        return f"the alignment of {alignment.num_in_gate} surface points does not converge"
    if (
        alignment.num_inliers < MIN_INLIER_SHARE * alignment.num_with_reading
        or alignment.sigma > MAX_SIGMA_PER_M
    ):
        return f"only {alignment.num_inliers} of {alignment.num_with_reading} surface points agree"
    count = np.count_nonzero(~alignment.degeneracy.is_observable)
    if count == 0:
        return ""
    return f"degenerate view: depth leaves {count} of 6 degrees of freedom unconstrained"


def alignment_covariance(alignment: IcpAlignment) -> Array:
    """6x6 of T_reference_camera: (translation m, rotation rad), a motion in the camera's axes.

    All six degrees of freedom have to be constrained.
    """
    variance = COVARIANCE_INFLATION * alignment.sigma**2
    in_reference = np.asarray(variance * np.linalg.inv(alignment.information), np.float64)
    in_camera = transport_covariance(in_reference, inverse(alignment.T_camera_reference))
    return 0.5 * (in_camera + in_camera.T)


# A reference is replaced when less than this share of its planes is in view,
RENEW_SHARE = 0.75
# but while the view constrains some direction poorly, only below this share.
MIN_SHARE = 0.5
GOOD_OBSERVABILITY = 2.0 * MIN_OBSERVABILITY


@dataclass(frozen=True)
class IcpTrack:
    """A reference that frames are aligned with, and the last good frame.

    Attributes:
        planes: (N, 7) of the reference for each level.
        last_frame: The last good frame.
        T_camera_reference: 4x4 of that frame.
        covariance: 6x6 of that motion, (translation m, rotation rad), as a small motion in the last
            camera's axes; zero if the last frame is the reference.
    """

    planes: PlanePyramid
    last_frame: DepthPyramid
    T_camera_reference: Array
    covariance: Array

    def advance(self, view: DepthPyramid, alignment: IcpAlignment) -> "IcpTrack":
        """Return the track at the next good frame."""
        return IcpTrack(
            self.planes, view, alignment.T_camera_reference, alignment_covariance(alignment)
        )

    def relative_motion(self, after: "IcpTrack") -> tuple[Array, Array]:
        """4x4 T_last_camera between two tracks of one reference, and its 6x6 covariance.

        The errors of both frames are added, each in its own camera's axes.
        """
        T_last_camera = self.T_camera_reference @ inverse(after.T_camera_reference)
        return T_last_camera, transport_covariance(
            self.covariance, T_last_camera
        ) + after.covariance


def start_track(view: DepthPyramid, max_planes: int) -> IcpTrack:
    """Start a track with this frame as the reference, with at most `max_planes` per level."""
    planes = tuple(find_planes(level, max_planes) for level in view.levels)
    return IcpTrack(planes, view, np.eye(4), np.zeros((6, 6)))


def needs_new_reference(alignment: IcpAlignment) -> bool:
    """Whether the reference is to be replaced by the current frame.

    A poorly constrained view makes a poor reference, so the old one is kept longer.
    """
    share = alignment.num_in_gate / alignment.num_planes
    if share >= RENEW_SHARE:
        return False
    return share < MIN_SHARE or bool(alignment.degeneracy.observability[0] >= GOOD_OBSERVABILITY)


@dataclass(frozen=True)
class IcpParameters:
    """Number of planes, and handling of failures."""

    max_planes: int = 4000  # of a reference on each level
    max_failures: int = 30  # consecutive frames; then tracking restarts at the last pose


# Gate of an inlier, in standard deviations.
INLIER_SIGMAS = 3.0


def make_tracking_debug(
    planes: PlanePyramid, view: DepthPyramid, alignment: IcpAlignment
) -> TrackingDebug:
    """Make the debug data: planes in view, and as matches those with a reading.

    Args:
        planes: Of the reference, for each level.
        view: The frame.
        alignment: Of the frame with the planes.
    """
    level = view.levels[0]
    residuals = compute_residuals(
        planes[0], alignment.T_camera_reference, level.inverse_depth, level.intrinsics
    )
    is_matched = ~np.isnan(residuals[:, 2])
    return TrackingDebug(
        keypoints_px=_to_full_resolution(residuals[np.isfinite(residuals[:, 0]), :2], level),
        matches_px=_to_full_resolution(residuals[is_matched, :2], level),
        reference_matches_px=project_planes(planes, view)[is_matched],
        inlier=np.abs(residuals[is_matched, 2]) <= INLIER_SIGMAS * alignment.sigma,
    )


def project_planes(planes: PlanePyramid, view: DepthPyramid) -> NDArray[np.float32]:
    """(N, 2) pixels of a reference's planes in its own image."""
    level = view.levels[0]
    fx, fy, cx, cy = level.intrinsics
    x, y, z = planes[0][:, :3].T
    return _to_full_resolution(np.column_stack([fx * x / z + cx, fy * y / z + cy]), level)


def _to_full_resolution(pixels: Array, level: DepthLevel) -> NDArray[np.float32]:
    """Pixels of the whole image, from those of a level; centers of first pixels are (0, 0)."""
    whole: NDArray[np.float32] = (level.scale * (pixels + 0.5) - 0.5).astype(np.float32)
    return whole


class IcpOdometry:
    """Odometry that aligns frames with a reference, until a quarter of it is out of view.

    So the pose of a camera at rest does not drift. A frame that fails is skipped. The world frame
    is the first good camera pose.

    Args:
        parameters: Default ones if None.
        timer: Times the stages; not timed if None.
    """

    def __init__(
        self, parameters: IcpParameters | None = None, timer: StageTimer | None = None
    ) -> None:
        self._parameters = parameters or IcpParameters()
        self._timer = timer or NullStageTimer()
        self._model = ConstantVelocityModel()
        self._track: IcpTrack | None = None
        self._T_world_camera = np.eye(4)
        self._failures = 0

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Estimate the camera's pose by aligning this frame with the reference."""
        with self._timer.stage("pyramid"):
            view = build_depth_pyramid(frame)
        if self._track is None:
            return self._start(view, is_reset=False)
        with self._timer.stage("align"):
            track = self._track
            alignment = align(track.planes, view, self._initial_guesses(track, view), FINE_ONLY)
        # The alignment is valid if it fits and all six degrees of freedom are constrained.
        if rejection_reason(alignment):
            with self._timer.stage("retry"):
                track, alignment = self._retry(track, view, alignment)
        if rejection_reason(alignment):
            return self._fail(view, track, alignment)
        return self._advance(view, track, alignment)

    def _initial_guesses(self, track: IcpTrack, view: DepthPyramid) -> Sequence[Array]:
        """4x4 T_camera_reference by the predicted motion, and that of the last good frame."""
        prediction = self._model.predict(view.stamp_s)
        if prediction is None:
            return [track.T_camera_reference]
        T_camera_last = inverse(prediction.T_reference_camera)
        return [T_camera_last @ track.T_camera_reference, track.T_camera_reference]

    def _retry(
        self, track: IcpTrack, view: DepthPyramid, alignment: IcpAlignment
    ) -> tuple[IcpTrack, IcpAlignment]:
        """Return the first valid retry; else the track and the alignment."""
        for retry_track, retry in self._retries(track, view):
            if not rejection_reason(retry):
                return retry_track, retry
        return track, alignment

    def _retries(
        self, track: IcpTrack, view: DepthPyramid
    ) -> Iterator[tuple[IcpTrack, IcpAlignment]]:
        """Yield alignments from coarse to fine, then with the last good frame as the reference."""
        yield track, align(track.planes, view, self._initial_guesses(track, view), COARSE_TO_FINE)
        newer = start_track(track.last_frame, self._parameters.max_planes)
        initial_guesses = self._initial_guesses(newer, view)
        yield newer, align(newer.planes, view, initial_guesses, FINE_ONLY)
        yield newer, align(newer.planes, view, initial_guesses, COARSE_TO_FINE)

    def _start(self, view: DepthPyramid, is_reset: bool) -> Estimate:
        """Make this view the first of a chain, if others can be aligned with it."""
        with self._timer.stage("planes"):
            track = start_track(view, self._parameters.max_planes)
        self_alignment = evaluate_alignment(track.planes, view, np.eye(4))
        debug = TrackingDebug(keypoints_px=project_planes(track.planes, view))
        if reason := rejection_reason(self_alignment):
            return self._make_estimate(f"cannot start: {reason}", debug)
        self._model.reset(view.stamp_s)
        self._track = track
        self._failures = 0
        return self._make_estimate("", debug, is_reset=is_reset)

    def _fail(self, view: DepthPyramid, track: IcpTrack, alignment: IcpAlignment) -> Estimate:
        """Keep the pose; after too many failures drop the reference and start again."""
        self._failures += 1
        if self._failures > self._parameters.max_failures:
            return self._start(view, is_reset=True)
        return self._make_estimate(
            rejection_reason(alignment), make_tracking_debug(track.planes, view, alignment)
        )

    def _advance(self, view: DepthPyramid, track: IcpTrack, alignment: IcpAlignment) -> Estimate:
        """Take over the alignment; the frame may become the next reference."""
        debug = make_tracking_debug(track.planes, view, alignment)
        next_track = track.advance(view, alignment)
        T_last_camera, covariance = track.relative_motion(next_track)
        self._T_world_camera = self._T_world_camera @ T_last_camera
        self._model.add(T_last_camera, view.stamp_s)
        self._failures = 0
        if needs_new_reference(alignment):
            with self._timer.stage("planes"):
                next_track = start_track(view, self._parameters.max_planes)
        self._track = next_track
        return self._make_estimate("", debug, T_last_camera, covariance)

    def _make_estimate(
        self,
        reason: str,
        debug: TrackingDebug,
        T_last_camera: Array | None = None,
        covariance: Array | None = None,
        is_reset: bool = False,
    ) -> Estimate:
        return Estimate(
            ok=not reason,
            reason=reason,
            T_world_camera=self._T_world_camera.copy(),
            T_reference_camera=np.eye(4) if T_last_camera is None else T_last_camera,
            covariance=np.zeros((6, 6)) if covariance is None else covariance,
            features=len(debug.keypoints_px),
            matches=len(debug.matches_px),
            inliers=int(debug.inlier.sum()),
            is_reset=is_reset and not reason,
            debug=debug,
        )
