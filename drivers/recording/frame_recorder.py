"""Recording of the frames of any camera, into a folder or a file."""

import logging
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from decimal import Decimal
from functools import partial
from typing import Any, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers.calibration import CameraCalibration
from drivers.camera import NewReadings, RgbdFrame
from drivers.core import UserFacingError
from drivers.core.geometry import Trajectory
from drivers.core.write_errors import WriteError, check_disk_space
from drivers.recording.frame_encoding import EARLIEST_STAMPS, FrameStamps, calibration_of_frame
from drivers.recording.image_encoding import ColorFormat, encode_image
from drivers.recording.odometry import OdometryRecord
from drivers.recording.recording_sink import RecordingFile, RecordingSink, StoredFrame

_log = logging.getLogger(__name__)

ENCODER_THREADS = 2
# A crash loses this, and the frames that still wait for the disk.
FLUSH_PERIOD_S = 0.25

_Images = tuple[Any, Any]  # color and depth: encoded, or raw
FileT = TypeVar("FileT", bound=RecordingFile)


class FrameRecorder(Generic[FileT]):
    """Writes frames, gravity and the ground truth into a new file or folder.

    Images are encoded on threads and written in order on another, so that a slow disk does not hold
    up the camera; memory is bounded. Everything older than `FLUSH_PERIOD_S` outlives the process. A
    frame whose stamp is not after the previous one, to the microsecond, is skipped, counted and
    logged. If the disk fails, the file ends with its last whole part; one without a frame is
    removed.

    Args:
        ground_truth: Written up to each frame; may be set until the first one.

    Attributes:
        skipped: Number of frames whose stamp did not rise.
    """

    def __init__(self, file: FileT, ground_truth: Trajectory | None = None) -> None:
        self.path, self.file = file.path, file
        self.skipped = 0
        self.ground_truth = ground_truth
        self._true_poses = 0  # that are written
        self._sink: RecordingSink | None = None  # from the first frame on
        self._calibration: CameraCalibration | None = None
        self._last_stamps = EARLIEST_STAMPS
        self._new_readings = NewReadings()
        self._failure: UserFacingError | None = None
        self._is_cut = self._is_failure_raised = self._is_closed = False
        self._flushed_s = time.monotonic()
        self._pending: deque[Future[None]] = deque()
        self._encoders = ThreadPoolExecutor(ENCODER_THREADS, thread_name_prefix="record-encode")
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="record-write")

    @property
    def written(self) -> int:
        """Number of frames in the file."""
        return self.file.written

    def write(
        self,
        frame: RgbdFrame,
        write_others: Callable[[], None] = lambda: None,
        odometry: Sequence[OdometryRecord] = (),
    ) -> None:
        """Add a frame; it may reach the disk a few frames later.

        Args:
            write_others: Writes what else belongs to it, before it.
            odometry: Messages of the base's odometry since the frame before.

        Raises:
            WriteError: Writing fails; earlier frames remain.
            UserFacingError: The camera differs from that of the first frame.
        """
        self._raise_failure()
        stamps = FrameStamps.from_frame(frame)
        if not stamps.is_after(self._last_stamps):
            self.skipped += 1
            _log.warning("frame %d is not recorded: its stamp does not rise", frame.seq)
            return
        self._check_camera(calibration_of_frame(frame))
        self._last_stamps = stamps
        images = self._encoders.submit(self._encode, frame)
        self._submit(partial(self._write_frame, frame, stamps, images, write_others, odometry))

    def write_besides(self, write: Callable[[], None]) -> None:
        """Call a function that writes what belongs to no frame. Raises as `write`."""
        self._raise_failure()
        self._submit(write)

    def close(self) -> None:
        """Write pending frames and complete the file. Safe to call twice.

        Raises:
            UserFacingError: As for `write`, unless it was raised there.
        """
        if self._is_closed:
            return
        self._is_closed = True
        try:
            self._encoders.shutdown()
            self._writer.shutdown()
            while self._pending:
                self._pending.popleft().result()
            if not self._is_cut:
                self._try(self.file.complete)
        finally:
            self.file.close()
        if not self._is_failure_raised:
            self._raise_failure()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exc: object) -> None:
        self.close()

    def _encode(self, frame: RgbdFrame) -> _Images:
        return (
            _encoded(frame.color_bgr, self.file.color_format),
            _encoded(frame.depth_raw, self.file.depth_format),
        )

    def _raise_failure(self) -> None:
        if self._failure is not None:
            self._is_failure_raised = True
            raise self._failure

    def _check_camera(self, calibration: CameraCalibration) -> None:
        self._calibration = self._calibration or calibration
        if calibration != self._calibration:
            raise UserFacingError(
                f"{self.path}: the camera changed during recording (now {calibration.pinhole}, "
                f"depth factor {calibration.depth_factor}, readout {calibration.readout_s} s); "
                f"record it into another {'folder' if self.path.is_dir() else 'file'}"
            )

    def _submit(self, write: Callable[[], None]) -> None:
        """Call a function on the writer's thread; wait while too many are pending."""
        self._pending.append(self._writer.submit(self._commit, write))
        limit = self.file.max_pending_frames
        while len(self._pending) > limit or (self._pending and self._pending[0].done()):
            self._pending.popleft().result()
        self._raise_failure()

    def _commit(self, write: Callable[[], None]) -> None:
        """Write, on the writer's thread. After a failure the rest is discarded."""
        if self._failure is None:
            self._try(write)
        if self._failure is None and time.monotonic() - self._flushed_s >= FLUSH_PERIOD_S:
            self._try(self.file.flush)
            self._flushed_s = time.monotonic()
            self._check_disk_space()

    def _try(self, write: Callable[[], None]) -> None:
        """Call a function; keep its error, after which only an unharmed file can be completed."""
        try:
            write()
        except OSError as error:
            self.file.cut()
            self._is_cut = True
            self._failure = WriteError.of(self.path, error, self.file.remark)
        except UserFacingError as error:
            self._failure = error

    def _check_disk_space(self) -> None:
        """End the recording while there is space for the end of the file."""
        try:
            check_disk_space(self.path.parent, self.file.min_free_bytes)
        except OSError as error:
            self._failure = self._failure or WriteError.of(self.path, error, self.file.remark)

    def _write_frame(
        self,
        frame: RgbdFrame,
        stamps: FrameStamps,
        images: Future[_Images],
        write_others: Callable[[], None],
        odometry: Sequence[OdometryRecord],
    ) -> None:
        if self._sink is None:
            start = min(stamps.color, stamps.depth)
            self._sink = self.file.begin(calibration_of_frame(frame), start)
        self._write_true_poses(self._sink, float(max(stamps.color, stamps.depth)))
        write_others()
        for record in odometry:
            self._sink.write_odometry(Decimal(repr(record.stamp_s)), record.message)
        for reading in self._new_readings.take(frame.accelerometer):
            stamp = Decimal(repr(float(reading.stamp_s)))
            self._sink.write_reading(stamp, reading.acceleration_m_s2)
        if frame.gravity_m_s2 is not None:
            self._sink.write_gravity(stamps.color, frame.gravity_m_s2)
        self._sink.write_frame(StoredFrame(stamps, *images.result()))
        self.file.written += 1

    def _write_true_poses(self, sink: RecordingSink, end_s: float) -> None:
        """Write the next true poses up to the first one after a time."""
        truth = self.ground_truth
        if truth is None:
            return
        end = 1 + np.searchsorted(truth.stamps_s, end_s, side="right")
        for k in range(self._true_poses, min(int(end), len(truth.stamps_s))):
            stamp = Decimal(repr(float(truth.stamps_s[k])))
            sink.write_true_pose(stamp, truth.T_world_camera[k])
            self._true_poses = k + 1


def _encoded(image: NDArray[Any], image_format: ColorFormat | None) -> bytes | NDArray[Any]:
    return image if image_format is None else encode_image(image, image_format)
