"""Cost and completeness of a recording into MCAP.

    python -m benchmarks mcap_recording RECORDING [--seconds 60] [--json]

Frames of a recording are written at 30 Hz from memory, with JPEG and PNG, then raw. The table shows
the frames that were written and read back, the CPU time per frame, its share of one core at 30 Hz,
and the longest time that the camera's thread was held up.
"""

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from benchmarks.harness import add_json_option, format_table, print_json
from drivers.bag.mcap_recorder import McapRecorder
from drivers.camera import RgbdFrame
from drivers.recording_camera import RecordingCamera, open_recording

RATE_HZ = 30.0
SOURCE_FRAMES = 100


@dataclass(frozen=True)
class RecordingCost:
    """The figures of one kind of recording."""

    images: str
    sent: int
    read_back: int
    cpu_ms: float
    core_percent: float
    longest_write_ms: float
    megabytes: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("recording", metavar="RECORDING", type=Path, help="source of the frames")
    parser.add_argument("--seconds", type=float, default=60.0, help="duration (default: 60)")
    add_json_option(parser)


def main(args: argparse.Namespace) -> None:
    """Measure both kinds and print."""
    with RecordingCamera(args.recording) as camera:
        frames = list(islice(camera, SOURCE_FRAMES))
    with tempfile.TemporaryDirectory() as folder:
        costs = [
            measure(frames, Path(folder) / f"{name}.mcap", is_raw, args.seconds)
            for name, is_raw in (("compressed", False), ("raw", True))
        ]
    print_json(args, {"costs": costs})
    if args.json:
        return
    headings = ["sent", "read back", "CPU ms", "core %", "longest write ms", "MB"]
    rows = {
        cost.images: [
            f"{cost.sent}", f"{cost.read_back}", f"{cost.cpu_ms:.1f}", f"{cost.core_percent:.0f}",
            f"{cost.longest_write_ms:.0f}", f"{cost.megabytes:.0f}",
        ]
        for cost in costs
    }  # fmt: skip
    print(format_table(headings, rows))


def measure(frames: Sequence[RgbdFrame], path: Path, is_raw: bool, seconds: float) -> RecordingCost:
    """Record at 30 Hz and read the file again."""
    count = int(seconds * RATE_HZ)
    longest_s, cpu_s, due_s = 0.0, time.process_time(), time.monotonic()
    with McapRecorder(path, is_raw=is_raw) as recorder:
        for k in range(count):
            time.sleep(max(0.0, due_s - time.monotonic()))
            due_s += 1.0 / RATE_HZ
            begin_s = time.monotonic()
            recorder.write(replace(frames[k % len(frames)], stamp_s=1e9 + k / RATE_HZ))
            longest_s = max(longest_s, time.monotonic() - begin_s)
    cpu_ms = 1e3 * (time.process_time() - cpu_s) / count
    return RecordingCost(
        images=path.stem,
        sent=count,
        read_back=len(open_recording(path).frames.pairs),
        cpu_ms=cpu_ms,
        core_percent=cpu_ms * RATE_HZ / 10.0,
        longest_write_ms=1e3 * longest_s,
        megabytes=path.stat().st_size / 1e6,
    )
