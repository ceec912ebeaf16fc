"""Recording of any camera into an MCAP file that survives a crash."""

import logging
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from decimal import Decimal
from functools import partial
from io import FileIO
from pathlib import Path
from typing import IO, Any, Self, cast

import numpy as np
from mcap.writer import CompressionType

from drivers.bag.bag_writer import EncodedMessage, McapWriter
from drivers.bag.frame_writer import FrameWriter
from drivers.calibration import CameraCalibration
from drivers.camera import NewReadings, RgbdFrame
from drivers.core import UserFacingError
from drivers.core.geometry import T_BODY_CAMERA, Array, Trajectory
from drivers.core.write_errors import (
    WriteError,
    check_disk_space,
    check_in_place,
    creating,
    writing,
)
from drivers.recording.frame_encoding import (
    EARLIEST_STAMPS,
    ColorFormat,
    FrameStamps,
    calibration_of_frame,
    encode_image,
)
from drivers.recording.image_decoding import BgrImage

_log = logging.getLogger(__name__)

ENCODER_THREADS = 2
# Frames that wait for a slow disk: one second of a Kinect, 45 MB.
MAX_PENDING_FRAMES = 30
# A crash loses this, and the frames that still wait for the disk.
FLUSH_PERIOD_S = 0.25
# Left free on the disk, for the end of the file.
RESERVED_BYTES = 16_000_000
_Color = bytes | BgrImage


class McapRecorder:
    """Writes frames, gravity and the ground truth as ROS messages, see `FrameWriter`.

    If the disk fails, the file ends with its last whole part; one without a frame is removed.
    Color is encoded on threads and written in order on another, so that a slow disk does not hold
    up the camera. Everything older than `FLUSH_PERIOD_S` outlives the process. A frame whose stamp
    is not after the previous one, to the microsecond, is skipped, counted and logged.

    Args:
        path: New file.
        ground_truth: Written up to each frame; may be set until the first one.
        T_base_camera: 4x4 pose of the camera in the robot's base; may be set until the first frame.
        is_base_estimated: Whether `messages` have the transform to the base, see `FrameWriter`.
        is_raw: Write color as it is. Otherwise it is JPEG, which loses a little.
        min_free_bytes: Left free on the disk.

    Raises:
        InputError: The file exists, or no file can have this name.
        WriteError: It cannot be written.
    """

    def __init__(
        self,
        path: Path,
        *,
        ground_truth: Trajectory | None = None,
        T_base_camera: Array = T_BODY_CAMERA,
        is_base_estimated: bool = False,
        is_raw: bool = False,
        min_free_bytes: int = RESERVED_BYTES,
    ) -> None:
        self.path = path
        self.written = self.skipped = 0
        self.ground_truth, self.T_base_camera = ground_truth, T_base_camera
        self._is_base_estimated, self._is_raw = is_base_estimated, is_raw
        self._true_poses = 0  # that are written
        self._min_free_bytes = min_free_bytes
        with creating(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            check_disk_space(path.parent, min_free_bytes)
            self._file = path.open("xb", buffering=0)
        self._mcap = self._start()
        self._frame_writer: FrameWriter | None = None
        self._calibration: CameraCalibration | None = None
        self._last_stamps = EARLIEST_STAMPS
        self._new_readings = NewReadings()
        self._failure: UserFacingError | None = None
        self._is_cut = False
        self._flushed_bytes = self._flushed_frames = 0
        self._flushed_s = time.monotonic()
        self._pending: deque[Future[None]] = deque()
        self._encoders = ThreadPoolExecutor(ENCODER_THREADS, thread_name_prefix="mcap-encode")
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="mcap-write")

    def write(self, frame: RgbdFrame, messages: Sequence[EncodedMessage] = ()) -> None:
        """Add a frame and messages about it; it may reach the disk up to a second later.

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
        color = self._encoders.submit(_encode, frame.color_bgr, self._is_raw)
        self._submit(partial(self._write_frame, frame, stamps, color, messages))

    def write_message(self, message: EncodedMessage) -> None:
        """Add a message that belongs to no frame. Raises as `write`."""
        self._raise_failure()
        self._submit(partial(self._mcap.write_encoded, message))

    def _submit(self, write: Callable[[], None]) -> None:
        """Call a function on the writer's thread; wait while too many are pending."""
        self._pending.append(self._writer.submit(self._commit, write))
        while len(self._pending) > MAX_PENDING_FRAMES or (
            self._pending and self._pending[0].done()
        ):
            self._pending.popleft().result()
        self._raise_failure()

    def close(self) -> None:
        """Write pending frames and complete the file. Safe to call twice. Raises as `write`."""
        if self._file.closed:
            return
        try:
            self._encoders.shutdown()
            self._writer.shutdown()
            while self._pending:
                self._pending.popleft().result()
            self._complete()
            self._raise_failure()
        finally:
            if not self.written:
                self._remove()
            self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exc: object) -> None:
        self.close()

    def _raise_failure(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _check_camera(self, calibration: CameraCalibration) -> None:
        if self._calibration is None:
            self._calibration = calibration
        if calibration != self._calibration:
            raise UserFacingError(
                f"{self.path}: the camera changed during recording (now {calibration.pinhole}, "
                f"depth factor {calibration.depth_factor}, readout {calibration.readout_s} s); "
                "record it into another file"
            )

    def _write_frame(
        self,
        frame: RgbdFrame,
        stamps: FrameStamps,
        color: Future[_Color],
        messages: Sequence[EncodedMessage],
    ) -> None:
        writer = self._frame_writer or self._begin(calibration_of_frame(frame), stamps)
        self._write_true_poses(writer, float(max(stamps.color, stamps.depth)))
        for message in messages:
            self._mcap.write_encoded(message)
        for reading in self._new_readings.take(frame.accelerometer):
            stamp = Decimal(repr(float(reading.stamp_s)))
            writer.write_reading(stamp, reading.acceleration_m_s2)
        if frame.gravity_m_s2 is not None:
            writer.write_gravity(stamps.color, frame.gravity_m_s2)
        writer.write_frame(stamps, color.result(), frame.depth_raw)
        self.written += 1

    def _commit(self, write: Callable[[], None]) -> None:
        """Write, on the writer's thread. After a failure the rest is discarded."""
        if self._failure is not None:
            return
        try:
            write()
            if time.monotonic() - self._flushed_s >= FLUSH_PERIOD_S:
                self._flush()
        except UserFacingError as error:  # the file can still be completed
            self._failure = error
        except OSError as error:
            self._set_failure(error)

    def _start(self) -> McapWriter:
        """Write the start of the file. Raises WriteError; then no file is left."""
        # Zstandard is better, but takes half of a core for raw color.
        compression = CompressionType.LZ4 if self._is_raw else CompressionType.ZSTD
        try:
            with writing(self.path):
                return McapWriter(cast(IO[bytes], _UnbufferedStream(self._file)), compression)
        except WriteError:
            self._remove()
            self._file.close()
            raise

    def _remove(self) -> None:
        """Remove the file, unless another one has its name by now."""
        with suppress(OSError):
            check_in_place(self._file.fileno(), self.path)
            self.path.unlink()

    def _begin(self, calibration: CameraCalibration, stamps: FrameStamps) -> FrameWriter:
        """Write what belongs to the whole recording."""
        self._frame_writer = FrameWriter(
            self._mcap,
            calibration,
            min(stamps.color, stamps.depth),
            T_base_camera=self.T_base_camera,
            is_base_estimated=self._is_base_estimated,
        )
        return self._frame_writer

    def _write_true_poses(self, writer: FrameWriter, end_s: float) -> None:
        """Write the next true poses up to the first one after a time."""
        truth = self.ground_truth
        if truth is None:
            return
        end = 1 + np.searchsorted(truth.stamps_s, end_s, side="right")
        for k in range(self._true_poses, min(int(end), len(truth.stamps_s))):
            stamp = Decimal(repr(float(truth.stamps_s[k])))
            writer.write_true_pose(stamp, truth.T_world_camera[k])
            self._true_poses = k + 1

    def _flush(self) -> None:
        """Hand the messages to the system; raise WriteError if the disk is nearly full."""
        self._mcap.flush()
        check_in_place(self._file.fileno(), self.path)
        self._flushed_bytes, self._flushed_frames = self._file.tell(), self.written
        self._flushed_s = time.monotonic()
        with writing(self.path, self._remark()):
            check_disk_space(self.path.parent, self._min_free_bytes)

    def _complete(self) -> None:
        """Write the end of the file, which is already cut if the disk was full."""
        if not self._is_cut:
            try:
                self._mcap.close()
                check_in_place(self._file.fileno(), self.path)
            except OSError as error:
                self._set_failure(error)

    def _set_failure(self, error: OSError) -> None:
        self._cut_to_last_flush()
        self._failure = WriteError.of(self.path, error, self._remark())

    def _remark(self) -> str:
        has_frames = self.written and self.path.exists()
        return "the frames recorded so far can be replayed" if has_frames else ""

    def _cut_to_last_flush(self) -> None:
        """Remove the incomplete chunk: the file is then read up to its last whole one."""
        self.written, self._is_cut = self._flushed_frames, True
        try:
            self._file.truncate(self._flushed_bytes)
        except OSError as error:
            _log.warning("%s: cannot be cut: %s", self.path, error.strerror)


class _UnbufferedStream:
    """Writes all or raises OSError; nothing stays in a buffer that a full disk could not take."""

    def __init__(self, file: FileIO) -> None:
        self._file = file
        self.tell, self.flush = file.tell, file.flush

    def write(self, data: Any) -> int:
        view = memoryview(data).cast("B")
        written = 0
        while written < len(view):
            written += self._file.write(view[written:])
        return written


def _encode(color_bgr: BgrImage, is_raw: bool) -> _Color:
    return color_bgr if is_raw else encode_image(color_bgr, ColorFormat.JPEG)
