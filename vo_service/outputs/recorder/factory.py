"""Opening the flight recorder, or what stands in for it where there is none."""

import logging
from collections.abc import Mapping

from drivers.core.errors import UserFacingError
from drivers.core.paths import state_folder
from vo_service.config_tables import RecorderConfig
from vo_service.types import NullRecorder, Recorder
from vo_service.versions import versions

logger = logging.getLogger(__name__)


def open_recorder(settings: RecorderConfig, config: Mapping[str, object]) -> Recorder:
    """The recorder that the settings ask for. The service goes on without where it cannot be had.

    `config` of the service goes into each incident as JSON, beside the versions.
    """
    if not settings.enabled:
        return NullRecorder("the recorder is switched off (recorder.enabled)")
    # It compiles kernels: `kinect-vo --help` is spared them.
    from vo_service.outputs.recorder.flight_recorder import FlightRecorder

    about = {"versions": versions(), "config": config}
    try:
        return FlightRecorder(settings, state_folder(), about)
    except UserFacingError as error:
        reason = f"recorder: switched off: {error}"
    except OSError as error:
        reason = f"recorder: switched off: its memory cannot be had: {error.strerror}"
    logger.warning("%s", reason)
    return NullRecorder(reason, reason)
