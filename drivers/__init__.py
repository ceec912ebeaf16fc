"""Cameras that deliver color and registered depth. Knows nothing of odometry.

    from drivers import open_camera

    with open_camera("tum:recordings/desk") as camera:
        for frame in camera:
            print(frame.stamp_s, frame.color_bgr.shape, frame.depth_m.max())

`docs/guide/python.md` shows more. OpenCV is imported when the first of these names is used.
"""

from importlib import import_module
from typing import TYPE_CHECKING

__all__ = [
    "CameraError",
    "CameraLostError",
    "CameraNotFoundError",
    "EndOfStream",
    "FrameTimeout",
    "InputError",
    "Led",
    "PinholeCamera",
    "PlaybackMode",
    "RgbdCamera",
    "RgbdFrame",
    "SensorConfig",
    "SyntheticConfig",
    "open_camera",
]

if TYPE_CHECKING:
    from drivers.camera import (
        EndOfStream,
        FrameTimeout,
        Led,
        PinholeCamera,
        PlaybackMode,
        RgbdCamera,
        RgbdFrame,
        SensorConfig,
    )
    from drivers.core import CameraError, CameraLostError, CameraNotFoundError, InputError
    from drivers.registry import open_camera
    from drivers.synthetic import SyntheticConfig

# Where each name is; mypy and editors see the imports above instead.
_MODULES = {
    "CameraError": "drivers.core",
    "CameraLostError": "drivers.core",
    "CameraNotFoundError": "drivers.core",
    "EndOfStream": "drivers.camera",
    "FrameTimeout": "drivers.camera",
    "InputError": "drivers.core",
    "Led": "drivers.camera",
    "PinholeCamera": "drivers.camera",
    "PlaybackMode": "drivers.camera",
    "RgbdCamera": "drivers.camera",
    "RgbdFrame": "drivers.camera",
    "SensorConfig": "drivers.camera",
    "SyntheticConfig": "drivers.synthetic",
    "open_camera": "drivers.registry",
}

if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        """Import a public name when it is first used (PEP 562)."""
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return __all__
