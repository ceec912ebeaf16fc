"""The incident writer with a deadline and without frames."""

import json
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from drivers.core.process.record_ring import RecordRingReader, RecordRingWriter, RingRecord
from tests.drivers.tum.read_recording import read_recording
from tests.vo_service.outputs.recorder.recorder_inputs import make_update
from vo_service.frame_packing import write_frame
from vo_service.outputs.recorder import incidents as incident_module
from vo_service.outputs.recorder.incidents import IncidentWriter, select_last_frames
from vo_service.outputs.recorder.messages import RecorderMessage, RecorderWorkerConfig
from vo_service.outputs.recorder.worker import RecorderWorker

FRAMES = 20


@pytest.fixture
def frames() -> Iterator[RecordRingWriter]:
    """A ring of twenty frames."""
    writer = RecordRingWriter("trial", 5.0, 1 << 22)
    for seq in range(FRAMES):
        write_frame(writer, make_update(seq))
    yield writer
    writer.close()


def test_the_oldest_frames_are_omitted_if_time_runs_out(
    tmp_path: Path, frames: RecordRingWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader, now_s = RecordRingReader(frames.memory), [100.0]
    clock = SimpleNamespace(monotonic=lambda: now_s[0], time=time.time)
    monkeypatch.setattr(incident_module, "time", clock)

    def slow(number: int) -> RingRecord | None:
        now_s[0] += 0.05
        return reader.read_record(number)

    numbers = select_last_frames(reader, 5.0)
    incident = IncidentWriter("crash", numbers, slow, [], "{}")
    incident.set_deadline(now_s[0] + 0.5)
    incident(tmp_path)
    stamps_s = [found.stamp_s for found in read_recording(tmp_path)]
    summary = json.loads((tmp_path / "incident.json").read_text())
    assert summary["frames"] + summary["frames_left_out_for_want_of_time"] == FRAMES
    assert 4 <= summary["frames"] < FRAMES
    assert stamps_s[-1] == pytest.approx(make_update(FRAMES - 1).stamp_s, abs=1e-6)
    assert stamps_s[0] == pytest.approx(make_update(0).stamp_s, abs=1e-6)


def test_overwritten_frames_are_counted(tmp_path: Path, frames: RecordRingWriter) -> None:
    reader = RecordRingReader(frames.memory)
    IncidentWriter(
        "command", range(FRAMES), lambda n: reader.read_record(n) if n > 2 else None, [], "{}"
    )(tmp_path)
    assert json.loads((tmp_path / "incident.json").read_text())["frames_overwritten"] == 3
    assert len(read_recording(tmp_path)) == FRAMES - 3


def test_a_crash_before_the_first_frame_leaves_no_incident(tmp_path: Path) -> None:
    messages: list[RecorderMessage] = []
    writer = RecordRingWriter("trial", 1.0, 1 << 20)
    worker = RecorderWorker(
        RecorderWorkerConfig(
            frame_ring=writer.memory,
            status_ring=writer.memory,
            incident_duration_s=5.0,
            incidents_folder=tmp_path / "incidents",
            max_incident_bytes=1 << 30,
            recordings_folder=tmp_path / "recordings",
            service_info="{}",
        ),
        messages.append,
    )
    worker.dump_after_crash()
    assert messages == []
    assert list(tmp_path.iterdir()) == []
    writer.close()
