"""Whole layers of Hessian responses, of which the detector computes three rows at a time."""

import cv2
import numpy as np
from numpy.typing import NDArray

from vo_service.odometry.features.detector import box_rows, fill_row, lobe_margin, make_row_sums


def response_layer(image: NDArray[np.uint8], lobe: int, step: int = 1) -> NDArray[np.float32]:
    """det(H) at every `step`-th pixel; 0 where the filter leaves the image."""
    height, width = image.shape
    integral: NDArray[np.int32] = cv2.integral(image)  # type: ignore[assignment]
    out = np.zeros((-(-height // step), -(-width // step)), np.float32)
    margin = lobe_margin(lobe)
    rows, columns = (
        np.flatnonzero((at >= margin) & (at < size - margin))
        for size, at in ((height, np.arange(0, height, step)), (width, np.arange(0, width, step)))
    )
    if len(columns) == 0:
        return out
    sums = make_row_sums(width)
    inside = slice(columns[0], columns[-1] + 1)
    for row in rows:
        bounds = box_rows(integral, lobe, int(row) * step)
        fill_row(bounds, lobe, int(columns[0]) * step, step, sums, out[row, inside])
    return out
