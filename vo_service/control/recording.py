"""What the commands need of whoever keeps frames."""

from typing import NoReturn, Protocol

from vo_service.control.errors import CommandError, ErrorCode


class Recorder(Protocol):
    """Keeps the last seconds of frames, and records on request. Never blocks the caller."""

    @property
    def recording(self) -> str:
        """Folder that is being recorded into; "" = none."""
        ...

    def start_recording(self, name: str) -> str:
        """Record into a new folder, which is the answer. Raises CommandError."""
        ...

    def stop_recording(self) -> str:
        """End that; the answer is the folder. Raises CommandError."""
        ...

    def save(self, reason: str) -> str:
        """Write out the last seconds; the answer is the folder. Raises CommandError."""
        ...


class NoRecorder:
    """Where no frames are kept."""

    recording = ""

    def start_recording(self, name: str) -> str:
        """See `Recorder`."""
        _refuse()

    def stop_recording(self) -> str:
        """See `Recorder`."""
        _refuse()

    def save(self, reason: str) -> str:
        """See `Recorder`."""
        _refuse()


def _refuse() -> NoReturn:
    raise CommandError(
        ErrorCode.NOT_POSSIBLE, "there is no flight recorder; set recorder.enabled = true"
    )
