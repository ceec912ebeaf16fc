"""Cache folder of one run, and its key: a digest of everything that changes the result."""

import csv
import hashlib
import io
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from drivers.core import InputError, UserFacingError
from drivers.core.files import atomic_write
from drivers.core.geometry import Trajectory, format_trajectory, read_trajectory
from drivers.core.write_errors import create_output_folder
from vo_service.tools.compare.methods import MethodFactory
from vo_service.tools.compare.observers import NULL_OBSERVER, ObserverFactory
from vo_service.tools.compare.recordings import BenchmarkRecording
from vo_service.tools.compare.run_outcome import (
    EMPTY_RUN,
    FRAME_COLUMNS,
    CompletedRun,
    FrameLog,
    LoopClosureRun,
    RunOutcome,
    RunState,
)

SCHEMA = 1
RESULT_FILE, FRAMES_FILE, DETAILS_FILE = "result.json", "frames.csv", "error.txt"
TRAJECTORY_FILE, OPTIMIZED_TRAJECTORY_FILE = "trajectory.txt", "trajectory_optimized.txt"
FILES = (RESULT_FILE, FRAMES_FILE, DETAILS_FILE, TRAJECTORY_FILE, OPTIMIZED_TRAJECTORY_FILE)


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
        "camera": repr(recording.contents.calibration),
        "topics": recording.topics,
        "frames": list(_frame_fingerprints(recording)),
        "truth": _ground_truth_digest(recording) if factory.uses_truth else None,
    }
    text = json.dumps(content, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def _frame_fingerprints(recording: BenchmarkRecording) -> Iterator[tuple[str, str, int, int]]:
    for pair in recording.contents.frames.pairs:
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


class RunCache:
    """Cache of an outcome in files that are written atomically, result.json last."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def load(self, key: str) -> RunOutcome | None:
        """Return the outcome stored with this key, or None if it is missing or damaged."""
        try:
            result = json.loads((self.path / RESULT_FILE).read_text())
            if result["schema"] != SCHEMA or result["key"] != key:
                return None
            state = RunState(result["state"])
            if state is not RunState.DONE:
                file = self.path / DETAILS_FILE
                details = file.read_text() if file.exists() else ""
                return RunOutcome(state, EMPTY_RUN, result["error"], details)
            return RunOutcome(state, self._load_run(result))
        except (OSError, UserFacingError, ValueError, KeyError, TypeError, AttributeError):
            return None

    def save(self, key: str, outcome: RunOutcome, description: Mapping[str, object]) -> None:
        """Store an outcome; the description goes into result.json, too. Raises UserFacingError."""
        run = outcome.run
        create_output_folder(self.path)
        for name in FILES:
            (self.path / name).unlink(missing_ok=True)
        if outcome.state is RunState.DONE:
            atomic_write(self.path / TRAJECTORY_FILE, format_trajectory(run.trajectory))
            if run.loop_closure is not None:
                optimized = format_trajectory(run.loop_closure.trajectory)
                atomic_write(self.path / OPTIMIZED_TRAJECTORY_FILE, optimized)
            atomic_write(self.path / FRAMES_FILE, _format_frames(run.frames).encode())
        elif outcome.details:
            atomic_write(self.path / DETAILS_FILE, outcome.details.encode())
        result = {
            "schema": SCHEMA,
            "key": key,
            **description,
            "state": outcome.state,
            "error": outcome.error,
            **run_as_json(run),
            **loop_closure_as_json(run.loop_closure),
        }
        atomic_write(self.path / RESULT_FILE, (json.dumps(result, indent=2) + "\n").encode())

    def _load_run(self, result: Mapping[str, Any]) -> CompletedRun:
        frames = _read_frames((self.path / FRAMES_FILE).read_text())
        poses_s = frames["stamp_s"][frames["has_pose"]]
        trajectory = self._load_trajectory(TRAJECTORY_FILE, len(poses_s))
        if len(frames) != result["frames"] or not np.array_equal(poses_s, trajectory.stamps_s):
            raise ValueError("the files belong to different runs")
        return CompletedRun(
            frames=frames,
            trajectory=trajectory,
            skipped=int(result["skipped"]),
            stage_ms={str(stage): float(ms) for stage, ms in result["stage_ms"].items()},
            memory_mb=float(result["memory_mb"]),
            loop_closure=self._load_loop_closure(result) if "loop_closures" in result else None,
        )

    def _load_loop_closure(self, result: Mapping[str, Any]) -> LoopClosureRun:
        optimized = self._load_trajectory(OPTIMIZED_TRAJECTORY_FILE, int(result["optimized_poses"]))
        cpu_ms = float(result["loop_closure_ms_per_frame"])
        return LoopClosureRun(
            optimized, int(result["map_keyframes"]), int(result["loop_closures"]), cpu_ms
        )

    def _load_trajectory(self, name: str, count: int) -> Trajectory:
        """Read a file of `count` poses, which does not exist for none; raise ValueError if not."""
        trajectory = read_trajectory(self.path / name) if count else EMPTY_RUN.trajectory
        if len(trajectory) != count:
            raise ValueError("the files belong to different runs")
        return trajectory


def run_as_json(run: CompletedRun) -> dict[str, object]:
    """Return the metrics of a run that need no ground truth."""
    return {
        "frames": len(run.frames),
        "failed": run.failed,
        "skipped": run.skipped,
        "new_epochs": run.new_epochs,
        "cpu_s": round(run.cpu_s, 6),
        "wall_s": round(run.wall_s, 6),
        "stage_ms": {stage: round(ms, 3) for stage, ms in run.stage_ms.items()},
        "memory_mb": round(run.memory_mb, 1),
    }


def loop_closure_as_json(loop_closure: LoopClosureRun | None) -> dict[str, object]:
    """Return the metrics of loop closure that need no ground truth; empty without it."""
    if loop_closure is None:
        return {}
    return {
        "map_keyframes": loop_closure.map_keyframes,
        "loop_closures": loop_closure.loop_closures,
        "loop_closure_ms_per_frame": round(loop_closure.cpu_ms_per_frame, 3),
        "optimized_poses": len(loop_closure.trajectory),
    }


def _format_frames(frames: FrameLog) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(FRAME_COLUMNS.names or ())
    for stamp_s, has_pose, epoch, inliers, cpu_ms, wall_ms, reason in frames.tolist():
        times = f"{cpu_ms:.4f}", f"{wall_ms:.4f}"
        writer.writerow((f"{stamp_s:.6f}", int(has_pose), epoch, inliers, *times, reason))
    return text.getvalue()


def _read_frames(text: str) -> FrameLog:
    header, *rows = csv.reader(io.StringIO(text))
    if tuple(header) != FRAME_COLUMNS.names:
        raise ValueError("a file of other columns")
    numbers = [(stamp, int(has_pose), *others) for stamp, has_pose, *others in rows]
    return np.array(numbers, FRAME_COLUMNS)
