"""From a pair of image files to the frame that odometry sees."""

import time

from drivers.camera import RgbdFrame
from drivers.tum.decode import load_pair
from drivers.tum.folder import TumFolder
from drivers.tum.lists import FramePair
from drivers.undistort import undistorter


class FrameReader:
    """Reads the frames of one folder, in any order."""

    def __init__(self, folder: TumFolder) -> None:
        self._folder = folder
        camera = folder.camera_file
        self._pinhole = camera.pinhole
        self._lens = undistorter(self._pinhole, camera.distortion)

    def read(self, pair: FramePair, seq: int) -> RgbdFrame:
        """Load, undistort and stamp one pair. Raises UnreadableFrameError."""
        camera = self._folder.camera_file
        colour, depth = load_pair(pair, (camera.width, camera.height))
        return RgbdFrame(
            seq=seq,
            stamp_s=pair.colour.stamp_s,
            arrival_s=time.monotonic(),
            colour_bgr=self._lens.colour(colour),
            depth_raw=self._lens.depth(depth),
            depth_factor=camera.depth_factor,
            camera=self._pinhole,
            skew_s=pair.skew_s + camera.depth_offset_s,
            gravity_m_s2=self._folder.gravity.at(pair.colour.stamp_s),
            readout_s=camera.readout_s,
        )
