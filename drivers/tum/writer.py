"""Recording of any camera into a TUM folder that replays the same frames, bit for bit."""

import logging
import shutil
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from decimal import Decimal
from pathlib import Path
from typing import Self

from drivers.calibration import (
    CAMERA_FILE_NAME,
    CameraCalibration,
    format_calibration,
)
from drivers.camera import RgbdFrame
from drivers.core import InputError, UserFacingError
from drivers.core.files import AppendOnlyFile, atomic_write
from drivers.core.geometry import Trajectory, Vector, format_pose_line
from drivers.core.write_errors import WriteError, creating
from drivers.recording.frame_encoding import (
    EARLIEST_STAMPS,
    ColorFormat,
    EncodedFrame,
    FrameStamps,
    calibration_of_frame,
    encode_frame,
    format_stamp,
    round_to_microseconds,
)
from drivers.tum.accelerometer import AccelerometerWriter

_log = logging.getLogger(__name__)

ENCODER_THREADS = 2
MAX_PENDING_FRAMES = 4
INDEX_FILES = {
    "rgb.txt": "timestamp filename",
    "depth.txt": "timestamp filename",
    "associations.txt": "timestamp rgb timestamp depth",
}


class TumWriter:
    """Writes ``rgb/``, ``depth/``, their lists, the camera file, gravity and the ground truth.

    Images are encoded on threads and written in order on the caller's; memory is bounded. A frame
    is listed after both its images are written, so the folder can be replayed even if the process
    is killed. A frame whose stamp is not after the previous one, to the microsecond, is skipped,
    counted and logged. If the disk fails before the first frame, nothing is left.

    Args:
        folder: Created; it must not exist or be empty.
        ground_truth: Written to groundtruth.txt.
        color_format: File format of the color images.

    Raises:
        InputError: No folder can have this name, or it is not empty.
        WriteError: The folder cannot be written.
    """

    def __init__(
        self,
        folder: Path,
        *,
        ground_truth: Trajectory | None = None,
        color_format: ColorFormat = ColorFormat.PNG,
    ) -> None:

        self.folder = folder
        self.written = self.skipped = 0
        self._color_format = color_format
        self._calibrations: list[CameraCalibration] = []
        self._last_stamps = EARLIEST_STAMPS
        self._failure: WriteError | None = None
        self._index_files: list[AppendOnlyFile] = []
        self._accelerometer = AccelerometerWriter(folder)
        self._pending: deque[Future[EncodedFrame]] = deque()
        self._is_new_folder = not folder.exists()
        self._create_files(ground_truth)
        self._pool = ThreadPoolExecutor(ENCODER_THREADS, thread_name_prefix="tum-encode")

    def write(self, frame: RgbdFrame) -> None:
        """Add a frame; it may reach the disk a few frames later.

        Raises:
            WriteError: Writing fails; complete frames remain.
            UserFacingError: The camera differs from that of the first frame.
        """
        if self._failure:
            raise self._failure
        stamps = FrameStamps.from_frame(frame)
        if not stamps.is_after(self._last_stamps):
            self.skipped += 1
            _log.warning("frame %d is not recorded: its stamp does not rise", frame.seq)
            return
        self.set_calibration(calibration_of_frame(frame))
        self._last_stamps = stamps
        self._pending.append(self._pool.submit(encode_frame, frame, stamps, self._color_format))
        while len(self._pending) > MAX_PENDING_FRAMES or (
            self._pending and self._pending[0].done()
        ):
            self._commit(self._pending.popleft().result())

    def write_encoded(self, frame: EncodedFrame) -> None:
        """Write a frame with the bytes that it has; errors as `write`."""
        self._commit(frame)

    def write_gravity(self, stamp: Decimal, gravity_m_s2: Vector) -> None:
        """Write a reading that belongs to no frame; errors as `write`."""
        try:
            self._accelerometer.add(format_stamp(stamp), gravity_m_s2)
        except OSError as error:
            raise self._set_failure(error) from error

    def close(self) -> None:
        """Write pending frames. Safe to call twice. Raises as `write`, but no error twice."""
        try:
            while self._pending and not self._failure:
                self._commit(self._pending.popleft().result())
        finally:
            self._pending.clear()
            self._pool.shutdown()
            self._close_files()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exc: object) -> None:
        self.close()

    def set_calibration(self, calibration: CameraCalibration) -> None:
        """Write the camera file, the first time; later frames must have the same camera.

        Raises:
            UserFacingError: Writing fails, or the camera is another one.
        """
        if not self._calibrations:
            self._write_files(
                [(self.folder / CAMERA_FILE_NAME, format_calibration(calibration).encode())]
            )
            self._calibrations.append(calibration)
        if calibration != self._calibrations[0]:
            raise UserFacingError(
                f"{self.folder}: the camera changed during recording (now {calibration.pinhole}, "
                f"depth factor {calibration.depth_factor}, readout {calibration.readout_s} s); "
                "record it into another folder"
            )

    def _create_files(self, ground_truth: Trajectory | None) -> None:
        folder = self.folder
        with creating(folder):
            folder.mkdir(parents=True, exist_ok=True)
            if any(folder.iterdir()):
                raise InputError(f"{folder}: is not empty; name a new folder for the recording")
            try:
                (folder / "rgb").mkdir()
                (folder / "depth").mkdir()
                if ground_truth is not None:
                    atomic_write(folder / "groundtruth.txt", _format_poses(ground_truth))
                for name, columns in INDEX_FILES.items():
                    self._index_files.append(AppendOnlyFile(folder / name, columns))
            except OSError as error:
                self._set_failure(error)
                self._close_files()
                raise

    def _close_files(self) -> None:
        """Close the files; after a failure before the first frame, remove them."""
        self._accelerometer.close()
        is_ours = all(file.is_in_place for file in self._index_files)
        while self._index_files:
            self._index_files.pop().close()
        if self._failure and not self.written and is_ours:
            with suppress(OSError):
                for path in [self.folder] if self._is_new_folder else [*self.folder.iterdir()]:
                    shutil.rmtree(path) if path.is_dir() else path.unlink()

    def _commit(self, frame: EncodedFrame) -> None:
        stamps = frame.stamps
        color_file = f"rgb/{round_to_microseconds(stamps.color):f}.{frame.color_format}"
        depth_file = f"depth/{round_to_microseconds(stamps.depth):f}.png"
        self._write_files(
            [(self.folder / color_file, frame.color), (self.folder / depth_file, frame.depth)]
        )
        color_line = f"{format_stamp(stamps.color)} {color_file}"
        depth_line = f"{format_stamp(stamps.depth)} {depth_file}"
        lines = (color_line, depth_line, f"{color_line} {depth_line}")
        try:
            self._accelerometer.add(format_stamp(stamps.color), frame.gravity_m_s2)
            for index_file, line in zip(self._index_files, lines, strict=True):
                index_file.append(line)
        except OSError as error:
            raise self._set_failure(error) from error
        self.written += 1

    def _write_files(self, files: Sequence[tuple[Path, bytes]]) -> None:
        """Write all files or none."""
        try:
            for path, data in files:
                atomic_write(path, data)
        except OSError as error:
            for path, _ in files:
                with suppress(OSError):
                    path.unlink(missing_ok=True)
            raise self._set_failure(error) from error

    def _set_failure(self, error: OSError) -> WriteError:
        has_frames = self.written and self.folder.exists()
        remark = f"the {self.written} frames recorded so far are complete" if has_frames else ""
        self._failure = WriteError.of(self.folder, error, remark)
        return self._failure


def _format_poses(trajectory: Trajectory) -> bytes:
    poses = zip(trajectory.stamps_s, trajectory.T_world_camera, strict=True)
    lines = [format_pose_line(stamp_s, T_world_camera) for stamp_s, T_world_camera in poses]
    return "".join(["# timestamp tx ty tz qx qy qz qw\n", *lines]).encode()
