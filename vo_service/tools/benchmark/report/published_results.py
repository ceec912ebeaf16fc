"""What the paper reports, to stand beside our figures, and what it calls the methods.

Fontes and Maia, "Visual odometry for moving RGB-D cameras": Table I (mean global error) and Table
II (total time), on two sequences of the TUM RGB-D benchmark; Matlab on a Core i3 of 1.7 GHz.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class PublishedResult:
    """What the paper reports of one method on one sequence."""

    mean_global_error_m: float
    time_s: float


@dataclass(frozen=True)
class MethodDescription:
    """A method for readers: its name, and what it is."""

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
        "color and depth: SURF features of one frame are matched with those of the frame before; "
        "RANSAC keeps the matches that agree on one motion, and singular value decomposition fits "
        "it. The method that the paper proposes.",
    ),
    "icp": MethodDescription(
        "ICP",
        "depth alone: the surface that a frame sees is laid onto that of an earlier one (iterative "
        "closest point). It needs shapes: where it sees little but one plane, it gives no pose.",
    ),
    "sfm": MethodDescription(
        "SfM",
        "color alone: features are followed from frame to frame, and motion and points are found "
        "from them together (structure from motion). Color alone has no scale: the first "
        "is given from outside, and it may drift from there.",
    ),
    "direct": MethodDescription(
        "Keyframes",
        "color and depth: brightness and depth of every frame are laid on those of a keyframe, "
        "which stays as long as most of it is in view; each row of the sensor counts at its own "
        "time. Not of the paper: what the service uses unless told otherwise.",
    ),
}
_SEQUENCE_PATTERN = re.compile(r"(?<![a-z0-9])(?:freiburg|fr)1[_/-](floor|teddy)$", re.IGNORECASE)


def find_published_results(folder: Path) -> Mapping[str, PublishedResult]:
    """By method; empty unless the folder is named as one of the paper's two sequences."""
    name = "/".join(folder.resolve().parts[-2:])
    found = _SEQUENCE_PATTERN.search(name)
    return PUBLISHED_RESULTS[found[1].lower()] if found else {}


def describe_method(method: str) -> MethodDescription:
    """Also of a method that this page does not know."""
    return METHOD_DESCRIPTIONS.get(method, MethodDescription(method.upper(), "see docs/method.md."))
