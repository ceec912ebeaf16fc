"""Writing an incident by itself: where time runs out, and where there is nothing."""

import json
import logging
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.drivers.tum.replaying import replayed
from tests.vo_service.recorder.moments import update
from vo_service.recorder import incident as incident_module
from vo_service.recorder.depth_packing import pack_depth
from vo_service.recorder.desk import Desk
from vo_service.recorder.frame_record import put_frame
from vo_service.recorder.incident import Incident, last_frames
from vo_service.recorder.messages import Job, Word
from vo_service.recorder.shared_ring import Record, RingReader, RingWriter

FRAMES = 20


@pytest.fixture
def frames() -> Iterator[RingWriter]:
    """A ring of twenty frames."""
    writer = RingWriter("trial", 5.0, 1 << 22)
    for seq in range(FRAMES):
        put_frame(writer, update(seq), pack_depth)
    yield writer
    writer.close()


def test_the_oldest_frames_are_left_out_where_the_time_runs_out(
    tmp_path: Path, frames: RingWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader, now_s = RingReader(frames.memory), [100.0]
    clock = SimpleNamespace(monotonic=lambda: now_s[0], time=time.time)
    monkeypatch.setattr(incident_module, "time", clock)

    def slow(number: int) -> Record | None:
        now_s[0] += 0.05
        return reader.record(number)

    numbers = last_frames(reader, 5.0)
    incident = Incident("crash", numbers, slow, [], "{}")
    incident.hurry(now_s[0] + 0.5)
    incident(tmp_path)
    stamps_s = [found.stamp_s for found in replayed(tmp_path)]
    summary = json.loads((tmp_path / "incident.json").read_text())
    assert summary["frames"] + summary["frames_left_out_for_want_of_time"] == FRAMES
    assert 4 <= summary["frames"] < FRAMES
    assert stamps_s[-1] == pytest.approx(update(FRAMES - 1).stamp_s, abs=1e-6)
    assert stamps_s[0] == pytest.approx(update(0).stamp_s, abs=1e-6)


def test_frames_that_are_overwritten_meanwhile_are_counted(
    tmp_path: Path, frames: RingWriter
) -> None:
    reader = RingReader(frames.memory)
    Incident("command", range(FRAMES), lambda n: reader.record(n) if n > 2 else None, [], "{}")(
        tmp_path
    )
    assert json.loads((tmp_path / "incident.json").read_text())["frames_overwritten"] == 3
    assert len(replayed(tmp_path)) == FRAMES - 3


def test_a_service_that_crashed_before_its_first_frame_leaves_no_incident(tmp_path: Path) -> None:
    heard: list[Word] = []
    writer = RingWriter("trial", 1.0, 1 << 20)
    desk = Desk(
        Job(
            frames=writer.memory,
            statuses=writer.memory,
            seconds=5.0,
            incidents=tmp_path / "incidents",
            total_bytes=1 << 30,
            recordings=tmp_path / "recordings",
            about="{}",
            log_level=logging.WARNING,
        ),
        heard.append,
    )
    desk.rescue()
    assert heard == []
    assert list(tmp_path.iterdir()) == []
    writer.close()
