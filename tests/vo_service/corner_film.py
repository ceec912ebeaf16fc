"""A short film on which the odometry works, for a Kinect: a walk past a corner, and back."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.geometry import Array, rigid_transform, rotation_from_vector
from tests.stand_ins.played_kinect import IDENTITY, Loop, Model, PlayedKinect
from tests.stand_ins.wire_film import WireFilm, wire_film
from tests.vo_service.odometry.synthetic_views import view_of_a_corner

# What a Kinect without a camera file is taken for.
CAMERA = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)
FRAMES = 12


def corner_pose(seq: int) -> Array:
    """T_world_camera of frame `seq`: 15 mm and a third of a degree from the one before."""
    turn = rotation_from_vector([0.002 * seq, 0.004 * seq, -0.003 * seq])
    return rigid_transform(turn, [0.01 * seq, -0.004 * seq, 0.01 * seq])


def corner_frames(count: int = FRAMES) -> Iterator[RgbdFrame]:
    """What a Kinect there would see, before its own encoding; depth in whole millimetres."""
    for seq in range(count):
        view = view_of_a_corner(corner_pose(seq), seq, CAMERA)
        depth_mm = np.rint(view.depth_m * 1000.0).astype(np.uint16)
        yield RgbdFrame(
            seq, view.stamp_s, 0.0, view.colour_bgr, depth_mm, depth_factor=1000.0, camera=CAMERA
        )


def corner_film(folder: Path, count: int = FRAMES) -> WireFilm:
    """The film of these frames."""
    return wire_film(folder, ((f.colour_bgr, f.depth_raw) for f in corner_frames(count)))


def corner_kinect(folder: Path, film: WireFilm, model: Model = Model.K1414) -> PlayedKinect:
    """A Kinect that plays it for ever, without a jump."""
    kinect = PlayedKinect(folder, film, model, registration=IDENTITY)
    kinect.loop = Loop.THERE_AND_BACK
    return kinect
