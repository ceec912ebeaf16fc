"""The folder of one run: what it did is kept there, so that it need not be done again."""

import csv
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import InputError, UserFacingError
from drivers.full_disk import is_full
from drivers.trajectory import StampedPoses, pose_line, read_trajectory
from drivers.tum.whole_files import write_whole
from vo_service.folders import make_output_folder
from vo_service.runs.run import NO_RUN, FrameLog, LoopsRun, Outcome, Run, RunState

SCHEMA = 1
RESULT, TRAJECTORY, FRAMES, DETAILS = "result.json", "trajectory.txt", "frames.csv", "error.txt"
CORRECTED = "trajectory_corrected.txt"
COLUMNS = ("stamp_s", "has_pose", "epoch", "inliers", "cpu_ms", "wall_ms", "reason")


class RunFolder:
    """Keeps an outcome in files that are written whole, result.json last."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def load(self, key: str) -> Outcome | None:
        """What was kept under this very key; None if there is no such thing, or it is damaged."""
        try:
            result = json.loads((self.path / RESULT).read_text())
            if result["schema"] != SCHEMA or result["key"] != key:
                return None
            state = RunState(result["state"])
            if state is not RunState.DONE:
                return Outcome(state, NO_RUN, result["trouble"], self._details())
            return Outcome(state, self._run(result))
        except (OSError, UserFacingError, ValueError, KeyError, TypeError, AttributeError):
            return None

    def save(self, key: str, outcome: Outcome, about: Mapping[str, object]) -> None:
        """Keep it; `about` goes into result.json as well. Raises as `write_file`."""
        run = outcome.run
        make_output_folder(self.path)
        for name in (RESULT, TRAJECTORY, CORRECTED, FRAMES, DETAILS):
            (self.path / name).unlink(missing_ok=True)
        if outcome.state is RunState.DONE:
            write_file(self.path / TRAJECTORY, _trajectory_text(run.trajectory))
            if run.with_loops is not None:
                write_file(self.path / CORRECTED, _trajectory_text(run.with_loops.trajectory))
            write_file(self.path / FRAMES, _frames_text(run.frames).encode())
        elif outcome.details:
            write_file(self.path / DETAILS, outcome.details.encode())
        result = {
            "schema": SCHEMA,
            "key": key,
            **about,
            "state": outcome.state,
            "trouble": outcome.trouble,
            **run_as_json(run),
            **loops_as_json(run.with_loops),
        }
        write_file(self.path / RESULT, (json.dumps(result, indent=2) + "\n").encode())

    def _run(self, result: Mapping[str, Any]) -> Run:
        frames = _read_frames((self.path / FRAMES).read_text())
        has_poses = bool(frames.is_good.any())
        trajectory = read_trajectory(self.path / TRAJECTORY) if has_poses else NO_RUN.trajectory
        _check(frames, trajectory, result["frames"])
        return Run(
            frames=frames,
            trajectory=trajectory,
            skipped=int(result["skipped"]),
            stage_ms={str(stage): float(ms) for stage, ms in result["stage_ms"].items()},
            memory_mb=float(result["memory_mb"]),
            with_loops=self._with_loops(result) if "loops" in result else None,
        )

    def _with_loops(self, result: Mapping[str, Any]) -> LoopsRun:
        count = int(result["corrected_poses"])
        corrected = read_trajectory(self.path / CORRECTED) if count else NO_RUN.trajectory
        if len(corrected) != count:
            raise ValueError("the files are not of one run")
        cpu_ms = float(result["loops_ms_per_frame"])
        return LoopsRun(corrected, int(result["places"]), int(result["loops"]), cpu_ms)

    def _details(self) -> str:
        file = self.path / DETAILS
        return file.read_text() if file.exists() else ""


def run_as_json(run: Run) -> dict[str, object]:
    """The figures of a run that need no ground truth."""
    return {
        "frames": len(run.frames),
        "failed": run.failed,
        "skipped": run.skipped,
        "new_epochs": run.new_epochs,
        "cpu_s": round(run.cpu_s, 6),
        "wall_s": round(run.wall_s, 6),
        "cpu_ms_per_frame": round(run.cpu_ms_per_frame, 3),
        "stage_ms": {stage: round(spent, 3) for stage, spent in run.stage_ms.items()},
        "memory_mb": round(run.memory_mb, 1),
    }


def loops_as_json(with_loops: LoopsRun | None) -> dict[str, object]:
    """The figures of loops that need no ground truth; none where there are no loops."""
    if with_loops is None:
        return {}
    return {
        "places": with_loops.places,
        "loops": with_loops.loops,
        "loops_ms_per_frame": round(with_loops.cpu_ms, 3),
        "corrected_poses": len(with_loops.trajectory),
    }


def write_file(path: Path, data: bytes) -> None:
    """Write a whole file or none. Raises UserFacingError for a full disk, InputError otherwise."""
    try:
        write_whole(path, data)
    except OSError as error:
        raise (UserFacingError if is_full(error) else InputError)(
            f"{path}: cannot be written: {error.strerror}; make room, or name another folder with "
            "--output"
        ) from error


def _trajectory_text(poses: StampedPoses) -> bytes:
    return "".join(map(pose_line, poses.stamps_s, poses.T_world_camera)).encode()


def _frames_text(frames: FrameLog) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for k in range(len(frames)):
        state = int(frames.is_good[k]), int(frames.epochs[k]), int(frames.inliers[k])
        times = f"{frames.cpu_ms[k]:.4f}", f"{frames.wall_ms[k]:.4f}"
        writer.writerow((f"{frames.stamps_s[k]:.6f}", *state, *times, frames.reasons[k]))
    return text.getvalue()


def _read_frames(text: str) -> FrameLog:
    rows = list(csv.DictReader(io.StringIO(text)))
    return FrameLog.of(
        [
            (
                float(row["stamp_s"]),
                row["has_pose"] == "1",
                int(row["epoch"]),
                int(row["inliers"]),
                float(row["cpu_ms"]),
                float(row["wall_ms"]),
                row["reason"],
            )
            for row in rows
        ]
    )


def _check(frames: FrameLog, trajectory: StampedPoses, count: int) -> None:
    """Raise ValueError unless the files belong together."""
    is_whole = len(frames) == count
    if not is_whole or not np.array_equal(frames.stamps_s[frames.is_good], trajectory.stamps_s):
        raise ValueError("the files are not of one run")
