"""Cost of the flight recorder: CPU time per frame in both processes, memory, and an incident.

    python -m benchmarks recorder_cost [--folder RECORDING] [--seconds 15] [--rate 30] [--json]

Frames from memory are sent to it at a camera's rate: 640x480 with noise in color and depth, or
those of a recording in TUM format. `service` is the process of the service, which does nothing
else; `worker` is the recorder's process. There are three phases: it only buffers; it also records;
it writes an incident at the beginning. Memory is without the ring, which both processes share.
"""

import argparse
import re
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count, islice
from pathlib import Path

import cv2
import numpy as np

from benchmarks.harness import add_json_option, format_table, make_printer, print_json
from benchmarks.tracking import read_all_frames
from drivers.camera import PinholeCamera, RgbdFrame
from drivers.recording_camera import RecordingCamera
from vo_service.config_tables import RecorderConfig
from vo_service.outputs.recorder import FlightRecorder
from vo_service.types import Estimate, OdometryUpdate, TrackingState
from vo_service.types.commands import CommandError

SOURCE_IMAGES = 60
CPU_TICK_S = 0.01  # tick of /proc/PID/stat


@dataclass(frozen=True)
class RecorderCost:
    """CPU milliseconds per frame, missed frames, and resident megabytes at the end of a phase.

    `ring_mb` is shared by both processes; the other two do not include it.
    """

    name: str
    service_ms: float
    worker_ms: float
    missed: int
    service_mb: float
    worker_mb: float
    ring_mb: float


class FramePlayer:
    """Sends frames to a recorder at a rate, and measures."""

    def __init__(self, recorder: FlightRecorder, frames: Sequence[RgbdFrame], rate: float) -> None:
        self._recorder, self._rate = recorder, rate
        (self._there,) = _children()
        self._frames = (
            replace(frames[seq % len(frames)], seq=seq, stamp_s=1e6 + seq / rate) for seq in count()
        )

    def play(self, name: str, seconds: float) -> RecorderCost:
        """Measure a phase."""
        missed, here_s, there_s = self._recorder.dropped, time.process_time(), self._worker_cpu_s()
        frames = int(seconds * self._rate)
        due_s = time.monotonic()
        for frame in islice(self._frames, frames):
            time.sleep(max(0.0, due_s - time.monotonic()))
            due_s += 1.0 / self._rate
            self._recorder.on_update(_make_update(frame))
        return RecorderCost(
            name,
            service_ms=(time.process_time() - here_s) / frames * 1e3,
            worker_ms=(self._worker_cpu_s() - there_s) / frames * 1e3,
            missed=self._recorder.dropped - missed,
            service_mb=_private_memory_mb("self"),
            worker_mb=_private_memory_mb(str(self._there)),
            ring_mb=_resident_mb("self", "RssShmem"),
        )

    def _worker_cpu_s(self) -> float:
        fields = Path(f"/proc/{self._there}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) * CPU_TICK_S


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--folder", type=Path, help="recording whose frames are used")
    parser.add_argument("--seconds", type=float, default=15.0, help="duration of each phase")
    parser.add_argument("--rate", type=float, default=30.0, help="frames per second")
    add_json_option(parser)


def main(args: argparse.Namespace) -> None:
    """Measure and print."""
    frames = _load_frames(args.folder) if args.folder else [_make_frame(seq) for seq in range(8)]
    with tempfile.TemporaryDirectory() as state:
        phases, incident_s, incident_mb = _measure(Path(state), frames, args.seconds, args.rate)
    headings = ("service ms", "worker ms", "missed", "MB service", "MB worker", "MB ring")
    rows = {
        phase.name: (
            f"{phase.service_ms:.2f}", f"{phase.worker_ms:.2f}", f"{phase.missed}",
            f"{phase.service_mb:.0f}", f"{phase.worker_mb:.0f}", f"{phase.ring_mb:.0f}",
        )
        for phase in phases
    }  # fmt: skip
    print_line = make_printer(args)
    print_line(f"per frame\n{format_table(headings, rows)}")
    print_line(f"an incident took {incident_s:.1f} s and {incident_mb:.0f} MB of disk")
    print_json(args, {"spells": phases, "incident_s": incident_s, "mb": incident_mb})


def _measure(
    state: Path, frames: Sequence[RgbdFrame], seconds: float, rate: float
) -> tuple[list[RecorderCost], float, float]:
    """Return the phases, the seconds of an incident, and its megabytes."""
    recorder = FlightRecorder(RecorderConfig(), state, {})
    try:
        while not recorder.is_ready:
            time.sleep(0.1)
        player = FramePlayer(recorder, frames, rate)
        player.play("filling", 6.0)
        phases = [player.play("remembering", seconds)]
        recorder.start_recording("trial")
        phases.append(player.play("recording", seconds))
        recorder.stop_recording()
        begin_s = time.monotonic()
        folder = Path(_save_incident(recorder))
        phases.append(player.play("with an incident", seconds))
        incident_s = folder.stat().st_ctime - (time.time() - (time.monotonic() - begin_s))
        size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    finally:
        recorder.close()
    return phases, incident_s, size / 1e6


def _save_incident(recorder: FlightRecorder) -> str:
    while True:
        try:
            return recorder.save("benchmark")
        except CommandError:
            time.sleep(0.1)


def _load_frames(folder: Path) -> list[RgbdFrame]:
    """The first frames of a recording."""
    with RecordingCamera(folder) as camera:
        return list(islice(read_all_frames(camera), SOURCE_IMAGES))


def _make_frame(seq: int) -> RgbdFrame:
    """Make a slanted wall of blobs, with a Kinect's noise in both images."""
    random = np.random.default_rng(seq)
    blobs = cv2.resize(random.integers(0, 255, (48, 64, 3), np.uint8), (640, 480))
    color = np.clip(blobs + random.normal(0.0, 2.0, blobs.shape), 0, 255).astype(np.uint8)
    wall_mm = np.linspace(1500.0, 3500.0, 640) + random.normal(0.0, 8.0, (480, 640))
    depth = wall_mm.astype(np.uint16)
    depth[random.random(depth.shape) < 0.05] = 0
    camera = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)
    return RgbdFrame(seq, 0.0, 0.0, color, depth, 1000.0, camera)


def _make_update(frame: RgbdFrame) -> OdometryUpdate:
    nowhere, unsure = np.eye(4), np.eye(6)
    return OdometryUpdate(
        seq=frame.seq,
        stamp_s=frame.stamp_s,
        state=TrackingState.TRACKING,
        reason="",
        epoch=1,
        T_world_camera=nowhere,
        T_odom_base=nowhere,
        T_odom_camera=nowhere,
        pose_covariance=unsure,
        twist=np.zeros(6),
        twist_covariance=unsure,
        frame=frame,
        estimate=Estimate(True, "", nowhere, nowhere, unsure),
        stage_ms={},
        latency_s=0.0,
    )


def _children() -> list[int]:
    lists = Path("/proc/self/task").glob("*/children")
    return [int(number) for each in lists for number in each.read_text().split()]


def _private_memory_mb(process: str) -> float:
    """Resident memory of a process, without shared memory."""
    return _resident_mb(process, "RssAnon") + _resident_mb(process, "RssFile")


def _resident_mb(process: str, kind: str) -> float:
    match = re.search(rf"{kind}:\s+(\d+) kB", Path(f"/proc/{process}/status").read_text())
    assert match is not None
    return int(match[1]) / 1e3
