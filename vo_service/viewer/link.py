"""The way to the viewer's process, which may be another one each time."""

from threading import Lock

from drivers.isolation.process import ChildProcess
from vo_service.viewer.messages import Message
from vo_service.viewer.wire import parts_of


class Link:
    """What is sent while there is no process is lost.

    A process that takes nothing blocks the sender, until it does or is killed.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._process: ChildProcess | None = None
        self._is_new = False

    @property
    def is_connected(self) -> bool:
        """Whether there is a process that is sent to."""
        return self._process is not None

    def connect(self, process: ChildProcess) -> None:
        """Send to this process from now on."""
        with self._lock:
            self._process, self._is_new = process, True

    def cut(self) -> None:
        """Send nowhere. Waits for a sender: kill a process that takes nothing before."""
        with self._lock:
            self._process = None

    def send(self, message: Message, first: Message) -> bool:
        """Send a message, before it `first` if the process is new. False if there is no process."""
        with self._lock:
            if self._process is None:
                return False
            if self._is_new:
                self._process.tell_parts(parts_of(first))
                self._is_new = False
            self._process.tell_parts(parts_of(message))
            return True
