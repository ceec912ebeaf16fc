"""What the program and the process of one run say to each other."""

from dataclasses import dataclass
from pathlib import Path

from drivers.isolation.messages import LogLine
from vo_service.runs.excerpt import WHOLE, Excerpt
from vo_service.runs.listening import NOBODY, ListenerRecipe
from vo_service.runs.recipe import Recipe
from vo_service.runs.run import Outcome


@dataclass(frozen=True)
class Job:
    """To the process, once: follow this folder. `camera_file` as for `open_folder`.

    listener          who hears what the method says
    may_end_compiled  where kernels had to be compiled first, the last word is `Compiled`
    """

    folder: Path
    camera_file: Path | None
    recipe: Recipe
    log_level: int
    excerpt: Excerpt = WHOLE
    may_end_compiled: bool = True
    listener: ListenerRecipe = NOBODY


@dataclass(frozen=True)
class Preparing:
    """From the process: what is being compiled, loaded or tried out beforehand."""

    stage: str


@dataclass(frozen=True)
class Progress:
    """From the process: so many of the frames are done."""

    done: int
    total: int


@dataclass(frozen=True)
class Compiled:
    """From the process: kernels had to be compiled, so its memory is not what the method takes.

    They are kept: another process will find them.
    """


# The last word is one of the last two.
Word = Preparing | Progress | LogLine | Compiled | Outcome
