"""Connection to the viewer's process, which may be replaced by a new one."""

from threading import Lock

from drivers.core.process.worker_process import WorkerProcess
from vo_service.outputs.rerun.messages import RerunMessage
from vo_service.outputs.rerun.serialization import serialize


class WorkerConnection:
    """Sender of messages to the current process; without a process, messages are lost.

    A process that does not read blocks the sender until it reads or is killed.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._process: WorkerProcess | None = None
        self._is_new = False

    @property
    def is_connected(self) -> bool:
        """Whether there is a process to send to."""
        return self._process is not None

    def connect(self, process: WorkerProcess) -> None:
        """Send to this process from now on."""
        with self._lock:
            self._process, self._is_new = process, True

    def disconnect(self) -> None:
        """Drop the process. Waits for a sender, so kill a process that does not read first."""
        with self._lock:
            self._process = None

    def send(self, message: RerunMessage, initial_state: RerunMessage) -> bool:
        """Send a message; to a new process, send `initial_state` first.

        Returns:
            False if there is no process.
        """
        with self._lock:
            if self._process is None:
                return False
            if self._is_new:
                self._process.send_parts(serialize(initial_state))
                self._is_new = False
            self._process.send_parts(serialize(message))
            return True
