"""Corruptions of pieces of a recording, like those of a live camera."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, so3_exp

Frames = list[RgbdFrame]
Image = NDArray[np.integer[Any]]
FrameTransform = Callable[[Frames], Frames]  # the corrupted frames, perhaps fewer

BLUR_SAMPLES = 9  # views within the exposure that are averaged for motion blur


@dataclass(frozen=True)
class SwingMotion:
    """A swing about the camera's own axes: to one side, back, and to the other side.

    Attributes:
        furthest_rad: (3,) rotation vector of the largest deviation.
    """

    max_rotation_rad: tuple[float, float, float]
    rate_hz: float
    exposure_s: float

    def rotation_at(self, time_s: float) -> Array:
        """R_mounting_camera, 3x3."""
        furthest_rad = np.array(self.max_rotation_rad)
        return so3_exp(furthest_rad * np.sin(2 * np.pi * self.rate_hz * time_s))


@dataclass(frozen=True)
class FrameCorruption:
    """A corruption of `pieces` evenly spread pieces of `frames` frames each."""

    corrupt: FrameTransform
    frames: int
    pieces: int

    def apply(self, frames: Frames) -> Frames:
        """Return the frames with corrupted pieces; frames between the pieces do not change."""
        out: Frames = []
        begin = 0
        for n in range(self.pieces):
            first = (2 * n + 1) * len(frames) // (2 * self.pieces) - self.frames // 2
            last = first + self.frames
            out += frames[begin:first] + self.corrupt(frames[first:last])
            begin = last
        return out + frames[begin:]


def blacken(piece: Frames) -> Frames:
    """Make color black; depth needs no light."""
    return [replace(f, color_bgr=np.zeros_like(f.color_bgr)) for f in piece]


def freeze(piece: Frames) -> Frames:
    """Repeat the first images with new stamps."""
    first = piece[0]
    return [replace(f, color_bgr=first.color_bgr, depth_raw=first.depth_raw) for f in piece]


def replace_with_noise(piece: Frames) -> Frames:
    """Replace color and depth by noise."""
    return [_noise_frame(f) for f in piece]


def remove(piece: Frames) -> Frames:
    """Remove all frames."""
    return piece[:0]


def add_swing(piece: Frames, motion: SwingMotion) -> Frames:
    """Swing the camera and return it, with motion blur."""
    begin_s = piece[0].stamp_s
    return [_rotate(f, motion, f.stamp_s - begin_s) for f in piece]


def _noise_frame(frame: RgbdFrame) -> RgbdFrame:
    random = np.random.default_rng(frame.seq)
    shape = frame.color_bgr.shape
    gray = random.integers(0, 256, (*shape[:2], 1), np.uint8)
    farthest = int(5.0 * frame.depth_factor)
    return replace(
        frame,
        color_bgr=np.repeat(gray, 3, axis=2),
        depth_raw=random.integers(0, farthest, shape[:2]).astype(np.uint16),
    )


def _rotate(frame: RgbdFrame, swing: SwingMotion, time_s: float) -> RgbdFrame:
    exposed_s = time_s + swing.exposure_s * np.linspace(-0.5, 0.5, BLUR_SAMPLES)
    shots = [
        _warp(frame.color_bgr, frame, swing.rotation_at(t), cv2.INTER_LINEAR) for t in exposed_s
    ]
    R = swing.rotation_at(time_s)
    depth = _warp(frame.depth_raw, frame, R, cv2.INTER_NEAREST)
    return replace(
        frame,
        color_bgr=np.mean(shots, axis=0).astype(np.uint8),
        depth_raw=np.rint(depth * _depth_scale(frame, R)).astype(np.uint16),
    )


def _warp(image: Image, frame: RgbdFrame, R: Array, interpolation: int) -> Image:
    """Warp an image to the view of the rotated camera, by its pixel rays rotated back."""
    K = frame.camera.K
    size = frame.camera.width, frame.camera.height
    flags = interpolation | cv2.WARP_INVERSE_MAP
    mapping = K @ R @ np.linalg.inv(K)
    return np.asarray(cv2.warpPerspective(image, mapping, size, flags=flags))


def _depth_scale(frame: RgbdFrame, R: Array) -> Array:
    """Depth (H, W) along the rotated camera's axis of one meter along the original axis."""
    camera = frame.camera
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    share: Array = 1.0 / (R[2, 0] * x[None, :] + R[2, 1] * y[:, None] + R[2, 2])
    return share


# A push against the robot: at most 14 degrees per frame.
SHAKE = SwingMotion((0.15, 0.4, 0.1), rate_hz=2.75, exposure_s=0.012)
# A turn to both sides in a dim room: at most 4 degrees per frame.
PAN = SwingMotion((0.15, 0.7, 0.1), rate_hz=0.5, exposure_s=0.025)

CORRUPTIONS: Mapping[str, FrameCorruption] = {
    "black 0.5 s": FrameCorruption(blacken, 15, 4),
    "frozen 0.5 s": FrameCorruption(freeze, 15, 4),
    "noise 0.5 s": FrameCorruption(replace_with_noise, 15, 4),
    "shaken 1 s": FrameCorruption(partial(add_swing, motion=SHAKE), 30, 3),
    "panned 2 s": FrameCorruption(partial(add_swing, motion=PAN), 60, 2),
    "missing 0.5 s": FrameCorruption(remove, 15, 4),
    "missing 1 s": FrameCorruption(remove, 30, 3),
    "missing 2 s": FrameCorruption(remove, 60, 2),
    "missing 3 s": FrameCorruption(remove, 90, 1),
}
