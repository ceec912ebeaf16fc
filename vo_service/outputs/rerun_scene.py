"""What one result looks like in Rerun. Imports rerun: load it lazily.

Everything is drawn in the world of the first camera (x right, y down, z forward).
"""

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.geometry import Array, inverse, quaternion_from_rotation
from vo_service.odometry.estimate import Evidence
from vo_service.outputs import rerun_blueprint as paths
from vo_service.outputs.output import PoseUpdate, Status, TrackingState, TruthSource, no_truth
from vo_service.outputs.rerun_sinks import Sink

FEATURE_COLOUR = (255, 220, 90)
MATCH_COLOUR = (90, 160, 250)
INLIER_COLOUR = (40, 220, 130)
OUTLIER_COLOUR = (240, 80, 60)
TRAJECTORY_COLOUR = (255, 150, 40)
TRUTH_COLOUR = (150, 170, 200)

JPEG_QUALITY = 80
POINT_GRID_PX = 6
DEPTH_GRID_PX = 2
SEGMENT_LENGTH = 128
TRUTH_WITHIN_S = 0.02
DEPTH_RANGE_M = (0.4, 5.0)


def open_scene(application: str, sink: Sink, ground_truth: TruthSource) -> "Scene":
    """A scene that goes to a sink. Raises what the sink raises."""
    # Rerun waits at exit until everything is sent, for ever if the viewer is frozen.
    rr.unregister_shutdown()
    stream = rr.RecordingStream(application)
    try:
        sink.attach(stream, paths.blueprint())
    except BaseException:
        sink.close()
        raise
    return Scene(stream, ground_truth)


class Scene:
    """Logs results to one recording stream.

    The truth is moved so that its pose at the first frame it knows is the estimate's there: what
    then grows apart is drift.
    """

    def __init__(self, stream: rr.RecordingStream, ground_truth: TruthSource) -> None:
        self._stream = stream
        self._truth = ground_truth
        self._trajectory = _GrowingLine(stream, paths.TRAJECTORY)
        self._said: tuple[TrackingState, int] | None = None
        self._log_fixed_things()

    def log_numbers(self, update: PoseUpdate) -> None:
        """Pose, counts, times and state: small, for every frame."""
        stream, T = self._stream, update.T_world_camera
        stream.set_time(paths.TIMELINE, sequence=update.seq)
        stream.set_time("stamp", timestamp=update.stamp_s)
        turn = rr.Quaternion(xyzw=quaternion_from_rotation(T[:3, :3]))
        stream.log(paths.CAMERA, rr.Transform3D(translation=T[:3, 3], quaternion=turn))
        estimate = update.estimate
        for name in ("features", "matches", "inliers"):
            stream.log(f"{paths.COUNTS}/{name}", rr.Scalars(getattr(estimate, name)))
        for stage, cpu_ms in update.stage_ms.items():
            stream.log(f"{paths.STAGES}/{stage}", rr.Scalars(cpu_ms))
        self._log_state(update.state, update.reason, update.epoch)
        self._log_truth(update)

    def log_pictures(self, update: PoseUpdate) -> None:
        """Images, features, points and the trajectory: heavy, for some frames."""
        frame = update.frame
        self._log_camera(frame)
        self._log_evidence(update.estimate.evidence)
        self._log_points(frame)
        if update.estimate.ok:
            self._trajectory.append(update.T_world_camera[:3, 3], update.epoch)

    def log_status(self, status: Status) -> None:
        """Say a change of state that came without a frame (no camera)."""
        self._log_state(status.state, status.reason, status.epoch)

    def finish(self) -> None:
        """Write out everything; nothing can be logged after."""
        self._stream.disconnect()

    def _log_fixed_things(self) -> None:
        self._stream.log(paths.WORLD, rr.ViewCoordinates.RDF, static=True)
        colours = {
            "features": FEATURE_COLOUR,
            "matches": MATCH_COLOUR,
            "inliers": INLIER_COLOUR,
        }
        for name, colour in colours.items():
            style = rr.SeriesLines(colors=colour, names=name, widths=1.5)
            self._stream.log(f"{paths.COUNTS}/{name}", style, static=True)

    def _log_state(self, state: TrackingState, reason: str, epoch: int) -> None:
        if self._said == (state, epoch):
            return
        self._said = (state, epoch)
        level = rr.TextLogLevel.INFO if state == TrackingState.TRACKING else rr.TextLogLevel.WARN
        text = f"{state}: {reason}" if reason else str(state)
        self._stream.log(paths.LOG, rr.TextLog(f"{text} (epoch {epoch})", level=level))

    def _log_truth(self, update: PoseUpdate) -> None:
        """Once, as soon as a frame has truth."""
        truth = self._truth()
        if truth is None or not update.estimate.ok:
            return
        gaps_s = np.abs(truth.stamps_s - update.frame.stamp_s)
        nearest = int(np.argmin(gaps_s))
        if gaps_s[nearest] > TRUTH_WITHIN_S:
            return
        T_world_truth = update.T_world_camera @ inverse(truth.T_world_camera[nearest])
        line = (T_world_truth @ truth.T_world_camera)[:, :3, 3]
        strip = rr.LineStrips3D([line], colors=TRUTH_COLOUR, radii=rr.Radius.ui_points(1.0))
        self._stream.log(paths.GROUND_TRUTH, strip, static=True)
        self._truth = no_truth

    def _log_camera(self, frame: RgbdFrame) -> None:
        camera = frame.camera
        pinhole = rr.Pinhole(
            image_from_camera=camera.K,
            resolution=(camera.width, camera.height),
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=0.3,
        )
        self._stream.log(paths.IMAGE, pinhole, _jpeg(frame.colour_bgr))
        depth = np.ascontiguousarray(frame.depth_raw[::DEPTH_GRID_PX, ::DEPTH_GRID_PX])
        limits = [limit_m * frame.depth_factor for limit_m in DEPTH_RANGE_M]
        image = rr.DepthImage(depth, meter=frame.depth_factor, colormap="turbo", depth_range=limits)
        self._stream.log(paths.DEPTH, image)

    def _log_evidence(self, evidence: Evidence) -> None:
        inlier = evidence.inlier
        lines = np.stack([evidence.reference_matches_px, evidence.matches_px], axis=1)
        features = rr.Points2D(
            evidence.keypoints_px, colors=FEATURE_COLOUR, radii=rr.Radius.ui_points(1.0)
        )
        self._stream.log(paths.FEATURES, features)
        for path, some, colour in (
            (paths.INLIERS, lines[inlier], INLIER_COLOUR),
            (paths.OUTLIERS, lines[~inlier], OUTLIER_COLOUR),
        ):
            strips = rr.LineStrips2D(some, colors=colour, radii=rr.Radius.ui_points(1.0))
            self._stream.log(path, strips)

    def _log_points(self, frame: RgbdFrame) -> None:
        points, colours = back_project(frame, POINT_GRID_PX)
        cloud = rr.Points3D(points, colors=colours, radii=rr.Radius.ui_points(2.0))
        self._stream.log(paths.POINTS, cloud)


class _GrowingLine:
    """A line drawn in segments, so that a long one is not sent again with each new point."""

    def __init__(self, stream: rr.RecordingStream, path: str) -> None:
        self._stream = stream
        self._path = path
        self._epoch = -1
        self._segment = -1
        self._points: list[Array] = []

    def append(self, point: Array, epoch: int) -> None:
        """Add a point; another epoch starts another line."""
        if epoch != self._epoch:
            self._start_segment([])
        elif len(self._points) >= SEGMENT_LENGTH:
            self._start_segment(self._points[-1:])
        self._epoch = epoch
        self._points.append(point)
        strip = rr.LineStrips3D(
            [self._points], colors=TRAJECTORY_COLOUR, radii=rr.Radius.ui_points(2.0)
        )
        self._stream.log(f"{self._path}/{self._segment:05d}", strip)

    def _start_segment(self, points: list[Array]) -> None:
        self._segment += 1
        self._points = points


def back_project(frame: RgbdFrame, grid_px: int) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """(N, 3) points in camera axes, metres, and their (N, 3) RGB, on a coarse grid of pixels."""
    camera = frame.camera
    v, u = np.mgrid[0 : camera.height : grid_px, 0 : camera.width : grid_px]
    z = frame.depth_m[v, u]
    seen = z > 0
    u, v, z = u[seen], v[seen], z[seen]
    x = (u - camera.cx) / camera.fx * z
    y = (v - camera.cy) / camera.fy * z
    return np.stack([x, y, z], axis=1).astype(np.float32), frame.colour_bgr[v, u, ::-1]


def _jpeg(image_bgr: NDArray[np.uint8]) -> rr.EncodedImage:
    _, encoded = cv2.imencode(".jpg", image_bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return rr.EncodedImage(contents=encoded.tobytes(), media_type="image/jpeg")
