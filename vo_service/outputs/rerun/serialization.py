"""Messages with images in them, from process to process, without a copy on the sender's side."""

import pickle
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

from vo_service.outputs.rerun.messages import RerunMessage

_COUNT_BYTES = 2


def serialize(message: RerunMessage) -> Iterator[bytes | memoryview]:
    """What to send one after another: the message with how many arrays it has, then these."""
    arrays: list[pickle.PickleBuffer] = []
    text = pickle.dumps(message, protocol=5, buffer_callback=arrays.append)
    yield len(arrays).to_bytes(_COUNT_BYTES, "little") + text
    for array in arrays:
        yield array.raw()


def receive_message(connection: "Connection[Any, Any]") -> RerunMessage:
    """Wait for the next message; its arrays are read-only. Raises EOFError, OSError at the end."""
    head = connection.recv_bytes()
    count = int.from_bytes(head[:_COUNT_BYTES], "little")
    arrays = [connection.recv_bytes() for _ in range(count)]
    message: RerunMessage = pickle.loads(head[_COUNT_BYTES:], buffers=arrays)
    return message
