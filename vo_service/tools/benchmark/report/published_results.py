"""Published results of the paper for comparison, and descriptions of the methods.

Fontes and Maia, "Visual odometry for moving RGB-D cameras": Table I (mean global error) and Table
II (total time), on two sequences of the TUM RGB-D benchmark; Matlab on a Core i3 with 1.7 GHz.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class PublishedResult:
    """Published result of one method on one sequence."""

    mean_global_error_m: float
    time_s: float


@dataclass(frozen=True)
class MethodDescription:
    """Name and description of a method for readers."""

    name: str
    description: str


PUBLISHED_RESULTS: Mapping[str, Mapping[str, PublishedResult]] = {
    "floor": {
        "surf": PublishedResult(0.05, 458),
        "icp": PublishedResult(0.12, 621),
        "sfm": PublishedResult(0.51, 950),
    },
    "teddy": {
        "surf": PublishedResult(0.13, 953),
        "icp": PublishedResult(0.74, 1155),
        "sfm": PublishedResult(0.22, 1430),
    },
}
METHOD_DESCRIPTIONS = {
    "surf": MethodDescription(
        "SURF (proposed)",
        "color and depth: SURF features of a frame are matched with those of the previous frame. "
        "RANSAC selects the matches that agree on one motion, and singular value decomposition "
        "fits it. This is the method that the paper proposes.",
    ),
    "icp": MethodDescription(
        "ICP",
        "depth only: the surface in a frame is aligned with that of an earlier frame (iterative "
        "closest point). It needs structure: if it sees hardly more than one plane, it gives no "
        "pose.",
    ),
    "sfm": MethodDescription(
        "SfM",
        "color only: features are tracked from frame to frame, and give motion and points together "
        "(structure from motion). Color alone has no scale: the first scale is given, and it may "
        "drift from there.",
    ),
    "direct": MethodDescription(
        "Direct",
        "color and depth: brightness and depth of every frame are aligned with those of a "
        "keyframe, which stays as long as most of it is in view; each sensor row has its own "
        "time. Not in the paper; this is the default of the service.",
    ),
}
_SEQUENCE_PATTERN = re.compile(r"(?<![a-z0-9])(?:freiburg|fr)1[_/-](floor|teddy)$", re.IGNORECASE)


def find_published_results(folder: Path) -> Mapping[str, PublishedResult]:
    """Return results by method; empty unless the folder is named as a published sequence."""
    name = "/".join(folder.resolve().parts[-2:])
    match = _SEQUENCE_PATTERN.search(name)
    return PUBLISHED_RESULTS[match[1].lower()] if match else {}


def describe_method(method: str) -> MethodDescription:
    """Return the description of a method; unknown methods get a general one."""
    return METHOD_DESCRIPTIONS.get(method, MethodDescription(method.upper(), "see docs/design."))
