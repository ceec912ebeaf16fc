"""A short sequence on which the odometry works, for a Kinect: a walk past a corner, and back."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array, rigid_transform, so3_exp
from tests.simulators.kinect_simulator import IDENTITY, KinectModel, KinectSimulator, LoopMode
from tests.simulators.usb_frames import UsbFrames, write_usb_frames
from tests.vo_service.odometry.synthetic_views import render_corner

# What a Kinect without a camera file is taken for.
CAMERA = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)
FRAMES = 12
RATE_HZ = 25.0


def corner_pose(seq: int) -> Array:
    """T_world_camera of frame `seq`: 15 mm and a third of a degree from the one before."""
    turn = so3_exp([0.002 * seq, 0.004 * seq, -0.003 * seq])
    return rigid_transform(turn, [0.01 * seq, -0.004 * seq, 0.01 * seq])


def corner_frames(count: int = FRAMES) -> Iterator[RgbdFrame]:
    """What a Kinect there would see, before its own encoding.

    Depth is in whole millimetres and stamps in whole microseconds: every recording holds the same.
    """
    for seq in range(count):
        view = render_corner(corner_pose(seq), seq, CAMERA)
        depth_mm = np.rint(view.depth_m * 1000.0).astype(np.uint16)
        yield RgbdFrame(
            seq, seq / RATE_HZ, 0.0, view.color_bgr, depth_mm, depth_factor=1000.0, camera=CAMERA
        )


def write_corner_frames(folder: Path, count: int = FRAMES) -> UsbFrames:
    """The sequence of these frames."""
    return write_usb_frames(folder, ((f.color_bgr, f.depth_raw) for f in corner_frames(count)))


def make_corner_kinect(
    folder: Path, sequence: UsbFrames, model: KinectModel = KinectModel.K1414
) -> KinectSimulator:
    """A Kinect that plays it for ever, without a jump."""
    kinect = KinectSimulator(folder, sequence, model, registration=IDENTITY)
    kinect.loop = LoopMode.THERE_AND_BACK
    return kinect
