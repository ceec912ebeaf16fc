"""Uncertainty: noise of depth, directions that a view does not constrain, covariance of poses.

A sensor that measures disparity has an error of 1/z that is about constant, so that of z grows with
z^2 (Khoshelham and Elberink, Sensors 12, 2012, eq. 10).

A plane constrains three of six degrees of freedom; before a single wall, ICP slides. The
information of each direction is compared with the information that noise alone would give: if both
are alike, the direction is unconstrained. The ratio of the two quadratic forms depends neither on
the units of translation and rotation nor on the origin. After Zhang, Kaess and Singh, "On
Degeneracy of Optimization-based State Estimation Problems" (ICRA 2016), who look at the eigenvalues
of the information matrix, and Gelfand et al., "Geometrically Stable Sampling for the ICP Algorithm"
(3DIM 2003).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, transport_covariance
from vo_service.types.estimate import Estimate

# Standard deviation of 1/z of one pixel, in 1/m. The Kinect reports disparity in steps of 1/8
# pixel, which at a baseline of 75 mm and a focal length of 580 pixels is 2.9e-3 1/m; the noise is
# about half a step.
INVERSE_DEPTH_SIGMA_PER_M = 1.4e-3
# Standard deviation of a feature's position in the image, in pixels.
FEATURE_SIGMA_PX = 0.3
# Smallest ratio of information to that of noise of a constrained direction. Measured: at most 5
# before a floor with a Kinect's noise and depth quantization, at least 27 in well constrained
# views; in between the pose crept along one direction.
MIN_OBSERVABILITY = 12.0
# Sigma of the first pose of an epoch.
MIN_SIGMA_M, MIN_SIGMA_RAD = 1e-4, 1e-4


def depth_sigma_m(depth_m: Array) -> Array:
    """Standard deviation along the viewing ray, in meters; depth_m (N,)."""
    return INVERSE_DEPTH_SIGMA_PER_M * depth_m * depth_m


def lateral_sigma_m(depth_m: Array, focal_px: float) -> Array:
    """Standard deviation across the viewing ray, in meters; depth_m (N,)."""
    return depth_m * (FEATURE_SIGMA_PX / focal_px)


@dataclass(frozen=True)
class DegeneracyAnalysis:
    """Six directions of motion, (translation m, rotation rad), the least constrained one first.

    Attributes:
        observability: (6,) ascending: ratio of a direction's information to that of noise.
        axes: (6, 6), a column for each direction.
    """

    observability: Array
    axes: Array

    @property
    def is_observable(self) -> NDArray[np.bool_]:
        """(6,) which directions are constrained."""
        return self.observability >= MIN_OBSERVABILITY

    @property
    def observable_axes(self) -> Array:
        """(6, K) the constrained directions."""
        return self.axes[:, self.is_observable]

    def suppress_noise(self, is_constrained: NDArray[np.bool_]) -> Array:
        """(6, 6) W such that W^T J W removes the share of noise from an information matrix J.

        Args:
            is_constrained: (6,) which directions have information; there the share of noise is
                1 / observability, elsewhere 1.
        """
        shares = np.where(is_constrained, 1.0 - 1.0 / np.maximum(self.observability, 1.0), 0.0)
        W: Array = (self.axes * np.sqrt(shares)) @ np.linalg.inv(self.axes)
        return W


def analyze_degeneracy(information: Array, noise_information: Array) -> DegeneracyAnalysis:
    """Compare two 6x6 information matrices: of the view, and of its noise."""
    noise, axes = np.linalg.eigh(noise_information)
    if noise[-1] <= 0.0:
        return DegeneracyAnalysis(np.zeros(6), np.eye(6))
    whitening = axes / np.sqrt(np.maximum(noise, 1e-9 * noise[-1]))
    observability, rotation = np.linalg.eigh(whitening.T @ information @ whitening)
    return DegeneracyAnalysis(observability, whitening @ rotation)


def point_information(moments: Array) -> Array:
    """6x6 information of points that are constrained in all three directions of space.

    It is sum w J^T J with J = (1, -[p]x) for a small motion (translation, rotation) of a point p.

    Args:
        moments: (4, 4), sum w q q^T with q = (p, 1).
    """
    # Lists: NumPy's scalars and slices are slow.
    (xx, xy, xz, x), (yx, yy, yz, y), (zx, zy, zz, z), (*_, n) = moments.tolist()
    trace = xx + yy + zz
    return np.array(
        [
            [n, 0.0, 0.0, 0.0, z, -y],
            [0.0, n, 0.0, -z, 0.0, x],
            [0.0, 0.0, n, y, -x, 0.0],
            [0.0, -z, y, trace - xx, -xy, -xz],
            [z, 0.0, -x, -yx, trace - yy, -yz],
            [-y, x, 0.0, -zx, -zy, trace - zz],
        ]
    )


class CovarianceAccumulator:
    """Accumulate the covariance along a chain of good estimates.

    Attributes:
        pose: 6x6 of the last pose since the start: (translation m, rotation rad), as a small
            motion in the camera's axes.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Make the next pose the origin."""
        self.pose = diagonal_covariance(MIN_SIGMA_M, MIN_SIGMA_RAD)
        self._step: tuple[Array | None, Array, Array] = None, np.zeros((6, 6)), np.eye(4)
        self._reference_covariance = self.pose  # in the reference's axes
        # Of the last good frame against the reference; None if it is the reference.
        self._last_covariance: Array | None = None

    def add(self, estimate: Estimate, T_last_camera: Array) -> None:
        """Add a good estimate, and the 4x4 motion since the last good one."""
        covariance = estimate.covariance
        reference = transport_covariance(self._reference_covariance, estimate.T_reference_camera)
        if estimate.has_biased_error:
            self.pose = _add_biased(reference, covariance)
        else:
            self.pose = covariance + reference
        self._step = self._last_covariance, covariance, T_last_camera
        self._last_covariance = covariance
        if estimate.is_next_reference:
            self._reference_covariance = self.pose
            self._last_covariance = None

    @property
    def step(self) -> Array:
        """6x6 of the motion since the last good frame, as `pose`; computed by each call."""
        last, this, T_last_this = self._step
        return this if last is None else _step_covariance(last, this, T_last_this)


def _add_biased(first: Array, second: Array) -> Array:
    """6x6 of the sum of two errors whose correlation is not known: at most this.

    It is smallest in position, where the standard deviations add up if the covariances are alike.
    """
    ratio = np.sqrt(np.trace(second[:3, :3]) / np.trace(first[:3, :3]))
    total: Array = (1.0 + ratio) * first + (1.0 + 1.0 / ratio) * second
    return total


def _step_covariance(last: Array, this: Array, T_last_this: Array) -> Array:
    """6x6 of the motion between two frames that are aligned with one reference.

    Half of each error is that of the reference, which is the same in both frames and cancels.
    """
    return 0.5 * (transport_covariance(last, T_last_this) + this)


def diagonal_covariance(sigma_m: float, sigma_rad: float) -> Array:
    """6x6 covariance, equal in all directions."""
    return np.diag([sigma_m**2] * 3 + [sigma_rad**2] * 3)
