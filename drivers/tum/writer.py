"""Writing of folders in TUM format, which replay the same frames, bit for bit."""

import shutil
from collections.abc import Sequence
from contextlib import suppress
from decimal import Decimal
from pathlib import Path

from drivers.calibration import CAMERA_FILE_NAME, CameraCalibration, format_calibration
from drivers.core import InputError
from drivers.core.files import AppendOnlyFile, LateFile, atomic_write
from drivers.core.geometry import Array, Trajectory, Vector, format_trajectory
from drivers.core.write_errors import check_disk_space, creating
from drivers.recording.frame_encoding import format_stamp, round_to_microseconds
from drivers.recording.image_decoding import JPEG_START, BgrImage, DepthImage
from drivers.recording.image_encoding import ColorFormat, encode_image
from drivers.recording.recording_sink import RecordingFile, RecordingSink, StoredFrame
from drivers.tum.accelerometer import (
    ACCELEROMETER_COLUMNS,
    ACCELEROMETER_FILE,
    format_reading,
)
from drivers.tum.odometry import ODOMETRY_COLUMNS, ODOMETRY_FILE, format_message

INDEX_FILES = {
    "rgb.txt": "timestamp filename",
    "depth.txt": "timestamp filename",
    "associations.txt": "timestamp rgb timestamp depth",
}


class TumFolder(RecordingFile, RecordingSink):
    """Writes ``rgb/``, ``depth/``, their lists, the camera file, gravity and the ground truth.

    A frame is listed after both its images are written, so the folder can be replayed even if the
    process is killed. If the disk fails before the first frame, nothing is left.

    Args:
        folder: Created; it must not exist or be empty.
        ground_truth: Written to groundtruth.txt at once; `write_true_pose` does nothing.
        has_gravity: Whether the accelerometer's file gets the gravity of the frames, and not the
            readings.

    Raises:
        InputError: No folder can have this name, or it is not empty.
        WriteError: The folder cannot be written.
    """

    depth_format = ColorFormat.PNG
    max_pending_frames = 4

    def __init__(
        self,
        folder: Path,
        ground_truth: Trajectory | None = None,
        *,
        color_format: ColorFormat = ColorFormat.PNG,
        has_gravity: bool = True,
        min_free_bytes: int = 0,
    ) -> None:
        self.path, self.color_format, self.min_free_bytes = folder, color_format, min_free_bytes
        self._has_gravity = has_gravity
        self._has_failed = False
        self._index_files: list[AppendOnlyFile] = []
        self._accelerometer = LateFile(folder / ACCELEROMETER_FILE, ACCELEROMETER_COLUMNS)
        self._odometry = LateFile(folder / ODOMETRY_FILE, ODOMETRY_COLUMNS)
        self._is_new_folder = not folder.exists()
        with creating(folder):
            folder.parent.mkdir(parents=True, exist_ok=True)
            check_disk_space(folder.parent, min_free_bytes)
            folder.mkdir(exist_ok=True)
            if any(folder.iterdir()):
                raise InputError(f"{folder}: is not empty; name a new folder for the recording")
            try:
                self._create_files(ground_truth)
            except OSError:
                self.cut()
                self.close()
                raise

    def begin(self, calibration: CameraCalibration, start: Decimal) -> RecordingSink:
        atomic_write(self.path / CAMERA_FILE_NAME, format_calibration(calibration).encode())
        return self

    def write_frame(self, frame: StoredFrame) -> None:
        stamps, color, depth = frame.stamps, _as_file(frame.color), _as_file(frame.depth)
        suffix = ColorFormat.JPEG if color.startswith(JPEG_START) else ColorFormat.PNG
        color_file = f"rgb/{round_to_microseconds(stamps.color):f}.{suffix}"
        depth_file = f"depth/{round_to_microseconds(stamps.depth):f}.png"
        _write_files([(self.path / color_file, color), (self.path / depth_file, depth)])
        color_line = f"{format_stamp(stamps.color)} {color_file}"
        depth_line = f"{format_stamp(stamps.depth)} {depth_file}"
        lines = (color_line, depth_line, f"{color_line} {depth_line}")
        for index_file, line in zip(self._index_files, lines, strict=True):
            index_file.append(line)

    def write_reading(self, stamp: Decimal, acceleration_m_s2: Vector) -> None:
        if not self._has_gravity:
            x, y, z = acceleration_m_s2
            self.write_gravity(stamp, (-x, -y, -z))

    def write_gravity(self, stamp: Decimal, gravity_m_s2: Vector) -> None:
        self._accelerometer.append(f"{format_stamp(stamp)} {format_reading(gravity_m_s2)}")

    def write_odometry(self, stamp: Decimal, message: bytes) -> None:
        self._odometry.append(f"{format_stamp(stamp)} {format_message(message)}")

    def write_true_pose(self, stamp: Decimal, T_world_camera: Array) -> None:
        """Do nothing: the pose is in the folder already."""

    def flush(self) -> None:
        """Do nothing: nothing is buffered."""

    def cut(self) -> None:
        """Every listed frame is whole."""
        self._has_failed = True

    def complete(self) -> None:
        """Do nothing: the folder is whole after each frame."""

    def close(self) -> None:
        """Close the files; after a failure before the first frame, remove them."""
        self._accelerometer.close()
        self._odometry.close()
        is_ours = all(file.is_in_place for file in self._index_files)
        while self._index_files:
            self._index_files.pop().close()
        if self._has_failed and not self.written and is_ours:
            with suppress(OSError):
                for path in [self.path] if self._is_new_folder else [*self.path.iterdir()]:
                    shutil.rmtree(path) if path.is_dir() else path.unlink()

    @property
    def remark(self) -> str:
        has_frames = self.written and self.path.exists()
        return f"the {self.written} frames recorded so far are complete" if has_frames else ""

    def _create_files(self, ground_truth: Trajectory | None) -> None:
        (self.path / "rgb").mkdir()
        (self.path / "depth").mkdir()
        if ground_truth is not None:
            heading = b"# timestamp tx ty tz qx qy qz qw\n"
            poses = format_trajectory(ground_truth)
            atomic_write(self.path / "groundtruth.txt", heading + poses)
        for name, columns in INDEX_FILES.items():
            self._index_files.append(AppendOnlyFile(self.path / name, columns))


def _as_file(image: bytes | BgrImage | DepthImage) -> bytes:
    return image if isinstance(image, bytes) else encode_image(image, ColorFormat.PNG)


def _write_files(files: Sequence[tuple[Path, bytes]]) -> None:
    """Write all files or none."""
    try:
        for path, data in files:
            atomic_write(path, data)
    except OSError:
        for path, _ in files:
            with suppress(OSError):
                path.unlink(missing_ok=True)
        raise
