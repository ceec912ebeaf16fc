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
from drivers.tum.folder import TumFolder, open_folder
from drivers.tum.frame_reader import FrameReader
from drivers.tum.lists import FramePair
from vo_service.runs.diary import Diary
from vo_service.runs.messages import Job, Preparing, Progress
from vo_service.runs.recipe import Recipe
from vo_service.runs.run import Run
from vo_service.stage_clock import StageClock
from vo_service.types import Estimate, Odometry

PROGRESS_S = 0.1
# A method is first tried on so many frames and then made anew: what it loads, compiles and sets up
# the first time is not counted.
WARM_UP_FRAMES = 3

logger = logging.getLogger(__name__)


class CompiledFirst(Exception):  # noqa: N818 (no error: all is well, but for the memory)
    """Kernels had to be compiled in this process, and no frame has been counted yet."""


def follow(job: Job, tell: Callable[[Preparing | Progress], None]) -> Run:
    """All frames of the excerpt. Raises UserFacingError if the folder or a pose is without use.

    Raises CompiledFirst where the job allows it, and kernels had to be compiled.
    """
    folder = open_folder(job.folder, job.camera_file)
    pairs = job.excerpt.of(folder.frames.pairs)
    with install_recorder("numba:compile") as compiled:
        warm_up(job.recipe, folder, pairs, lambda stage: tell(Preparing(stage)))
        job.listener.prepare(lambda stage: tell(Preparing(stage)))
    if job.may_end_compiled and compiled.buffer:
        raise CompiledFirst
    stages, diary = StageClock(), Diary()
    odometry = job.recipe.make(stages, folder.ground_truth)
    listener = job.listener.make()
    told_s = 0.0
    for frame in _frames(folder, pairs):
        listener.hear(frame, _add(diary, odometry, frame, stages))
        if time.monotonic() - told_s > PROGRESS_S:
            told_s = time.monotonic()
            tell(Progress(frame.seq + 1, len(pairs)))
    return diary.run(skipped=len(pairs) - len(diary), with_loops=listener.result)


def warm_up(
    recipe: Recipe, folder: TumFolder, pairs: Sequence[FramePair], tell: Callable[[str], None]
) -> None:
    """Compile or load what there is, and let the method see the first frames once."""
    recipe.prepare(tell)
    tell("first frames")
    odometry = recipe.make(StageClock(), folder.ground_truth)
    reader = FrameReader(folder)
    for seq, pair in enumerate(pairs[:WARM_UP_FRAMES]):
        try:
            odometry.estimate(reader.read(pair, seq))
        except UnreadableFrameError:  # to be told when its turn comes
            continue


def _add(diary: Diary, odometry: Odometry, frame: RgbdFrame, stages: StageClock) -> Estimate:
    """Let the method see a frame, and take down what it says and takes."""
    begin_s, begin_cpu_s = time.monotonic(), time.process_time()
    estimate = odometry.estimate(frame)
    cpu_s, wall_s = time.process_time() - begin_cpu_s, time.monotonic() - begin_s
    diary.add(frame, estimate, cpu_s, wall_s)
    diary.add_stages(stages.take())
    return estimate


def _frames(folder: TumFolder, pairs: Sequence[FramePair]) -> Iterator[RgbdFrame]:
    """Those that can be read; the others are named in the log."""
    reader = FrameReader(folder)
    for seq, pair in enumerate(pairs):
        try:
            frame = reader.read(pair, seq)
        except UnreadableFrameError as error:
            logger.warning("frame %d is skipped: %s", seq, error)
            continue
        yield frame
