"""The topics whose messages are passed on as they are: keys of kinect-vo and names in ROS."""

from collections.abc import Sequence
from dataclasses import dataclass

from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu, LaserScan, PointCloud2


@dataclass(frozen=True)
class Topic:
    """A topic that is passed on.

    Attributes:
        key: Key below the prefix of kinect-vo.
        name: Name in ROS.
        message: Class of the message.
    """

    key: str
    name: str
    message: type


def frame_topics(camera_name: str) -> Sequence[Topic]:
    """Return the topics of frames; images and points have the names of openni2_camera."""
    color, depth = f"{camera_name}/rgb", f"{camera_name}/depth_registered"
    return [
        Topic("color/image", f"{color}/image_raw", Image),
        Topic("color/compressed", f"{color}/image_raw/compressed", CompressedImage),
        Topic("color/camera_info", f"{color}/camera_info", CameraInfo),
        Topic("depth/image", f"{depth}/image_raw", Image),
        Topic("depth/compressed", f"{depth}/image_raw/compressedDepth", CompressedImage),
        Topic("depth/camera_info", f"{depth}/camera_info", CameraInfo),
        Topic("points", f"{depth}/points", PointCloud2),
        Topic("imu", f"{camera_name}/imu", Imu),
        Topic("scan", "scan", LaserScan),
    ]
