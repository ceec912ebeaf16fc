"""One method over one recording, frame by frame, with its times.

Frames are read one at a time, between two estimates: nothing is decoded while a method works, so
all processor time meanwhile is the method's, whatever threads it has, and no frames but the newest
take memory.
"""

import logging
import time
from collections.abc import Callable, Iterator, Sequence

from numba.core.event import install_recorder

from drivers.camera import RgbdFrame
from drivers.tum.decode import UnreadableFrameError
from drivers.tum.folder import TumFolder, open_tum_folder
from drivers.tum.frame_reader import TumFrameReader
from drivers.tum.index_files import FramePair
from vo_service.odometry.profiling import CpuStageTimer
from vo_service.tools.benchmark.messages import RunPreparing, RunProgress, RunRequest
from vo_service.tools.benchmark.method_factory import MethodFactory
from vo_service.tools.benchmark.run import CompletedRun
from vo_service.tools.benchmark.run_recorder import RunRecorder
from vo_service.types import Estimate, Odometry

PROGRESS_PERIOD_S = 0.1
# A method is first tried on so many frames and then made anew: what it loads, compiles and sets up
# the first time is not counted.
WARM_UP_FRAMES = 3

logger = logging.getLogger(__name__)


class KernelsCompiledFirst(Exception):  # noqa: N818 (no error: all is well, but for the memory)
    """Kernels had to be compiled in this process, and no frame has been counted yet."""


def run_method(
    request: RunRequest, send: Callable[[RunPreparing | RunProgress], None]
) -> CompletedRun:
    """All frames of the excerpt. Raises UserFacingError if the folder or a pose is without use.

    Raises CompiledFirst where the job allows it, and kernels had to be compiled.
    """
    folder = open_tum_folder(request.folder, request.camera_file)
    pairs = request.frame_selection.select(folder.frames.pairs)
    with install_recorder("numba:compile") as compiled:
        warm_up_method(request.factory, folder, pairs, lambda stage: send(RunPreparing(stage)))
        request.observer_factory.prepare(lambda stage: send(RunPreparing(stage)))
    if request.stop_after_compiling and compiled.buffer:
        raise KernelsCompiledFirst
    stages, diary = CpuStageTimer(), RunRecorder()
    odometry = request.factory.make(stages, folder.ground_truth)
    listener = request.observer_factory.make()
    told_s = 0.0
    for frame in _read_frames(folder, pairs):
        listener.observe(frame, _process_frame(diary, odometry, frame, stages))
        if time.monotonic() - told_s > PROGRESS_PERIOD_S:
            told_s = time.monotonic()
            send(RunProgress(frame.seq + 1, len(pairs)))
    return diary.finish(skipped=len(pairs) - len(diary), loop_closure=listener.result)


def warm_up_method(
    factory: MethodFactory,
    folder: TumFolder,
    pairs: Sequence[FramePair],
    on_progress: Callable[[str], None],
) -> None:
    """Compile or load what there is, and let the method see the first frames once."""
    factory.prepare(on_progress)
    on_progress("first frames")
    odometry = factory.make(CpuStageTimer(), folder.ground_truth)
    reader = TumFrameReader(folder)
    for seq, pair in enumerate(pairs[:WARM_UP_FRAMES]):
        try:
            odometry.estimate(reader.read(pair, seq))
        except UnreadableFrameError:  # to be told when its turn comes
            continue


def _process_frame(
    recorder: RunRecorder, odometry: Odometry, frame: RgbdFrame, stages: CpuStageTimer
) -> Estimate:
    """Let the method see a frame, and take down what it says and takes."""
    begin_s, begin_cpu_s = time.monotonic(), time.process_time()
    estimate = odometry.estimate(frame)
    cpu_s, wall_s = time.process_time() - begin_cpu_s, time.monotonic() - begin_s
    recorder.add_frame(frame, estimate, cpu_s, wall_s)
    recorder.add_stages(stages.take_stage_ms())
    return estimate


def _read_frames(folder: TumFolder, pairs: Sequence[FramePair]) -> Iterator[RgbdFrame]:
    """Those that can be read; the others are named in the log."""
    reader = TumFrameReader(folder)
    for seq, pair in enumerate(pairs):
        try:
            frame = reader.read(pair, seq)
        except UnreadableFrameError as error:
            logger.warning("frame %d is skipped: %s", seq, error)
            continue
        yield frame
