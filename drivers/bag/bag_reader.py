"""Opening of recordings in MCAP and in ROS bags: topics, frames, camera, ground truth."""

from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from drivers.bag.bag_contents import (
    BagContents,
    BagTopics,
    ImageFactory,
    exact_stamps,
    find_topics,
    is_named_registered,
    is_rectified,
    read_contents,
)
from drivers.bag.bag_file import open_bag_file
from drivers.bag.bag_storage import BagStorage
from drivers.bag.calibration import (
    camera_from_message,
    frame_name,
    make_depth_camera,
    matrix_from_message,
)
from drivers.bag.image_messages import MessageCursor, is_depth_in_meters
from drivers.bag.pairing import FoundFrames, match_recorded_frames, pair_between_jumps
from drivers.calibration import (
    MILLIMETERS_PER_METER,
    CameraCalibration,
    DepthCameraCalibration,
    check_intrinsics,
    find_benchmark_calibration,
    read_calibration,
)
from drivers.camera import MAX_PAIR_SKEW_US
from drivers.core import InputError
from drivers.core.config import parse_toml
from drivers.core.geometry import Array, Trajectory
from drivers.recording.accelerometer import AccelerometerSeries
from drivers.recording.depth_enlargement import check_first_frame
from drivers.recording.image_decoding import UnreadableFrameError
from drivers.recording.recorded_frames import RecordedFrames
from drivers.recording.recording import BagTopicsInUse, ImageTopics, Recording

# Depth in meters is rounded to 0.2 mm, as the TUM benchmark does.
METER_DEPTH_FACTOR = 5000.0
# The intrinsics that drivers report for a Kinect without calibration.
DEFAULT_FOCAL_LENGTH_PX = 525.0
# A calibrated camera differs less from the default intrinsics of the same camera, as a fraction of
# the image's width.
MAX_SAME_CAMERA_DIFFERENCE = 0.04


def open_bag(path: Path, camera_file: Path | None, named: ImageTopics | None) -> Recording:
    """Open an MCAP file or a ROS bag, and load its first frame.

    Args:
        path: The bag, see `BagStorage`.
        camera_file: Camera file; None for that of the recording, or its camera_info.
        named: The topics of color and depth; None to find them.

    Raises:
        InputError: The file cannot be used.
    """
    storage = BagStorage(path)
    with open_bag_file(storage) as bag:
        topics = find_topics(path, bag, named)
        contents = read_contents(bag, topics)
        is_cut_off = bag.is_cut_off
    for topic, track in ((topics.color, contents.color), (topics.depth, contents.depth)):
        if not track.keys:
            raise InputError(f"{path}: topic {topic} has no images; name others with --topics")
    recording = _BagReader(storage, camera_file, topics, contents).make_recording()
    try:
        recording = check_first_frame(recording)
    except UnreadableFrameError as error:
        raise InputError(f"{error} (the first frame)") from error
    finally:
        recording.close()
    if is_cut_off:
        summary = f"{recording.summary}; the file is cut off and read up to its last whole chunk"
        recording = replace(recording, summary=summary)
    return recording


@dataclass(frozen=True)
class _BagReader:
    storage: BagStorage
    camera_file: Path | None
    topics: BagTopics
    contents: BagContents

    @property
    def path(self) -> Path:
        return self.storage.path

    def make_recording(self) -> Recording:
        calibration, source = self._find_calibration()
        cursor = MessageCursor(self.storage, (self.topics.color, self.topics.depth))
        found = self._make_frames(cursor, calibration.depth_factor)
        frames = self._check_pairs(found.frames)
        truth, truth_source = self._find_ground_truth()
        count = len(self.storage.files)
        parts = (
            f"{count} files" if count > 1 else "",
            f"color {self.topics.color}, depth {self.topics.depth}, camera {source}",
            f"ground truth {truth_source}" if truth_source else "",
            f"{frames.unpaired} images without a partner" if frames.unpaired else "",
        )
        return Recording(
            path=self.path,
            frames=frames,
            calibration=calibration,
            ground_truth=truth,
            accelerometer=self._find_accelerometer(),
            gravity=self._find_gravity(),
            depth_camera=self._find_depth_camera(calibration),
            intrinsics_source=source,
            depth_unit_source=self._describe_depth_unit(source),
            summary=f"{self.path}: {', '.join(part for part in parts if part)}",
            warning=found.warning(self.path),
            topics=self._topics_in_use(truth_source),
            close=cursor.close,
        )

    def _topics_in_use(self, truth_source: str) -> BagTopicsInUse:
        topics = self.topics
        transforms = topics.transforms if truth_source != topics.pose else ()
        return BagTopicsInUse(
            frozenset(topics.of_frames),
            frozenset((*topics.imus, topics.gravity, topics.pose, *transforms)),
            self.contents.color.first.header.frame_id,
        )

    @property
    def color_frame(self) -> str:
        return frame_name(self.contents.color.first.header.frame_id)

    def _make_frames(self, cursor: MessageCursor, depth_factor: float) -> FoundFrames:
        """Make the frames; images of wrong stamps are left out, see `split_at_jumps`."""
        factory = ImageFactory(cursor, self.storage.newest_file, depth_factor)
        stamps = self.contents.frame_stamps
        if stamps:
            colors = factory.make(self.contents.color, exact_stamps([s.color for s in stamps]))
            depths = factory.make(self.contents.depth, exact_stamps([s.depth for s in stamps]))
            return match_recorded_frames(stamps, colors, depths)
        colors = factory.make(self.contents.color, {})
        depths = factory.make(self.contents.depth, {})
        found = pair_between_jumps(colors, depths)
        if 2 * found.left_out > len(colors) + len(depths):
            raise InputError(
                f"{self.path}: the stamps of most images are before earlier ones; record again "
                "with a steady clock"
            )
        return found

    def _check_pairs(self, frames: RecordedFrames) -> RecordedFrames:
        if frames.pairs:
            return frames
        raise InputError(
            f"{self.path}: no images of {self.topics.color} and {self.topics.depth} within "
            f"{MAX_PAIR_SKEW_US // 1000} ms of each other; name other topics with --topics"
        )

    def _find_calibration(self) -> tuple[CameraCalibration, str]:
        """Return the color camera, and where it comes from."""
        in_meters = is_depth_in_meters(self.contents.depth.first)
        factor = METER_DEPTH_FACTOR if in_meters else MILLIMETERS_PER_METER
        if self.camera_file is not None:
            return read_calibration(self.camera_file, factor), str(self.camera_file)
        if self.contents.camera_file:
            name = f"{self.path}: {self.topics.camera_file}"
            text = self.contents.camera_file
            calibration = parse_toml(text, name, CameraCalibration, check_intrinsics)
            return calibration, self.topics.camera_file
        model = self._camera_model(self.topics.color_info, self.topics.color)
        known = find_benchmark_calibration(self.path)
        if known is not None and model.fx == DEFAULT_FOCAL_LENGTH_PX:
            return known, "of the benchmark, by the file's name"
        return replace(model, depth_factor=factor), self.topics.color_info

    def _camera_model(self, info_topic: str, image_topic: str) -> CameraCalibration:
        info = self.contents.infos.get(info_topic)
        if info is None:
            raise InputError(
                f"{self.path}: no camera_info beside {image_topic}; give the camera file with "
                "--camera-file"
            )
        return camera_from_message(info, is_rectified(image_topic), f"{self.path}: {info_topic}")

    def _describe_depth_unit(self, calibration_source: str) -> str:
        """Return where the depth factor comes from; "" for meters, whose factor is any."""
        if is_depth_in_meters(self.contents.depth.first):
            return ""
        return calibration_source if self._has_camera_file else self.topics.depth

    def _find_depth_camera(self, calibration: CameraCalibration) -> DepthCameraCalibration | None:
        """Return the depth camera, if depth is not registered to color."""
        depth_frame = frame_name(self.contents.depth.first.header.frame_id)
        if is_named_registered(self.topics.depth):
            return None
        if depth_frame in ("", self.color_frame):
            return self._find_depth_camera_without_frame(calibration, depth_frame)
        if calibration.depth is not None:
            return calibration.depth
        T_color_depth = self.contents.transforms.constant_transform(self.color_frame, depth_frame)
        if T_color_depth is None:
            raise InputError(
                f"{self.path}: {self.topics.depth} (frame {depth_frame}) is not registered to "
                f"{self.topics.color} (frame {self.color_frame}), and no transform between them is "
                "recorded; record registered depth, or give a camera file with [depth]"
            )
        model = self._camera_model(self.topics.depth_info, self.topics.depth)
        return make_depth_camera(model, T_color_depth)

    def _find_depth_camera_without_frame(
        self, calibration: CameraCalibration, depth_frame: str
    ) -> DepthCameraCalibration | None:
        """Return the depth camera if camera_info tells that depth is of another camera than color.

        Then the camera file says where it is, or that depth is registered nevertheless.
        """
        topics = self.topics
        if not {topics.color_info, topics.depth_info} <= self.contents.infos.keys():
            return None
        color = self._camera_model(topics.color_info, topics.color)
        depth = self._camera_model(topics.depth_info, topics.depth)
        difference = np.abs(color.pinhole.K - depth.pinhole.K).max()
        # Images of another size are refused when the first frame is loaded.
        is_same_size = (color.width, color.height) == (depth.width, depth.height)
        if not is_same_size or difference <= MAX_SAME_CAMERA_DIFFERENCE * color.width:
            return None
        if self._has_camera_file:
            return calibration.depth
        raise InputError(
            f"{self.path}: {topics.depth_info} has fx = {depth.fx:g}, cx = "
            f"{depth.cx:g}, but {topics.color_info} has fx = {color.fx:g}, "
            f"cx = {color.cx:g}: depth is not registered to color, and its frame "
            f'"{depth_frame}" does not tell where its camera is; record registered depth, or give '
            "--camera-file FILE, with a table [depth] unless depth is registered"
        )

    @property
    def _has_camera_file(self) -> bool:
        return self.camera_file is not None or bool(self.contents.camera_file)

    def _find_ground_truth(self) -> tuple[Trajectory | None, str]:
        """Return the true poses of the color camera, and where they come from."""
        poses = self._poses_of_topic()
        if poses is not None:
            return poses, self.topics.pose
        found = self.contents.transforms.trajectory(self.color_frame)
        if found is None:
            return None, ""
        return found[0], f"/tf ({found[1]} to {self.color_frame})"

    def _poses_of_topic(self) -> Trajectory | None:
        poses: dict[float, Array] = {}
        for stamp_ns, message in self.contents.poses:
            pose = getattr(message, "pose", None) or message.transform
            pose = getattr(pose, "pose", pose)  # with covariance
            position = getattr(pose, "position", None) or pose.translation
            T = matrix_from_message(position, getattr(pose, "orientation", None) or pose.rotation)
            if T is not None:
                poses[float(Decimal(stamp_ns).scaleb(-9))] = T @ self._T_body_camera(message)
        stamps_s = sorted(poses)
        return (
            Trajectory(np.array(stamps_s), np.array([poses[s] for s in stamps_s]))
            if poses
            else None
        )

    def _T_body_camera(self, message: Any) -> Array:
        """Return the camera in the frame of a pose, which is the camera's if it is not known."""
        body = getattr(message, "child_frame_id", "")
        T = self.contents.transforms.constant_transform(body, self.color_frame) if body else None
        return np.eye(4) if T is None else T

    def _find_accelerometer(self) -> AccelerometerSeries:
        """Convert the accelerometer with the most readings that gravity alone explains."""
        series = [self._make_series(each) for each in self.contents.accelerations.values()]
        empty = AccelerometerSeries(np.empty(0), np.empty((0, 3)))
        return max(series, key=lambda each: each.gravity_count, default=empty)

    def _find_gravity(self) -> AccelerometerSeries | None:
        rows = [(stamp, -v.x, -v.y, -v.z) for stamp, v in self.contents.gravity]
        return self._sort_rows(rows) if rows else None

    def _make_series(self, readings: list[tuple[int, Any]]) -> AccelerometerSeries:
        rows = []
        rotations: dict[str, Array | None] = {}
        for stamp_ns, message in readings:
            frame = frame_name(message.header.frame_id)
            if frame not in rotations:
                rotations[frame] = self.contents.transforms.constant_transform(
                    self.color_frame, frame
                )
            T_color_imu = rotations[frame]
            if T_color_imu is None:
                continue
            a = message.linear_acceleration
            if np.isfinite([a.x, a.y, a.z]).all():
                rows.append((stamp_ns, *(T_color_imu[:3, :3] @ [a.x, a.y, a.z]).tolist()))
        return self._sort_rows(rows)

    def _sort_rows(self, rows: list[tuple[int, float, float, float]]) -> AccelerometerSeries:
        """Make a series of stamps in ns and accelerations, with exact stamps of frames."""
        exact = exact_stamps([each.color for each in self.contents.frame_stamps])
        seconds = [(float(exact.get(ns) or Decimal(ns).scaleb(-9)), *a) for ns, *a in sorted(rows)]
        table = np.array(seconds).reshape(-1, 4)
        return AccelerometerSeries(table[:, 0], table[:, 1:])
