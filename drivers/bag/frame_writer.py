"""Writing of frames, readings and true poses as ROS messages."""

from decimal import Decimal

import numpy as np

from drivers.bag.bag_contents import COMPRESSED_PARTS, OWN_IMAGES, format_frame_stamps, to_ns
from drivers.bag.bag_writer import BagWriter, EncodedMessage
from drivers.calibration import MILLIMETERS_PER_METER, CameraCalibration, format_calibration
from drivers.core import InputError
from drivers.core.bounded_trajectory import SampledPath
from drivers.core.geometry import Array, Vector, inverse
from drivers.recording.image_decoding import JPEG_START, BgrImage, DepthImage, decode_depth
from drivers.recording.image_encoding import ColorFormat, encode_image
from drivers.recording.odometry import ODOMETRY_TOPIC
from drivers.recording.recording_sink import RecordingSink, StoredFrame
from drivers.ros_messages import navigation, sensors
from drivers.ros_messages.cdr import STRING_SCHEMA, encode_string
from drivers.ros_messages.sensors import CompressedImageMessage, RawImageMessage

NAMESPACE = "/camera"
# Not in the namespace: Rerun shows color and depth in one view only if all in it has their frame.
IMU_TOPIC = "/imu"
CAMERA_FRAME = "camera_rgb_optical_frame"
BASE_FRAME = "base_link"
WORLD_FRAME = "world"
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
        self._write_string("/camera_file", format_calibration(calibration), _checked(start))
        if T_base_camera is not None:
            self._write_transform("/tf_static", start, BASE_FRAME, camera_frame, T_base_camera)

    def write_frame(self, frame: StoredFrame) -> None:
        stamps, logged = frame.stamps, frame.log_times
        self._write_color(_checked(stamps.color), frame.color, logged.color)
        self._write_camera_info("rgb", stamps.color, logged.color)
        self._write_depth(_checked(stamps.depth), frame.depth, logged.depth)
        # Depth has the frame of color. Rerun shows an error if a frame has two of them.
        if not self._writer.is_for_viewers:
            self._write_camera_info("depth_registered", stamps.depth, logged.depth)
        # Written last: a frame counts once all of it is in the file.
        text = format_frame_stamps(stamps)
        self._write_string("/frame_stamps", text, max(logged.color, logged.depth))

    def _write_color(self, stamp: Decimal, color: bytes | BgrImage, logged: Decimal) -> None:
        topic = f"{NAMESPACE}/rgb/image_raw"
        if isinstance(color, bytes):
            is_jpeg = color.startswith(JPEG_START)
            form = sensors.JPEG_FORMAT if is_jpeg else sensors.PNG_FORMAT
            self._write_compressed(f"{topic}/compressed", stamp, form, color, logged)
        else:
            image = RawImageMessage(stamp, self._camera_frame, "bgr8", color)
            self._write_raw(topic, image, logged)

    def _write_depth(self, stamp: Decimal, depth: bytes | DepthImage, logged: Decimal) -> None:
        factor, topic = self._calibration.depth_factor, f"{NAMESPACE}/depth_registered/image"
        frame = self._camera_frame
        # ROS defines 16-bit depth as millimeters. Depth in other units is written in meters.
        if factor != MILLIMETERS_PER_METER:
            meters = np.divide(_decoded(depth), np.float32(factor), dtype=np.float32)
            self._write_raw(topic, RawImageMessage(stamp, frame, "32FC1", meters), logged)
        elif self._writer.is_for_viewers:  # which read no compressed depth
            image = RawImageMessage(stamp, frame, "16UC1", _decoded(depth))
            self._write_raw(f"{topic}_raw", image, logged)
        else:
            png = depth if isinstance(depth, bytes) else encode_image(depth, ColorFormat.PNG)
            data, topic = sensors.DEPTH_PNG_HEADER + png, f"{topic}_raw/compressedDepth"
            self._write_compressed(topic, stamp, sensors.DEPTH_PNG_FORMAT, data, logged)

    def write_gravity(self, stamp: Decimal, gravity_m_s2: Vector) -> None:
        data = navigation.encode_vector(_checked(stamp), self._camera_frame, gravity_m_s2)
        self._write(f"{NAMESPACE}/gravity", navigation.VECTOR_SCHEMA, stamp, data)

    def write_reading(self, stamp: Decimal, acceleration_m_s2: Vector) -> None:
        acceleration = np.array(acceleration_m_s2)
        message = sensors.ImuMessage(_checked(stamp), self._camera_frame, acceleration)
        self._write(IMU_TOPIC, sensors.IMU_SCHEMA, stamp, sensors.encode_imu(message))

    def write_odometry(self, stamp: Decimal, message: bytes) -> None:
        self._write(ODOMETRY_TOPIC, navigation.ODOMETRY_SCHEMA, _checked(stamp), message)

    def write_true_pose(self, stamp: Decimal, T_world_camera: Array) -> None:
        """Write a true pose of the camera, and the path to it. Raises OSError."""
        data = navigation.encode_pose(_checked(stamp), WORLD_FRAME, T_world_camera)
        self._write("/ground_truth", navigation.POSE_SCHEMA, stamp, data)
        if self._T_base_camera is None:
            return
        T_world_base = T_world_camera @ inverse(self._T_base_camera)
        if not self._is_base_estimated:
            self._write_transform("/tf", stamp, WORLD_FRAME, BASE_FRAME, T_world_base)
        path = self._true_path.add(float(stamp), T_world_base[:3, 3])
        if path is not None:
            cloud = sensors.PointCloudMessage(stamp, WORLD_FRAME, path, bgr=None)
            data = sensors.encode_point_cloud(cloud)
            self._write("/ground_truth/path", sensors.POINT_CLOUD_SCHEMA, stamp, data)

    def _write_transform(
        self, topic: str, stamp: Decimal, parent: str, child: str, T_parent_child: Array
    ) -> None:
        transform = navigation.TransformMessage(stamp, parent, child, T_parent_child)
        data = navigation.encode_transforms([transform])
        self._write(topic, navigation.TRANSFORMS_SCHEMA, stamp, data)

    def _write_camera_info(self, name: str, stamp: Decimal, logged: Decimal) -> None:
        c = self._calibration
        message = sensors.CameraInfoMessage(
            stamp, self._camera_frame, c.width, c.height, c.pinhole.K, c.distortion
        )
        data = sensors.encode_camera_info(message)
        self._write(f"{NAMESPACE}/{name}/camera_info", sensors.CAMERA_INFO_SCHEMA, logged, data)

    def _write_raw(self, topic: str, image: RawImageMessage, logged: Decimal) -> None:
        self._write(topic, sensors.IMAGE_SCHEMA, logged, sensors.encode_image(image))

    def _write_compressed(
        self, topic: str, stamp: Decimal, form: str, data: bytes, logged: Decimal
    ) -> None:
        message = CompressedImageMessage(stamp, self._camera_frame, form, data)
        encoded = sensors.encode_compressed_image(message)
        self._write(topic, sensors.COMPRESSED_IMAGE_SCHEMA, logged, encoded)

    def _write_string(self, name: str, text: str, logged: Decimal) -> None:
        self._write(NAMESPACE + name, STRING_SCHEMA, logged, encode_string(text))

    def _write(self, topic: str, message_type: str, logged: Decimal, data: bytes) -> None:
        self._writer.write(EncodedMessage(topic, message_type, to_ns(logged), data))


def _checked(stamp: Decimal) -> Decimal:
    if not 0 <= stamp < MAX_STAMP_S:
        raise InputError(f"stamp {stamp}: stamps of ROS are between 1970 and 2038; use a folder")
    return stamp


def _decoded(depth: bytes | DepthImage) -> DepthImage:
    return decode_depth(depth, "depth") if isinstance(depth, bytes) else depth
