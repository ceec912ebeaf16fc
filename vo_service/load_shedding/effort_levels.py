"""Steps from all the effort that was asked for down to the least that is of use."""

from dataclasses import dataclass

# Shares of the features to find, before the fewest that are allowed.
FEATURE_SHARES = (0.7, 0.5)


@dataclass(frozen=True)
class EffortLevel:
    """What is done of all that could be."""

    is_viewer_paused: bool
    feature_count: int


def effort_levels(feature_count: int, min_features: int, has_viewer: bool) -> list[EffortLevel]:
    """From everything down to the least: the viewer first, then features, never below `least`."""
    fewer = [round(share * feature_count) for share in FEATURE_SHARES]
    counts = [
        feature_count,
        *(count for count in fewer if count > min_features),
        *([min_features] * (min_features < feature_count)),
    ]
    full = [EffortLevel(False, feature_count)] if has_viewer else []
    return full + [EffortLevel(has_viewer, count) for count in counts]
