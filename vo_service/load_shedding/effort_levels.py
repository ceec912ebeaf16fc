"""Effort levels, from the full work down to the least useful one."""

from dataclasses import dataclass

# Shares of the full feature count, tried before the minimum.
FEATURE_SHARES = (0.7, 0.5)


@dataclass(frozen=True)
class EffortLevel:
    """Amount of work that is done."""

    is_viewer_paused: bool
    feature_count: int


def effort_levels(feature_count: int, min_features: int, has_viewer: bool) -> list[EffortLevel]:
    """List the levels from full to least: the viewer goes first, then features.

    Args:
        feature_count: features at full effort.
        min_features: least number of features.
        has_viewer: whether there is a viewer to pause.
    """
    fewer = [round(share * feature_count) for share in FEATURE_SHARES]
    counts = [
        feature_count,
        *(count for count in fewer if count > min_features),
        *([min_features] * (min_features < feature_count)),
    ]
    full = [EffortLevel(False, feature_count)] if has_viewer else []
    return full + [EffortLevel(has_viewer, count) for count in counts]
