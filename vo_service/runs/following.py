"""One method over one recording, frame by frame, with its times."""

import resource
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from statistics import median

import numpy as np

from drivers.camera import EndOfStream, Pace, RgbdFrame
from drivers.errors import UserFacingError
from drivers.trajectory import StampedPoses
from drivers.tum.camera import TumCamera
from vo_service.odometry.estimate import Estimate
from vo_service.runs.messages import Job, Preparing, Progress
from vo_service.runs.run import FrameLog, Run
from vo_service.stage_clock import StageClock

# A disk that does not answer for this long will not answer at all.
READ_LIMIT_S = 60.0
PROGRESS_S = 0.1


def follow(job: Job, tell: Callable[[Preparing | Progress], None]) -> Run:
    """The whole folder, as fast as it goes; raises UserFacingError if it cannot be read on."""
    job.recipe.prepare(lambda stage: tell(Preparing(stage)))
    diary = _Diary()
    with TumCamera(job.folder, job.camera_file, Pace.LOCKSTEP) as camera:
        total = camera.frame_count or 0
        stages = StageClock()
        odometry = job.recipe.make(stages, camera.ground_truth)
        told_s = 0.0
        for frame in _frames(camera):
            begin_s, begin_cpu_s = time.monotonic(), time.thread_time()
            estimate = odometry.estimate(frame)
            cpu_s, wall_s = time.thread_time() - begin_cpu_s, time.monotonic() - begin_s
            diary.add(frame, estimate, cpu_s, wall_s)
            diary.add_stages(stages)
            if time.monotonic() - told_s > PROGRESS_S:
                told_s = time.monotonic()
                tell(Progress(frame.seq + 1, total))
        skipped = camera.counters.skipped
    return diary.run(skipped)


def _frames(camera: TumCamera) -> Iterator[RgbdFrame]:
    while True:
        try:
            yield camera.read(READ_LIMIT_S)
        except EndOfStream:
            return


class _Diary:
    """Takes down what becomes of each frame."""

    def __init__(self) -> None:
        self._rows: list[tuple[float, bool, int, int, float, float, str]] = []
        self._stamps_s: list[float] = []
        self._poses: list[np.ndarray] = []
        self._epoch = 0
        self._stages_ms: defaultdict[str, list[float]] = defaultdict(list)

    def add(self, frame: RgbdFrame, estimate: Estimate, cpu_s: float, wall_s: float) -> None:
        self._epoch += estimate.restarted
        times_ms = 1e3 * cpu_s, 1e3 * wall_s
        state = frame.stamp_s, estimate.ok, self._epoch, estimate.inliers
        self._rows.append((*state, *times_ms, estimate.reason))
        if estimate.ok:
            self._stamps_s.append(frame.stamp_s)
            self._poses.append(estimate.T_world_camera)

    def add_stages(self, stages: StageClock) -> None:
        for stage, spent_ms in stages.take().items():
            self._stages_ms[stage].append(spent_ms)

    def run(self, skipped: int) -> Run:
        poses = np.array(self._poses, np.float64).reshape(-1, 4, 4)
        if not np.isfinite(poses).all():
            raise UserFacingError("a pose is not finite: the method has a fault")
        return Run(
            frames=FrameLog.of(self._rows),
            trajectory=StampedPoses(np.array(self._stamps_s), poses),
            skipped=skipped,
            stage_ms={stage: median(spent) for stage, spent in self._stages_ms.items()},
            memory_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
        )
