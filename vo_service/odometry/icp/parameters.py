"""What can be set of ICP."""

from dataclasses import dataclass


@dataclass(frozen=True)
class IcpParameters:
    """How much is looked at, and what happens when frames fail."""

    max_planes: int = 4000  # of a reference, at most, on each level
    max_failures: int = 30  # frames in a row; then the pose is held and tracking starts afresh
