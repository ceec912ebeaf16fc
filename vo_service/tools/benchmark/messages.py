"""What the program and the process of one run say to each other."""

from dataclasses import dataclass
from pathlib import Path

from drivers.core.process.messages import LogMessage
from vo_service.tools.benchmark.frame_selection import ALL_FRAMES, FrameSelection
from vo_service.tools.benchmark.method_factory import MethodFactory
from vo_service.tools.benchmark.observers import NULL_OBSERVER, ObserverFactory
from vo_service.tools.benchmark.run import RunOutcome


@dataclass(frozen=True)
class RunRequest:
    """To the process, once: follow this folder. `camera_file` as for `open_tum_folder`.

    listener          who hears what the method says
    may_end_compiled  where kernels had to be compiled first, the last word is `KernelsCompiled`
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
    """From the process: what is being compiled, loaded or tried out beforehand."""

    stage: str


@dataclass(frozen=True)
class RunProgress:
    """From the process: so many of the frames are done."""

    done: int
    total: int


@dataclass(frozen=True)
class KernelsCompiled:
    """From the process: kernels had to be compiled, so its memory is not what the method takes.

    They are kept: another process will find them.
    """


# The last word is one of the last two.
RunMessage = RunPreparing | RunProgress | LogMessage | KernelsCompiled | RunOutcome
