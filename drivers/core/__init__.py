"""What both packages use: errors, plug-ins, geometry, files, configuration, queues, processes."""

from drivers.core.errors import (
    CameraError,
    CameraLostError,
    CameraNotFoundError,
    InputError,
    UserFacingError,
)
from drivers.core.plugins import PluginGroup

__all__ = [
    "CameraError",
    "CameraLostError",
    "CameraNotFoundError",
    "InputError",
    "PluginGroup",
    "UserFacingError",
]
