"""Creation of the flight recorder, or of a null recorder if it is off or fails."""

import logging
from collections.abc import Mapping

from drivers.core.errors import UserFacingError
from drivers.core.paths import state_folder
from vo_service.config_tables import RecorderConfig
from vo_service.types import NullRecorder, Recorder
from vo_service.versions import versions

logger = logging.getLogger(__name__)


def open_recorder(settings: RecorderConfig, config: Mapping[str, object]) -> Recorder:
    """Create the configured recorder; if that fails, a null recorder, so the service still runs.

    Args:
        settings: the recorder's settings.
        config: the service's configuration, copied into each incident with the versions.
    """
    if not settings.enabled:
        return NullRecorder("the recorder is switched off (recorder.enabled)")
    # Imported here because it compiles kernels, which `kinect-vo --help` does not need.
    from vo_service.outputs.recorder.flight_recorder import FlightRecorder

    service_info = {"versions": versions(), "config": config}
    try:
        return FlightRecorder(settings, state_folder(), service_info)
    except UserFacingError as error:
        reason = f"recorder: switched off: {error}"
    except OSError as error:
        reason = f"recorder: switched off: cannot allocate its memory: {error.strerror}"
    logger.warning("%s", reason)
    return NullRecorder(reason, reason)
