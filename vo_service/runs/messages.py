"""What the program and the process of one run say to each other."""

from dataclasses import dataclass
from pathlib import Path

from drivers.isolation.messages import LogLine
from vo_service.runs.excerpt import WHOLE, Excerpt
from vo_service.runs.recipe import Recipe
from vo_service.runs.run import Outcome


@dataclass(frozen=True)
class Job:
    """To the process, once: follow this folder. `camera_file` as for `open_folder`."""

    folder: Path
    camera_file: Path | None
    recipe: Recipe
    log_level: int
    excerpt: Excerpt = WHOLE


@dataclass(frozen=True)
class Preparing:
    """From the process: what is being compiled, loaded or tried out beforehand."""

    stage: str


@dataclass(frozen=True)
class Progress:
    """From the process: so many of the frames are done."""

    done: int
    total: int


# The last word is the outcome.
Word = Preparing | Progress | LogLine | Outcome
