"""One folder of ``frame-000000.color.png``, ``.depth.png`` and ``.pose.txt``.

7-Scenes has it without a calibration, and with depth that is not registered to color. ScanNet's
exporter in C++ writes the same names, and the calibration into ``_info.txt``.
"""

from pathlib import Path

import numpy as np

from drivers.calibration import (
    NO_DISTORTION,
    CameraCalibration,
    DepthCameraCalibration,
    RigidTransform,
)
from drivers.core import InputError
from drivers.core.geometry import Array, Trajectory, inverse
from drivers.core.input_files import read_input_text
from drivers.layouts.contents import (
    AT_30_HZ,
    FolderContents,
    find_numbered_files,
    make_camera,
    pair_numbered,
    read_pose_files,
)

COLOR_PATTERN = r"frame-(\d{1,9})\.color\.\w+"
INFO_FILES = ("_info.txt", "info.txt")
# 7-Scenes publishes only the intrinsics of the depth camera, and says that neither camera was
# calibrated. The color camera and the place of the depth camera, 25 mm to its left with parallel
# axes, are those of a Kinect by its design.
SEVEN_SCENES_COLOR = CameraCalibration(640, 480, 525.0, 525.0, 320.0, 240.0, NO_DISTORTION, 1000.0)
SEVEN_SCENES_DEPTH = DepthCameraCalibration(
    585.0, 585.0, 320.0, 240.0, RigidTransform((-0.025, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
)


def has_frame_files(folder: Path) -> bool:
    """Whether there is a color image ``frame-NUMBER.color.*``."""
    return bool(find_numbered_files(folder, COLOR_PATTERN))


def read_frame_files(folder: Path) -> FolderContents:
    """Read the frames, the poses and, if there is one, the calibration."""
    color = find_numbered_files(folder, COLOR_PATTERN)
    depth = find_numbered_files(folder, r"frame-(\d{1,9})\.depth\.\w+")
    frames = pair_numbered(folder, color, depth)
    truth, invalid = read_pose_files(find_numbered_files(folder, r"frame-(\d{1,9})\.pose\.txt"))
    skipped = (f"frames without a pose: {invalid}",) if invalid else ()
    info = next((folder / name for name in INFO_FILES if (folder / name).exists()), None)
    if info is not None:
        camera, depth_camera = read_info(info)
        assumptions = (f"cameras of {info.name}", AT_30_HZ, *skipped)
        return FolderContents(frames, camera, truth, assumptions, depth_camera)
    assumptions = (
        "uncalibrated depth registered by the usual geometry of a Kinect (color 525 px, depth "
        "585 px, 25 mm apart), unless a camera file has [depth]",
        "depth in millimeters",
        AT_30_HZ,
        *(("true poses of the depth camera",) if truth else ()),
        *skipped,
    )
    color_truth = None if truth is None else _move_to_color(truth)
    return FolderContents(frames, SEVEN_SCENES_COLOR, color_truth, assumptions, SEVEN_SCENES_DEPTH)


def _move_to_color(poses: Trajectory) -> Trajectory:
    """Convert poses of the depth camera to those of the color camera."""
    T_depth_color = inverse(SEVEN_SCENES_DEPTH.T_color_depth.matrix)
    return Trajectory(poses.stamps_s, poses.T_world_camera @ T_depth_color)


def read_info(file: Path) -> tuple[CameraCalibration, DepthCameraCalibration | None]:
    """Read the two cameras of ScanNet's ``_info.txt``; the second is None if they are the same.

    Raises:
        InputError: A key is missing or is not what it should be; the message names it.
    """
    lines = read_input_text(file, "restore it, or give a camera file").splitlines()
    pairs = [line.split("=", 1) for line in lines if "=" in line]
    values = {key.strip(): value.split() for key, value in pairs}

    def numbers(key: str, count: int) -> Array:
        try:
            found = np.array(values[key], np.float64)
        except (KeyError, ValueError) as error:
            raise InputError(f"{file}: key {key} is missing or wrong; restore it") from error
        if len(found) != count or not np.isfinite(found).all():
            raise InputError(f"{file}: key {key} does not have {count} numbers; restore it")
        return found

    for key in ("m_calibrationColorExtrinsic", "m_calibrationDepthExtrinsic"):
        if key in values and not np.allclose(numbers(key, 16).reshape(4, 4), np.eye(4), atol=1e-6):
            raise InputError(
                f"{file}: key {key} is not the identity, so depth is not aligned with color; give "
                "a camera file with [depth]"
            )

    def size(name: str) -> tuple[int, int]:
        width, height = (int(numbers(f"m_{name}{side}", 1)[0]) for side in ("Width", "Height"))
        return width, height

    K_color = numbers("m_calibrationColorIntrinsic", 16).reshape(4, 4)
    K_depth = numbers("m_calibrationDepthIntrinsic", 16).reshape(4, 4)
    camera = make_camera(K_color, size("color"), float(numbers("m_depthShift", 1)[0]))
    return camera, same_place_depth_camera(camera, K_depth, size("depth"))


def same_place_depth_camera(
    camera: CameraCalibration, K_depth: Array, size: tuple[int, int]
) -> DepthCameraCalibration | None:
    """Return a depth camera in the place of the color camera; None if it has the same pixels.

    Args:
        K_depth: (4, 4) intrinsics of the depth camera.
        size: (width, height) of the depth images.
    """
    depth = make_camera(K_depth, size, camera.depth_factor)
    if depth == camera:
        return None
    here = RigidTransform((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    return DepthCameraCalibration(
        depth.fx, depth.fy, depth.cx, depth.cy, here, width=depth.width, height=depth.height
    )
