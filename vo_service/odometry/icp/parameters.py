"""Parameters of the ICP odometry."""

from dataclasses import dataclass


@dataclass(frozen=True)
class IcpParameters:
    """Number of planes, and handling of failures."""

    max_planes: int = 4000  # of a reference on each level
    max_failures: int = 30  # consecutive frames; then tracking restarts at the last pose
