"""SURF: Speeded-Up Robust Features, after Bay, Ess, Tuytelaars, Van Gool (CVIU 110, 2008).

SURF on one image: detect in scale space, select the strongest, orient, describe. The scale
space has octaves of filter sizes, Section 3.3. Reading order as in the paper: `detector` (box
filters on the integral image, maxima), then `descriptor` (direction and descriptor).
"""

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from vo_service.odometry.features.descriptor import (
    DESCRIPTOR_SIZE,
    build_pyramid,
    describe,
    make_templates,
    packed_size,
)
from vo_service.odometry.features.detector import RESPONSE, SCALE, SIGN, Layer, X, Y, find_maxima

# Below this response (gray levels^2) a maximum is sensor noise.
MIN_THRESHOLD = 10.0
# The next image's threshold is this share of the weakest selected response.
NEXT_THRESHOLD_RATIO = 0.6
# If too few are found, the threshold is multiplied by this for another search.
RETRY_THRESHOLD_RATIO = 0.2


@dataclass(frozen=True)
class Octave:
    """Filters that grow by a constant amount, sampled at every `step`-th pixel.

    Each inner lobe is searched for maxima against its two neighbors.
    """

    step: int
    lobes: tuple[int, ...]


# Lobe 3 is the 9x9 filter. The second octave is sampled at every pixel, not every other one as in
# the paper: its keypoints are then located 30 % more precisely for 0.6 ms. A fourth octave (filters
# of 99 to 195 pixels) would find some 30 keypoints with an error of a pixel: useless for a pose.
OCTAVES = (
    Octave(step=1, lobes=(3, 5, 7, 9)),
    Octave(step=1, lobes=(5, 9, 13, 17)),
    Octave(step=4, lobes=(9, 17, 25, 33)),
)


# In the order of the keypoint table.
LAYERS = tuple(
    Layer(lobes, octave.step)
    for octave in OCTAVES
    for lobes in zip(octave.lobes, octave.lobes[1:], octave.lobes[2:], strict=False)
)


def detect_keypoints(integral: NDArray[np.int32], threshold: float) -> NDArray[np.float32]:
    """Detect the maxima above a threshold: keypoint table (N, 5).

    Order: octave, layer, row, column.

    Args:
        integral: (H+1, W+1) integral image.
        threshold: Smallest response, gray levels^2.
    """
    return np.concatenate([find_maxima(integral, layer, np.float32(threshold)) for layer in LAYERS])


@dataclass(frozen=True)
class Features:
    """SURF features of one image, strongest first.

    Attributes:
        position_px: (N, 2) float32, (x, y); the center of the first pixel is (0, 0).
        scale_px: (N,) float32, the sigma s of the blob.
        direction: (N, 2) float32, (cos, sin) of the dominant direction, x right and y down.
        response: (N,) float32, det(H), gray levels^2.
        sign: (N,) float32, of the Laplacian: +1 dark blob, -1 bright blob.
        descriptor: (N, 64) float32 whole numbers of norm 300, except for rounding.
    """

    position_px: NDArray[np.float32]
    scale_px: NDArray[np.float32]
    direction: NDArray[np.float32]
    response: NDArray[np.float32]
    sign: NDArray[np.float32]
    descriptor: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.position_px)


class FeatureExtractor(Protocol):
    """Extractor of features: SURF, or another one in a benchmark.

    Attributes:
        count: Largest number of features; may be changed between images.
    """

    count: int

    def extract(self, gray: NDArray[np.uint8]) -> Features:
        """Extract the features of a (H, W) image."""
        ...


class SurfExtractor:
    """Extractor of the strongest SURF features of an image.

    The result depends on the image only: what is kept between images (two buffers, the initial
    threshold) only saves time.

    Args:
        count: Largest number of features; may be changed between images.
        upright: Whether features have no orientation.
    """

    def __init__(self, count: int = 1000, upright: bool = False) -> None:
        self.count = count
        self._upright = upright
        self._threshold = MIN_THRESHOLD
        self._templates = make_templates()
        self.release_buffers()

    def release_buffers(self) -> None:
        """Free the memory that is kept for the next image of the same size, 2.9 MB for VGA."""
        self._integral = np.empty((0, 0), np.int32)
        self._packed = np.empty(0, np.uint32)

    @property
    def kept_bytes(self) -> int:
        """Size of what is kept for the next image."""
        return self._integral.nbytes + self._packed.nbytes

    def extract(self, gray: NDArray[np.uint8]) -> Features:
        """Extract the features of a (H, W) uint8 image, at least 16x16."""
        keypoints = self.select_strongest(self.detect(gray))
        directions = np.empty((len(keypoints), 2), np.float32)
        descriptors = np.empty((len(keypoints), DESCRIPTOR_SIZE), np.float32)
        size = packed_size(*gray.shape)
        if self._packed.size != size:
            self._packed = np.empty(size, np.uint32)
        pyramid = build_pyramid(gray, self._packed)
        describe(pyramid, keypoints, self._upright, self._templates, directions, descriptors)
        return Features(
            position_px=np.ascontiguousarray(keypoints[:, [X, Y]]),
            scale_px=keypoints[:, SCALE].copy(),
            direction=directions,
            response=keypoints[:, RESPONSE].copy(),
            sign=keypoints[:, SIGN].copy(),
            descriptor=descriptors,
        )

    def detect(self, gray: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Detect keypoints (N, 5) in image order, at least the `count` strongest if possible."""
        shape = (gray.shape[0] + 1, gray.shape[1] + 1)
        if self._integral.shape != shape:
            self._integral = np.empty(shape, np.int32)
        integral = self._integral
        cv2.integral(gray, integral)
        keypoints = detect_keypoints(integral, self._threshold)
        while len(keypoints) < self.count and self._threshold > MIN_THRESHOLD:
            self._threshold = max(RETRY_THRESHOLD_RATIO * self._threshold, MIN_THRESHOLD)
            keypoints = detect_keypoints(integral, self._threshold)
        return keypoints

    def select_strongest(self, keypoints: NDArray[np.float32]) -> NDArray[np.float32]:
        """Select the strongest, strongest first; they set the threshold of the next image."""
        order = np.argsort(-keypoints[:, RESPONSE], kind="stable")[: self.count]
        strongest: NDArray[np.float32] = keypoints[order]
        if len(strongest) == self.count:
            weakest = float(strongest[-1, RESPONSE])
            self._threshold = max(NEXT_THRESHOLD_RATIO * weakest, MIN_THRESHOLD)
        return strongest
