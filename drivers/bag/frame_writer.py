"""Writing of frames, readings and true poses as ROS messages."""

from decimal import Decimal
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.bag.bag_contents import (
    CAMERA_INFO,
    COMPRESSED_PARTS,
    IMU,
    OWN_IMAGES,
    STRING,
    VECTOR_STAMPED,
    format_frame_stamps,
    to_ns,
)
from drivers.bag.bag_writer import BagWriter
from drivers.bag.image_messages import COMPRESSED_DEPTH_HEADER, COMPRESSED_IMAGE, IMAGE
from drivers.calibration import CameraCalibration, format_calibration
from drivers.core import InputError
from drivers.core.bounded_trajectory import SampledPath
from drivers.core.geometry import Array, Vector, inverse, quaternion_from_rotation
from drivers.recording.image_decoding import JPEG_START, BgrImage, DepthImage, decode_depth
from drivers.recording.image_encoding import ColorFormat, encode_image
from drivers.recording.recording_sink import RecordingSink, StoredFrame

NS_PER_S = 1_000_000_000
NAMESPACE = "/camera"
# Not in the namespace: Rerun shows color and depth in one view only if all in it has their frame.
IMU_TOPIC = "/imu"
CAMERA_FRAME = "camera_rgb_optical_frame"
BASE_FRAME = "base_link"
WORLD_FRAME = "world"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
FLOAT32 = 7  # of sensor_msgs/msg/PointField
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
# ROS defines 16-bit depth as millimeters. Depth in other units is written in meters.
MILLIMETER_DEPTH_FACTOR = 1000.0
MAX_STAMP_S = 2**31  # of ROS 2
# The topics that frames are written to.
FRAME_TOPICS = frozenset(
    NAMESPACE + name
    for name in (
        "/camera_file",
        "/frame_stamps",
        "/rgb/camera_info",
        "/depth_registered/camera_info",
        *OWN_IMAGES,
        *(f"{image}/{part}" for image in OWN_IMAGES for part in COMPRESSED_PARTS),
    )
)


class FrameWriter(RecordingSink):
    """Writes frames, readings of the accelerometer, gravity and true poses as messages.

    The camera file and the exact stamps of each frame are written too, so that the same frames are
    read back bit for bit.

    Args:
        writer: Writes the messages.
        calibration: The camera of all frames.
        start: Stamp of the first message.
        camera_frame: The name of the color camera's frame.
        T_base_camera: 4x4 pose of the camera in the robot's base, for the transforms; None if
            others write them.
        is_base_estimated: Whether others write the transform to the base, from estimated poses;
            otherwise it has the true poses.
    """

    def __init__(
        self,
        writer: BagWriter,
        calibration: CameraCalibration,
        start: Decimal,
        camera_frame: str = CAMERA_FRAME,
        *,
        T_base_camera: Array | None = None,
        is_base_estimated: bool = False,
    ) -> None:
        self._writer, self._calibration = writer, calibration
        self._camera_frame = camera_frame
        self._T_base_camera, self._is_base_estimated = T_base_camera, is_base_estimated
        self._true_path = SampledPath()
        start_ns = _checked_ns(start)
        text = self._make(STRING, format_calibration(calibration))
        writer.write(f"{NAMESPACE}/camera_file", STRING, start_ns, text)
        if T_base_camera is not None:
            self._write_transform("/tf_static", start_ns, BASE_FRAME, camera_frame, T_base_camera)

    def write_frame(self, frame: StoredFrame) -> None:
        stamps, logged = frame.stamps, frame.log_times
        color_ns, depth_ns = _checked_ns(stamps.color), _checked_ns(stamps.depth)
        color_log_ns, depth_log_ns = to_ns(logged.color), to_ns(logged.depth)
        self._write_color(color_ns, frame.color, color_log_ns)
        self._write_camera_info("rgb", color_ns, color_log_ns)
        self._write_depth(depth_ns, frame.depth, depth_log_ns)
        # Depth has the frame of color. Rerun shows an error if a frame has two of them.
        if not self._writer.is_for_viewers:
            self._write_camera_info("depth_registered", depth_ns, depth_log_ns)
        # Written last: a frame counts once all of it is in the file.
        text = self._make(STRING, format_frame_stamps(stamps))
        log_ns = max(color_log_ns, depth_log_ns)
        self._writer.write(f"{NAMESPACE}/frame_stamps", STRING, log_ns, text)

    def _write_color(self, stamp_ns: int, color: bytes | BgrImage, log_ns: int) -> None:
        topic = f"{NAMESPACE}/rgb/image_raw"
        if isinstance(color, bytes):
            kind = "jpeg" if color.startswith(JPEG_START) else "png"
            message = self._compressed(stamp_ns, color, f"bgr8; {kind} compressed bgr8")
            self._writer.write(f"{topic}/compressed", COMPRESSED_IMAGE, log_ns, message)
        else:
            self._writer.write(topic, IMAGE, log_ns, self._image(stamp_ns, color, "bgr8"))

    def _write_depth(self, stamp_ns: int, depth: bytes | DepthImage, log_ns: int) -> None:
        factor, topic = self._calibration.depth_factor, f"{NAMESPACE}/depth_registered/image"
        if factor != MILLIMETER_DEPTH_FACTOR:
            meters = _decoded(depth) / np.float32(factor)
            self._writer.write(topic, IMAGE, log_ns, self._image(stamp_ns, meters, "32FC1"))
        elif self._writer.is_for_viewers:  # which read no compressed depth
            image = self._image(stamp_ns, _decoded(depth), "16UC1")
            self._writer.write(f"{topic}_raw", IMAGE, log_ns, image)
        else:
            png = depth if isinstance(depth, bytes) else encode_image(depth, ColorFormat.PNG)
            data = COMPRESSED_DEPTH_HEADER.pack(0, 0.0, 0.0) + png
            message = self._compressed(stamp_ns, data, "16UC1; compressedDepth png")
            topic = f"{topic}_raw/compressedDepth"
            self._writer.write(topic, COMPRESSED_IMAGE, log_ns, message)

    def write_gravity(self, stamp: Decimal, gravity_m_s2: Vector) -> None:
        stamp_ns = _checked_ns(stamp)
        vector = self._make("geometry_msgs/msg/Vector3", *gravity_m_s2)
        message = self._make(VECTOR_STAMPED, self._header(stamp_ns), vector)
        self._writer.write(f"{NAMESPACE}/gravity", VECTOR_STAMPED, stamp_ns, message)

    def write_reading(self, stamp: Decimal, acceleration_m_s2: Vector) -> None:
        stamp_ns = _checked_ns(stamp)
        reaction = self._make("geometry_msgs/msg/Vector3", *acceleration_m_s2)
        unknown = np.array([-1.0, *[0.0] * 8])
        no_turn = self._make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
        no_rate = self._make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        message = self._make(
            IMU, self._header(stamp_ns), no_turn, unknown, no_rate, unknown, reaction, np.zeros(9)
        )  # fmt: skip
        self._writer.write(IMU_TOPIC, IMU, stamp_ns, message)

    def write_true_pose(self, stamp: Decimal, T_world_camera: Array) -> None:
        """Write a true pose of the camera, and the path to it. Raises OSError."""
        stamp_ns = _checked_ns(stamp)
        point, quaternion = self._make_pose(T_world_camera, "geometry_msgs/msg/Point")
        pose = self._make("geometry_msgs/msg/Pose", point, quaternion)
        message = self._make(POSE_STAMPED, self._header(stamp_ns, WORLD_FRAME), pose)
        self._writer.write("/ground_truth", POSE_STAMPED, stamp_ns, message)
        if self._T_base_camera is None:
            return
        T_world_base = T_world_camera @ inverse(self._T_base_camera)
        if not self._is_base_estimated:
            self._write_transform("/tf", stamp_ns, WORLD_FRAME, BASE_FRAME, T_world_base)
        path = self._true_path.add(float(stamp), T_world_base[:3, 3])
        if path is not None:
            self._write_path(stamp_ns, path)

    def _write_path(self, stamp_ns: int, points: NDArray[np.float32]) -> None:
        fields = [
            self._make("sensor_msgs/msg/PointField", name, 4 * k, FLOAT32, 1)
            for k, name in enumerate("xyz")
        ]
        data = points.astype("<f4").view(np.uint8).ravel()
        message = self._make(
            POINT_CLOUD, self._header(stamp_ns, WORLD_FRAME), 1, len(points), fields, False,
            12, len(data), data, True,
        )  # fmt: skip
        self._writer.write("/ground_truth/path", POINT_CLOUD, stamp_ns, message)

    def _write_transform(
        self, topic: str, stamp_ns: int, parent: str, child: str, T_parent_child: Array
    ) -> None:
        vector, quaternion = self._make_pose(T_parent_child, "geometry_msgs/msg/Vector3")
        transform = self._make("geometry_msgs/msg/Transform", vector, quaternion)
        header = self._header(stamp_ns, parent)
        stamped = self._make("geometry_msgs/msg/TransformStamped", header, child, transform)
        self._writer.write(topic, TF_MESSAGE, stamp_ns, self._make(TF_MESSAGE, [stamped]))

    def _make_pose(self, T: Array, position_type: str) -> tuple[Any, Any]:
        """Make the position and the orientation of a pose."""
        quaternion = quaternion_from_rotation(T[:3, :3]).tolist()
        return (
            self._make(position_type, *T[:3, 3].tolist()),
            self._make("geometry_msgs/msg/Quaternion", *quaternion),
        )

    def _write_camera_info(self, name: str, stamp_ns: int, log_ns: int) -> None:
        c = self._calibration
        K = np.array([c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0])
        P = np.array([c.fx, 0.0, c.cx, 0.0, 0.0, c.fy, c.cy, 0.0, 0.0, 0.0, 1.0, 0.0])
        roi = self._make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
        message = self._make(
            CAMERA_INFO, self._header(stamp_ns), c.height, c.width, "plumb_bob",
            np.array(c.distortion, np.float64), K, np.eye(3).ravel(), P, 0, 0, roi,
        )  # fmt: skip
        self._writer.write(f"{NAMESPACE}/{name}/camera_info", CAMERA_INFO, log_ns, message)

    def _image(self, stamp_ns: int, image: NDArray[Any], encoding: str) -> Any:
        height, width = image.shape[:2]
        data = np.ascontiguousarray(image).view(np.uint8).ravel()
        header = self._header(stamp_ns)
        return self._make(IMAGE, header, height, width, encoding, 0, len(data) // height, data)

    def _compressed(self, stamp_ns: int, data: bytes, form: str) -> Any:
        pixels = np.frombuffer(data, np.uint8)
        return self._make(COMPRESSED_IMAGE, self._header(stamp_ns), form, pixels)

    def _header(self, stamp_ns: int, frame: str | None = None) -> Any:
        stamp = self._make("builtin_interfaces/msg/Time", *divmod(stamp_ns, NS_PER_S))
        sequence = [0] if self._writer.is_ros1 else []
        frame = self._camera_frame if frame is None else frame
        return self._make("std_msgs/msg/Header", *sequence, stamp, frame)

    def _make(self, message_type: str, *values: Any) -> Any:
        return self._writer.store.types[message_type](*values)


def _checked_ns(stamp: Decimal) -> int:
    if not 0 <= stamp < MAX_STAMP_S:
        raise InputError(f"stamp {stamp}: stamps of ROS are between 1970 and 2038; use a folder")
    return to_ns(stamp)


def _decoded(depth: bytes | DepthImage) -> DepthImage:
    return decode_depth(depth, "depth") if isinstance(depth, bytes) else depth
