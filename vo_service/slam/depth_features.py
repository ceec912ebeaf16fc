"""Features of a view with depth, in compact form."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from drivers.core.jit import kernel
from vo_service.odometry.direct.motion import (
    constant_velocity_motion,
    propagate_motion,
    propagate_point,
    row_time,
)
from vo_service.odometry.features import FeaturePoints, backproject_features
from vo_service.odometry.surf import SurfExtractor
from vo_service.odometry.uncertainty import depth_sigma_m, lateral_sigma_m


@dataclass(frozen=True, eq=False)
class DepthFeatures:
    """SURF features with 3-D points, strongest first.

    Attributes:
        descriptor_int8: (N, 64) int8 whole numbers; the few beyond 127 are clipped.
        sign: (N,) int8 of the Laplacian: +1 dark blob, -1 bright blob.
        position_m: (N, 3) float32 in the camera's axes at the stamp.
    """

    descriptor_int8: NDArray[np.int8]
    sign: NDArray[np.int8]
    position_m: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.descriptor_int8)

    @property
    def descriptor(self) -> NDArray[np.float32]:
        """(N, 64) float32, for matching."""
        return self.descriptor_int8.astype(np.float32)

    @property
    def size_bytes(self) -> int:
        """Memory of the arrays."""
        return self.descriptor_int8.nbytes + self.sign.nbytes + self.position_m.nbytes

    def to_feature_points(self, focal_px: float) -> FeaturePoints:
        """Convert to points with their standard deviations."""
        depth_m = self.position_m[:, 2].astype(np.float64)
        return FeaturePoints(
            position_m=self.position_m.astype(np.float64),
            has_depth=np.ones(len(self), np.bool_),
            sigma_across_m=lateral_sigma_m(depth_m, focal_px),
            sigma_along_m=depth_sigma_m(depth_m),
        )


def extract_depth_features(
    frame: RgbdFrame, extractor: SurfExtractor, velocity: Array, max_features: int
) -> DepthFeatures:
    """Extract the strongest features with depth.

    Args:
        frame: The frame.
        extractor: Of the features.
        velocity: (6,) twist of the camera in its own axes, m/s and rad/s; it corrects each row for
            its time.
        max_features: Largest number of features with depth.
    """
    features = extractor.extract(frame.gray)
    points = backproject_features(features, frame)
    selected = np.flatnonzero(points.has_depth)[:max_features]
    position_m = compensate_rolling_shutter(
        points.position_m[selected],
        features.position_px[selected, 1].astype(np.float64),
        frame.camera.height,
        frame.readout_s,
        constant_velocity_motion(velocity),
    )
    return DepthFeatures(
        descriptor_int8=np.clip(features.descriptor[selected], -127, 127).astype(np.int8),
        sign=features.sign[selected].astype(np.int8),
        position_m=position_m.astype(np.float32),
    )


@kernel
def compensate_rolling_shutter(
    position_m: Array, row_px: Array, height: int, readout_s: float, motion: Array
) -> Array:
    """Transform points (N, 3), observed in rows (N,), to the time of the middle row.

    motion is (9,) of the camera in its own axes, see `motion`.

    Args:
        position_m: (N, 3) points in camera axes at the time of their row, m.
        row_px: (N,) rows in which they were observed.
        height: Rows of the image.
        readout_s: Time from the first row to the last, s.
        motion: (9,) motion of the camera in its own axes.
    """
    compensated = np.empty_like(position_m)
    for n in range(len(position_m)):
        x, y, z = position_m[n]
        tau = row_time(row_px[n], height, readout_s)
        compensated[n, 0], compensated[n, 1], compensated[n, 2] = propagate_point(
            propagate_motion(motion, tau), x, y, z, -tau
        )
    return compensated
