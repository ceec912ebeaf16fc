"""Writing an incident: the last frames as a TUM folder, with what the service said then."""

import json
import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import Any

from drivers.errors import UserFacingError
from drivers.trajectory import COLUMNS, pose_line
from drivers.tum.whole_files import write_whole
from drivers.tum.writer import TumWriter
from vo_service.recorder.frame_record import FrameNote, frame_of, note_of
from vo_service.recorder.shared_ring import Record, RingReader

SCHEMA = 1
# So many frames tell how long one takes.
_MEASURED = 4


def last_frames(ring: RingReader, seconds: float) -> range:
    """Numbers of the newest frames that make one recording: one camera, rising stamps."""
    begin = end = ring.count
    later: list[FrameNote] = []
    for number in range(end - 1, ring.oldest - 1, -1):
        note = ring.note(number)
        if note is None:
            break
        found = note_of(note)
        if later and not _leads_to(found, later[-1]):
            break
        if later and later[0].stamp_s - found.stamp_s > seconds:
            break
        later.append(found)
        begin = number
    return range(begin, end)


def _leads_to(earlier: FrameNote, later: FrameNote) -> bool:
    cameras = {(note.camera, note.depth_factor, note.readout_s) for note in (earlier, later)}
    return len(cameras) == 1 and earlier.stamp_s < later.stamp_s


class Incident:
    """Frames and statuses on their way to a folder; a `fill` for `IncidentFolder.write`.

    The newest frames matter most: where the time runs out, the oldest are left out.
    """

    def __init__(
        self,
        reason: str,
        numbers: Iterable[int],
        fetch: Callable[[int], Record | None],
        statuses: Sequence[bytes],
        about: str,
    ) -> None:
        """What to write.

        fetch     a frame's record by its number; None if it has been overwritten
        statuses  JSON lines
        about     JSON object about the service
        """
        self._reason, self._fetch = reason, fetch
        self._numbers = deque(numbers)
        self._statuses, self._about = statuses, about
        self._deadline_s = math.inf
        self._overwritten = self._left_out = 0
        self._notes: list[FrameNote] = []

    @property
    def frames(self) -> int:
        """How many have been written."""
        return len(self._notes)

    def hurry(self, deadline_s: float) -> None:
        """Have the last frame written by then, on CLOCK_MONOTONIC."""
        self._deadline_s = min(self._deadline_s, deadline_s)

    def __call__(self, folder: Path) -> None:
        """Write everything. Raises OSError or UserFacingError if the disk refuses."""
        records = self._records()
        first = next(records, None)
        if first is None:
            raise UserFacingError("there was no time to write a single frame")
        offset_s = note_of(first.note).offset_s
        with TumWriter(folder) as writer:
            for record in chain([first], records):
                writer.write(frame_of(record, offset_s))
                self._notes.append(note_of(record.note))
        poses = (n for n in self._notes if n.said.has_pose)
        lines = [pose_line(n.stamp_s + offset_s, n.said.T_world_camera) for n in poses]
        write_whole(folder / "trajectory.txt", "".join([f"# {COLUMNS}\n", *lines]).encode())
        write_whole(folder / "poses.jsonl", b"".join(_said_line(n, offset_s) for n in self._notes))
        write_whole(folder / "status.jsonl", b"".join(line + b"\n" for line in self._statuses))
        write_whole(folder / "incident.json", json.dumps(self._summary(), indent=1).encode())

    def _records(self) -> Iterator[Record]:
        begin_s, done = time.monotonic(), 0
        while self._numbers:
            now_s = time.monotonic()
            each_s = (now_s - begin_s) / done if done >= _MEASURED else 0.0
            while self._numbers and now_s + each_s * len(self._numbers) > self._deadline_s:
                self._numbers.popleft()
                self._left_out += 1
            if self._numbers:
                record = self._fetch(self._numbers.popleft())
                if record is None:
                    self._overwritten += 1
                else:
                    yield record
            done += 1

    def _summary(self) -> dict[str, Any]:
        now_s = time.time()
        first, last = self._notes[0], self._notes[-1]
        return {
            "schema": SCHEMA,
            "reason": self._reason,
            "written": datetime.fromtimestamp(now_s, UTC).isoformat(),
            "written_unix_s": now_s,
            "frames": self.frames,
            "frames_left_out_for_want_of_time": self._left_out,
            "frames_overwritten": self._overwritten,
            "first_stamp_s": first.stamp_s + first.offset_s,
            "last_stamp_s": last.stamp_s + first.offset_s,
            "stamp_minus_camera_stamp_s": first.offset_s,
            "about": json.loads(self._about),
        }


def _said_line(note: FrameNote, offset_s: float) -> bytes:
    said = note.said
    content = {
        "stamp_s": note.stamp_s + offset_s,
        "camera_stamp_s": note.stamp_s,
        "published_stamp_s": said.stamp_s,
        "seq": said.seq,
        "state": said.state,
        "reason": said.reason,
        "epoch": said.epoch,
        "has_pose": said.has_pose,
        "inliers": said.inliers,
        "T_world_camera": said.T_world_camera.tolist(),
    }
    return json.dumps(content).encode() + b"\n"
