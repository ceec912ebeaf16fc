"""Serialization of messages with images, without a copy on the sender's side."""

import pickle
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

from vo_service.outputs.rerun.messages import RerunMessage

_COUNT_BYTES = 2


def serialize(message: RerunMessage) -> Iterator[bytes | memoryview]:
    """Yield the parts to send: the number of arrays with the pickled message, then each array."""
    arrays: list[pickle.PickleBuffer] = []
    pickled = pickle.dumps(message, protocol=5, buffer_callback=arrays.append)
    yield len(arrays).to_bytes(_COUNT_BYTES, "little") + pickled
    for array in arrays:
        yield array.raw()


def receive_message(connection: "Connection[Any, Any]") -> RerunMessage:
    """Receive the next message, with read-only arrays. Raises EOFError or OSError at the end."""
    head = connection.recv_bytes()
    count = int.from_bytes(head[:_COUNT_BYTES], "little")
    arrays = [connection.recv_bytes() for _ in range(count)]
    message: RerunMessage = pickle.loads(head[_COUNT_BYTES:], buffers=arrays)
    return message
