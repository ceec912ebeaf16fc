"""Which directions of motion the planes in view settle, and which they leave open.

A plane holds a camera in three of six directions; before a single wall, ICP slides. What the
normals say of each direction is therefore compared with what their noise alone would say: where the
two are alike, the direction is not known. Two quadratic forms are compared, so that no choice of
units between metres and radians enters, nor of origin. After Zhang, Kaess and Singh, "On Degeneracy
of Optimization-based State Estimation Problems" (ICRA 2016), who look at the eigenvalues of the
information matrix, and Gelfand et al., "Geometrically Stable Sampling for the ICP Algorithm"
(3DIM 2003).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, skew_matrix

# A direction is known if the planes say so many times more of it than their noise would. Measured:
# 5 and less before a floor with a Kinect's noise and steps of depth, 27 and more where the camera
# was held fast; in between it crept along in one direction.
MIN_OBSERVABILITY = 12.0


@dataclass(frozen=True)
class DegeneracyAnalysis:
    """Six directions of motion, (translation m, rotation rad), from the least known one on.

    clarity  (6,) rising: how many times more than their noise the planes say of each
    axes     (6, 6), a column for each
    """

    observability: Array
    axes: Array

    @property
    def is_observable(self) -> NDArray[np.bool_]:
        """(6,) along which axes a step may be taken."""
        return self.observability >= MIN_OBSERVABILITY

    @property
    def observable_axes(self) -> Array:
        """(6, K) those axes."""
        return self.axes[:, self.is_observable]

    @property
    def noise_suppression(self) -> Array:
        """(6, 6), W: of an information J of motions, W^T J W leaves out what is but noise.

        Of a direction's information this is one part in its clarity, and no more than all.
        """
        shares = 1.0 - 1.0 / np.maximum(self.observability, 1.0)
        W: Array = (self.axes * np.sqrt(shares)) @ np.linalg.inv(self.axes)
        return W


def analyze_degeneracy(information: Array, noise_information: Array) -> DegeneracyAnalysis:
    """Compare two 6x6 information matrices: of the planes, and of the noise of their normals."""
    noise, axes = np.linalg.eigh(noise_information)
    if noise[-1] <= 0.0:
        return DegeneracyAnalysis(np.zeros(6), np.eye(6))
    whitening = axes / np.sqrt(np.maximum(noise, 1e-9 * noise[-1]))
    clarity, turned = np.linalg.eigh(whitening.T @ information @ whitening)
    return DegeneracyAnalysis(clarity, whitening @ turned)


def point_information(moments: Array) -> Array:
    """6x6 information of points that are held in all three directions of space.

    With J = (1, -[p]x) for a small motion (translation, rotation) of a point p, sum w J^T J.
    moments  (4, 4), sum w q q^T with q = (p, 1)
    """
    G = np.empty((6, 6))
    second, first, zeroth = moments[:3, :3], moments[:3, 3], moments[3, 3]
    G[:3, :3] = zeroth * np.eye(3)
    G[3:, :3] = skew_matrix(first)
    G[:3, 3:] = G[3:, :3].T
    G[3:, 3:] = np.trace(second) * np.eye(3) - second
    return G
