"""An output that writes a file from a thread of its own, and reports what is missing in it."""

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Generic, TypeVar

from drivers.core import UserFacingError
from drivers.core.queues import BoundedQueue, WorkerThread
from vo_service.outputs.write_fault import WriteFault

T = TypeVar("T")


class FileOutput(ABC, Generic[T]):
    """Base of an output whose thread takes items from a queue and writes them.

    Args:
        path: The file.
        name: What the file is, for messages: "trajectory".
        items: What it holds: "poses".
        close_timeout_s: Longest wait for the thread at the end.
    """

    def __init__(self, path: Path, name: str, items: str, close_timeout_s: float) -> None:
        self._path, self._name, self._items = path, name, items
        self._close_timeout_s = close_timeout_s
        self._fault = WriteFault()
        self._worker: WorkerThread[T]

    def _start(self, thread_name: str, queue: BoundedQueue[T]) -> None:
        """Start the thread; the queue blocks or drops if the disk is slow."""
        self._worker = WorkerThread(thread_name, queue, self._write, self._finish)

    @abstractmethod
    def _write(self, item: T) -> None:
        """Write an item, on the thread."""

    @abstractmethod
    def _finish(self) -> None:
        """Complete the file, on the thread."""

    @property
    def warning(self) -> str:
        """Why the file is incomplete; "" while it is complete."""
        if not (fault := str(self._fault)) and self._worker.dropped:
            return f"{self._path}: the disk is too slow; {self._items} are missing"
        return fault

    def close(self) -> None:
        """Complete the file. Raises UserFacingError, once, if it is incomplete."""
        has_ended = self._worker.close(self._close_timeout_s)
        error, self._fault.data_loss = self._fault.data_loss, None
        if error is not None:
            raise UserFacingError(f"{self._path}: the {self._name} is incomplete") from error
        if not has_ended:
            raise UserFacingError(
                f"{self._path}: the disk hangs; the end of the {self._name} is lost"
            )
