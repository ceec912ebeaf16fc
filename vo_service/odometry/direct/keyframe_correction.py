"""Frames and keyframes with another calibration than the one that they tell or were made with.

A calibration (3,) corrects what frames tell: readout and delay, s, and the logarithm of the focal
length. The points of a keyframe are moved to where another calibration sees them, to first order:
to make them anew takes forty times as long.
"""

from copy import copy
from dataclasses import replace
from math import exp

import numpy as np

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array
from drivers.core.jit import kernel
from vo_service.odometry.direct.image_pyramid import ImageTiming
from vo_service.odometry.direct.keyframe import DirectKeyframe
from vo_service.odometry.direct.motion import propagate_motion, propagate_point, row_time
from vo_service.odometry.direct.points import Points, drop_empty_levels

# Every point of this many is enough to compare calibrations.
SPARSE_STRIDE = 4


def correct_camera(camera: PinholeCamera, calibration: Array) -> PinholeCamera:
    """Return a camera with the focal length corrected by a calibration (3,)."""
    if calibration[2] == 0.0:
        return camera
    scale = exp(calibration[2])
    return replace(camera, fx=scale * camera.fx, fy=scale * camera.fy)


def correct_shutter(told: ImageTiming, calibration: Array) -> ImageTiming:
    """Return the timing of images, corrected by a calibration; the readout is at least zero."""
    readout_s, skew_s = calibration[:2].tolist()
    return ImageTiming(max(told.readout_s + readout_s, 0.0), told.skew_s + skew_s)


def told_shutter(frame: RgbdFrame) -> ImageTiming:
    """Timing of images that a frame tells."""
    return ImageTiming(frame.readout_s, frame.skew_s)


def correct_frame(frame: RgbdFrame, calibration: Array) -> RgbdFrame:
    """Return a frame with a calibration (3,)."""
    if not calibration.any():
        return frame
    shutter = correct_shutter(told_shutter(frame), calibration)
    camera = correct_camera(frame.camera, calibration)
    # `replace` would check all of the depth again, which takes 0.1 ms.
    corrected = copy(frame)
    vars(corrected).update(camera=camera, readout_s=shutter.readout_s, skew_s=shutter.skew_s)
    return corrected


def correct_keyframe(
    keyframe: DirectKeyframe,
    camera: PinholeCamera,
    shutter: ImageTiming,
    motion: Array,
    stride: int = 1,
) -> DirectKeyframe:
    """Return a keyframe as another calibration and another motion of its camera make it.

    Args:
        keyframe: The keyframe.
        camera: Intrinsics of the whole size.
        shutter: Times of the rows.
        motion: (9,) of the camera in its own axes.
        stride: Every point of this many is kept.
    """
    old = keyframe.images
    before = np.array([old.shutter.readout_s, old.shutter.skew_s, *keyframe.motion])
    after = np.array([shutter.readout_s, shutter.skew_s, *motion])
    shape = np.array([old.camera.fy, old.camera.cy, old.camera.height, old.camera.fx / camera.fx])
    kept = (level.select(slice(None, None, stride)) for level in keyframe.points)
    points = drop_empty_levels(
        level._replace(position_m=_correct_positions(level, shape, before, after)) for level in kept
    )
    images = replace(old, camera=camera, shutter=shutter)
    return replace(keyframe, points=points, images=images, motion=motion)


@kernel
def _correct_positions(points: Points, shape: Array, before: Array, after: Array) -> Array:
    """(3, N) positions of points, m, with the timing `after` instead of `before`.

    Args:
        points: Of a keyframe level.
        shape: (4,) fy, cy and height of the image; ratio of the focal length before to that after.
        before: (11,) readout, delay and motion of the camera (9,).
        after: (11,), see before.
    """
    position_m, gradient = points.position_m, points.depth_gradient
    corrected = np.empty_like(position_m)
    fy, cy, height, magnified = shape[0], shape[1], int(shape[2]), shape[3]
    motion, motion_after = before[2:], after[2:]
    for n in range(len(points.brightness)):
        x, y, z = position = position_m[0, n], position_m[1, n], position_m[2, n]
        # As the color row saw the point; depth was read later, and is that of another place.
        row_x, row_y, row_z = x, y, z
        for _ in range(2):
            tau = row_time(fy * row_y / row_z + cy, height, before[0])
            row_x, row_y, row_z = propagate_point(motion, x, y, z, tau)
        w = 1.0 / row_z
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            spin = motion[3 + a] * position[b] - motion[3 + b] * position[a]
            spin_after = motion_after[3 + a] * position[b] - motion_after[3 + b] * position[a]
            w -= gradient[k, n] * after[1] * (motion_after[k] + spin_after)
            w += gradient[k, n] * before[1] * (motion[k] + spin)
        if w > 0.0:
            row_x, row_y, row_z = row_x / (row_z * w), row_y / (row_z * w), 1.0 / w
        tau = row_time(fy * row_y / row_z + cy, height, after[0])
        row_x, row_y = row_x * magnified, row_y * magnified
        now = propagate_motion(motion_after, tau)
        x, y, z = propagate_point(now, row_x, row_y, row_z, -tau)
        corrected[0, n], corrected[1, n], corrected[2, n] = x, y, z
    return corrected
