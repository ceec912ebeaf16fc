"""What a recording holds, read back and compared."""

from pathlib import Path

import numpy as np

from drivers.camera import RgbdFrame
from drivers.playback.camera import RecordingCamera

# All that a recording keeps of a frame but its images.
KEPT_FIELDS = (
    "stamp_s",
    "skew_s",
    "readout_s",
    "timing_prior",
    "depth_factor",
    "camera",
    "gravity_m_s2",
)


def read_recording(path: Path) -> list[RgbdFrame]:
    """All frames of a recording."""
    with RecordingCamera(path) as camera:
        return list(camera)


def assert_same(ours: list[RgbdFrame], theirs: list[RgbdFrame]) -> None:
    """All that a recording keeps of the frames is the same to the last bit."""
    assert len(ours) == len(theirs) > 0
    for a, b in zip(ours, theirs, strict=True):
        for name in KEPT_FIELDS:
            assert getattr(a, name) == getattr(b, name), name
        np.testing.assert_array_equal(a.color_bgr, b.color_bgr)
        np.testing.assert_array_equal(a.depth_raw, b.depth_raw)
