"""Cache key of a run: a digest of everything that changes its result."""

import hashlib
import json
from collections.abc import Iterator, Mapping

from drivers.core.errors import InputError
from vo_service.tools.benchmark.method_factory import MethodFactory
from vo_service.tools.benchmark.observers import NULL_OBSERVER, ObserverFactory
from vo_service.tools.benchmark.recordings import BenchmarkRecording


def make_cache_key(
    recording: BenchmarkRecording,
    factory: MethodFactory,
    versions: Mapping[str, str],
    observer_factory: ObserverFactory = NULL_OBSERVER,
) -> str:
    """Return a digest of the versions, the settings, the camera and the recording's files.

    Images count by name, size and modification time. The ground truth counts if it is used.

    Raises:
        InputError: A file cannot be read.
    """
    content = {
        "versions": dict(versions),
        "settings": {**factory.settings, **observer_factory.settings},
        "camera": repr(recording.tum_folder.calibration),
        "frames": list(_frame_fingerprints(recording)),
        "truth": _ground_truth_digest(recording) if factory.uses_truth else None,
    }
    text = json.dumps(content, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def _frame_fingerprints(recording: BenchmarkRecording) -> Iterator[tuple[str, str, int, int]]:
    for pair in recording.tum_folder.frames.pairs:
        for image in (pair.color, pair.depth):
            try:
                state = image.file.stat()
            except FileNotFoundError:  # the run will skip this frame
                yield str(image.stamp), image.file.name, 0, 0
                continue
            except OSError as error:
                raise InputError(f"{image.file}: cannot be read: {error.strerror}") from error
            yield str(image.stamp), image.file.name, state.st_size, state.st_mtime_ns


def _ground_truth_digest(recording: BenchmarkRecording) -> str:
    truth = recording.truth
    if truth is None:
        return ""
    data = truth.stamps_s.tobytes() + truth.T_world_camera.tobytes()
    return hashlib.sha256(data).hexdigest()
