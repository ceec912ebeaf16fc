"""SURF on one image: detect, select the strongest, orient, describe."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vo_service.odometry.surf.descriptor import DESCRIPTOR_SIZE, PATCH_SIDE, describe, patch_weights
from vo_service.odometry.surf.maxima import RESPONSE, SCALE, SIGN, X, Y
from vo_service.odometry.surf.orientation import GRID_SIDE, disc_weights
from vo_service.odometry.surf.packed_pyramid import build_pyramid, centered_grid
from vo_service.odometry.surf.scale_space import ScaleSpace

# Below this response (gray levels^2) a maximum is sensor noise.
MIN_THRESHOLD = 10.0
# The next image's threshold is this share of the weakest selected response.
NEXT_THRESHOLD_RATIO = 0.6
# If too few are found, the threshold is multiplied by this for another search.
RETRY_THRESHOLD_RATIO = 0.2


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
        self._templates = (
            disc_weights(),
            centered_grid(GRID_SIDE),
            patch_weights(),
            centered_grid(PATCH_SIDE),
        )

    def extract(self, gray: NDArray[np.uint8]) -> Features:
        """Extract the features of a (H, W) uint8 image, at least 16x16."""
        keypoints = self._select_strongest(self.detect(gray))
        directions = np.empty((len(keypoints), 2), np.float32)
        descriptors = np.empty((len(keypoints), DESCRIPTOR_SIZE), np.float32)
        pyramid = build_pyramid(gray)
        describe(
            pyramid.packed, pyramid.level_table, keypoints, self._upright,
            *self._templates, directions, descriptors,
        )  # fmt: skip
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
