"""Plays a fakenect dump in a process of its own: FOLDER, PACE, and the file to save it in.

fakenect ends the process where it does not like a dump, and takes libfreenect's name.
"""

import sys
from pathlib import Path

import numpy as np

from drivers.camera import PlaybackMode, RgbdCamera, RgbdFrame
from drivers.core import InputError
from drivers.freenect.camera import make_fakenect_camera


def read_all_frames(camera: RgbdCamera) -> list[RgbdFrame]:
    """Every frame up to the end."""
    with camera:
        return list(camera)


if __name__ == "__main__":
    try:
        _camera = make_fakenect_camera(Path(sys.argv[1]), None, PlaybackMode(sys.argv[2]))
        _frames = read_all_frames(_camera)
        _again = read_all_frames(_camera)
    except InputError as error:
        sys.exit(f"InputError: {error}")
    np.savez(
        sys.argv[3],
        color=[frame.color_bgr for frame in _frames],
        depth=[frame.depth_raw for frame in _frames],
        stamp_s=[frame.stamp_s for frame in _frames],
        device_stamp_s=np.array([frame.device_stamp_s for frame in _frames], dtype=float),
        skew_s=[frame.skew_s for frame in _frames],
        seq=[frame.seq for frame in _frames],
        again=len(_again),
    )
