"""A simulated Kinect that plays a recording."""

from pathlib import Path

from tests.simulators.frame_sources import folder_frames, write_fitted_usb_frames
from tests.simulators.kinect_simulator import IDENTITY, KinectSimulator, LoopMode
from tests.vo_service.corner_sequence import make_corner_kinect, write_corner_frames


def make_kinect(folder: Path, recording: Path | None) -> KinectSimulator:
    """Make a Kinect that plays a recording, or a rendered corner, forwards and backwards.

    Args:
        folder: For its frames.
        recording: TUM folder; None: the corner.
    """
    if recording is None:
        return make_corner_kinect(folder, write_corner_frames(folder))
    frames = write_fitted_usb_frames(folder, folder_frames(recording))
    kinect = KinectSimulator(folder, frames, registration=IDENTITY)
    kinect.loop = LoopMode.THERE_AND_BACK
    return kinect
