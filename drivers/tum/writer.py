"""Recording any camera into a TUM folder that replays as the same frames, bit for bit."""

import logging
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Self

from drivers.camera import RgbdFrame
from drivers.camera_file import FILE_NAME, NO_DISTORTION, CameraFile, camera_file_text
from drivers.errors import InputError, UserFacingError
from drivers.full_disk import is_full
from drivers.trajectory import StampedPoses, pose_line
from drivers.tum.accelerometer import AccelerometerList
from drivers.tum.encode import (
    BEFORE_ALL,
    ColourFormat,
    EncodedFrame,
    FrameStamps,
    encode,
    exact,
    microseconds,
)
from drivers.tum.whole_files import GrowingList, write_whole

ENCODERS = 2
MOST_PENDING = 4
_log = logging.getLogger(__name__)


class TumWriter:
    """Writes ``rgb/``, ``depth/``, their lists, the camera file, gravity and the ground truth.

    Images are encoded on threads and written on the caller's, in order; memory stays bounded. A
    frame is listed once both its images are in place, so the folder can be replayed whenever the
    process is killed. A frame whose stamp does not come after the one before, to the microsecond,
    has no place in a recording: it is left out, counted and reported in the log.
    """

    def __init__(
        self,
        folder: Path,
        *,
        ground_truth: StampedPoses | None = None,
        colour: ColourFormat = ColourFormat.PNG,
    ) -> None:
        """Create the folder. Raises InputError if it cannot be created or is not empty."""
        self.folder = folder
        self.written = self.skipped = 0
        self._format = colour
        self._cameras: list[CameraFile] = []
        self._last = BEFORE_ALL
        self._failure: UserFacingError | None = None
        self._lists = _create(folder, ground_truth)
        self._accelerometer = AccelerometerList(folder)
        self._pending: deque[Future[EncodedFrame]] = deque()
        self._pool = ThreadPoolExecutor(ENCODERS, thread_name_prefix="tum-encode")

    def write(self, frame: RgbdFrame) -> None:
        """Add a frame; it may reach the disk a few frames later.

        Raises UserFacingError if the disk is full or refuses (what was written stays whole), or
        if the camera is not the one that the recording began with.
        """
        if self._failure:
            raise self._failure
        stamps = FrameStamps.of(frame)
        if not stamps.follow(self._last):
            self.skipped += 1
            _log.warning("frame %d is not recorded: its stamp does not rise", frame.seq)
            return
        self._write_camera(frame)
        self._last = stamps
        self._pending.append(self._pool.submit(encode, frame, stamps, self._format))
        while len(self._pending) > MOST_PENDING or (self._pending and self._pending[0].done()):
            self._commit(self._pending.popleft().result())

    def close(self) -> None:
        """Write what is pending. Safe to call twice. Raises as `write`, but not what it raised."""
        try:
            while self._pending and not self._failure:
                self._commit(self._pending.popleft().result())
        finally:
            self._pending.clear()
            self._pool.shutdown()
            self._accelerometer.close()
            while self._lists:
                self._lists.pop().close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _write_camera(self, frame: RgbdFrame) -> None:
        """Write the camera file with the first frame; from then on the camera must stay."""
        found = _camera_file(frame)
        if not self._cameras:
            self._store([(self.folder / FILE_NAME, camera_file_text(found).encode())])
            self._cameras.append(found)
        if found != self._cameras[0]:
            raise UserFacingError(
                f"{self.folder}: the camera changed while it was recorded (now {frame.camera}, "
                f"depth factor {frame.depth_factor}, readout {frame.readout_s} s); record it into "
                "another folder"
            )

    def _commit(self, frame: EncodedFrame) -> None:
        stamps = frame.stamps
        colour_file = f"rgb/{microseconds(stamps.colour):f}.{self._format}"
        depth_file = f"depth/{microseconds(stamps.depth):f}.png"
        self._store(
            [(self.folder / colour_file, frame.colour), (self.folder / depth_file, frame.depth)]
        )
        colour_line = f"{exact(stamps.colour)} {colour_file}"
        depth_line = f"{exact(stamps.depth)} {depth_file}"
        lines = (colour_line, depth_line, f"{colour_line} {depth_line}")
        try:
            self._accelerometer.add(exact(stamps.colour), frame.gravity_m_s2)
            for growing, line in zip(self._lists, lines, strict=True):
                growing.append(line)
        except OSError as error:
            raise self._fail(error) from error
        self.written += 1

    def _store(self, files: Sequence[tuple[Path, bytes]]) -> None:
        """Write all of them or none."""
        try:
            for path, data in files:
                write_whole(path, data)
        except OSError as error:
            for path, _ in files:
                path.unlink(missing_ok=True)
            raise self._fail(error) from error

    def _fail(self, error: OSError) -> UserFacingError:
        full = is_full(error)
        cause = "the disk is full" if full else f"cannot be written: {error.strerror}"
        self._failure = UserFacingError(
            f"{self.folder}: {cause}; the {self.written} frames recorded so far are complete; "
            f"{'free some space' if full else 'see to the disk'} and record into a new folder"
        )
        return self._failure


def _create(folder: Path, ground_truth: StampedPoses | None) -> list[GrowingList]:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise InputError(f"{folder}: is not empty; name a new folder for the recording")
        (folder / "rgb").mkdir()
        (folder / "depth").mkdir()
        if ground_truth is not None:
            poses = zip(ground_truth.stamps_s, ground_truth.T_world_camera, strict=True)
            text = "# timestamp tx ty tz qx qy qz qw\n" + "".join(pose_line(*p) for p in poses)
            write_whole(folder / "groundtruth.txt", text.encode())
        return [
            GrowingList(folder / "rgb.txt", "timestamp filename"),
            GrowingList(folder / "depth.txt", "timestamp filename"),
            GrowingList(folder / "associations.txt", "timestamp rgb timestamp depth"),
        ]
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be written: {error.strerror}; name a folder that you may write to"
        ) from error


def _camera_file(frame: RgbdFrame) -> CameraFile:
    """The camera of a frame, which is undistorted already.

    Its stamps are written with the whole skew, so depth is where they say: no offset is left.
    """
    c, timing = frame.camera, (frame.readout_s, 0.0)
    intrinsics = (c.width, c.height, c.fx, c.fy, c.cx, c.cy)
    return CameraFile(*intrinsics, NO_DISTORTION, frame.depth_factor, *timing)
