"""What the two streams of OpenNI2 tell of their images."""

from math import tan

from drivers.camera import PinholeCamera
from drivers.openni2.bindings import PixelFormat
from drivers.openni2.stream import DEPTH_FACTORS, OpenNI2Stream
from drivers.rectify import DepthRegistration, Size, SourceProperties, factory_camera

# The usual focal length of these sensors, for an image 640 pixels wide.
DEFAULT_FOCAL_PX, DEFAULT_WIDTH_PX = 525.0, 640


def read_source_properties(
    name: str, color: OpenNI2Stream, depth: OpenNI2Stream, registration: DepthRegistration
) -> SourceProperties:
    """Read the properties of the images that two streams are set to deliver."""
    camera, camera_source = sensor_camera(color.size, color.fov_rad)
    factor = DEPTH_FACTORS[PixelFormat(depth.video_mode.format)]
    return SourceProperties(name, camera, camera_source, depth.size, factor, registration)


def sensor_camera(size: Size, fov_rad: tuple[float, float]) -> tuple[PinholeCamera, str]:
    """Return the camera with a sensor's field of view, else the usual one, and its origin."""
    horizontal_rad, vertical_rad = fov_rad
    width, height = size
    if 0.1 < horizontal_rad < 3.0 and 0.1 < vertical_rad < 3.0:
        fx, fy = width / (2 * tan(horizontal_rad / 2)), height / (2 * tan(vertical_rad / 2))
        return factory_camera(size, fx, fy), "factory"
    focal_px = DEFAULT_FOCAL_PX * width / DEFAULT_WIDTH_PX
    return factory_camera(size, focal_px, focal_px), "default"
