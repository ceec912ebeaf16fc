"""Previews of long computations in Rerun; each has its own thread and never delays the work.

Rerun is an extra: it is imported only if a preview is opened.
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

# Longest wait, at the end, for a viewer to take its last data.
CLOSE_TIMEOUT_S = 5.0

T = TypeVar("T")
T_contra = TypeVar("T_contra", contravariant=True)


class PreviewScene(Protocol[T_contra]):
    """Draws items into one recording stream."""

    def __init__(self, stream: "rr.RecordingStream") -> None: ...

    @staticmethod
    def blueprint() -> "rrb.Blueprint":
        """Return the viewer's layout."""
        ...

    def log(self, item: T_contra) -> None:
        """Draw one item."""
        ...


class RerunPreview(Generic[T]):
    """Preview in one Rerun target: a viewer gets the newest item, a file gets all.

    Args:
        target: One of serve, connect, connect:HOST:PORT or FILE.rrd.
        application: Rerun's application id.
        load_scene: Imports and returns the class that draws items.

    Raises:
        InputError: Rerun is not installed, or the target is invalid.
        PortTakenError: A port is in use.
    """

    def __init__(
        self, target: str, application: str, load_scene: Callable[[], type[PreviewScene[T]]]
    ) -> None:
        self._sink = make_sink(target)
        prepare_rerun()
        import rerun as rr

        # At exit, Rerun waits until everything is sent: forever if the viewer is frozen.
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
        """Queue an item; for a viewer, a newer item replaces it."""
        self._worker.put(item)

    def close(self) -> None:
        """Finish drawing; wait at most a few seconds for a frozen viewer."""
        self._worker.close(CLOSE_TIMEOUT_S)
        self._sink.close()


@contextmanager
def open_previews(
    targets: Sequence[str],
    application: str,
    load_scene: Callable[[], type[PreviewScene[T]]],
    log_line: Callable[[str], None],
) -> Iterator[list[RerunPreview[T]]]:
    """Open a preview for each target.

    Args:
        targets: As for `RerunPreview`.
        application: Rerun's application id.
        load_scene: Imports and returns the class that draws items.
        log_line: Called with the address of each preview.

    Raises:
        InputError: As `RerunPreview`, or two targets are the same.
        PortTakenError: As `RerunPreview`.
    """
    check_targets(targets)
    with ExitStack() as stack:
        previews = []
        for target in targets:
            preview = RerunPreview(target, application, load_scene)
            previews.append(stack.enter_context(closing(preview)))
            log_line(f"Rerun: {preview.address}")
        yield previews
