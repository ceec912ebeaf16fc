"""Factory of the mapper."""

import logging

from drivers.core.errors import UserFacingError
from drivers.core.paths import state_folder
from vo_service.config_tables import MapConfig
from vo_service.types import Mapper, NullMapper

logger = logging.getLogger(__name__)


def open_mapper(settings: MapConfig) -> Mapper:
    """Open the mapper of the settings; a `NullMapper` if it is disabled or fails."""
    if not settings.enabled:
        return NullMapper("the map is disabled (map.enabled)")
    # This import compiles kernels, which `kinect-vo --help` does not need.
    from vo_service.slam.mapper.live_mapper import LiveMapper

    try:
        return LiveMapper(settings, state_folder() / "maps")
    except UserFacingError as error:
        reason = f"map: disabled: {error}"
    except OSError as error:
        reason = f"map: disabled: no shared memory: {error.strerror}"
    logger.warning("%s", reason)
    return NullMapper(reason, reason)
