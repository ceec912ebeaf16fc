"""The features of a view that have depth, in as little memory as will do."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from drivers.core.jit import kernel
from vo_service.odometry.depth_noise import depth_sigma_m, lateral_sigma_m
from vo_service.odometry.direct.rolling_shutter import (
    constant_velocity_motion,
    propagate_motion,
    propagate_point,
    row_time,
)
from vo_service.odometry.feature_points import FeaturePoints, backproject_features
from vo_service.odometry.surf import SurfExtractor


@dataclass(frozen=True, eq=False)
class DepthFeatures:
    """SURF features and where they are, strongest first.

    look        (N, 64) int8: descriptors, whole numbers; the few beyond 127 are cut
    sign        (N,) int8 of the Laplacian: +1 dark blob, -1 bright blob
    position_m  (N, 3) float32 in the camera's axes at the stamp
    """

    descriptor_int8: NDArray[np.int8]
    sign: NDArray[np.int8]
    position_m: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.descriptor_int8)

    @property
    def descriptor(self) -> NDArray[np.float32]:
        """(N, 64) as they are matched."""
        return self.descriptor_int8.astype(np.float32)

    @property
    def size_bytes(self) -> int:
        """What they take."""
        return self.descriptor_int8.nbytes + self.sign.nbytes + self.position_m.nbytes

    def to_feature_points(self, focal_px: float) -> FeaturePoints:
        """The same in space, with how far off they are."""
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
    """The strongest features with depth.

    velocity  (6,) twist of the camera in its own axes, m/s and rad/s: rows that were taken earlier
              or later are brought to the stamp
    """
    features = extractor.extract(frame.gray)
    points = backproject_features(features, frame)
    chosen = np.flatnonzero(points.has_depth)[:max_features]
    position_m = compensate_rolling_shutter(
        points.position_m[chosen],
        features.position_px[chosen, 1].astype(np.float64),
        frame.camera.height,
        frame.readout_s,
        constant_velocity_motion(velocity),
    )
    return DepthFeatures(
        descriptor_int8=np.clip(features.descriptor[chosen], -127, 127).astype(np.int8),
        sign=features.sign[chosen].astype(np.int8),
        position_m=position_m.astype(np.float32),
    )


@kernel
def compensate_rolling_shutter(
    position_m: Array, row_px: Array, height: int, readout_s: float, motion: Array
) -> Array:
    """Points (N, 3), each seen by its row (N,), as they are at the instant of the middle row.

    movement  (9,) of the camera in its own axes, see `movement`
    """
    settled = np.empty_like(position_m)
    for n in range(len(position_m)):
        x, y, z = position_m[n]
        tau = row_time(row_px[n], height, readout_s)
        settled[n, 0], settled[n, 1], settled[n, 2] = propagate_point(
            propagate_motion(motion, tau), x, y, z, -tau
        )
    return settled
