"""A configuration that was read again, on its way to the loop."""

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from drivers.errors import CameraError
from vo_service.config import Config
from vo_service.reload import Changes

# How each key that may change while the service runs is applied; see `reload.LIVE_KEYS`.
Appliers = Mapping[str, Callable[[Config], None]]

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Reconfigure:
    """Apply what has changed. Only the program itself sends it."""

    changes: Changes

    def apply(self, appliers: Appliers) -> None:
        """Call each applier that is concerned, once; what a camera says to it is logged."""
        for apply in dict.fromkeys(appliers[key] for key in self.changes.live):
            try:
                apply(self.changes.config)
            except CameraError as error:
                logger.warning("%s", error)
