"""What a recording holds, read back."""

from pathlib import Path

from drivers.camera import EndOfStream, RgbdFrame
from drivers.playback.camera import RecordingCamera


def read_recording(folder: Path) -> list[RgbdFrame]:
    """All frames of a recorded folder."""
    frames = []
    with RecordingCamera(folder) as camera:
        while True:
            try:
                frames.append(camera.read(10))
            except EndOfStream:
                return frames
