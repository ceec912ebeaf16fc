"""Incidents: folders with the last frames, poses and statuses, below a disk quota."""

import json
import math
import re
import shutil
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import Any

from drivers.core import UserFacingError
from drivers.core.files import (
    PARTIAL_SUFFIX,
    atomic_write,
    folder_size_bytes,
    partial_folder,
    remove_partial_folders,
)
from drivers.core.geometry import COLUMNS, format_pose_line
from drivers.core.process.record_ring import RecordRingReader, RingRecord
from drivers.core.write_errors import writing
from drivers.recording.frame_recorder import FrameRecorder
from drivers.tum.writer import TumFolder
from vo_service.frame_record import FrameMetadata, decode_frame, decode_metadata

SCHEMA = 1
# The time per frame is estimated once this many frames are written.
_MIN_TIMED_FRAMES = 4


def select_last_frames(ring: RecordRingReader, seconds: float) -> range:
    """Select the newest frames of the ring that have one camera and rising stamps.

    Args:
        ring: Ring of frames.
        seconds: Longest time from the first to the last frame.

    Returns:
        Their record numbers.
    """
    begin = end = ring.record_count
    later: list[FrameMetadata] = []
    for number in range(end - 1, ring.oldest_number - 1, -1):
        encoded = ring.read_metadata(number)
        if encoded is None:
            break
        metadata = decode_metadata(encoded)
        if later and not _is_continuous(metadata, later[-1]):
            break
        if later and later[0].stamp_s - metadata.stamp_s > seconds:
            break
        later.append(metadata)
        begin = number
    return range(begin, end)


def _is_continuous(earlier: FrameMetadata, later: FrameMetadata) -> bool:
    cameras = {(frame.camera, frame.depth_factor, frame.readout_s) for frame in (earlier, later)}
    return len(cameras) == 1 and earlier.stamp_s < later.stamp_s


class IncidentWriter:
    """Writes frames and statuses into a folder; called by `IncidentStore.write`.

    If the time runs out, the oldest frames are skipped: the newest matter most.
    """

    def __init__(
        self,
        reason: str,
        numbers: Iterable[int],
        read_record: Callable[[int], RingRecord | None],
        statuses: Sequence[bytes],
        service_info: str,
    ) -> None:
        """Take what to write.

        Args:
            reason: Why the incident is written.
            numbers: Record numbers of the frames.
            read_record: Returns a frame's record by its number; None if it is overwritten.
            statuses: JSON lines.
            service_info: JSON object about the service.
        """
        self._reason, self._read_record = reason, read_record
        self._numbers = deque(numbers)
        self._statuses, self._service_info = statuses, service_info
        self._deadline_s = math.inf
        self._overwritten = self._skipped = 0
        self._written: list[FrameMetadata] = []

    @property
    def frame_count(self) -> int:
        """Number of frames written."""
        return len(self._written)

    def set_deadline(self, deadline_s: float) -> None:
        """Set when the last frame must be written, on CLOCK_MONOTONIC."""
        self._deadline_s = min(self._deadline_s, deadline_s)

    def __call__(self, folder: Path) -> None:
        """Write everything. Raises OSError or UserFacingError if the disk fails."""
        records = self._iterate_records()
        first = next(records, None)
        if first is None:
            raise UserFacingError("no time was left to write a frame of the incident")
        offset_s = decode_metadata(first.metadata).clock_offset_s
        with FrameRecorder(TumFolder(folder)) as writer:
            for record in chain([first], records):
                metadata = decode_metadata(record.metadata)
                writer.write(decode_frame(record, offset_s), odometry=metadata.odometry)
                self._written.append(metadata)
        poses = (n for n in self._written if n.published.has_pose)
        lines = [format_pose_line(n.stamp_s + offset_s, n.published.T_world_camera) for n in poses]
        atomic_write(folder / "trajectory.txt", "".join([f"# {COLUMNS}\n", *lines]).encode())
        atomic_write(
            folder / "poses.jsonl", b"".join(_pose_json_line(n, offset_s) for n in self._written)
        )
        atomic_write(folder / "status.jsonl", b"".join(line + b"\n" for line in self._statuses))
        atomic_write(folder / "incident.json", json.dumps(self._summary(), indent=1).encode())

    def _iterate_records(self) -> Iterator[RingRecord]:
        begin_s, done = time.monotonic(), 0
        while self._numbers:
            now_s = time.monotonic()
            frame_time_s = (now_s - begin_s) / done if done >= _MIN_TIMED_FRAMES else 0.0
            while self._numbers and now_s + frame_time_s * len(self._numbers) > self._deadline_s:
                self._numbers.popleft()
                self._skipped += 1
            if self._numbers:
                record = self._read_record(self._numbers.popleft())
                if record is None:
                    self._overwritten += 1
                else:
                    yield record
            done += 1

    def _summary(self) -> dict[str, Any]:
        now_s = time.time()
        first, last = self._written[0], self._written[-1]
        return {
            "schema": SCHEMA,
            "reason": self._reason,
            "written": datetime.fromtimestamp(now_s, UTC).isoformat(),
            "written_unix_s": now_s,
            "frames": self.frame_count,
            "frames_left_out_for_want_of_time": self._skipped,
            "frames_overwritten": self._overwritten,
            "first_stamp_s": first.stamp_s + first.clock_offset_s,
            "last_stamp_s": last.stamp_s + first.clock_offset_s,
            "stamp_minus_camera_stamp_s": first.clock_offset_s,
            "about": json.loads(self._service_info),
        }


def _pose_json_line(frame: FrameMetadata, offset_s: float) -> bytes:
    published = frame.published
    content = {
        "stamp_s": frame.stamp_s + offset_s,
        "camera_stamp_s": frame.stamp_s,
        "published_stamp_s": published.stamp_s,
        "seq": published.seq,
        "state": published.state,
        "reason": published.reason,
        "epoch": published.epoch,
        "has_pose": published.has_pose,
        "inliers": published.inliers,
        "T_world_camera": published.T_world_camera.tolist(),
    }
    return json.dumps(content).encode() + b"\n"


_NAME = re.compile(r"\d{4}-\d\d-\d\dT\d\d-\d\d-\d\dZ-[a-z0-9-]+")


class IncidentStore:
    """Folder of incidents with a disk quota.

    Only folders with an incident's name are deleted, as the user may choose any folder. An incident
    is locked while it is written, so that another service, or a restarted one, does not delete it.
    """

    def __init__(self, folder: Path, max_total_bytes: int) -> None:
        self.folder = folder
        self.max_total_bytes = max_total_bytes

    def clean_up(self) -> None:
        """Remove partial incidents of earlier recorders, and old ones over the quota.

        Raises:
            OSError: The folder is not usable.
        """
        remove_partial_folders(self._incidents(PARTIAL_SUFFIX))
        self._make_room(0)

    def _make_room(self, expected_bytes: int) -> None:
        """Delete the oldest incidents until this many more bytes fit into the quota."""
        incidents = sorted(self._incidents(""))
        sizes = {incident: folder_size_bytes(incident) for incident in incidents}
        excess = sum(sizes.values()) + expected_bytes - self.max_total_bytes
        for oldest in incidents:
            if excess <= 0:
                return
            shutil.rmtree(oldest, ignore_errors=True)
            excess -= sizes[oldest] - folder_size_bytes(oldest)

    def write(self, name: str, write_content: Callable[[Path], None]) -> Path:
        """Write an incident into a partial folder, then rename it.

        The oldest incidents are deleted to make room.

        Args:
            name: The incident's name; a number is added if it exists.
            write_content: Fills the empty folder that it is given.

        Returns:
            The incident's folder.

        Raises:
            UserFacingError: The disk or `write_content` failed; nothing is left.
        """
        with writing(self.folder):
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            final = self._free_name(name)
            with partial_folder(final) as part:
                write_content(part)
                self._make_room(folder_size_bytes(part))
                part.rename(final)
        return final

    def _free_name(self, name: str) -> Path:
        """Return `name`, with a number if an incident of the same second exists."""
        final, number = self.folder / name, 2
        while final.exists() or final.with_name(final.name + PARTIAL_SUFFIX).exists():
            final, number = self.folder / f"{name}-{number}", number + 1
        return final

    def _incidents(self, suffix: str) -> list[Path]:
        if not self.folder.is_dir():
            return []
        return [
            path
            for path in self.folder.iterdir()
            if path.name.endswith(suffix)
            and _NAME.fullmatch(path.name.removesuffix(suffix))
            and path.is_dir()
            and not path.is_symlink()
        ]
