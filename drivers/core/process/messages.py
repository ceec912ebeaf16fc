"""What the service and its worker processes send each other, and how."""

import pickle
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

from drivers.core import UserFacingError
from drivers.core.process.worker_spec import WorkerConfig, WorkerSpec

_COUNT_BYTES = 2


@dataclass(frozen=True)
class Shutdown:
    """To the worker, as the last message: finish and end."""


@dataclass(frozen=True)
class Heartbeat:
    """From the worker: it is alive and receives messages. A subclass may add its status."""

    @property
    def activity(self) -> str:
        """What the worker is doing, for the message if it hangs; "" = nothing special."""
        return ""

    @property
    def timeout_s(self) -> float | None:
        """How long until the next heartbeat at most; None = as the `WorkerSpec` says."""
        return None


@dataclass(frozen=True)
class LogMessage:
    """From the worker, for the log of the service."""

    level: int
    logger_name: str
    text: str


@dataclass(frozen=True)
class WorkerFailed:
    """From the worker, as the last message: an error that the user can understand ended it."""

    error: UserFacingError


def send_message(connection: "Connection[Any, Any]", message: object) -> None:
    """Send a message; its arrays are not copied into one buffer first. Raises OSError."""
    arrays: list[pickle.PickleBuffer] = []
    pickled = pickle.dumps(message, protocol=5, buffer_callback=arrays.append)
    connection.send_bytes(len(arrays).to_bytes(_COUNT_BYTES, "little") + pickled)
    for array in arrays:
        connection.send_bytes(array.raw())


def receive_message(connection: "Connection[Any, Any]") -> Any:
    """Wait for the next message.

    Raises:
        EOFError, OSError: The other process has ended.
    """
    head = connection.recv_bytes()
    count = int.from_bytes(head[:_COUNT_BYTES], "little")
    # A bytearray, so that the arrays can be written to, as after any other way to send them.
    arrays = [bytearray(connection.recv_bytes()) for _ in range(count)]
    return pickle.loads(head[_COUNT_BYTES:], buffers=arrays)


@dataclass(frozen=True)
class StartWorker:
    """The first message to a worker process; see `WorkerSpec`."""

    spec: WorkerSpec
    config: WorkerConfig
    log_level: int
