"""What is known of the way from one place to another, and how such ways are put together."""

from dataclasses import dataclass

import numpy as np

from drivers.geometry import Array, carried, inverse, orthonormal


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
    def spread_m2(self) -> float:
        """How unsure it is, as one number: the variance of points that are a metre away."""
        return float(np.trace(self.covariance))

    def other(self, end: int) -> int:
        """The end that is not this one."""
        return self.a + self.b - end

    def starting_at(self, end: int) -> "Edge":
        """The same edge, told from this end."""
        if end == self.a:
            return self
        T_b_a = inverse(self.T_a_b)
        covariance = carried(self.covariance, T_b_a)
        return Edge(self.b, self.a, T_b_a, covariance, self.is_loop, self.length_m)

    def then(self, onward: "Edge") -> "Edge":
        """One edge of this one and another that starts where it ends; a loop if either is."""
        return Edge(
            self.a,
            onward.b,
            orthonormal(self.T_a_b @ onward.T_a_b),
            carried(self.covariance, onward.T_a_b) + onward.covariance,
            self.is_loop or onward.is_loop,
            self.length_m + onward.length_m,
        )
