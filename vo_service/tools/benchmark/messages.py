"""Messages between the program and the worker process of one run."""

from dataclasses import dataclass
from pathlib import Path

from drivers.core.process.worker_process import LogMessage
from vo_service.tools.benchmark.frame_selection import ALL_FRAMES, FrameSelection
from vo_service.tools.benchmark.method_factory import MethodFactory
from vo_service.tools.benchmark.observers import NULL_OBSERVER, ObserverFactory
from vo_service.tools.benchmark.run import RunOutcome


@dataclass(frozen=True)
class RunRequest:
    """Request to the worker, sent once: run a method on a recording.

    Attributes:
        folder: The recording.
        camera_file: As for `open_tum_folder`.
        factory: Makes the method.
        log_level: Level of the log messages to forward.
        frame_selection: Frames to use.
        stop_after_compiling: If kernels had to be compiled, end with `KernelsCompiled`.
        observer_factory: Makes the observer of the run.
    """

    folder: Path
    camera_file: Path | None
    factory: MethodFactory
    log_level: int
    frame_selection: FrameSelection = ALL_FRAMES
    stop_after_compiling: bool = True
    observer_factory: ObserverFactory = NULL_OBSERVER


@dataclass(frozen=True)
class RunPreparing:
    """Message of the worker: the current stage of compilation, loading or warm-up."""

    stage: str


@dataclass(frozen=True)
class RunProgress:
    """Message of the worker: number of processed frames."""

    done: int
    total: int


@dataclass(frozen=True)
class KernelsCompiled:
    """Last message of a worker that had to compile kernels, so its memory use is not the method's.

    The kernels are cached for the next process.
    """


# The last message is one of the last two types.
RunMessage = RunPreparing | RunProgress | LogMessage | KernelsCompiled | RunOutcome
