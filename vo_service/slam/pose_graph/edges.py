"""What is known of the way from one place to another, and how such ways are put together."""

from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, inverse, orthonormalize, transport_covariance


@dataclass(frozen=True, eq=False)
class Edge:
    """Where place b is, seen from place a.

    T_a_b       4x4
    covariance  6x6 of T_a_b, (translation m, rotation rad), as a small motion in b's axes
    is_loop     a place was known again; otherwise the odometry went from a to b
    length_m    of the way that the camera travelled; 0 for a loop
    """

    a: int
    b: int
    T_a_b: Array
    covariance: Array
    is_loop: bool
    length_m: float

    @property
    def variance_m2(self) -> float:
        """How unsure it is, as one number: the variance of points that are a metre away."""
        return float(np.trace(self.covariance))

    def other_end(self, end: int) -> int:
        """The end that is not this one."""
        return self.a + self.b - end

    def oriented_from(self, end: int) -> "Edge":
        """The same edge, told from this end."""
        if end == self.a:
            return self
        T_b_a = inverse(self.T_a_b)
        covariance = transport_covariance(self.covariance, T_b_a)
        return Edge(self.b, self.a, T_b_a, covariance, self.is_loop, self.length_m)

    def compose(self, following: "Edge") -> "Edge":
        """One edge of this one and another that starts where it ends; a loop if either is."""
        return Edge(
            self.a,
            following.b,
            orthonormalize(self.T_a_b @ following.T_a_b),
            transport_covariance(self.covariance, following.T_a_b) + following.covariance,
            self.is_loop or following.is_loop,
            self.length_m + following.length_m,
        )
