"""What the viewer is shown. Imports rerun: for the viewer's process alone.

Everything is drawn in the world of the first camera (x right, y down, z forward).
"""

from collections.abc import Sequence

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.geometry import Array, quaternion_from_rotation
from vo_service.types import Evidence, TrackingState
from vo_service.viewer import blueprint as paths
from vo_service.viewer.map_drawing import MapDrawing
from vo_service.viewer.messages import (
    Backdrop,
    Corrected,
    Graph,
    Message,
    Note,
    Numbers,
    Picture,
    Point,
    State,
    Truth,
)
from vo_service.viewer.sinks import Sink

FEATURE_COLOUR = (255, 220, 90)
MATCH_COLOUR = (90, 160, 250)
INLIER_COLOUR = (40, 220, 130)
OUTLIER_COLOUR = (240, 80, 60)
TRAJECTORY_COLOUR = (255, 150, 40)
TRUTH_COLOUR = (150, 170, 200)

POINT_GRID_PX = 6
DEPTH_GRID_PX = 2
# The whole trajectory is drawn again after this many pictures; in between, only what is new.
PICTURES_PER_TRAIL = 100
DEPTH_RANGE_M = (0.4, 5.0)


class Scene:
    """Logs messages to one recording stream."""

    def __init__(self, stream: rr.RecordingStream, backdrop: Backdrop, jpeg_quality: int) -> None:
        """`backdrop` is what is there already; its trail grows while this scene is drawn."""
        self._stream = stream
        self._jpeg_quality = jpeg_quality
        self._said: State | None = None
        self._log_fixed_things()
        self._set_up(backdrop)

    def draw(self, message: Message) -> None:
        """Show one message."""
        match message:
            case Backdrop():
                self._set_up(message)
            case Numbers():
                self._log_numbers(message)
            case Picture(frame, evidence):
                self._log_camera(frame)
                self._log_evidence(evidence)
                self._log_points(frame)
                self._line.next_picture()
                self._map.next_picture()
            case Point(position, epoch):
                self._line.append(position, epoch)
            case Truth():
                self._log_truth(message)
            case Graph():
                self._map.draw(message)
            case Corrected():
                self._map.go_on(message)
            case State():
                self._log_state(message)
            case Note(text):
                self._stream.log(paths.LOG, rr.TextLog(text, level=rr.TextLogLevel.WARN))

    def check(self, sink: Sink) -> None:
        """Raises UserFacingError if what was logged has not arrived, or nothing more can."""
        sink.check(self._stream)

    def is_over(self, sink: Sink) -> bool:
        """Whether its place is full."""
        return sink.is_full()

    def finish(self) -> None:
        """Write out everything; nothing can be logged after."""
        self._stream.disconnect()

    def _set_up(self, backdrop: Backdrop) -> None:
        self._line = _GrowingLine(self._stream, backdrop)
        self._map = MapDrawing(self._stream, backdrop.graph)
        if backdrop.truth is not None:
            self._log_truth(backdrop.truth)

    def _log_numbers(self, numbers: Numbers) -> None:
        """Pose, counts, times and state: small, for every frame."""
        stream, T = self._stream, numbers.T_world_camera
        stream.set_time(paths.TIMELINE, sequence=numbers.seq)
        stream.set_time("stamp", timestamp=numbers.stamp_s)
        turn = rr.Quaternion(xyzw=quaternion_from_rotation(T[:3, :3]))
        stream.log(paths.CAMERA, rr.Transform3D(translation=T[:3, 3], quaternion=turn))
        for name, count in numbers.counts.items():
            stream.log(f"{paths.COUNTS}/{name}", rr.Scalars(count))
        for stage, cpu_ms in numbers.stage_ms.items():
            stream.log(f"{paths.STAGES}/{stage}", rr.Scalars(cpu_ms))
        self._log_state(numbers.state)

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

    def _log_state(self, state: State) -> None:
        """If it has changed; the reason alone is no news."""
        said, self._said = self._said, state
        if said is not None and (said.state, said.epoch) == (state.state, state.epoch):
            return
        is_well = state.state == TrackingState.TRACKING
        level = rr.TextLogLevel.INFO if is_well else rr.TextLogLevel.WARN
        text = f"{state.state}: {state.reason}" if state.reason else str(state.state)
        self._stream.log(paths.LOG, rr.TextLog(f"{text} (epoch {state.epoch})", level=level))

    def _log_truth(self, truth: Truth) -> None:
        strip = rr.LineStrips3D(
            [truth.positions], colors=TRUTH_COLOUR, radii=rr.Radius.ui_points(1.0)
        )
        self._stream.log(paths.GROUND_TRUTH, strip, static=True)

    def _log_camera(self, frame: RgbdFrame) -> None:
        camera = frame.camera
        pinhole = rr.Pinhole(
            image_from_camera=camera.K,
            resolution=(camera.width, camera.height),
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=0.3,
        )
        self._stream.log(paths.IMAGE, pinhole, self._jpeg(frame.colour_bgr))
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

    def _jpeg(self, image_bgr: NDArray[np.uint8]) -> rr.EncodedImage:
        _, encoded = cv2.imencode(".jpg", image_bgr, [cv2.IMWRITE_JPEG_QUALITY, self._jpeg_quality])
        return rr.EncodedImage(contents=encoded.tobytes(), media_type="image/jpeg")


class _GrowingLine:
    """The trajectory: what is new with each point, all of it now and then.

    So a long one is not sent again with each point, and is whole for a viewer that comes late.
    """

    def __init__(self, stream: rr.RecordingStream, backdrop: Backdrop) -> None:
        self._stream = stream
        self._trail = backdrop.trail
        self._pictures = PICTURES_PER_TRAIL  # at once
        self._epoch = -1
        self._latest: list[Array] = []

    def append(self, position: Array, epoch: int) -> None:
        """Draw a point that the trail has been given; another epoch starts another line."""
        if epoch != self._epoch:
            self._draw_trail()
            self._latest = []
        self._epoch = epoch
        self._latest.append(position)
        self._draw("latest", [self._latest])

    def next_picture(self) -> None:
        """Draw everything if it is time."""
        self._pictures += 1
        if self._pictures >= PICTURES_PER_TRAIL:
            self._draw_trail()

    def _draw_trail(self) -> None:
        self._draw("so_far", self._trail.lines)
        self._latest = self._latest[-1:]
        self._pictures = 0

    def _draw(self, part: str, lines: Sequence[Sequence[Array]]) -> None:
        strips = rr.LineStrips3D(lines, colors=TRAJECTORY_COLOUR, radii=rr.Radius.ui_points(2.0))
        self._stream.log(f"{paths.TRAJECTORY}/{part}", strips)


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
