"""Previews of long work in Rerun: each is fed by a thread of its own and never holds the work up.

Rerun is an extra: it is imported only where a preview is asked for.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from drivers.camera import PlaybackMode
from drivers.core.queues import WorkerThread
from vo_service.outputs.rerun.targets import check_targets, make_sink, prepare_rerun

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

# For a viewer to take the last of its data.
CLOSE_TIMEOUT_S = 5.0

T = TypeVar("T")
T_contra = TypeVar("T_contra", contravariant=True)


class PreviewScene(Protocol[T_contra]):
    """Draws items into one recording stream."""

    def __init__(self, stream: "rr.RecordingStream") -> None: ...

    @staticmethod
    def blueprint() -> "rrb.Blueprint":
        """How the viewer is laid out."""
        ...

    def log(self, item: T_contra) -> None:
        """Draw one item."""
        ...


class RerunPreview(Generic[T]):
    """A preview in one Rerun target: a viewer gets the newest item, a file gets all.

    Raises InputError if Rerun is not installed or the target is none, UserFacingError if a port is
    taken.
    """

    def __init__(
        self, target: str, application: str, load_scene: Callable[[], type[PreviewScene[T]]]
    ) -> None:
        self._sink = make_sink(target)
        prepare_rerun()
        import rerun as rr

        # Rerun waits at exit until everything is sent, for ever if the viewer is frozen.
        rr.unregister_shutdown()
        scene_type = load_scene()
        stream = rr.RecordingStream(application)
        try:
            self._sink.attach(stream, scene_type.blueprint())
        except BaseException:
            self._sink.close()
            raise
        self.address = self._sink.address
        queue = self._sink.make_queue(PlaybackMode.LOCKSTEP)
        scene = scene_type(stream)
        self._worker: WorkerThread[T] = WorkerThread("rerun", queue, scene.log, stream.disconnect)

    def show(self, item: T) -> None:
        """Draw it; in a viewer, unless something newer comes first."""
        self._worker.put(item)

    def close(self) -> None:
        """Finish. A viewer that does not answer is left after a few seconds."""
        self._worker.close(CLOSE_TIMEOUT_S)
        self._sink.close()


@contextmanager
def open_previews(
    targets: Sequence[str],
    application: str,
    load_scene: Callable[[], type[PreviewScene[T]]],
    log_line: Callable[[str], None],
) -> Iterator[list[RerunPreview[T]]]:
    """Open a preview for each target; `tell` gets the addresses to open.

    Raises what `RerunPreview` raises, and InputError if two targets are the same place.
    """
    check_targets(targets)
    with ExitStack() as stack:
        previews = []
        for target in targets:
            preview = RerunPreview(target, application, load_scene)
            previews.append(stack.enter_context(closing(preview)))
            log_line(f"pictures: {preview.address}")
        yield previews
