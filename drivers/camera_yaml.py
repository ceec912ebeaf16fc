"""Camera files in YAML: of OpenCV, of ROS's camera_calibration, and of ORB-SLAM."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drivers.core import InputError
from drivers.core.input_files import read_input_text

YAML_SUFFIXES = (".yaml", ".yml")
MAX_FILE_BYTES = 1_000_000
# ORB-SLAM2's and ORB-SLAM3's prefixes.
ORB_SLAM_PREFIXES = ("Camera1.", "Camera.")
DEPTH_FACTOR_KEYS = ("RGBD.DepthMapFactor", "DepthMapFactor", "depth_factor")
# Names of Brown's model with k1 k2 p1 p2 k3, and of no distortion.
BROWN_MODELS = ("", "plumb_bob", "radtan", "pinhole", "rectified", "none")


def read_camera_yaml(path: Path) -> dict[str, Any]:
    """Read width, height, intrinsics and distortion, and the depth factor if it is there.

    Returns:
        Values of a `CameraCalibration` by field.

    Raises:
        InputError: The file cannot be read, or has no camera; the message names file and key.
    """
    values = _parse(path)
    model = str(values.get("Camera.type", values.get("distortion_model", ""))).lower()
    if model not in BROWN_MODELS:
        raise InputError(
            f"{path}: the lens model {model} is not supported, only k1 k2 p1 p2 k3 (plumb_bob); "
            "give undistorted images and their camera"
        )
    prefix = next((each for each in ORB_SLAM_PREFIXES if f"{each}fx" in values), "")
    if prefix:
        camera = _read_orb_slam(path, values, prefix)
    elif "camera_matrix" in values:
        camera = _read_matrices(path, values)
    else:
        raise InputError(
            f"{path}: has no camera; a camera file in YAML has camera_matrix (OpenCV, ROS), or "
            "Camera.fx or Camera1.fx (ORB-SLAM)"
        )
    factor = next((values[key] for key in DEPTH_FACTOR_KEYS if key in values), None)
    return camera if factor is None else camera | {"depth_factor": factor}


def _parse(path: Path) -> dict[str, Any]:
    """Parse with OpenCV, which wants a header and lists that are further right than their key."""
    import cv2

    text = read_input_text(path, "name a camera file", MAX_FILE_BYTES)
    has_header = text.startswith("%YAML")
    header = "" if has_header else "%YAML:1.0\n"
    text = re.sub(r"(?m)^( *)- ", r"\1  - ", text.replace("\t", " "))
    try:
        storage = cv2.FileStorage(header + text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        values = _convert(storage.root())
    except (cv2.error, SystemError) as error:
        reason = re.search(r"\((\d+)\): (.*)'", str(error.__cause__ or error))
        line = f":{int(reason[1]) - (not has_header)}" if reason else ""
        what = f": {reason[2]}" if reason else ""
        raise InputError(f"{path}{line}: not YAML{what}; write `key: value`") from error
    return values if isinstance(values, dict) else {}


def _convert(node: Any) -> Any:
    """Convert a node of OpenCV to Python's types."""
    if node.isMap():
        return {key: _convert(node.getNode(key)) for key in node.keys()}  # noqa: SIM118
    if node.isSeq():
        return [_convert(node.at(index)) for index in range(node.size())]
    if node.isInt():
        return int(node.real())
    return node.real() if node.isReal() else node.string()


def _read_orb_slam(path: Path, values: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    intrinsics = {key: _get(path, values, f"{prefix}{key}") for key in ("fx", "fy", "cx", "cy")}
    size = {key: _get(path, values, f"Camera.{key}") for key in ("width", "height")}
    distortion = [values.get(f"{prefix}{key}", 0.0) for key in ("k1", "k2", "p1", "p2", "k3")]
    return size | intrinsics | {"distortion": distortion}


def _read_matrices(path: Path, values: Mapping[str, Any]) -> dict[str, Any]:
    K = _get_data(path, values, "camera_matrix")
    if len(K) != 9:
        raise InputError(f"{path}: key `camera_matrix`: has {len(K)} numbers; give 9")
    coefficients = (
        _get_data(path, values, "distortion_coefficients")
        if "distortion_coefficients" in values
        else []
    )
    if any(coefficients[5:]):
        raise InputError(
            f"{path}: key `distortion_coefficients`: has {len(coefficients)} numbers; only "
            "k1 k2 p1 p2 k3 are supported"
        )
    return {
        "width": _get(path, values, "image_width"),
        "height": _get(path, values, "image_height"),
        "fx": K[0],
        "fy": K[4],
        "cx": K[2],
        "cy": K[5],
        "distortion": [*coefficients, *[0.0] * 5][:5],
    }


def _get(path: Path, values: Mapping[str, Any], key: str) -> Any:
    if key not in values:
        raise InputError(f"{path}: key `{key}` is missing; add `{key}: ...`")
    return values[key]


def _get_data(path: Path, values: Mapping[str, Any], key: str) -> list[Any]:
    """Return the numbers of a matrix."""
    matrix = values[key]
    data = matrix.get("data") if isinstance(matrix, dict) else matrix
    if not isinstance(data, list):
        raise InputError(f"{path}: key `{key}`: is not a matrix; give rows, cols and data")
    return data
