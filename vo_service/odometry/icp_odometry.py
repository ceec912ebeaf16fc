"""Odometry on depth alone: point-to-plane ICP with projective association.

Chen and Medioni (1991) for the distance, Besl and McKay (1992) for the iteration, Rusinkiewicz and
Levoy (2001) for the choice of points and the projection. It needs shape, and no light.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from drivers.camera import RgbdFrame
from drivers.geometry import Array, inverse
from vo_service.odometry.icp.alignment import (
    COARSE_TO_FINE,
    FINE_ALONE,
    Alignment,
    align,
    measure,
)
from vo_service.odometry.icp.confidence import doubt
from vo_service.odometry.icp.drawing import draw, draw_planes
from vo_service.odometry.icp.parameters import IcpParameters
from vo_service.odometry.icp.pyramid import DepthPyramid, make_pyramid
from vo_service.odometry.icp.track import Track, is_used_up, track_from
from vo_service.odometry.motion_model import MotionModel
from vo_service.odometry.stopwatch import NullStopwatch, Stopwatch
from vo_service.types import Estimate, Evidence


class IcpOdometry:
    """Frames are laid on a reference, which stays until a quarter of it is out of sight.

    So the pose of a camera that stands still does not drift. A frame that fails is left out of the
    chain. World is the first good camera.
    """

    def __init__(
        self, parameters: IcpParameters | None = None, stopwatch: Stopwatch | None = None
    ) -> None:
        self._parameters = parameters or IcpParameters()
        self._stopwatch = stopwatch or NullStopwatch()
        self._model = MotionModel()
        self._track: Track | None = None
        self._T_world_camera = np.eye(4)
        self._failures = 0

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Where the camera is, from this frame and the reference."""
        # The depth image in three sizes, as 1/z.
        with self._stopwatch.stage("pyramid"):
            view = make_pyramid(frame)
        if self._track is None:
            return self._start(view, restarted=False)
        # The reference's planes, laid on this frame's surfaces.
        with self._stopwatch.stage("align"):
            track = self._track
            found = align(track.planes, view, self._starts(track, view), FINE_ALONE)
        # Does it fit, and does the shape in view hold the camera in all six directions?
        if doubt(found):
            with self._stopwatch.stage("again"):
                track, found = self._again(track, view, found)
        if doubt(found):
            return self._fail(view, track, found)
        # Concatenation.
        return self._advance(view, track, found)

    def _starts(self, track: Track, view: DepthPyramid) -> Sequence[Array]:
        """Where the reference may be: as the motion goes on, or as for the last good frame."""
        prediction = self._model.predict(view.stamp_s)
        if prediction is None:
            return [track.T_camera_reference]
        T_camera_last = inverse(prediction.T_reference_camera)
        return [T_camera_last @ track.T_camera_reference, track.T_camera_reference]

    def _again(self, track: Track, view: DepthPyramid, found: Alignment) -> tuple[Track, Alignment]:
        """The first of some more tries that is beyond doubt; else the track and what was found."""
        for another, again in self._tries(track, view):
            if not doubt(again):
                return another, again
        return track, found

    def _tries(self, track: Track, view: DepthPyramid) -> Iterator[tuple[Track, Alignment]]:
        """From coarse to fine; then with the last good frame as the reference: it sees more."""
        yield track, align(track.planes, view, self._starts(track, view), COARSE_TO_FINE)
        newer = track_from(track.last, self._parameters.planes)
        starts = self._starts(newer, view)
        yield newer, align(newer.planes, view, starts, FINE_ALONE)
        yield newer, align(newer.planes, view, starts, COARSE_TO_FINE)

    def _start(self, view: DepthPyramid, restarted: bool) -> Estimate:
        """Make this view the first of a chain, if its shape can be found again."""
        with self._stopwatch.stage("planes"):
            track = track_from(view, self._parameters.planes)
        itself = measure(track.planes, view, np.eye(4))
        evidence = Evidence(keypoints_px=draw_planes(track.planes, view))
        if reason := doubt(itself):
            return self._estimate(f"cannot start: {reason}", evidence)
        self._model.begin(view.stamp_s)
        self._track = track
        self._failures = 0
        return self._estimate("", evidence, restarted=restarted)

    def _fail(self, view: DepthPyramid, track: Track, found: Alignment) -> Estimate:
        """Hold the pose; after too many failures give the reference up."""
        self._failures += 1
        if self._failures > self._parameters.max_failures:
            return self._start(view, restarted=True)
        return self._estimate(doubt(found), draw(track.planes, view, found))

    def _advance(self, view: DepthPyramid, track: Track, found: Alignment) -> Estimate:
        """Go on from here; where little is left of the reference, this frame is the next one."""
        evidence = draw(track.planes, view, found)
        after = track.moved(view, found)
        T_last_camera, covariance = track.step_to(after)
        self._T_world_camera = self._T_world_camera @ T_last_camera
        self._model.add(T_last_camera, view.stamp_s)
        self._failures = 0
        if is_used_up(found):
            with self._stopwatch.stage("planes"):
                after = track_from(view, self._parameters.planes)
        self._track = after
        return self._estimate("", evidence, T_last_camera, covariance)

    def _estimate(
        self,
        reason: str,
        evidence: Evidence,
        T_last_camera: Array | None = None,
        covariance: Array | None = None,
        restarted: bool = False,
    ) -> Estimate:
        return Estimate(
            ok=not reason,
            reason=reason,
            T_world_camera=self._T_world_camera.copy(),
            T_reference_camera=np.eye(4) if T_last_camera is None else T_last_camera,
            covariance=np.zeros((6, 6)) if covariance is None else covariance,
            features=len(evidence.keypoints_px),
            matches=len(evidence.matches_px),
            inliers=int(evidence.inlier.sum()),
            restarted=restarted and not reason,
            evidence=evidence,
        )
