"""The output that records frames with poses, transforms, timing and status into an MCAP file."""

import logging
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from drivers.bag.bag_writer import EncodedMessage
from drivers.bag.frame_writer import BASE_FRAME, NAMESPACE, WORLD_FRAME
from drivers.bag.mcap_recording_file import RESERVED_BYTES, McapRecordingFile
from drivers.camera import PlaybackMode
from drivers.core import UserFacingError
from drivers.core.bounded_trajectory import SampledPath
from drivers.core.files import check_suffix, rotate_file
from drivers.core.geometry import T_BODY_CAMERA, Array, Trajectory, inverse
from drivers.core.queues import BlockingQueue, BoundedQueue, DropOldestQueue
from drivers.core.write_errors import WriteError, check_disk_space, creating, is_disk_full
from drivers.recording.frame_recorder import FrameRecorder
from drivers.recording.odometry import OdometryRecord
from drivers.ros_messages.cdr import STRING_SCHEMA, encode_string
from drivers.ros_messages.navigation import (
    OCCUPANCY_GRID_SCHEMA,
    ODOMETRY_SCHEMA,
    TRANSFORMS_SCHEMA,
    TransformMessage,
    encode_transforms,
)
from drivers.ros_messages.sensors import (
    LASER_SCAN_SCHEMA,
    POINT_CLOUD_SCHEMA,
    LaserScanMessage,
    PointCloudMessage,
    encode_laser_scan,
    encode_point_cloud,
)
from vo_service.config_tables import MIN_FREE_BYTES, FrameIds
from vo_service.outputs.file_output import FileOutput
from vo_service.types.messages import (
    Status,
    encode_message,
    grid_payload,
    pose_attachment,
    pose_payload,
    pose_transforms,
    timing_payload,
)
from vo_service.types.occupancy_grid import NO_GRID
from vo_service.types.odometry_update import (
    OdometryUpdate,
    UpdateWithWheels,
    WheelMessageSource,
)
from vo_service.types.outputs import GroundTruthSource, no_ground_truth

logger = logging.getLogger(__name__)
McapRecorder = FrameRecorder[McapRecordingFile]

SUFFIX = ".mcap"
FRAME_IDS = FrameIds(base_frame_id=BASE_FRAME)
# A slow disk has a second besides, in the recorder.
MAX_QUEUED = 8
# A file that is begun has room for this: not many small ones on a disk that is nearly full.
MIN_FILE_BYTES = 100_000_000
PATH_COLOR_BGR = (40, 150, 255)
CLOSE_TIMEOUT_S, LOCKSTEP_CLOSE_TIMEOUT_S = 2.0, 25.0


# A status has the time at which the service gave it, CLOCK_MONOTONIC.
Item = UpdateWithWheels | tuple[Status, float]


def open_mcap_recording(
    path: Path,
    playback_mode: PlaybackMode,
    ground_truth: GroundTruthSource = no_ground_truth,
    wheel_messages: WheelMessageSource = tuple,
    T_base_camera: Array = T_BODY_CAMERA,
) -> "McapOutput":
    """Create the file. In realtime, an existing one is renamed to FILE-0001 and so on.

    In realtime, a disk that is full is a warning, and recording starts when there is space.

    Args:
        path: The file.
        playback_mode: Lockstep or realtime.
        ground_truth: See `McapOutput`.
        wheel_messages: See `McapOutput`.
        T_base_camera: 4x4 pose of the optical camera in the base, for the file.

    Raises:
        InputError: No file can have this name, or it exists in lockstep.
        WriteError: The file cannot be written.
    """
    check_suffix(path, [SUFFIX])
    if playback_mode is PlaybackMode.LOCKSTEP:
        create = partial(_create, path, RESERVED_BYTES, T_base_camera)
        lockstep_queue: BoundedQueue[Item] = BlockingQueue(2)
        return McapOutput(
            path,
            create,
            lockstep_queue,
            ground_truth,
            wheel_messages,
            LOCKSTEP_CLOSE_TIMEOUT_S,
        )
    queue: BoundedQueue[Item] = DropOldestQueue(MAX_QUEUED)
    create = partial(_create_next, path, T_base_camera)
    return McapOutput(path, create, queue, ground_truth, wheel_messages, can_retry=True)


def _create_next(path: Path, T_base_camera: Array) -> McapRecorder:
    """Rename an existing file to FILE-0001 and so on, if there is space for another one."""
    with creating(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        check_disk_space(path.parent, MIN_FREE_BYTES + MIN_FILE_BYTES)
        rotate_file(path, max_files=sys.maxsize)
    return _create(path, MIN_FREE_BYTES, T_base_camera)


def _create(path: Path, min_free_bytes: int, T_base_camera: Array) -> McapRecorder:
    file = McapRecordingFile(
        path,
        T_base_camera=T_base_camera,
        is_base_estimated=True,
        min_free_bytes=min_free_bytes,
    )
    return FrameRecorder(file)


class McapOutput(FileOutput[Item]):
    """Writes all messages of `docs/guide/bags.md` with published stamps, from a thread of its own.

    If writing fails, the file ends with its last whole part, and `close` raises the error.

    Args:
        path: The file.
        create: Creates it.
        queue: Frames for the thread; it blocks or drops if the disk is slow.
        ground_truth: Returns the ground truth; called after the first frame.
        wheel_messages: Returns the messages of the wheels since its last call.
        close_timeout_s: Longest wait for the thread at the end.
        can_retry: Whether to create another file when the disk works again.

    Raises:
        UserFacingError: The file cannot be created.
    """

    def __init__(
        self,
        path: Path,
        create: Callable[[], McapRecorder],
        queue: BoundedQueue[Item],
        ground_truth: GroundTruthSource,
        wheel_messages: WheelMessageSource = tuple,
        close_timeout_s: float = CLOSE_TIMEOUT_S,
        *,
        can_retry: bool = False,
    ) -> None:
        super().__init__(path, "recording", "frames", close_timeout_s)
        self._create, self._can_retry = create, can_retry
        self._ground_truth = ground_truth
        self._wheel_messages = wheel_messages
        self._grid = NO_GRID  # that was last written
        self._recorder: McapRecorder | None = None
        # The last published stamp, and the time on CLOCK_MONOTONIC when it came.
        self._last_stamp_s: tuple[float, float] | None = None
        self._trail = SampledPath()
        # The ground truth in odom, and the epoch in which that is so.
        self._T_odom_world: Array = np.eye(4)
        self._world_epoch: int | None = None
        try:
            self._recorder = create()
        except WriteError as error:
            if not (can_retry and is_disk_full(error)):
                raise
            self._fail(error)
        self._start("mcap", queue)

    def on_update(self, update: OdometryUpdate) -> None:
        """Queue a frame, its pose, and the messages of the wheels until then."""
        self._worker.put(UpdateWithWheels(update, self._wheel_messages()))

    def on_status(self, status: Status) -> None:
        """Queue a status."""
        self._worker.put((status, time.monotonic()))

    def _write(self, item: Item) -> None:
        if not self._fault.is_retry_due:
            return
        try:
            recorder = self._recorder or self._begin_next()
            if isinstance(item, UpdateWithWheels):
                self._write_update(recorder, item.update, item.wheel_messages)
            elif self._last_stamp_s is not None:  # else there is no time for it
                status, now_s = item
                last_stamp_s, received_s = self._last_stamp_s
                stamp_s = last_stamp_s + max(0.0, now_s - received_s)
                message = _string("/vo/status", stamp_s, encode_message(status))
                recorder.write_besides(partial(recorder.file.write_messages, [message]))
        except UserFacingError as error:
            self._fail(error)

    def _begin_next(self) -> McapRecorder:
        self._recorder = self._create()
        self._last_stamp_s, self._grid = None, NO_GRID
        self._fault.clear()
        logger.info("%s: recording again", self._path)
        return self._recorder

    def _write_update(
        self,
        recorder: McapRecorder,
        update: OdometryUpdate,
        wheel_messages: Sequence[OdometryRecord],
    ) -> None:
        messages = [
            _string("/vo/state", update.stamp_s, pose_attachment(update)),
            _string(f"{NAMESPACE}/timing", update.stamp_s, timing_payload(update)),
            _encoded("/vo/odom", ODOMETRY_SCHEMA, update.stamp_s, pose_payload(update, FRAME_IDS)),
        ]
        if self._last_stamp_s is None:
            recorder.ground_truth = self._published_ground_truth(update)
        messages += self._navigation_messages(update)
        transforms = pose_transforms(update, FRAME_IDS)
        if transforms:
            transforms += _scan_transforms(update)
            transforms += self._world_transforms(recorder, update)
            messages.append(_transforms("/tf", transforms))
            messages += self._path_messages(update)
        self._last_stamp_s = update.stamp_s, time.monotonic()
        write_messages = partial(recorder.file.write_messages, messages)
        frame = update.frame.restamped(update.stamp_s)
        recorder.write(frame, write_messages, wheel_messages)

    def _navigation_messages(self, update: OdometryUpdate) -> list[EncodedMessage]:
        """Make the scan, and the occupancy grid if it has changed."""
        messages = []
        scan = _scan_of(update)
        if scan is not None:
            data = encode_laser_scan(scan)
            messages.append(_encoded("/scan", LASER_SCAN_SCHEMA, update.stamp_s, data))
        if update.grid is not self._grid:
            self._grid = update.grid
            data = grid_payload(update, FRAME_IDS)
            messages.append(_encoded("/map", OCCUPANCY_GRID_SCHEMA, update.stamp_s, data))
        return messages

    def _path_messages(self, update: OdometryUpdate) -> list[EncodedMessage]:
        """Make the path to the pose, if it is due."""
        points = self._trail.add(update.stamp_s, update.T_odom_base[:3, 3], update.epoch)
        if points is None:
            return []
        colors = np.full((len(points), 3), PATH_COLOR_BGR, np.uint8)
        cloud = PointCloudMessage(update.stamp_s, FRAME_IDS.odom_frame_id, points, colors)
        data = encode_point_cloud(cloud)
        return [_encoded("/vo/path", POINT_CLOUD_SCHEMA, update.stamp_s, data)]

    def _world_transforms(
        self, recorder: McapRecorder, update: OdometryUpdate
    ) -> list[TransformMessage]:
        """Make odom->world, once the ground truth is known at a pose of the epoch."""
        truth = recorder.ground_truth
        if truth is not None and update.epoch != self._world_epoch:
            T_world_camera = truth.pose_near(update.stamp_s)
            if T_world_camera is not None:
                self._T_odom_world = update.T_odom_camera @ inverse(T_world_camera)
                self._world_epoch = update.epoch
        if update.epoch != self._world_epoch:
            return []
        return [
            TransformMessage(
                update.stamp_s, FRAME_IDS.odom_frame_id, WORLD_FRAME, self._T_odom_world
            )
        ]

    def _published_ground_truth(self, update: OdometryUpdate) -> Trajectory | None:
        """Return the ground truth with published stamps."""
        truth = self._ground_truth()
        if truth is None:
            return None
        return replace(truth, stamps_s=truth.stamps_s + (update.stamp_s - update.frame.stamp_s))

    def _finish(self) -> None:
        try:
            if self._recorder is not None:
                self._recorder.close()
        except UserFacingError as error:
            self._fail(error)

    def _fail(self, error: UserFacingError) -> None:
        """End the file. Only a disk may work again; each kind of fault is logged once."""
        if self._fault.set(error, can_retry=self._can_retry and isinstance(error, WriteError)):
            logger.warning("%s", self.warning)
        recorder, self._recorder = self._recorder, None
        with suppress(UserFacingError):
            if recorder is not None:
                recorder.close()


def _scan_of(update: OdometryUpdate) -> LaserScanMessage | None:
    """Return the scan, unless all of it is unknown."""
    return update.scan.message() if update.scan.is_above_floor else None


def _scan_transforms(update: OdometryUpdate) -> list[TransformMessage]:
    scan = _scan_of(update)
    if scan is None:
        return []
    frames = FRAME_IDS.base_frame_id, scan.frame_id
    return [TransformMessage(update.stamp_s, *frames, update.scan.T_base_scan)]


def _transforms(topic: str, transforms: list[TransformMessage]) -> EncodedMessage:
    data = encode_transforms(transforms)
    return _encoded(topic, TRANSFORMS_SCHEMA, float(transforms[0].stamp_s), data)


def _string(topic: str, stamp_s: float, text: bytes) -> EncodedMessage:
    return _encoded(topic, STRING_SCHEMA, stamp_s, encode_string(text.decode()))


def _encoded(topic: str, schema: str, stamp_s: float, data: bytes) -> EncodedMessage:
    return EncodedMessage(topic, schema, round(stamp_s * 1e9), data)
