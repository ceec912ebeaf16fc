"""Degeneracy analysis: which directions of motion the view constrains.

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

from drivers.core.geometry import Array, skew_matrix

# Smallest ratio of information to that of noise of a constrained direction. Measured: at most 5
# before a floor with a Kinect's noise and depth quantization, at least 27 in well constrained
# views; in between the pose crept along one direction.
MIN_OBSERVABILITY = 12.0


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

    @property
    def noise_suppression(self) -> Array:
        """(6, 6) W such that W^T J W removes the share of noise from an information matrix J.

        In each direction this share is 1 / observability, at most 1.
        """
        shares = 1.0 - 1.0 / np.maximum(self.observability, 1.0)
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
    G = np.empty((6, 6))
    second, first, zeroth = moments[:3, :3], moments[:3, 3], moments[3, 3]
    G[:3, :3] = zeroth * np.eye(3)
    G[3:, :3] = skew_matrix(first)
    G[:3, 3:] = G[3:, :3].T
    G[3:, 3:] = np.trace(second) * np.eye(3) - second
    return G
