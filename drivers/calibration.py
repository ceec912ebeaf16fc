"""The camera file: what turns a recording's pixels and depth values into rays and metres."""

import math
import re
from dataclasses import dataclass
from pathlib import Path

from drivers.camera import PinholeCamera
from drivers.core.config import SCHEMA_VERSION, config_field, read_toml, required_field
from drivers.core.errors import InputError
from drivers.core.geometry import Array, transform_from_pose

CAMERA_FILE_NAME = "camera.toml"
Distortion = tuple[float, float, float, float, float]
NO_DISTORTION: Distortion = (0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class RigidTransform:
    """A rigid motion as a table."""

    translation_m: tuple[float, float, float] = required_field(
        "x y z in metres", minimum=-10.0, maximum=10.0
    )
    quaternion_xyzw: tuple[float, float, float, float] = required_field("x y z w, of length 1")

    def __post_init__(self) -> None:
        if abs(math.hypot(*self.quaternion_xyzw) - 1.0) > 1e-2:
            raise ValueError("quaternion_xyzw must have length 1, as x y z w")

    @property
    def matrix(self) -> Array:
        """4x4."""
        return transform_from_pose(self.translation_m, self.quaternion_xyzw)


@dataclass(frozen=True)
class DepthCameraCalibration:
    """`[depth]`: a depth camera of its own, for depth that the sensor does not register.

    T_color_depth  maps coordinates of the depth camera to those of the color camera
    scale          true distance per distance read
    """

    fx: float = required_field("horizontal focal length in pixels", minimum=1.0, maximum=1e6)
    fy: float = required_field("vertical focal length in pixels", minimum=1.0, maximum=1e6)
    cx: float = required_field("column of the principal point in pixels", minimum=-1e5, maximum=1e5)
    cy: float = required_field("row of the principal point in pixels", minimum=-1e5, maximum=1e5)
    T_color_depth: RigidTransform = required_field("translation_m and quaternion_xyzw")
    distortion: Distortion = config_field(
        NO_DISTORTION, "k1, k2, p1, p2, k3", minimum=-1e3, maximum=1e3
    )
    width: int = config_field(640, "depth image width in pixels", minimum=1, maximum=16384)
    height: int = config_field(480, "depth image height in pixels", minimum=1, maximum=16384)
    scale: float = config_field(1.0, "true distance per distance read", minimum=0.5, maximum=2.0)

    @property
    def pinhole(self) -> PinholeCamera:
        """Intrinsics without the distortion."""
        return PinholeCamera(self.width, self.height, self.fx, self.fy, self.cx, self.cy)


@dataclass(frozen=True)
class CameraCalibration:
    """A pinhole camera with lens distortion (k1 k2 p1 p2 k3, Brown's model as in OpenCV).

    depth_factor    value of the depth images per metre
    readout_s       rolling shutter: seconds from the first row to the last; a stamp is the middle
                    row
    depth_offset_s  instant of a depth image minus what its stamp says, relative to color; a
                    frame's skew is this and the difference of its two stamps
    """

    width: int = required_field("image width in pixels", minimum=1, maximum=16384)
    height: int = required_field("image height in pixels", minimum=1, maximum=16384)
    fx: float = required_field("horizontal focal length in pixels", minimum=1.0, maximum=1e6)
    fy: float = required_field("vertical focal length in pixels", minimum=1.0, maximum=1e6)
    cx: float = required_field("column of the principal point in pixels", minimum=-1e5, maximum=1e5)
    cy: float = required_field("row of the principal point in pixels", minimum=-1e5, maximum=1e5)
    distortion: Distortion = required_field(
        "k1, k2, p1, p2, k3; zeros for none", minimum=-1e3, maximum=1e3
    )
    depth_factor: float = required_field(
        "depth image value of one metre: 5000 for TUM, 1000 for millimetres",
        minimum=1.0,
        maximum=1e6,
    )
    readout_s: float = config_field(
        0.0, "seconds from the first row to the last", minimum=0.0, maximum=1.0
    )
    depth_offset_s: float = config_field(
        0.0, "how much later depth was taken than its stamp says", minimum=-0.1, maximum=0.1
    )
    depth: DepthCameraCalibration | None = config_field(
        None, "the depth camera, where it is one of its own"
    )

    @property
    def pinhole(self) -> PinholeCamera:
        """Intrinsics without the distortion."""
        return PinholeCamera(self.width, self.height, self.fx, self.fy, self.cx, self.cy)


def _tum_calibration(
    fx: float, fy: float, cx: float, cy: float, distortion: Distortion = NO_DISTORTION
) -> CameraCalibration:
    return CameraCalibration(640, 480, fx, fy, cx, cy, distortion, 5000.0)


# The color calibration that the TUM RGB-D benchmark publishes for its three sensors (the page
# "File Formats"; freiburg3 was undistorted before it was published). The factor is the nominal
# 5000 for all: the scale corrections on the same page (1.035, 1.031, 1.000) are not applied, so
# that results compare with published ones. A camera file in the folder can say otherwise.
TUM_CALIBRATIONS = {
    "1": _tum_calibration(517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "2": _tum_calibration(520.9, 521.0, 325.1, 249.7, (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "3": _tum_calibration(535.4, 539.2, 320.1, 247.6),
}
_TUM_NAME = re.compile(r"(?<![a-z0-9])(?:freiburg|fr)([123])(?![a-z0-9])", re.IGNORECASE)


def find_calibration(folder: Path, camera_file: Path | None) -> CameraCalibration:
    """The file `given`, else FOLDER/camera.toml, else TUM's camera named by the folder.

    Raises InputError if there is none of the three, or the file is wrong.
    """
    if camera_file is not None:
        return read_calibration(camera_file)
    inside = folder / CAMERA_FILE_NAME
    if inside.exists() or inside.is_symlink():
        return read_calibration(inside)
    known = _TUM_NAME.search(folder.resolve().name)
    if known:
        return TUM_CALIBRATIONS[known[1]]
    raise InputError(
        f"{folder}: no camera file, and the name says none of freiburg1, freiburg2, freiburg3; "
        f"write {inside} with the keys schema = {SCHEMA_VERSION}, width, height, fx, fy, cx, cy, "
        "distortion = [k1, k2, p1, p2, k3], depth_factor"
    )


def read_calibration(path: Path) -> CameraCalibration:
    """Read a camera file. Raises InputError naming file, line and key of what is wrong."""
    return read_toml(path, CameraCalibration)


def format_calibration(calibration: CameraCalibration) -> str:
    """`camera` as a camera file; reading it gives exactly the same numbers."""
    return _format_color(calibration) + (
        "" if calibration.depth is None else _format_depth(calibration.depth)
    )


def _format_depth(depth: DepthCameraCalibration) -> str:
    return (
        "\n[depth]\n"
        f"width = {depth.width}\n"
        f"height = {depth.height}\n"
        f"fx = {depth.fx!r}\n"
        f"fy = {depth.fy!r}\n"
        f"cx = {depth.cx!r}\n"
        f"cy = {depth.cy!r}\n"
        f"distortion = {list(depth.distortion)!r}\n"
        f"scale = {depth.scale!r}  # true distance per distance read\n"
        "\n[depth.T_color_depth]  # maps depth camera coordinates to the color camera\n"
        f"translation_m = {list(depth.T_color_depth.translation_m)!r}\n"
        f"quaternion_xyzw = {list(depth.T_color_depth.quaternion_xyzw)!r}\n"
    )


def _format_color(calibration: CameraCalibration) -> str:
    return (
        f"schema = {SCHEMA_VERSION}\n"
        f"width = {calibration.width}\n"
        f"height = {calibration.height}\n"
        f"fx = {calibration.fx!r}\n"
        f"fy = {calibration.fy!r}\n"
        f"cx = {calibration.cx!r}\n"
        f"cy = {calibration.cy!r}\n"
        f"distortion = {list(calibration.distortion)!r}  # k1 k2 p1 p2 k3\n"
        f"depth_factor = {calibration.depth_factor!r}  # depth image value of one metre\n"
        f"readout_s = {calibration.readout_s!r}  # rolling shutter: first row to last\n"
        f"depth_offset_s = {calibration.depth_offset_s!r}  # depth is later than its stamp by this\n"
    )
