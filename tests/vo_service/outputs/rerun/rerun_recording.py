"""Drawing in this process, and reading of recordings with Rerun's own reader."""

import subprocess
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rerun.chunk import RrdReader

from drivers.core.geometry import Trajectory
from vo_service.outputs.rerun.messages import RerunWorkerConfig, TextLog
from vo_service.outputs.rerun.rotating_recording import RotatingRecording
from vo_service.outputs.rerun.sinks import RrdFileSink, Sink
from vo_service.outputs.rerun.update_encoder import UpdateEncoder
from vo_service.outputs.rerun.web_viewer_server import rerun_binary
from vo_service.types.messages import Status
from vo_service.types.odometry_update import OdometryUpdate

IMAGE_PERIOD_S = 0.1


def make_config(sink: Sink) -> RerunWorkerConfig:
    """Make the configuration of a viewer's process."""
    return RerunWorkerConfig(sink, 80, "recording")


def draw(
    sink: Sink,
    items: Iterable[OdometryUpdate | Status | TextLog],
    ground_truth: Trajectory | None = None,
) -> RotatingRecording:
    """Draw all items and finish the recording."""
    encoder = UpdateEncoder(sink, IMAGE_PERIOD_S, lambda: ground_truth)
    recording = RotatingRecording(make_config(sink))
    for item in items:
        match item:
            case OdometryUpdate():
                for message in encoder.encode_update(item):
                    recording.log(message)
            case Status():
                recording.log(encoder.encode_status(item))
            case TextLog():
                recording.log(item)
    for message in encoder.encode_pending():
        recording.log(message)
    recording.finish()
    return recording


def draw_file(
    folder: Path,
    items: Iterable[OdometryUpdate | Status | TextLog],
    ground_truth: Trajectory | None = None,
) -> Path:
    """Draw all items into one file and return it."""
    draw(RrdFileSink(folder / "out.rrd"), items, ground_truth)
    return folder / "out.rrd"


def is_complete(path: Path) -> bool:
    """Return whether Rerun verifies the file, its end included."""
    command = [str(rerun_binary()), "rrd", "verify", str(path)]
    return subprocess.run(command, capture_output=True, timeout=100).returncode == 0


def count_rows(path: Path) -> Counter[str]:
    """Count how often each entity was logged."""
    counter: Counter[str] = Counter()
    for chunk in RrdReader(path).stream():
        counter[chunk.entity_path] += chunk.num_rows
    return counter


def read_column(path: Path, entity: str, component: str) -> list[Any]:
    """Read all values of one component of an entity."""
    batches = [c.to_record_batch() for c in RrdReader(path).stream() if c.entity_path == entity]
    with_component = [batch for batch in batches if component in batch.schema.names]
    return [value for batch in with_component for value in batch.column(component).to_pylist()]
