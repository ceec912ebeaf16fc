"""What a folder in another benchmark's layout holds, and how its numbered files are read."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from drivers.calibration import CameraCalibration, DepthCameraCalibration
from drivers.core import InputError
from drivers.core.geometry import Array, Trajectory, read_trajectory_rows
from drivers.core.trajectory_files import assumed_stamp, pose_from_matrix
from drivers.recording.image_decoding import BgrImage, DepthImage, UnreadableFrameError
from drivers.recording.recorded_frames import FramePair, RecordedFrames
from drivers.tum.index_files import ListedImage

# A saturated 16-bit value: 7-Scenes has it for pixels without a reading.
NO_READING = 65535
AT_30_HZ = "stamps at 30 Hz (assumed)"


@dataclass(frozen=True)
class FolderContents:
    """The frames of a folder, and everything that the layout says or leaves open.

    Attributes:
        camera: The camera that holds without a camera file.
        depth_camera: The depth camera, if depth is not registered to color.
        ground_truth: True poses of the color camera; None without.
        assumptions: What was found and what was assumed, in short phrases.
    """

    frames: RecordedFrames
    camera: CameraCalibration
    ground_truth: Trajectory | None
    assumptions: tuple[str, ...]
    depth_camera: DepthCameraCalibration | None = None


class NumberedImage(ListedImage):
    """An image whose depth may have `NO_READING`."""

    def read_depth(self) -> DepthImage:
        """Read the file; saturated values are 0, as all that are no readings."""
        depth = super().read_depth()
        return np.where(depth == NO_READING, np.uint16(0), depth)

    def read_stored_depth(self) -> bytes | DepthImage:
        """Read the file's bytes, or the depth if values have to be removed."""
        depth = super().read_depth()
        return self.read_depth() if depth.max() == NO_READING else super().read_stored_depth()


def find_numbered_files(folder: Path, pattern: str) -> dict[int, Path]:
    """Find the files of a folder by their number.

    Args:
        folder: The folder; it need not exist.
        pattern: Regular expression of a whole name; its first group is the number.

    Raises:
        InputError: The folder cannot be read.
    """
    expression = re.compile(pattern, re.IGNORECASE)
    try:
        names = sorted(each.name for each in folder.iterdir()) if folder.is_dir() else []
    except OSError as error:
        raise InputError(f"{folder}: cannot be read: {error.strerror}") from error
    matches = ((expression.fullmatch(name), name) for name in names)
    return {int(match[1]): folder / name for match, name in matches if match}


def pair_numbered(
    folder: Path, color: Mapping[int, Path], depth: Mapping[int, Path]
) -> RecordedFrames:
    """Pair images by their number, in its order, at 30 Hz.

    Args:
        color: Files of color by their number, at least one.

    Raises:
        InputError: No color and no depth image have the same number.
    """
    numbers = sorted(color.keys() & depth.keys())
    if not numbers:
        example = min(color.values())
        raise InputError(
            f"{folder}: has {len(color)} color images, such as {example.name}, but no depth image "
            f"of the same number ({len(depth)} depth images); restore them"
        )
    pairs = [
        FramePair(*(make_image(files[n], assumed_stamp(n)) for files in (color, depth)))
        for n in numbers
    ]
    return RecordedFrames(pairs, len(color) + len(depth) - 2 * len(pairs))


def make_image(file: Path, stamp: Decimal) -> NumberedImage:
    """Make an image that no list names."""
    return NumberedImage(stamp, file, str(file))


def read_pose_files(files: Mapping[int, Path]) -> tuple[Trajectory | None, int]:
    """Read one 4x4 pose from each file, for the stamps of `pair_numbered`.

    Returns:
        The poses, None without any; and the number of files whose numbers are not finite, which
        mark frames without a pose.

    Raises:
        InputError: A file cannot be read, or holds no pose.
    """
    numbers = sorted(files)
    matrices = [read_matrix(files[number]) for number in numbers]
    is_finite = [bool(np.isfinite(matrix).all()) for matrix in matrices]
    kept = [(n, m) for n, m, finite in zip(numbers, matrices, is_finite, strict=True) if finite]
    if not kept:
        return None, len(files)
    poses = [pose_from_matrix(matrix.ravel().tolist(), str(files[n])) for n, matrix in kept]
    stamps_s = [float(assumed_stamp(number)) for number, _ in kept]
    return Trajectory(np.array(stamps_s), np.array(poses)), len(files) - len(kept)


def read_matrix(file: Path) -> Array:
    """Read a 4x4 or 3x3 matrix as (4, 4); InputError if there is none."""
    words = [word for _, row in read_trajectory_rows(file) for word in row]
    try:
        numbers = np.array(words, dtype=np.float64)
    except ValueError as error:
        raise InputError(f"{file}: {error}; expected the numbers of a matrix") from error
    if len(numbers) not in (9, 16):
        raise InputError(f"{file}: has {len(numbers)} numbers; expected those of a 4x4 matrix")
    side = 3 if len(numbers) == 9 else 4
    matrix = np.eye(4)
    matrix[:side, :side] = numbers.reshape(side, side)
    return matrix


def make_camera(K: Array, size: tuple[int, int], depth_factor: float) -> CameraCalibration:
    """Make a camera without distortion.

    Args:
        K: (4, 4) or (3, 3) intrinsics.
    """
    fx, fy, cx, cy = (float(K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return CameraCalibration(*size, fx, fy, cx, cy, (0.0,) * 5, depth_factor)


def read_image_size(image: ListedImage, *, is_depth: bool = False) -> tuple[int, int]:
    """Read (width, height) of an image; InputError if it cannot be decoded."""
    try:
        pixels: BgrImage | DepthImage = image.read_depth() if is_depth else image.read_color()
    except UnreadableFrameError as error:
        raise InputError(f"{error} (the first frame)") from error
    return pixels.shape[1], pixels.shape[0]
