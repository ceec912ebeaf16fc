"""Virtual depth cameras of four kinds, as TUM folders with exact ground truth.

Each seed is another room, motion, rolling shutter and sensor. The kinds take turns: structured
light (the virtual Kinect itself), stereo, near range and time of flight. Complete folders are not
rendered again; each takes about 20 seconds of a core.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.rendered_sequences import VirtualRecording
from drivers.camera import RgbdFrame
from drivers.core.geometry import Trajectory
from drivers.synthetic.config import MotionKind, ShutterTiming, SyntheticConfig

SEEDS = tuple(range(1, 21))
DURATION_S = 5.0
MOTIONS = (MotionKind.HAND_HELD, MotionKind.ORBIT, MotionKind.SMOOTH)
# Exact depth, measured from the color camera; the sensors below add their errors.
EXACT_DEPTH = SyntheticConfig.ideal().depth
EXACT_DEPTH_FACTOR = 5000.0
DEPTH_FACTOR = 1000.0

Depth = NDArray[np.float32]
Image = NDArray[np.uint8]


class SensorKind(StrEnum):
    """Principle by which a depth camera measures."""

    STRUCTURED_LIGHT = "structured-light"
    STEREO = "stereo"
    NEAR_RANGE = "near-range"
    TIME_OF_FLIGHT = "time-of-flight"


@dataclass(frozen=True)
class VirtualSensor(VirtualRecording):
    """A depth camera of a seed.

    Attributes:
        kind: How it measures.
        noise: Of stereo and near range: sigma of inverse depth, 1/m; of time of flight: sigma of
            the depth of a white surface, m.
        scale: All lengths are multiplied by it: a small scene for near range.
    """

    kind: SensorKind
    noise: float
    scale: float = 1.0

    def measure(self, frame: RgbdFrame) -> RgbdFrame:
        """Return the frame with the depth as the sensor measures it."""
        if self.kind is SensorKind.STRUCTURED_LIGHT:
            return frame
        rng = np.random.default_rng([self.config.seed, frame.seq])
        gray = np.asarray(cv2.cvtColor(frame.color_bgr, cv2.COLOR_BGR2GRAY), np.uint8)
        true_m = np.float32(self.scale) * frame.depth_m
        measured_m = MODELS[self.kind](true_m, gray, self.noise, rng)
        raw = np.clip(np.rint(measured_m * np.float32(DEPTH_FACTOR)), 0, 65535)
        return replace(frame, depth_raw=raw.astype(np.uint16), depth_factor=DEPTH_FACTOR)

    def scale_truth(self, truth: Trajectory) -> Trajectory:
        """Return the true trajectory of the scaled scene."""
        T_world_camera = truth.T_world_camera.copy()
        T_world_camera[:, :3, 3] *= self.scale
        return Trajectory(truth.stamps_s, T_world_camera)


def make_sensor(seed: int) -> VirtualSensor:
    """Draw the sensor, the room and the motion of a seed."""
    rng = np.random.default_rng([seed, 77])
    kind = list(SensorKind)[seed % len(SensorKind)]
    config = SyntheticConfig(
        seed=1000 + seed,
        duration_s=DURATION_S,
        motion=MOTIONS[seed % len(MOTIONS)],
        timing=ShutterTiming(float(rng.uniform(0.0, 0.025)), float(rng.uniform(-0.01, 0.012))),
    )
    low, high = NOISE_RANGES[kind]
    noise = float(rng.uniform(low, high))
    if kind is not SensorKind.STRUCTURED_LIGHT:
        config = replace(config, depth=EXACT_DEPTH, depth_factor=EXACT_DEPTH_FACTOR)
    scale = 0.25 if kind is SensorKind.NEAR_RANGE else 1.0
    return VirtualSensor(config, kind, noise, scale)


def measure_stereo(
    true_m: Depth, gray: Image, noise_per_m: float, rng: np.random.Generator
) -> Depth:
    """Stereo matching of windows: correlated noise of the disparity, smeared edges, holes.

    Keselman et al., "Intel RealSense Stereoscopic Depth Cameras" (CVPR Workshops 2017).
    """
    inverse = _invert(true_m)
    # A window at an edge takes the nearer surface, or something between the two.
    nearest = np.asarray(cv2.dilate(inverse, np.ones((5, 5), np.uint8)), np.float32)
    smeared = np.asarray(cv2.GaussianBlur(nearest, (0, 0), 1.5), np.float32)
    smeared += np.float32(noise_per_m) * correlated_noise(true_m.shape, 2.5, rng)
    contrast = cv2.GaussianBlur(np.abs(cv2.Laplacian(gray, cv2.CV_32F)), (0, 0), 4.0)
    is_hole = correlated_noise(true_m.shape, 6.0, rng) > 1.0 + np.asarray(contrast) / 4.0
    # Left of a near object, one of the two cameras sees what is behind it.
    shadow = np.asarray(cv2.dilate(inverse, np.ones((1, 21), np.uint8), anchor=(0, 0)))
    is_hole |= shadow - inverse > 0.15
    return _to_depth(smeared, (true_m > 0) & ~is_hole, (0.3, 8.0))


def measure_near_range(
    true_m: Depth, gray: Image, noise_per_m: float, rng: np.random.Generator
) -> Depth:
    """Near-range structured light that is registered by forward warping: a grid of holes."""
    inverse = _invert(true_m) + np.float32(noise_per_m) * correlated_noise(true_m.shape, 1.2, rng)
    rows, columns = np.arange(true_m.shape[0]), np.arange(true_m.shape[1])
    # A smaller depth image is spread over the larger color image.
    has_row, has_column = (rows * 9 % 11) < 9, (columns * 11 % 14) < 11
    is_seen = has_row[:, None] & has_column & (gray > 12) & (true_m > 0)
    return _to_depth(inverse, is_seen, (0.15, 1.2))


def measure_time_of_flight(
    true_m: Depth, gray: Image, noise_m: float, rng: np.random.Generator
) -> Depth:
    """Time of flight: noise by returned light, flying pixels at edges.

    Lefloch et al., "Technical Foundations and Calibration Methods for Time-of-Flight Cameras"
    (LNCS 8200, 2013).
    """
    # A pixel that sees two surfaces measures a mixture of both.
    mixed = np.asarray(cv2.GaussianBlur(true_m, (0, 0), 0.7), np.float32)
    returned = (gray.astype(np.float32) + 10.0) / 255.0 / np.maximum(mixed, 0.5) ** 2
    sigma_m = np.float32(noise_m) / np.sqrt(returned)
    measured_m = mixed + sigma_m * correlated_noise(true_m.shape, 0.6, rng)
    is_seen = (true_m > 0) & (sigma_m < 0.05)
    return np.where(is_seen & (measured_m > 0.3) & (measured_m < 5.0), measured_m, 0.0)


MODELS: dict[SensorKind, Callable[[Depth, Image, float, np.random.Generator], Depth]] = {
    SensorKind.STEREO: measure_stereo,
    SensorKind.NEAR_RANGE: measure_near_range,
    SensorKind.TIME_OF_FLIGHT: measure_time_of_flight,
}
NOISE_RANGES = {
    SensorKind.STRUCTURED_LIGHT: (0.0, 0.0),
    SensorKind.STEREO: (5e-3, 1e-2),
    SensorKind.NEAR_RANGE: (4e-3, 1.2e-2),
    SensorKind.TIME_OF_FLIGHT: (2e-3, 5e-3),
}


def correlated_noise(shape: tuple[int, ...], blur_px: float, rng: np.random.Generator) -> Depth:
    """Noise (H, W) of unit deviation, correlated between neighbors."""
    white = rng.standard_normal(shape, dtype=np.float32)
    smooth = np.asarray(cv2.GaussianBlur(white, (0, 0), blur_px), np.float32)
    return smooth / np.float32(smooth.std())


def _invert(depth_m: Depth) -> Depth:
    return np.where(depth_m > 0, 1.0 / np.maximum(depth_m, 1e-3), 0.0).astype(np.float32)


def _to_depth(inverse: Depth, is_seen: NDArray[np.bool_], range_m: tuple[float, float]) -> Depth:
    depth_m = 1.0 / np.maximum(inverse, 1e-3)
    is_valid = is_seen & (depth_m >= range_m[0]) & (depth_m <= range_m[1])
    return np.where(is_valid, depth_m, 0.0).astype(np.float32)


def make_sensors(seeds: Sequence[int]) -> dict[str, VirtualSensor]:
    """Draw the sensors of some seeds, by name."""
    return {f"{make_sensor(seed).kind}-{seed}": make_sensor(seed) for seed in seeds}
