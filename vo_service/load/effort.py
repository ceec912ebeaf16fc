"""Steps from all the effort that was asked for down to the least that is of use."""

from dataclasses import dataclass

# Shares of the features to find, before the fewest that are allowed.
FEATURE_SHARES = (0.7, 0.5)


@dataclass(frozen=True)
class Effort:
    """What is done of all that could be."""

    viewer_rests: bool
    features: int


def efforts(features: int, least: int, has_viewer: bool) -> list[Effort]:
    """From everything down to the least: the viewer first, then features, never below `least`."""
    fewer = [round(share * features) for share in FEATURE_SHARES]
    counts = [
        features,
        *(count for count in fewer if count > least),
        *([least] * (least < features)),
    ]
    full = [Effort(False, features)] if has_viewer else []
    return full + [Effort(has_viewer, count) for count in counts]
