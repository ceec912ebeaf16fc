"""The way to the viewer's process, which may be another one each time."""

from threading import Lock

from drivers.core.process.worker_process import WorkerProcess
from vo_service.outputs.rerun.messages import RerunMessage
from vo_service.outputs.rerun.serialization import serialize


class WorkerConnection:
    """What is sent while there is no process is lost.

    A process that takes nothing blocks the sender, until it does or is killed.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._process: WorkerProcess | None = None
        self._is_new = False

    @property
    def is_connected(self) -> bool:
        """Whether there is a process that is sent to."""
        return self._process is not None

    def connect(self, process: WorkerProcess) -> None:
        """Send to this process from now on."""
        with self._lock:
            self._process, self._is_new = process, True

    def disconnect(self) -> None:
        """Send nowhere. Waits for a sender: kill a process that takes nothing before."""
        with self._lock:
            self._process = None

    def send(self, message: RerunMessage, initial_state: RerunMessage) -> bool:
        """Send a message, before it `first` if the process is new. False if there is no process."""
        with self._lock:
            if self._process is None:
                return False
            if self._is_new:
                self._process.send_parts(serialize(initial_state))
                self._is_new = False
            self._process.send_parts(serialize(message))
            return True
