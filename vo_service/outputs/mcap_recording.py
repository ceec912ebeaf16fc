"""The output that records frames with poses, transforms, timing and status into an MCAP file."""

import logging
import sys
import time
from dataclasses import replace
from pathlib import Path

from drivers.bag.bag_writer import CAMERA_FRAME, NAMESPACE, EncodedMessage
from drivers.bag.mcap_recorder import McapRecorder
from drivers.camera import PlaybackMode
from drivers.core import InputError, UserFacingError
from drivers.core.files import rotate_file
from drivers.core.flow_control import BlockingQueue, BoundedQueue, DropOldestQueue, WorkerThread
from drivers.core.geometry import Trajectory, inverse
from vo_service.config_tables import MIN_FREE_BYTES
from vo_service.ros_messages import (
    ODOMETRY_SCHEMA,
    STRING_SCHEMA,
    TRANSFORMS_SCHEMA,
    TransformMessage,
    encode_string,
    encode_transforms,
)
from vo_service.types import OdometryUpdate
from vo_service.types.messages import (
    FrameIds,
    Status,
    encode_message,
    pose_attachment,
    pose_payload,
    pose_transforms,
    timing_payload,
)
from vo_service.types.outputs import GroundTruthSource, no_ground_truth

logger = logging.getLogger(__name__)

SUFFIX = ".mcap"
FRAME_IDS = FrameIds("odom", "base_link", "map")
# A slow disk has a second besides, in the recorder.
MAX_QUEUED = 8
CLOSE_TIMEOUT_S, LOCKSTEP_CLOSE_TIMEOUT_S = 2.0, 25.0
# A status with the time at which the service gave it, CLOCK_MONOTONIC.
Item = OdometryUpdate | tuple[Status, float]


def open_mcap_recording(
    path: Path, playback_mode: PlaybackMode, ground_truth: GroundTruthSource = no_ground_truth
) -> "McapOutput":
    """Create the file. In realtime, an existing one is renamed to FILE-0001 and so on.

    Raises:
        InputError: It cannot be created, or exists in lockstep.
    """
    if path.suffix.lower() != SUFFIX:
        raise InputError(f"{path}: is no MCAP file; name a file that ends in {SUFFIX}")
    is_lockstep = playback_mode is PlaybackMode.LOCKSTEP
    if not is_lockstep and path.is_file():
        try:
            rotate_file(path, max_files=sys.maxsize)
        except OSError as error:
            raise InputError(
                f"{path}: cannot be renamed: {error.strerror}; name another file"
            ) from error
    if is_lockstep:
        recorder = McapRecorder(path)
        return McapOutput(recorder, BlockingQueue(2), LOCKSTEP_CLOSE_TIMEOUT_S, ground_truth)
    recorder = McapRecorder(path, min_free_bytes=MIN_FREE_BYTES)
    return McapOutput(recorder, DropOldestQueue(MAX_QUEUED), CLOSE_TIMEOUT_S, ground_truth)


class McapOutput:
    """Writes all messages of `docs/guide/bags.md` with published stamps, from a thread of its own.

    If writing fails, the file ends with its last whole part, and `close` raises the error.

    Args:
        recorder: Writes the file.
        queue: Frames for the thread; it blocks or drops if the disk is slow.
        close_timeout_s: Longest wait for the thread at the end.
        ground_truth: Returns the ground truth; called after the first frame.
    """

    def __init__(
        self,
        recorder: McapRecorder,
        queue: BoundedQueue[Item],
        close_timeout_s: float,
        ground_truth: GroundTruthSource,
    ) -> None:
        self._recorder, self._path = recorder, recorder.path
        self._close_timeout_s = close_timeout_s
        self._ground_truth = ground_truth
        self._error: UserFacingError | None = None
        # The last published stamp, and the time on CLOCK_MONOTONIC when it came.
        self._last_stamp_s: tuple[float, float] | None = None
        self._worker: WorkerThread[Item] = WorkerThread("mcap", queue, self._write, self._finish)

    @property
    def warning(self) -> str:
        """Why the file is incomplete; "" while it is complete."""
        if self._error is not None:
            return str(self._error)
        if self._worker.dropped:
            return f"{self._path}: the disk is too slow; frames are missing"
        return ""

    def on_update(self, update: OdometryUpdate) -> None:
        """Queue a frame and its pose."""
        self._worker.put(update)

    def on_status(self, status: Status) -> None:
        """Queue a status."""
        self._worker.put((status, time.monotonic()))

    def close(self) -> None:
        """Complete the file. Raises UserFacingError, once, if it is incomplete."""
        has_ended = self._worker.close(self._close_timeout_s)
        error, self._error = self._error, None
        if error is not None:
            raise UserFacingError(f"{self._path}: the recording is incomplete") from error
        if not has_ended:
            raise UserFacingError(f"{self._path}: the disk hangs; the end of the recording is lost")

    def _write(self, item: Item) -> None:
        if self._error is not None:
            return
        try:
            if isinstance(item, OdometryUpdate):
                self._write_update(item)
            elif self._last_stamp_s is not None:  # else there is no time for it
                self._write_status(*item, *self._last_stamp_s)
        except UserFacingError as error:
            self._fail(error)

    def _write_update(self, update: OdometryUpdate) -> None:
        messages = [
            _string("/vo/state", update.stamp_s, pose_attachment(update)),
            _string(f"{NAMESPACE}/timing", update.stamp_s, timing_payload(update)),
            _encoded("/vo/odom", ODOMETRY_SCHEMA, update.stamp_s, pose_payload(update, FRAME_IDS)),
        ]
        if self._last_stamp_s is None:
            messages.append(_transforms("/tf_static", [_camera_transform(update)]))
            self._recorder.ground_truth = self._published_ground_truth(update)
        transforms = pose_transforms(update, FRAME_IDS)
        if transforms:
            messages.append(_transforms("/tf", transforms))
        self._last_stamp_s = update.stamp_s, time.monotonic()
        self._recorder.write(update.frame.restamped(update.stamp_s), messages)

    def _published_ground_truth(self, update: OdometryUpdate) -> Trajectory | None:
        """Return the ground truth with published stamps."""
        truth = self._ground_truth()
        if truth is None:
            return None
        return replace(truth, stamps_s=truth.stamps_s + (update.stamp_s - update.frame.stamp_s))

    def _write_status(
        self, status: Status, now_s: float, last_stamp_s: float, received_s: float
    ) -> None:
        stamp_s = last_stamp_s + max(0.0, now_s - received_s)
        self._recorder.write_message(_string("/vo/status", stamp_s, encode_message(status)))

    def _finish(self) -> None:
        try:
            self._recorder.close()
        except UserFacingError as error:
            self._fail(error)
        if not self._recorder.written:
            self._path.unlink(missing_ok=True)

    def _fail(self, error: UserFacingError) -> None:
        if self._error is None:
            logger.error("%s", error)
            self._error = error


def _camera_transform(update: OdometryUpdate) -> TransformMessage:
    T_base_camera = inverse(update.T_odom_base) @ update.T_odom_camera
    return TransformMessage(update.stamp_s, FRAME_IDS.child_frame_id, CAMERA_FRAME, T_base_camera)


def _transforms(topic: str, transforms: list[TransformMessage]) -> EncodedMessage:
    data = encode_transforms(transforms)
    return _encoded(topic, TRANSFORMS_SCHEMA, transforms[0].stamp_s, data)


def _string(topic: str, stamp_s: float, text: bytes) -> EncodedMessage:
    return _encoded(topic, STRING_SCHEMA, stamp_s, encode_string(text.decode()))


def _encoded(topic: str, schema: str, stamp_s: float, data: bytes) -> EncodedMessage:
    return EncodedMessage(topic, schema, round(stamp_s * 1e9), data)
