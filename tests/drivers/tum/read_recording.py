"""What a recording holds, read back."""

from pathlib import Path

from drivers.camera import RgbdFrame
from drivers.playback.camera import RecordingCamera


def read_recording(path: Path) -> list[RgbdFrame]:
    """All frames of a recording."""
    with RecordingCamera(path) as camera:
        return list(camera)
