"""Messages between the reader of rendered frames and the renderer's process."""

from dataclasses import dataclass

from drivers.synthetic import SyntheticConfig
from drivers.synthetic.rendered_sequence import SequenceFiles


@dataclass(frozen=True)
class RenderJob:
    """What to render and where to store it; the first message to the renderer.

    Attributes:
        config: What is rendered.
        files: Where the frames are stored.
        rate_hz: As for `RenderSchedule`.
        threads: Rendering threads.
        wake_fd: An eventfd that is written to after each frame.
    """

    config: SyntheticConfig
    files: SequenceFiles
    rate_hz: float
    threads: int
    wake_fd: int

    @property
    def fds(self) -> tuple[int, ...]:
        """The file descriptor of the eventfd."""
        return (self.wake_fd,)


@dataclass(frozen=True)
class ReaderPosition:
    """The reader needs this frame next."""

    index: int


@dataclass(frozen=True)
class RenderRequest:
    """The reader waits for this frame."""

    index: int


@dataclass(frozen=True)
class RenderingComplete:
    """No frame is missing."""
