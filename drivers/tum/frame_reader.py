"""Reading of frames from pairs of image files."""

import time

from drivers.camera import RgbdFrame
from drivers.rectify import make_undistorter
from drivers.tum.decode import load_pair
from drivers.tum.folder import TumFolder
from drivers.tum.index_files import FramePair


class TumFrameReader:
    """Reads the frames of one folder, in any order."""

    def __init__(self, folder: TumFolder) -> None:
        self._folder = folder
        camera = folder.calibration
        self._pinhole = camera.pinhole
        self._undistorter = make_undistorter(self._pinhole, camera.distortion)

    def read(self, pair: FramePair, seq: int) -> RgbdFrame:
        """Load, undistort and stamp one pair. Raises UnreadableFrameError."""
        camera = self._folder.calibration
        color, depth = load_pair(pair, (camera.width, camera.height))
        return RgbdFrame(
            seq=seq,
            stamp_s=pair.color.stamp_s,
            receive_time_s=time.monotonic(),
            color_bgr=self._undistorter.undistort_color(color),
            depth_raw=self._undistorter.undistort_depth(depth),
            depth_factor=camera.depth_factor,
            camera=self._pinhole,
            skew_s=pair.skew_s + camera.depth_offset_s,
            gravity_m_s2=self._folder.gravity.mean_at(pair.color.stamp_s),
            readout_s=camera.readout_s,
        )
