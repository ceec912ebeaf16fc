"""The calibration of a camera: intrinsics, lens distortion, depth unit and timing; camera files."""

import logging
import math
import re
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from typing import Annotated

from drivers.camera import PinholeCamera, TimingPrior, TimingSource
from drivers.camera_yaml import YAML_SUFFIXES, read_camera_yaml
from drivers.core import InputError
from drivers.core.config import (
    SCHEMA_VERSION,
    Field,
    FieldError,
    build_dataclass,
    read_toml,
    typed_fields,
)
from drivers.core.geometry import Array, transform_from_pose
from drivers.plausibility import find_intrinsics_error

_log = logging.getLogger(__name__)
CAMERA_FILE_NAME = "camera.toml"
# Also the unit for which `cv2.registerDepth` takes uint16 depth, whatever its unit is.
MILLIMETERS_PER_METER = 1000.0
Distortion = tuple[float, float, float, float, float]
_Fx = Annotated[float, Field("horizontal focal length in pixels", minimum=1.0, maximum=1e6)]
_Fy = Annotated[float, Field("vertical focal length in pixels", minimum=1.0, maximum=1e6)]
_Cx = Annotated[float, Field("column of the principal point in pixels", minimum=-1e5, maximum=1e5)]
_Cy = Annotated[float, Field("row of the principal point in pixels", minimum=-1e5, maximum=1e5)]
NO_DISTORTION: Distortion = (0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class RigidTransform:
    """A rigid transform as a table of a camera file."""

    translation_m: Annotated[
        tuple[float, float, float], Field("x y z in meters", minimum=-10.0, maximum=10.0)
    ]
    quaternion_xyzw: Annotated[tuple[float, float, float, float], "x y z w, of length 1"]

    def __post_init__(self) -> None:
        if abs(math.hypot(*self.quaternion_xyzw) - 1.0) > 1e-2:
            raise FieldError(("quaternion_xyzw",), "must have length 1, as x y z w")

    @property
    def matrix(self) -> Array:
        """The 4x4 transform."""
        return transform_from_pose(self.translation_m, self.quaternion_xyzw)


@dataclass(frozen=True)
class DepthCameraCalibration:
    """The separate depth camera (`[depth]`), for depth that the sensor does not register.

    Attributes:
        T_color_depth: Maps coordinates of the depth camera to those of the color camera.
        scale: True distance per distance read.
    """

    fx: _Fx
    fy: _Fy
    cx: _Cx
    cy: _Cy
    T_color_depth: Annotated[RigidTransform, "translation_m and quaternion_xyzw"]
    distortion: Annotated[Distortion, Field("k1, k2, p1, p2, k3", minimum=-1e3, maximum=1e3)] = (
        NO_DISTORTION
    )
    width: Annotated[int, Field("depth image width in pixels", minimum=1, maximum=16384)] = 640
    height: Annotated[int, Field("depth image height in pixels", minimum=1, maximum=16384)] = 480
    scale: Annotated[float, Field("true distance per distance read", minimum=0.5, maximum=2.0)] = (
        1.0
    )

    @property
    def pinhole(self) -> PinholeCamera:
        """The intrinsics without the distortion."""
        return PinholeCamera(self.width, self.height, self.fx, self.fy, self.cx, self.cy)


# Standard deviations of readout and depth offset: as `calibrate --timing` measures them, and of
# values that nobody has measured.
MEASURED_TIMING_SIGMAS_S = (0.001, 0.0005)
UNKNOWN_TIMING_SIGMAS_S = (0.03, 0.01)
UNKNOWN_TIMING = TimingPrior(0.0, *UNKNOWN_TIMING_SIGMAS_S, TimingSource.UNKNOWN)


@dataclass(frozen=True)
class CameraCalibration:
    """A pinhole camera with lens distortion (k1 k2 p1 p2 k3, Brown's model as in OpenCV).

    Attributes:
        depth_factor: Value of the depth images per meter.
        readout_s: Rolling shutter: seconds from the first row to the last. A stamp is the time of
            the middle row.
        depth_offset_s: Capture time of a depth image minus its stamp, relative to color. A frame's
            skew is this plus the difference of its two stamps.
        readout_sigma_s: Standard deviation of `readout_s`, see `timing_prior`.
        depth_offset_sigma_s: Standard deviation of `depth_offset_s`, see `timing_prior`.
    """

    width: Annotated[int, Field("image width in pixels", minimum=1, maximum=16384)]
    height: Annotated[int, Field("image height in pixels", minimum=1, maximum=16384)]
    fx: _Fx
    fy: _Fy
    cx: _Cx
    cy: _Cy
    distortion: Annotated[
        Distortion, Field("k1, k2, p1, p2, k3; zeros for none", minimum=-1e3, maximum=1e3)
    ]
    depth_factor: Annotated[
        float,
        Field(
            "depth image value of one meter: 5000 for TUM, 1000 for millimeters",
            minimum=1.0,
            maximum=1e6,
        ),
    ]
    readout_s: Annotated[
        float, Field("seconds from the first row to the last", minimum=0.0, maximum=1.0)
    ] = 0.0
    depth_offset_s: Annotated[
        float, Field("capture time of depth minus its stamp, in seconds", minimum=-0.1, maximum=0.1)
    ] = 0.0
    depth: Annotated[
        DepthCameraCalibration | None, "the depth camera, if the sensor does not register depth"
    ] = None
    readout_sigma_s: Annotated[
        float | None,
        Field(
            "standard deviation of readout_s, 0 = exact; unset = 1 ms, or unknown if "
            "readout_s is 0",
            minimum=0.0,
            maximum=1.0,
        ),
    ] = None
    depth_offset_sigma_s: Annotated[
        float | None,
        Field(
            "standard deviation of depth_offset_s, 0 = exact; unset = 0.5 ms, or unknown if "
            "depth_offset_s is 0",
            minimum=0.0,
            maximum=1.0,
        ),
    ] = None

    @property
    def pinhole(self) -> PinholeCamera:
        """The intrinsics without the distortion."""
        return PinholeCamera(self.width, self.height, self.fx, self.fy, self.cx, self.cy)

    @property
    def timing_prior(self) -> TimingPrior | None:
        """How well the timing is known; None = exactly. A zero without a sigma was not measured."""
        readout_sigma_s = _timing_sigma_s(self.readout_s, self.readout_sigma_s, 0)
        offset_sigma_s = _timing_sigma_s(self.depth_offset_s, self.depth_offset_sigma_s, 1)
        if readout_sigma_s == offset_sigma_s == 0.0:
            return None
        is_unknown = (readout_sigma_s, offset_sigma_s) == UNKNOWN_TIMING_SIGMAS_S
        source = TimingSource.UNKNOWN if is_unknown else TimingSource.CAMERA_FILE
        return TimingPrior(self.depth_offset_s, readout_sigma_s, offset_sigma_s, source)


# Kinects read out in 27 to 33 ms.
KINECT_READOUT_S = 0.029
KINECT_TIMING_PRIOR = TimingPrior(0.0, 0.004, 0.005, TimingSource.SENSOR)


def kinect_timing(calibration: CameraCalibration | None) -> tuple[float, TimingPrior | None]:
    """Readout and timing prior of a Kinect: by its camera file, or the usual ones.

    Args:
        calibration: Contents of the camera file; None without one.
    """
    if calibration is not None:
        prior = calibration.timing_prior
        if prior is None or prior.source is not TimingSource.UNKNOWN:
            return calibration.readout_s, prior
    return KINECT_READOUT_S, KINECT_TIMING_PRIOR


def _timing_sigma_s(value_s: float, sigma_s: float | None, index: int) -> float:
    if sigma_s is not None:
        return sigma_s
    return (MEASURED_TIMING_SIGMAS_S if value_s else UNKNOWN_TIMING_SIGMAS_S)[index]


def _tum_calibration(
    fx: float, fy: float, cx: float, cy: float, distortion: Distortion = NO_DISTORTION
) -> CameraCalibration:
    return CameraCalibration(640, 480, fx, fy, cx, cy, distortion, 5000.0)


# The color calibrations that the TUM RGB-D benchmark publishes for its three sensors (page
# "File Formats"; the freiburg3 images are already undistorted). All have the nominal factor 5000:
# the scale corrections on that page (1.035, 1.031, 1.000) are not applied, so that results compare
# with published ones. A camera file in the folder overrides these.
TUM_CALIBRATIONS = {
    "1": _tum_calibration(517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "2": _tum_calibration(520.9, 521.0, 325.1, 249.7, (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "3": _tum_calibration(535.4, 539.2, 320.1, 247.6),
}
_TUM_NAME = re.compile(r"(?<![a-z0-9])(?:freiburg|fr)([123])(?![a-z0-9])", re.IGNORECASE)
# Of benchmarks in TUM's format, as their pages give them: Bonn RGB-D Dynamic, and the registered
# images of CoRBS.
BONN_CALIBRATION = _tum_calibration(
    542.822841, 542.576870, 315.593520, 237.756098, (0.039903, -0.099343, -0.000730, -0.000144, 0.0)
)
CORBS_CALIBRATION = _tum_calibration(468.60, 468.61, 318.27, 243.99)
_BONN_NAME = re.compile(r"(?<![a-z0-9])bonn(?![a-z0-9])", re.IGNORECASE)
_CORBS_NAME = re.compile(r"(?<![a-z0-9])corbs(?![a-z0-9])|^[DEHR]\d_pre_?registered", re.IGNORECASE)


def find_calibration(
    folder: Path, camera_file: Path | None, default: CameraCalibration | None = None
) -> CameraCalibration:
    """Find the calibration of a recording.

    The order is: `camera_file`, FOLDER/camera.toml, `default`, the benchmark's camera that the
    folder's name contains.

    Args:
        camera_file: Camera file; None for the recording's own.
        default: The camera of the folder's layout.

    Raises:
        InputError: None of them exists, or the file is invalid.
    """
    usual = default or find_benchmark_calibration(folder)
    default_file = folder / CAMERA_FILE_NAME
    if camera_file is None and (default_file.exists() or default_file.is_symlink()):
        camera_file = default_file
    if camera_file is not None:
        return read_calibration(camera_file, None if usual is None else usual.depth_factor)
    if usual is not None:
        return usual
    raise InputError(
        f"{folder}: no camera file, and the folder's name contains none of freiburg1, freiburg2, "
        f"freiburg3; write {default_file} with the keys schema = {SCHEMA_VERSION}, width, height, "
        "fx, fy, cx, cy, distortion = [k1, k2, p1, p2, k3], depth_factor"
    )


def find_benchmark_calibration(recording: Path) -> CameraCalibration | None:
    """Find the camera of TUM, Bonn or CoRBS by the recording's name; None if it has none."""
    name = recording.resolve().name
    tum_name = _TUM_NAME.search(name)
    if tum_name:
        return TUM_CALIBRATIONS[tum_name[1]]
    if _BONN_NAME.search(name):
        return BONN_CALIBRATION
    return CORBS_CALIBRATION if _CORBS_NAME.search(name) else None


def read_calibration(path: Path, depth_factor: float | None = None) -> CameraCalibration:
    """Read a camera file: TOML, or the YAML of OpenCV, ROS or ORB-SLAM.

    Args:
        depth_factor: Depth image value of one meter, if a file in YAML does not tell it. None
            assumes millimeters, with a warning in the log.

    Raises:
        InputError: The file is invalid; the message names file, line and key.
    """
    if path.suffix.lower() not in YAML_SUFFIXES:
        return read_toml(path, CameraCalibration, check_intrinsics)
    values = read_camera_yaml(path)
    if "depth_factor" not in values:
        values["depth_factor"] = depth_factor or MILLIMETERS_PER_METER
        if depth_factor is None:
            _log.warning(
                "%s: has no depth factor: depth in millimeters is assumed; otherwise add a line "
                "such as `DepthMapFactor: 5000.0`",
                path,
            )
    try:
        calibration = build_dataclass(CameraCalibration, values)
        check_intrinsics(calibration)
    except FieldError as error:
        raise InputError(f"{path}: key `{'.'.join(error.path)}`: {error}") from error.__cause__
    return calibration


def check_intrinsics(calibration: CameraCalibration) -> None:
    """Raise FieldError if a camera is impossible."""
    for path, camera in (((), calibration), (("depth",), calibration.depth)):
        if camera is not None and (error := find_intrinsics_error(camera.pinhole)) is not None:
            raise FieldError((*path, error[0]), error[1])


def format_calibration(calibration: CameraCalibration) -> str:
    """Format a camera file; `read_calibration` gives back exactly the same numbers."""
    text, depth = f"schema = {SCHEMA_VERSION}\n{_format_table(calibration)}", calibration.depth
    if depth is not None:
        text += (
            f"\n[depth]\n{_format_table(depth)}"
            "\n[depth.T_color_depth]  # maps depth camera coordinates to the color camera\n"
            f"{_format_table(depth.T_color_depth)}"
        )
    return text


def _format_table(table: object) -> str:
    """Format the values of a dataclass with their descriptions; not the tables in it."""
    lines = []
    for field in typed_fields(type(table)):
        value = getattr(table, field.name)
        if value is not None and not is_dataclass(value):
            number = list(value) if isinstance(value, tuple) else value
            lines.append(f"{field.name} = {number!r}  # {field.spec.description}\n")
    return "".join(lines)
