"""Reading of single messages, in almost any order, from a file that is best read in its own."""

from collections import OrderedDict
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.bag.bag_file import BagFile, Message, open_bag_file
from drivers.core.errors import InputError
from drivers.recording.images import UnreadableFrameError

MAX_RECENT_MESSAGES = 16
# A message farther ahead than this is looked up by the file's index.
MAX_SKIP_NS = 2_000_000_000


@dataclass(frozen=True)
class MessageKey:
    """Identity of a message: its topic, its log time, and its number among equal ones."""

    topic: str
    log_ns: int
    repeat: int


def number_messages(messages: Iterable[Message]) -> Iterator[tuple[MessageKey, Message]]:
    """Yield messages with their keys. The first log time must be complete."""
    last: dict[str, MessageKey] = {}
    for message in messages:
        before = last.get(message.topic)
        is_repeat = before is not None and before.log_ns == message.log_ns
        key = MessageKey(
            message.topic, message.log_ns, before.repeat + 1 if before and is_repeat else 0
        )
        last[message.topic] = key
        yield key, message


class MessageCursor:
    """Reads messages by key. Opens the file at the first read.

    Args:
        path: The file.
        topics: The topics to read.
    """

    def __init__(self, path: Path, topics: Collection[str]) -> None:
        self._path, self._topics = path, topics
        self._bag: BagFile | None = None
        self._stream: Iterator[tuple[MessageKey, Message]] = iter(())
        self._position_ns = 0
        self._recent: OrderedDict[MessageKey, Message] = OrderedDict()

    def read(self, key: MessageKey) -> Any:
        """Read and decode a message.

        Raises:
            UnreadableFrameError: It cannot be read, or no longer exists.
        """
        try:
            self._bag = self._bag or open_bag_file(self._path)
            if key not in self._recent:
                self._advance(self._bag, key)
            return self._bag.decode(self._recent[key])
        except InputError as error:
            raise UnreadableFrameError(str(error)) from error

    def _advance(self, bag: BagFile, key: MessageKey) -> None:
        if not self._position_ns <= key.log_ns <= self._position_ns + MAX_SKIP_NS:
            self._seek(bag, key.log_ns)
        if not self._read_until(key):
            self._seek(bag, key.log_ns)
            if not self._read_until(key):
                raise InputError(f"{self._path}: a message of {key.topic} is gone; reopen the file")

    def _seek(self, bag: BagFile, log_ns: int) -> None:
        self._recent.clear()
        self._stream = number_messages(bag.messages(self._topics, log_ns))
        self._position_ns = log_ns

    def _read_until(self, key: MessageKey) -> bool:
        for each, message in self._stream:
            self._position_ns = each.log_ns
            self._recent[each] = message
            if len(self._recent) > MAX_RECENT_MESSAGES:
                self._recent.popitem(last=False)
            if each == key:
                return True
        return False

    def close(self) -> None:
        """Close the file; the next read opens it again."""
        if self._bag is not None:
            self._bag.close()
        self._bag, self._stream, self._position_ns = None, iter(()), 0
        self._recent.clear()
