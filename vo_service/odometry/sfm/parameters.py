"""What can be set of structure from motion, apart from SURF's own settings."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SfmParameters:
    """Settings of matching, of the first two views, of keyframes, and of what fails."""

    match_ratio: float = 0.8
    seed: int = 1  # of RANSAC, the same for every try
    min_inliers: int = 15  # known points that must agree; fewer do so by chance
    max_sigma_rad: float = 0.03  # standard deviation of a motion that is still told, as an angle
    max_failures: int = 30  # frames in a row; then the pose is held and tracking starts afresh
    min_initial_inliers: int = 50  # pairs that must agree in the first two views
    min_initial_parallax_rad: float = float(np.radians(3.0))  # median over the first points
    max_keyframes: int = 10  # that are adjusted together
    # A frame becomes a keyframe when fewer of the matches agree than this share of the first
    # frame's after the last keyframe, or when they have moved this far (median, pixels at a width
    # of 640).
    min_keyframe_inlier_share: float = 0.7
    max_keyframe_flow_px: float = 60.0
    # While there are fewer keyframes than this the points are not sure yet.
    initial_keyframes: int = 5
    max_initial_flow_px: float = 9.0
