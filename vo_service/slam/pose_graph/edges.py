"""Edges of a pose graph: relative poses of keyframes, and their composition."""

from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, inverse, orthonormalize, transport_covariance


@dataclass(frozen=True, eq=False)
class Edge:
    """Relative pose of keyframe b in the axes of keyframe a.

    Attributes:
        a: Number of a keyframe.
        b: Number of a keyframe.
        T_a_b: 4x4.
        covariance: 6x6 of T_a_b, (translation m, rotation rad), as a small motion in b's axes.
        is_loop: Whether it is a loop closure; otherwise an odometry edge.
        length_m: Length of the camera's path; 0 for a loop closure.
    """

    a: int
    b: int
    T_a_b: Array
    covariance: Array
    is_loop: bool
    length_m: float

    @property
    def variance_m2(self) -> float:
        """Uncertainty as one number: variance of points at a distance of a meter."""
        return float(np.trace(self.covariance))

    def other_end(self, end: int) -> int:
        """The other one of the two nodes."""
        return self.a + self.b - end

    def oriented_from(self, end: int) -> "Edge":
        """Return the edge with this node as a."""
        if end == self.a:
            return self
        T_b_a = inverse(self.T_a_b)
        covariance = transport_covariance(self.covariance, T_b_a)
        return Edge(self.b, self.a, T_b_a, covariance, self.is_loop, self.length_m)

    def compose(self, following: "Edge") -> "Edge":
        """Compose the edge with a following one; the result is a loop if either is."""
        return Edge(
            self.a,
            following.b,
            orthonormalize(self.T_a_b @ following.T_a_b),
            transport_covariance(self.covariance, following.T_a_b) + following.covariance,
            self.is_loop or following.is_loop,
            self.length_m + following.length_m,
        )
