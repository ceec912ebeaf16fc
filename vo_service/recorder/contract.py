"""What the service asks of a flight recorder, and what stands in for one."""

from typing import Protocol

from vo_service.control.errors import CommandError, ErrorCode
from vo_service.outputs.output import Output, PoseUpdate, Status
from vo_service.settings import RecorderSettings


class Recorder(Output, Protocol):
    """An output that can write out what it remembers."""

    @property
    def recording(self) -> str:
        """Folder that is being recorded into; "" = none."""
        ...

    def save(self, reason: str) -> str:
        """Write the last seconds into a folder (soon), whose name is returned at once.

        Raises CommandError if that is not possible now.
        """
        ...

    def start_recording(self, name: str) -> str:
        """Record into a new folder of this name, which is returned with its path, at once.

        Raises CommandError if the name will not do, or if it is not possible now.
        """
        ...

    def stop_recording(self) -> str:
        """End the recording; its folder. Raises CommandError if there is none."""
        ...

    def configure(self, settings: RecorderSettings) -> None:
        """Take over what may change while it runs: `save_on_loss` and `total_mb`."""
        ...


class NoRecorder:
    """Where nothing is to be remembered, or nothing can be: says why to whoever asks."""

    recording = ""

    def __init__(self, reason: str = "there is no flight recorder", warning: str = "") -> None:
        self._reason = reason
        self.warning = warning

    def pose(self, update: PoseUpdate) -> None:
        """Nothing to remember."""

    def status(self, status: Status) -> None:
        """Nothing to remember."""

    def save(self, reason: str) -> str:
        """Never possible."""
        raise CommandError(ErrorCode.NOT_POSSIBLE, self._reason)

    def start_recording(self, name: str) -> str:
        """Never possible."""
        raise CommandError(ErrorCode.NOT_POSSIBLE, self._reason)

    def stop_recording(self) -> str:
        """Never possible."""
        raise CommandError(ErrorCode.NOT_POSSIBLE, self._reason)

    def configure(self, settings: RecorderSettings) -> None:
        """Nothing to change."""

    def close(self) -> None:
        """Nothing to release."""
