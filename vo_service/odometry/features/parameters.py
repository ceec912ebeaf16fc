"""Parameters of a motion by features."""

from dataclasses import dataclass


@dataclass(frozen=True)
class SurfParameters:
    """Parameters of a motion by features: matching, RANSAC, verification and failures."""

    match_ratio: float = 0.8
    max_hypotheses: int = 500  # per RANSAC run
    min_inliers: int = 15  # fewer pairs agree by chance
    # Share of the visible depth that a motion contradicts, if a minority of the matches agrees with
    # it. Right motions: more is contradicted by 0.03 % (of 17,200 in 19 recordings), and over up to
    # 10 frames by 0.4 % where a person walks past. Wrong ones: by 96 % if by 0.1 m and 10 degrees,
    # 99 % if by 0.3 m and 30 degrees, and 76 % if they slide and turn along the largest plane.
    max_depth_contradiction: float = 0.3
    # A motion whose three sigmas exceed either of these is in doubt.
    max_error_m: float = 0.05
    max_error_rad: float = 0.05
    max_failures: int = 30  # consecutive frames; then tracking restarts at the last pose
    seed: int = 1  # of RANSAC, the same for every run
