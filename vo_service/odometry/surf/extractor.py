"""SURF on one image: detect in scale space, select the strongest, orient, describe.

The scale space has octaves of filter sizes: Bay et al. 2008, Section 3.3.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vo_service.odometry.surf.descriptor import (
    DESCRIPTOR_SIZE,
    build_pyramid,
    describe,
    make_templates,
)
from vo_service.odometry.surf.detector import (
    NUM_COLUMNS,
    RESPONSE,
    SCALE,
    SIGN,
    LayerTriple,
    X,
    Y,
    fill_responses,
    find_maxima,
    max_num_maxima,
)

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


class ScaleSpace:
    """Layers of Hessian responses of one image; its buffers are reused for the next image."""

    def __init__(self, height: int, width: int) -> None:
        self._integral = np.zeros((height + 1, width + 1), np.int32)
        self._layers = {
            (octave.step, lobe): np.zeros(
                (-(-height // octave.step), -(-width // octave.step)), np.float32
            )
            for octave in OCTAVES
            for lobe in octave.lobes
        }
        max_keypoints = sum(
            max_num_maxima(*self._layers[octave.step, lobe].shape)
            for octave in OCTAVES
            for lobe in octave.lobes[1:-1]
        )
        # Sized for the worst image; memory that is never written is not allocated.
        self._table = np.empty((max_keypoints, NUM_COLUMNS), np.float32)

    def compute_responses(self, integral: NDArray[np.int32]) -> None:
        """Compute all layers of an image from its integral image, (H+1, W+1) int32."""
        self._integral = integral
        for (step, lobe), layer in self._layers.items():
            finer = self._layers.get((1, lobe))
            if step == 1 or finer is None:
                fill_responses(integral, lobe, step, layer)
            else:
                layer[:] = finer[::step, ::step]

    def find_maxima(self, threshold: float) -> NDArray[np.float32]:
        """Keypoint table (N, 5) of the maxima above the threshold, valid until the next search.

        Order: octave, layer, row, column.
        """
        count = 0
        for octave in OCTAVES:
            for lobes in zip(octave.lobes, octave.lobes[1:], octave.lobes[2:], strict=False):
                below, middle, above = (self._layers[octave.step, lobe] for lobe in lobes)
                layers = LayerTriple(below, middle, above, lobes, octave.step)
                count = find_maxima(
                    self._integral, layers, np.float32(threshold), self._table, count
                )
        return self._table[:count]


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


class SurfExtractor:
    """Extractor of the strongest SURF features of an image.

    The result depends on the image only: the state between images (buffers, initial threshold) only
    saves time.

    Args:
        count: Largest number of features; may be changed between images.
        upright: Whether features have no orientation.
    """

    def __init__(self, count: int = 1000, upright: bool = False) -> None:
        self.count = count
        self._upright = upright
        self._threshold = MIN_THRESHOLD
        self._scale_space = ScaleSpace(0, 0)
        self._shape = (0, 0)
        self._templates = make_templates()

    def extract(self, gray: NDArray[np.uint8]) -> Features:
        """Extract the features of a (H, W) uint8 image, at least 16x16."""
        keypoints = self._select_strongest(self.detect(gray))
        directions = np.empty((len(keypoints), 2), np.float32)
        descriptors = np.empty((len(keypoints), DESCRIPTOR_SIZE), np.float32)
        describe(
            build_pyramid(gray), keypoints, self._upright, self._templates, directions, descriptors
        )
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
        if gray.shape != self._shape:
            self._shape = (gray.shape[0], gray.shape[1])
            self._scale_space = ScaleSpace(*self._shape)
        self._scale_space.compute_responses(cv2.integral(gray))  # type: ignore[arg-type]
        keypoints = self._scale_space.find_maxima(self._threshold)
        while len(keypoints) < self.count and self._threshold > MIN_THRESHOLD:
            self._threshold = max(RETRY_THRESHOLD_RATIO * self._threshold, MIN_THRESHOLD)
            keypoints = self._scale_space.find_maxima(self._threshold)
        return keypoints

    def _select_strongest(self, keypoints: NDArray[np.float32]) -> NDArray[np.float32]:
        order = np.argsort(-keypoints[:, RESPONSE], kind="stable")[: self.count]
        strongest: NDArray[np.float32] = keypoints[order]
        if len(strongest) == self.count:
            weakest = float(strongest[-1, RESPONSE])
            self._threshold = max(NEXT_THRESHOLD_RATIO * weakest, MIN_THRESHOLD)
        return strongest
