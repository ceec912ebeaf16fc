"""What the person who holds the board is told."""

from collections.abc import Sequence

from vo_service.calibration.guidance import Lack, lacks
from vo_service.calibration.picking import Verdict, ViewPicker


class Guide:
    """Knows when the views are enough, and what to do until then."""

    def __init__(self, picker: ViewPicker, wanted: int, with_depth: bool) -> None:
        self._picker = picker
        self._wanted = wanted
        self._with_depth = with_depth

    @property
    def lacks(self) -> list[Lack]:
        """What the views taken so far still lack."""
        return lacks(self._picker.views, self._picker.stances, self._with_depth)

    @property
    def is_done(self) -> bool:
        """Views enough, and nothing lacking."""
        return len(self._picker.views) >= self._wanted and not self.lacks

    def text(self, verdict: Verdict) -> str:
        """One line, after a snapshot was judged: "12 of 25 views; show it at the top right"."""
        count = len(self._picker.views)
        views = f"{count} of {self._wanted} views" if count < self._wanted else f"{count} views"
        now = "" if verdict is Verdict.TAKEN else f" [{verdict}]"
        if self.is_done:
            return f"{views}: enough"
        return f"{views}; {_next(self.lacks)}{now}"


def _next(lacking: Sequence[Lack]) -> str:
    """What to do now."""
    return lacking[0].remedy if lacking else "go on, each time a little different"
