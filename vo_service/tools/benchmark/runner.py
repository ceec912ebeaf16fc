"""Run of one method on one recording, with times of each frame.

Frames are read one at a time between two estimates. So nothing is decoded while a method works:
all processor time belongs to the method and its threads, and only the newest frame takes memory.
"""

import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

from numba.core.event import install_recorder

from drivers.camera import RgbdFrame
from drivers.tum.camera import TumFrameReader
from drivers.tum.folder import TumFolder, UnreadableFrameError, open_tum_folder
from vo_service.odometry.profiling import CpuStageTimer
from vo_service.tools.benchmark.messages import RunPreparing, RunProgress, RunRequest
from vo_service.tools.benchmark.method_factory import MethodFactory
from vo_service.tools.benchmark.run import CompletedRun
from vo_service.tools.benchmark.run_recorder import RunRecorder
from vo_service.types import Estimate, Odometry

logger = logging.getLogger(__name__)

PROGRESS_PERIOD_S = 0.1
# A method first processes this many frames and is then made again, so that loading, compilation
# and setup do not count.
WARM_UP_FRAMES = 3


class KernelsCompiledFirst(Exception):  # noqa: N818 (not an error: only the memory would be wrong)
    """Kernels had to be compiled in this process; no frame has been counted yet."""


def run_method(
    request: RunRequest, send: Callable[[RunPreparing | RunProgress], None]
) -> CompletedRun:
    """Run a method on the selected frames.

    Raises:
        UserFacingError: The folder is not usable, or a pose is not finite.
        KernelsCompiledFirst: Kernels had to be compiled, and the request allows to stop then.
    """
    whole = open_tum_folder(request.folder, request.camera_file)
    pairs = request.frame_selection.select(whole.frames.pairs)
    recording = replace(whole, frames=replace(whole.frames, pairs=pairs))
    with install_recorder("numba:compile") as compiled:
        warm_up_method(request.factory, recording, lambda stage: send(RunPreparing(stage)))
        request.observer_factory.prepare(lambda stage: send(RunPreparing(stage)))
    if request.stop_after_compiling and compiled.buffer:
        raise KernelsCompiledFirst
    stages, recorder = CpuStageTimer(), RunRecorder()
    odometry = request.factory.make(stages, recording)
    observer = request.observer_factory.make()
    progress_sent_s = 0.0
    for frame in _read_frames(recording):
        observer.observe(frame, _process_frame(recorder, odometry, frame, stages))
        if time.monotonic() - progress_sent_s > PROGRESS_PERIOD_S:
            progress_sent_s = time.monotonic()
            send(RunProgress(frame.seq + 1, len(pairs)))
    return recorder.finish(skipped=len(pairs) - len(recorder), loop_closure=observer.result)


def warm_up_method(
    factory: MethodFactory, recording: TumFolder, on_progress: Callable[[str], None]
) -> None:
    """Compile or load the kernels, and process the first frames once."""
    factory.prepare(on_progress)
    on_progress("first frames")
    odometry = factory.make(CpuStageTimer(), recording)
    reader = TumFrameReader(recording)
    for seq, pair in enumerate(recording.frames.pairs[:WARM_UP_FRAMES]):
        try:
            odometry.estimate(reader.read(pair, seq))
        except UnreadableFrameError:  # will be reported in the run
            continue


def _process_frame(
    recorder: RunRecorder, odometry: Odometry, frame: RgbdFrame, stages: CpuStageTimer
) -> Estimate:
    """Estimate a frame, and record the result and the times."""
    begin_s, begin_cpu_s = time.monotonic(), time.process_time()
    estimate = odometry.estimate(frame)
    cpu_s, wall_s = time.process_time() - begin_cpu_s, time.monotonic() - begin_s
    recorder.add_frame(frame, estimate, cpu_s, wall_s)
    recorder.add_stages(stages.take_stage_ms())
    return estimate


def _read_frames(recording: TumFolder) -> Iterator[RgbdFrame]:
    """Yield the readable frames, and log the others."""
    reader = TumFrameReader(recording)
    for seq, pair in enumerate(recording.frames.pairs):
        try:
            frame = reader.read(pair, seq)
        except UnreadableFrameError as error:
            logger.warning("frame %d is skipped: %s", seq, error)
            continue
        yield frame
