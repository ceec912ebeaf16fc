"""The load governor under settings that may change while the service runs."""

from collections.abc import Sequence

from vo_service.load.governor import (
    HasFeatureCount,
    LoadShedder,
    NullLoadShedder,
    StepwiseLoadShedder,
)
from vo_service.load.meter import FrameCost
from vo_service.settings import LoadConfig
from vo_service.types import Odometry, PausableViewer


class _FixedFeatureCount:
    """Stands in for an odometry that looks for none."""

    feature_count = 0


class ReconfigurableLoadShedder:
    """A governor that is made anew whenever its settings change."""

    def __init__(self, viewers: Sequence[PausableViewer], odometry: Odometry) -> None:
        """An odometry without features can give nothing up."""
        self._viewers = viewers
        self._odometry = odometry if isinstance(odometry, HasFeatureCount) else _FixedFeatureCount()
        self._load_shedder: LoadShedder = NullLoadShedder()

    @property
    def warning(self) -> str:
        """What is given up."""
        return self._load_shedder.warning

    def configure(self, settings: LoadConfig, feature_count: int) -> None:
        """Begin with all the effort: so many features, and the viewers at work."""
        self._load_shedder.restore_all()
        self._odometry.feature_count = feature_count
        self._load_shedder = NullLoadShedder()
        if settings.adapt:
            self._load_shedder = StepwiseLoadShedder(settings, self._viewers, self._odometry)

    def add_frame(self, load: FrameCost) -> None:
        """See `LoadShedder`."""
        self._load_shedder.add_frame(load)

    def restore_all(self) -> None:
        """See `LoadShedder`."""
        self._load_shedder.restore_all()
