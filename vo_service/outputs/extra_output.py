"""An output by name, which the service survives whatever it does."""

import logging
from collections.abc import Callable

from drivers.camera import PlaybackMode
from drivers.core import UserFacingError
from vo_service.config import OUTPUTS
from vo_service.types.messages import Status
from vo_service.types.odometry_update import OdometryUpdate
from vo_service.types.outputs import Output

logger = logging.getLogger(__name__)


class ExtraOutput:
    """An output of `OUTPUTS`. If it raises an error, it is switched off and `warning` has it.

    Args:
        source: NAME or NAME:ARGUMENT.
        playback_mode: For the output: in lockstep it may block.
    """

    def __init__(self, source: str, playback_mode: PlaybackMode) -> None:
        self._source, self._fault = source, ""
        self._output: Output | None = None
        name, _, argument = source.partition(":")
        self._guard(lambda: self._open(name, argument, playback_mode))

    @property
    def warning(self) -> str:
        """Why it is switched off, else the warning of the output."""
        return self._fault if self._output is None else self._output.warning

    def on_update(self, update: OdometryUpdate) -> None:
        """Pass the update on."""
        if self._output is not None:
            self._guard(self._output.on_update, update)

    def on_status(self, status: Status) -> None:
        """Pass the status on."""
        if self._output is not None:
            self._guard(self._output.on_status, status)

    def close(self) -> None:
        """Close the output. Raises UserFacingError if data was lost."""
        output, self._output = self._output, None
        if output is not None:
            output.close()

    def _open(self, name: str, argument: str, playback_mode: PlaybackMode) -> None:
        self._output = OUTPUTS[name](argument, playback_mode)

    def _guard(self, call: Callable[..., None], *arguments: OdometryUpdate | Status) -> None:
        try:
            call(*arguments)
        except Exception as error:
            text = str(error) if isinstance(error, UserFacingError) else repr(error)
            self._fault = f"output {self._source}: switched off: {text}"
            logger.warning("%s", self._fault)
            logger.debug("%s", self._source, exc_info=True)
            self._output = None
