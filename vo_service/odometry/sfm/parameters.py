"""Parameters of structure from motion."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SfmParameters:
    """Parameters of matching, initialization, keyframes and failures."""

    match_ratio: float = 0.8
    seed: int = 1  # of RANSAC, the same for every run
    min_inliers: int = 15  # known points; fewer agree by chance
    max_sigma_rad: float = 0.03  # of a valid motion, as an angle
    max_failures: int = 30  # consecutive frames; then tracking restarts at the last pose
    min_initial_inliers: int = 50  # pairs of the first two views
    min_initial_parallax_rad: float = float(np.radians(3.0))  # median over the first points
    max_keyframes: int = 10  # in the window
    # A frame becomes a keyframe if its inliers are fewer than this share of the inliers of the
    # first frame after the last keyframe, or if their median flow is larger (pixels at a width of
    # 640).
    min_keyframe_inlier_share: float = 0.7
    max_keyframe_flow_px: float = 60.0
    # With fewer keyframes the points are not accurate yet, and the next keyframe is due sooner.
    initial_keyframes: int = 5
    max_initial_flow_px: float = 9.0
