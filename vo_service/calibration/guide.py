"""What the person who holds the board is told."""

from collections.abc import Sequence

from vo_service.calibration.guidance import CoverageGap, find_coverage_gaps
from vo_service.calibration.picking import ViewDecision, ViewSelector


class CoverageGuide:
    """Knows when the views are enough, and what to do until then."""

    def __init__(self, selector: ViewSelector, view_count: int, with_depth: bool) -> None:
        self._picker = selector
        self._wanted = view_count
        self._with_depth = with_depth

    @property
    def gaps(self) -> list[CoverageGap]:
        """What the views taken so far still lack."""
        return find_coverage_gaps(self._picker.views, self._picker.board_poses, self._with_depth)

    @property
    def is_complete(self) -> bool:
        """Views enough, and nothing lacking."""
        return len(self._picker.views) >= self._wanted and not self.gaps

    def instruction(self, decision: ViewDecision) -> str:
        """One line, after a snapshot was judged: "12 of 25 views; show it at the top right"."""
        count = len(self._picker.views)
        views = f"{count} of {self._wanted} views" if count < self._wanted else f"{count} views"
        now = "" if decision is ViewDecision.ACCEPTED else f" [{decision}]"
        if self.is_complete:
            return f"{views}: enough"
        return f"{views}; {_next_remedy(self.gaps)}{now}"


def _next_remedy(gaps: Sequence[CoverageGap]) -> str:
    """What to do now."""
    return gaps[0].remedy if gaps else "go on, each time a little different"
