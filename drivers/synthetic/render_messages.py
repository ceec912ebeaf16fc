"""What the reader of rendered frames and the renderer's process say to each other."""

from dataclasses import dataclass

from drivers.core.errors import UserFacingError
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.rendered_sequence import SequenceFiles


@dataclass(frozen=True)
class RenderJob:
    """What to render, and where to; `rate_hz` as for `RenderSchedule`.

    `wake` is an eventfd that is written to after each frame.
    """

    config: SyntheticConfig
    files: SequenceFiles
    rate_hz: float
    threads: int
    wake_fd: int


@dataclass(frozen=True)
class ReaderPosition:
    """The reader wants this frame next."""

    index: int


@dataclass(frozen=True)
class RenderRequest:
    """The reader waits for this frame."""

    index: int


@dataclass(frozen=True)
class RenderingComplete:
    """No frame is missing."""


@dataclass(frozen=True)
class RenderingFailed:
    """Why no more frames come."""

    error: UserFacingError
