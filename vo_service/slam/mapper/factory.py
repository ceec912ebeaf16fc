"""Opening the mapper, or what stands in for it where there is none."""

import logging

from drivers.core.errors import UserFacingError
from drivers.core.paths import state_folder
from vo_service.config_tables import MapConfig
from vo_service.types import Mapper, NullMapper

logger = logging.getLogger(__name__)


def open_mapper(settings: MapConfig) -> Mapper:
    """The mapper that the settings ask for. The service goes on without where it cannot be had."""
    if not settings.enabled:
        return NullMapper("the map is switched off (map.enabled)")
    # It compiles kernels: `kinect-vo --help` is spared them.
    from vo_service.slam.mapper.live_mapper import LiveMapper

    try:
        return LiveMapper(settings, state_folder() / "maps")
    except UserFacingError as error:
        reason = f"map: switched off: {error}"
    except OSError as error:
        reason = f"map: switched off: its memory cannot be had: {error.strerror}"
    logger.warning("%s", reason)
    return NullMapper(reason, reason)
