"""Parameters of the SURF odometry, except those of the features."""

from dataclasses import dataclass


@dataclass(frozen=True)
class SurfParameters:
    """Parameters of matching, RANSAC and failures."""

    match_ratio: float = 0.8
    max_hypotheses: int = 500  # per RANSAC run
    min_inliers: int = 15  # fewer pairs agree by chance
    max_failures: int = 30  # consecutive frames; then tracking restarts at the last pose
    seed: int = 1  # of RANSAC, the same for every run
