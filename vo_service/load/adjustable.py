"""The load governor under settings that may change while the service runs."""

from collections.abc import Sequence

from vo_service.load.governor import FeatureUser, FixedEffort, Governor, LoadGovernor
from vo_service.load.meter import FrameLoad
from vo_service.settings import LoadSettings
from vo_service.types import Odometry, Viewer


class _NoFeatures:
    """Stands in for an odometry that looks for none."""

    feature_count = 0


class AdjustableGovernor:
    """A governor that is made anew whenever its settings change."""

    def __init__(self, viewers: Sequence[Viewer], odometry: Odometry) -> None:
        """An odometry without features can give nothing up."""
        self._viewers = viewers
        self._odometry = odometry if isinstance(odometry, FeatureUser) else _NoFeatures()
        self._governor: Governor = FixedEffort()

    @property
    def warning(self) -> str:
        """What is given up."""
        return self._governor.warning

    def configure(self, settings: LoadSettings, feature_count: int) -> None:
        """Begin with all the effort: so many features, and the viewers at work."""
        self._governor.release()
        self._odometry.feature_count = feature_count
        self._governor = FixedEffort()
        if settings.adapt:
            self._governor = LoadGovernor(settings, self._viewers, self._odometry)

    def frame(self, load: FrameLoad) -> None:
        """See `Governor`."""
        self._governor.frame(load)

    def release(self) -> None:
        """See `Governor`."""
        self._governor.release()
