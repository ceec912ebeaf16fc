"""Drawing of messages in Rerun, in the world of the first camera (x right, y down, z forward).

Imports rerun: only for the viewer's process.
"""

from collections.abc import Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, quaternion_from_rotation
from drivers.recording.image_encoding import encode_jpeg
from vo_service.outputs.rerun import blueprint as paths
from vo_service.outputs.rerun.blueprint import MAP
from vo_service.outputs.rerun.messages import (
    CorrectedPosition,
    FrameImages,
    FrameScalars,
    GridCells,
    GroundTruth,
    InitialState,
    MapGraph,
    RerunMessage,
    ScanPoints,
    TextLog,
    TrackingStatus,
    TrajectoryPoint,
)
from vo_service.types.estimate import OnlineTiming, TrackingDebug
from vo_service.types.odometry_update import TrackingState

MAP_COLOR = (60, 210, 200)
LOOP_COLOR = (230, 80, 210)
SCAN_COLOR = (255, 60, 60)
OCCUPIED_COLOR, FREE_COLOR = (200, 120, 60), (70, 90, 80)
# An unchanged map is drawn again after this many images, for a viewer that connects late.
IMAGES_PER_MAP_REDRAW = 100


class MapLayer:
    """Keyframes, their edges, and a line from the newest keyframe to the camera."""

    def __init__(self, stream: rr.RecordingStream, graph: MapGraph) -> None:
        """Start with an existing map."""
        self._stream = stream
        self._graph = graph
        self._images_since_redraw = IMAGES_PER_MAP_REDRAW  # at once

    def set_graph(self, graph: MapGraph) -> None:
        """Draw a new map."""
        self._graph = graph
        self._log_graph()

    def on_image(self) -> None:
        """Draw the map again if it is due."""
        self._images_since_redraw += 1
        if self._images_since_redraw >= IMAGES_PER_MAP_REDRAW and len(self._graph.positions):
            self._log_graph()

    def extend_to(self, corrected: CorrectedPosition) -> None:
        """Draw the line from the newest keyframe to the camera."""
        if len(self._graph.positions):
            line = np.stack([self._graph.positions[-1], corrected.position])
            self._log_lines("latest", line[None].astype(np.float32), MAP_COLOR)

    def _log_graph(self) -> None:
        graph = self._graph
        self._images_since_redraw = 0
        keyframes = rr.Points3D(graph.positions, colors=MAP_COLOR, radii=rr.Radius.ui_points(4.0))
        self._stream.log(f"{MAP}/keyframes", keyframes)
        self._log_lines("odometry_edges", graph.odometry_edges, MAP_COLOR)
        self._log_lines("loop_closures", graph.loop_edges, LOOP_COLOR)

    def _log_lines(
        self, part: str, lines: NDArray[np.float32], color: tuple[int, int, int]
    ) -> None:
        strips = rr.LineStrips3D(lines, colors=color, radii=rr.Radius.ui_points(1.0))
        self._stream.log(f"{MAP}/{part}", strips)


FEATURE_COLOR = (255, 220, 90)
MATCH_COLOR = (90, 160, 250)
INLIER_COLOR = (40, 220, 130)
OUTLIER_COLOR = (240, 80, 60)
TRAJECTORY_COLOR = (255, 150, 40)
GROUND_TRUTH_COLOR = (150, 170, 200)

POINT_GRID_PX = 6
DEPTH_GRID_PX = 2
# The whole trajectory is drawn again after this many images; in between, only new points.
IMAGES_PER_TRAJECTORY_REDRAW = 100
DEPTH_RANGE_M = (0.4, 5.0)


class RerunScene:
    """Logs messages to one recording stream."""

    def __init__(
        self, stream: rr.RecordingStream, initial_state: InitialState, jpeg_quality: int
    ) -> None:
        """Draw the initial state.

        Args:
            stream: Rerun's recording stream.
            initial_state: What was drawn before; the caller extends its trajectory later.
            jpeg_quality: Quality of the color images, 0 to 100.
        """
        self._stream = stream
        self._jpeg_quality = jpeg_quality
        self._last_logged_state: TrackingStatus | None = None
        self._last_timing: OnlineTiming | None = None
        self._has_grid = False
        self._log_static()
        self._log_initial_state(initial_state)

    def log(self, message: RerunMessage) -> None:
        """Draw one message."""
        match message:
            case InitialState():
                self._log_initial_state(message)
            case FrameScalars():
                self._log_scalars(message)
            case FrameImages(frame, debug):
                self._log_images(frame)
                self._log_matches(debug)
                self._log_points(frame)
                self._trajectory.on_image()
                self._map.on_image()
            case TrajectoryPoint(position, epoch):
                self._trajectory.append(position, epoch)
            case GroundTruth():
                self._log_ground_truth(message)
            case MapGraph():
                self._map.set_graph(message)
            case ScanPoints(positions):
                points = rr.Points3D(positions, colors=SCAN_COLOR, radii=rr.Radius.ui_points(3.0))
                self._stream.log(paths.SCAN, points)
            case GridCells():
                self._log_grid(message)
            case CorrectedPosition():
                self._map.extend_to(message)
            case TrackingStatus():
                self._log_state(message)
            case TextLog(text):
                self._stream.log(paths.LOG, rr.TextLog(text, level=rr.TextLogLevel.WARN))

    def _log_initial_state(self, initial_state: InitialState) -> None:
        self._trajectory = _TrajectoryLayer(self._stream, initial_state)
        self._map = MapLayer(self._stream, initial_state.graph)
        self._log_grid(initial_state.grid)
        if initial_state.ground_truth is not None:
            self._log_ground_truth(initial_state.ground_truth)

    def _log_grid(self, grid: GridCells) -> None:
        """Draw the cells; an empty grid before the first one is not drawn."""
        is_empty = not len(grid.occupied) and not len(grid.free)
        if is_empty and not self._has_grid:
            return
        self._has_grid = not is_empty
        for name, positions, color in (
            ("occupied", grid.occupied, OCCUPIED_COLOR),
            ("free", grid.free, FREE_COLOR),
        ):
            points = rr.Points3D(positions, colors=color, radii=0.4 * grid.size_m)
            self._stream.log(f"{paths.GRID}/{name}", points)

    def _log_scalars(self, scalars: FrameScalars) -> None:
        """Log pose, counts, times and state."""
        stream, T = self._stream, scalars.T_world_camera
        stream.set_time(paths.TIMELINE, sequence=scalars.seq)
        stream.set_time("stamp", timestamp=scalars.stamp_s)
        rotation = rr.Quaternion(xyzw=quaternion_from_rotation(T[:3, :3]))
        stream.log(paths.CAMERA, rr.Transform3D(translation=T[:3, 3], quaternion=rotation))
        for name, count in scalars.counts.items():
            stream.log(f"{paths.COUNTS}/{name}", rr.Scalars(count))
        for stage, cpu_ms in scalars.stage_ms.items():
            stream.log(f"{paths.STAGES}/{stage}", rr.Scalars(cpu_ms))
        self._log_state(scalars.state)
        self._log_timing(scalars.timing)

    def _log_static(self) -> None:
        self._stream.log(paths.WORLD, rr.ViewCoordinates.RDF, static=True)
        colors = {
            "features": FEATURE_COLOR,
            "matches": MATCH_COLOR,
            "inliers": INLIER_COLOR,
        }
        for name, color in colors.items():
            style = rr.SeriesLines(colors=color, names=name, widths=1.5)
            self._stream.log(f"{paths.COUNTS}/{name}", style, static=True)

    def _log_state(self, state: TrackingStatus) -> None:
        """Log the state or epoch if it has changed; a new reason alone is not logged."""
        last, self._last_logged_state = self._last_logged_state, state
        if last is not None and (last.state, last.epoch) == (state.state, state.epoch):
            return
        is_tracking = state.state == TrackingState.TRACKING
        level = rr.TextLogLevel.INFO if is_tracking else rr.TextLogLevel.WARN
        text = f"{state.state}: {state.reason}" if state.reason else str(state.state)
        self._stream.log(paths.LOG, rr.TextLog(f"{text} (epoch {state.epoch})", level=level))

    def _log_timing(self, timing: OnlineTiming | None) -> None:
        """Plot the sensor's timing when it changes; log another value or source as text."""
        last, self._last_timing = self._last_timing, timing
        if timing is None or timing == last:
            return
        values_s = {
            "readout": (timing.readout_s, timing.readout_sigma_s),
            "depth offset": (timing.depth_offset_s, timing.depth_offset_sigma_s),
        }
        for name, (value_s, sigma_s) in values_s.items():
            path = f"{paths.TIMING}/{name.replace(' ', '_')}"
            self._stream.log(path, rr.Scalars(1e3 * value_s))
            self._stream.log(f"{path}_sigma", rr.Scalars(1e3 * sigma_s))
        if last is not None and _is_same_timing(timing, last):
            return
        parts = [f"{name} {1e3 * v:.1f} ± {1e3 * s:.1f} ms" for name, (v, s) in values_s.items()]
        text = f"sensor timing: {', '.join(parts)} ({timing.source})"
        self._stream.log(paths.LOG, rr.TextLog(text, level=rr.TextLogLevel.INFO))

    def _log_ground_truth(self, ground_truth: GroundTruth) -> None:
        strip = rr.LineStrips3D(
            [ground_truth.positions], colors=GROUND_TRUTH_COLOR, radii=rr.Radius.ui_points(1.0)
        )
        self._stream.log(paths.GROUND_TRUTH, strip, static=True)

    def _log_images(self, frame: RgbdFrame) -> None:
        camera = frame.camera
        pinhole = rr.Pinhole(
            image_from_camera=camera.K,
            resolution=(camera.width, camera.height),
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=0.3,
        )
        self._stream.log(paths.IMAGE, pinhole, self._jpeg(frame.color_bgr))
        depth = np.ascontiguousarray(frame.depth_raw[::DEPTH_GRID_PX, ::DEPTH_GRID_PX])
        limits = [limit_m * frame.depth_factor for limit_m in DEPTH_RANGE_M]
        image = rr.DepthImage(depth, meter=frame.depth_factor, colormap="turbo", depth_range=limits)
        self._stream.log(paths.DEPTH, image)

    def _log_matches(self, debug: TrackingDebug) -> None:
        inlier = debug.inlier
        matches = np.stack([debug.reference_matches_px, debug.matches_px], axis=1)
        features = rr.Points2D(
            debug.keypoints_px, colors=FEATURE_COLOR, radii=rr.Radius.ui_points(1.0)
        )
        self._stream.log(paths.FEATURES, features)
        for path, lines, color in (
            (paths.INLIERS, matches[inlier], INLIER_COLOR),
            (paths.OUTLIERS, matches[~inlier], OUTLIER_COLOR),
        ):
            strips = rr.LineStrips2D(lines, colors=color, radii=rr.Radius.ui_points(1.0))
            self._stream.log(path, strips)

    def _log_points(self, frame: RgbdFrame) -> None:
        points, colors = back_project(frame, POINT_GRID_PX)
        cloud = rr.Points3D(points, colors=colors, radii=rr.Radius.ui_points(2.0))
        self._stream.log(paths.POINTS, cloud)

    def _jpeg(self, image_bgr: NDArray[np.uint8]) -> rr.EncodedImage:
        jpeg = encode_jpeg(image_bgr, self._jpeg_quality)
        return rr.EncodedImage(contents=jpeg, media_type="image/jpeg")


def _is_same_timing(one: OnlineTiming, other: OnlineTiming) -> bool:
    """Whether two timings differ in their standard deviations only."""
    return (one.readout_s, one.depth_offset_s, one.source) == (
        other.readout_s,
        other.depth_offset_s,
        other.source,
    )


class _TrajectoryLayer:
    """The trajectory: new points are drawn at once, the whole line now and then.

    A long line is thus not sent again for each point, and a viewer that connects late gets it all.
    """

    def __init__(self, stream: rr.RecordingStream, initial_state: InitialState) -> None:
        self._stream = stream
        self._trajectory = initial_state.trajectory
        self._images_since_redraw = IMAGES_PER_TRAJECTORY_REDRAW  # at once
        self._epoch = -1
        self._latest: list[Array] = []

    def append(self, position: Array, epoch: int) -> None:
        """Draw a point that the trajectory already has; a new epoch starts a new line."""
        if epoch != self._epoch:
            self._log_all()
            self._latest = []
        self._epoch = epoch
        self._latest.append(position)
        self._log_lines("latest", [self._latest])

    def on_image(self) -> None:
        """Draw the whole trajectory if it is due."""
        self._images_since_redraw += 1
        if self._images_since_redraw >= IMAGES_PER_TRAJECTORY_REDRAW:
            self._log_all()

    def _log_all(self) -> None:
        self._log_lines("so_far", self._trajectory.lines)
        self._latest = self._latest[-1:]
        self._images_since_redraw = 0

    def _log_lines(self, part: str, lines: Sequence[Sequence[Array]]) -> None:
        strips = rr.LineStrips3D(lines, colors=TRAJECTORY_COLOR, radii=rr.Radius.ui_points(2.0))
        self._stream.log(f"{paths.TRAJECTORY}/{part}", strips)


def back_project(frame: RgbdFrame, grid_px: int) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Back-project the depth image on a coarse grid of pixels.

    Returns:
        (N, 3) points in camera axes, meters, and their (N, 3) RGB colors.
    """
    camera = frame.camera
    v, u = np.mgrid[0 : camera.height : grid_px, 0 : camera.width : grid_px]
    z = frame.depth_m[v, u]
    has_depth = z > 0
    u, v, z = u[has_depth], v[has_depth], z[has_depth]
    x = (u - camera.cx) / camera.fx * z
    y = (v - camera.cy) / camera.fy * z
    return np.stack([x, y, z], axis=1).astype(np.float32), frame.color_bgr[v, u, ::-1]
