"""The camera file: what turns a recording's pixels and depth values into rays and metres."""

import math
import re
from dataclasses import dataclass
from pathlib import Path

from drivers.camera import PinholeCamera
from drivers.errors import InputError
from drivers.geometry import Array, transform_from_pose
from drivers.strict_toml import SCHEMA, read_toml, required, setting

FILE_NAME = "camera.toml"
Distortion = tuple[float, float, float, float, float]
NO_DISTORTION: Distortion = (0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class RigidPose:
    """A rigid motion as a table."""

    translation_m: tuple[float, float, float] = required("x y z in metres", low=-10.0, high=10.0)
    quaternion_xyzw: tuple[float, float, float, float] = required("x y z w, of length 1")

    def __post_init__(self) -> None:
        if abs(math.hypot(*self.quaternion_xyzw) - 1.0) > 1e-2:
            raise ValueError("quaternion_xyzw must have length 1, as x y z w")

    @property
    def matrix(self) -> Array:
        """4x4."""
        return transform_from_pose(self.translation_m, self.quaternion_xyzw)


@dataclass(frozen=True)
class DepthTable:
    """`[depth]`: a depth camera of its own, for depth that the sensor does not register.

    T_color_depth  maps coordinates of the depth camera to those of the colour camera
    scale          true distance per distance read
    """

    fx: float = required("horizontal focal length in pixels", low=1.0, high=1e6)
    fy: float = required("vertical focal length in pixels", low=1.0, high=1e6)
    cx: float = required("column of the principal point in pixels", low=-1e5, high=1e5)
    cy: float = required("row of the principal point in pixels", low=-1e5, high=1e5)
    T_color_depth: RigidPose = required("translation_m and quaternion_xyzw")
    distortion: Distortion = setting(NO_DISTORTION, "k1, k2, p1, p2, k3", low=-1e3, high=1e3)
    width: int = setting(640, "depth image width in pixels", low=1, high=16384)
    height: int = setting(480, "depth image height in pixels", low=1, high=16384)
    scale: float = setting(1.0, "true distance per distance read", low=0.5, high=2.0)

    @property
    def pinhole(self) -> PinholeCamera:
        """Intrinsics without the distortion."""
        return PinholeCamera(self.width, self.height, self.fx, self.fy, self.cx, self.cy)


@dataclass(frozen=True)
class CameraFile:
    """A pinhole camera with lens distortion (k1 k2 p1 p2 k3, Brown's model as in OpenCV).

    depth_factor    value of the depth images per metre
    readout_s       rolling shutter: seconds from the first row to the last; a stamp is the middle
                    row
    depth_offset_s  instant of a depth image minus what its stamp says, relative to colour; a
                    frame's skew is this and the difference of its two stamps
    """

    width: int = required("image width in pixels", low=1, high=16384)
    height: int = required("image height in pixels", low=1, high=16384)
    fx: float = required("horizontal focal length in pixels", low=1.0, high=1e6)
    fy: float = required("vertical focal length in pixels", low=1.0, high=1e6)
    cx: float = required("column of the principal point in pixels", low=-1e5, high=1e5)
    cy: float = required("row of the principal point in pixels", low=-1e5, high=1e5)
    distortion: Distortion = required("k1, k2, p1, p2, k3; zeros for none", low=-1e3, high=1e3)
    depth_factor: float = required(
        "depth image value of one metre: 5000 for TUM, 1000 for millimetres", low=1.0, high=1e6
    )
    readout_s: float = setting(0.0, "seconds from the first row to the last", low=0.0, high=1.0)
    depth_offset_s: float = setting(
        0.0, "how much later depth was taken than its stamp says", low=-0.1, high=0.1
    )
    depth: DepthTable | None = setting(None, "the depth camera, where it is one of its own")

    @property
    def pinhole(self) -> PinholeCamera:
        """Intrinsics without the distortion."""
        return PinholeCamera(self.width, self.height, self.fx, self.fy, self.cx, self.cy)


def _tum(
    fx: float, fy: float, cx: float, cy: float, distortion: Distortion = NO_DISTORTION
) -> CameraFile:
    return CameraFile(640, 480, fx, fy, cx, cy, distortion, 5000.0)


# The colour calibration that the TUM RGB-D benchmark publishes for its three sensors (the page
# "File Formats"; freiburg3 was undistorted before it was published). The factor is the nominal
# 5000 for all: the scale corrections on the same page (1.035, 1.031, 1.000) are not applied, so
# that results compare with published ones. A camera file in the folder can say otherwise.
KNOWN_CAMERAS = {
    "1": _tum(517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "2": _tum(520.9, 521.0, 325.1, 249.7, (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "3": _tum(535.4, 539.2, 320.1, 247.6),
}
_KNOWN_NAME = re.compile(r"(?<![a-z0-9])(?:freiburg|fr)([123])(?![a-z0-9])", re.IGNORECASE)


def camera_of_folder(folder: Path, given: Path | None) -> CameraFile:
    """The file `given`, else FOLDER/camera.toml, else TUM's camera named by the folder.

    Raises InputError if there is none of the three, or the file is wrong.
    """
    if given is not None:
        return read_camera_file(given)
    inside = folder / FILE_NAME
    if inside.exists() or inside.is_symlink():
        return read_camera_file(inside)
    known = _KNOWN_NAME.search(folder.resolve().name)
    if known:
        return KNOWN_CAMERAS[known[1]]
    raise InputError(
        f"{folder}: no camera file, and the name says none of freiburg1, freiburg2, freiburg3; "
        f"write {inside} with the keys schema = {SCHEMA}, width, height, fx, fy, cx, cy, "
        "distortion = [k1, k2, p1, p2, k3], depth_factor"
    )


def read_camera_file(path: Path) -> CameraFile:
    """Read a camera file. Raises InputError naming file, line and key of what is wrong."""
    return read_toml(path, CameraFile)


def camera_file_text(camera: CameraFile) -> str:
    """`camera` as a camera file; reading it gives exactly the same numbers."""
    return _colour_text(camera) + ("" if camera.depth is None else _depth_text(camera.depth))


def _depth_text(depth: DepthTable) -> str:
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
        "\n[depth.T_color_depth]  # maps depth camera coordinates to the colour camera\n"
        f"translation_m = {list(depth.T_color_depth.translation_m)!r}\n"
        f"quaternion_xyzw = {list(depth.T_color_depth.quaternion_xyzw)!r}\n"
    )


def _colour_text(camera: CameraFile) -> str:
    return (
        f"schema = {SCHEMA}\n"
        f"width = {camera.width}\n"
        f"height = {camera.height}\n"
        f"fx = {camera.fx!r}\n"
        f"fy = {camera.fy!r}\n"
        f"cx = {camera.cx!r}\n"
        f"cy = {camera.cy!r}\n"
        f"distortion = {list(camera.distortion)!r}  # k1 k2 p1 p2 k3\n"
        f"depth_factor = {camera.depth_factor!r}  # depth image value of one metre\n"
        f"readout_s = {camera.readout_s!r}  # rolling shutter: first row to last\n"
        f"depth_offset_s = {camera.depth_offset_s!r}  # depth is later than its stamp by this\n"
    )
