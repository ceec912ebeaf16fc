"""What the paper reports, to stand beside our figures, and what it calls the methods.

Fontes and Maia, "Visual odometry for moving RGB-D cameras": Table I (mean global error) and Table
II (total time), on two sequences of the TUM RGB-D benchmark; Matlab on a Core i3 of 1.7 GHz.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class PaperFigures:
    """What the paper reports of one method on one sequence."""

    mean_global_error_m: float
    time_s: float


@dataclass(frozen=True)
class About:
    """A method for readers: its name, and what it is."""

    name: str
    text: str


PAPER: Mapping[str, Mapping[str, PaperFigures]] = {
    "floor": {
        "surf": PaperFigures(0.05, 458),
        "icp": PaperFigures(0.12, 621),
        "sfm": PaperFigures(0.51, 950),
    },
    "teddy": {
        "surf": PaperFigures(0.13, 953),
        "icp": PaperFigures(0.74, 1155),
        "sfm": PaperFigures(0.22, 1430),
    },
}
ABOUT = {
    "surf": About(
        "SURF (proposed)",
        "colour and depth: SURF features of one frame are matched with those of the frame before; "
        "RANSAC keeps the matches that agree on one motion, and singular value decomposition fits "
        "it. The method that the paper proposes.",
    ),
    "icp": About(
        "ICP",
        "depth alone: the surface that a frame sees is laid onto that of an earlier one (iterative "
        "closest point). It needs shapes: where it sees little but one plane, it gives no pose.",
    ),
    "sfm": About(
        "SfM",
        "colour alone: features are followed from frame to frame, and motion and points are found "
        "from them together (structure from motion). Colour alone has no scale: the first "
        "is given from outside, and it may drift from there.",
    ),
    "keyframe": About(
        "Keyframes",
        "colour and depth: brightness and depth of every frame are laid on those of a keyframe, "
        "which stays as long as most of it is in view; each row of the sensor counts at its own "
        "time. Not of the paper: what the service uses unless told otherwise.",
    ),
}
_WHOLE_SEQUENCE = re.compile(r"(?<![a-z0-9])(?:freiburg|fr)1[_/-](floor|teddy)$", re.IGNORECASE)


def paper_figures(folder: Path) -> Mapping[str, PaperFigures]:
    """By method; empty unless the folder is named as one of the paper's two sequences."""
    name = "/".join(folder.resolve().parts[-2:])
    found = _WHOLE_SEQUENCE.search(name)
    return PAPER[found[1].lower()] if found else {}


def about(method: str) -> About:
    """Also of a method that this page does not know."""
    return ABOUT.get(method, About(method.upper(), "see docs/method.md."))
