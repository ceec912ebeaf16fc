"""Opening the flight recorder, or what stands in for it where there is none."""

import logging
from collections.abc import Callable, Mapping
from typing import Protocol

from drivers.errors import UserFacingError
from vo_service.control.errors import CommandError, ErrorCode
from vo_service.folders import state_folder
from vo_service.outputs.output import Output, PoseUpdate, Status
from vo_service.outputs.zenoh_messages import versions
from vo_service.recorder.recorder import FlightRecorder
from vo_service.settings import RecorderSettings

logger = logging.getLogger(__name__)


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

    def __init__(self, reason: str, warning: str = "") -> None:
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


def open_recorder(
    settings: RecorderSettings,
    config: Mapping[str, object],
    readout_s: Callable[[], float] = lambda: 0.0,
) -> Recorder:
    """The recorder that the settings ask for. The service goes on without where it cannot be had.

    config     of the service: goes into each incident as JSON, beside the versions
    readout_s  tells the camera's rolling shutter: seconds from the first row to the last
    """
    if not settings.enabled:
        return NoRecorder("the recorder is switched off (recorder.enabled)")
    about = {"versions": versions(), "config": config}
    try:
        return FlightRecorder(settings, state_folder(), about, readout_s)
    except UserFacingError as error:
        reason = f"recorder: switched off: {error}"
    except OSError as error:
        reason = f"recorder: switched off: its memory cannot be had: {error.strerror}"
    logger.warning("%s", reason)
    return NoRecorder(reason, reason)
