"""What can be set of the method, apart from SURF's own settings."""

from dataclasses import dataclass


@dataclass(frozen=True)
class SurfParameters:
    """Settings of matching, RANSAC and of what happens when a frame fails."""

    match_ratio: float = 0.8
    max_hypotheses: int = 500  # of RANSAC, a try
    min_inliers: int = 15  # fewer pairs agree by chance
    max_failures: int = 30  # frames in a row; then the pose is held and tracking starts afresh
    seed: int = 1  # of RANSAC, the same for every try
