"""Run of one method on one recording, with times of each frame.

Frames are read one at a time between two estimates. So nothing is decoded while a method works:
all processor time belongs to the method and its threads, and only the newest frame takes memory.
"""

import logging
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np
from numba.core.event import install_recorder

from drivers.camera import RgbdFrame
from drivers.core import UserFacingError
from drivers.core.geometry import Trajectory
from drivers.playback.frame_reader import FrameReader
from drivers.playback.recording_formats import open_recording
from drivers.recording.image_decoding import UnreadableFrameError
from drivers.recording.recording import Recording
from vo_service.odometry.stage_timers import CpuStageTimer
from vo_service.tools.compare.batch import KernelsCompiled, RunProgress, RunRequest
from vo_service.tools.compare.methods import MethodFactory
from vo_service.tools.compare.run_outcome import FRAME_COLUMNS, CompletedRun, LoopClosureRun
from vo_service.types.estimate import Estimate

logger = logging.getLogger(__name__)


PROGRESS_PERIOD_S = 0.1
# A method first processes this many frames and is then made again, so that loading, compilation
# and setup do not count.
WARM_UP_FRAMES = 3


class RunRecorder:
    """Recorder with one row per frame."""

    def __init__(self) -> None:
        self._rows: list[tuple[object, ...]] = []
        self._poses: list[np.ndarray] = []
        self._epoch = 0
        self._stages_ms: defaultdict[str, list[float]] = defaultdict(list)

    def __len__(self) -> int:
        return len(self._rows)

    def add_frame(
        self,
        frame: RgbdFrame,
        estimate: Estimate,
        cpu_s: float,
        wall_s: float,
        stages_ms: Mapping[str, float],
    ) -> None:
        """Add the result of a frame, and its processor time, elapsed time and times by stage."""
        self._epoch += estimate.is_reset
        times_ms = 1e3 * cpu_s, 1e3 * wall_s
        state = frame.stamp_s, estimate.ok, self._epoch, estimate.inliers
        self._rows.append((*state, *times_ms, estimate.reason))
        if estimate.ok:
            self._poses.append(estimate.T_world_camera)
        for stage, time_ms in stages_ms.items():
            self._stages_ms[stage].append(time_ms)

    def finish(self, skipped: int, loop_closure: LoopClosureRun | None = None) -> CompletedRun:
        """Return the complete run.

        Raises:
            UserFacingError: If a pose is not finite.
        """
        poses = np.array(self._poses, np.float64).reshape(-1, 4, 4)
        if not np.isfinite(poses).all():
            raise UserFacingError("a pose is not finite; this is an error of the method, report it")
        frames = np.array(self._rows, FRAME_COLUMNS)
        return CompletedRun(
            frames=frames,
            trajectory=Trajectory(frames["stamp_s"][frames["has_pose"]], poses),
            skipped=skipped,
            stage_ms={stage: median(times_ms) for stage, times_ms in self._stages_ms.items()},
            memory_mb=peak_memory_mb(),
            loop_closure=loop_closure,
        )


def peak_memory_mb() -> float:
    """Return the peak memory of this process, 10^6 bytes.

    The peak of `getrusage` would include the parent process before the fork.
    """
    lines = Path("/proc/self/status").read_text().splitlines()
    peak = next(line for line in lines if line.startswith("VmHWM:"))
    return int(peak.split()[1]) * 1024 / 1e6


def run_method(
    request: RunRequest, send: Callable[[str | RunProgress], None]
) -> CompletedRun | KernelsCompiled:
    """Run a method on the selected frames.

    Returns:
        The run; or `KernelsCompiled` before the first frame, if the request allows to stop then.

    Raises:
        UserFacingError: The folder is not usable, or a pose is not finite.
    """
    whole = open_recording(request.folder, request.camera_file, request.topics)
    pairs = request.frame_selection.select(whole.frames.pairs)
    recording = replace(whole, frames=replace(whole.frames, pairs=pairs))
    with install_recorder("numba:compile") as compiled:
        warm_up_method(request.factory, recording, send)
        request.observer_factory.prepare(send)
    if request.stop_after_compiling and compiled.buffer:
        return KernelsCompiled()
    stages, recorder = CpuStageTimer(), RunRecorder()
    odometry = request.factory.make(stages, recording)
    observer = request.observer_factory.make()
    progress_sent_s = 0.0
    for frame in _read_frames(recording):
        begin_s, begin_cpu_s = time.monotonic(), time.process_time()
        estimate = odometry.estimate(frame)
        cpu_s, wall_s = time.process_time() - begin_cpu_s, time.monotonic() - begin_s
        recorder.add_frame(frame, estimate, cpu_s, wall_s, stages.take_stage_ms())
        observer.observe(frame, estimate)
        if time.monotonic() - progress_sent_s > PROGRESS_PERIOD_S:
            progress_sent_s = time.monotonic()
            send(RunProgress(frame.seq + 1, len(pairs)))
    return recorder.finish(skipped=len(pairs) - len(recorder), loop_closure=observer.result)


def warm_up_method(
    factory: MethodFactory, recording: Recording, on_progress: Callable[[str], None]
) -> None:
    """Compile or load the kernels, and process the first frames once."""
    factory.prepare(on_progress)
    on_progress("first frames")
    odometry = factory.make(CpuStageTimer(), recording)
    count = min(WARM_UP_FRAMES, len(recording.frames.pairs))
    for frame in FrameReader(recording).read_sample(range(count)):
        odometry.estimate(frame)


def _read_frames(recording: Recording) -> Iterator[RgbdFrame]:
    """Yield the readable frames, and log the others."""
    reader = FrameReader(recording)
    for seq, pair in enumerate(recording.frames.pairs):
        try:
            frame = reader.read(pair, seq)
        except UnreadableFrameError as error:
            logger.warning("frame %d is skipped: %s", seq, error)
            continue
        yield frame
