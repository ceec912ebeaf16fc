"""What a preview of a live calibration shows."""

from dataclasses import dataclass
from typing import Protocol

from vo_service.tools.calibration.board import BoardCorners
from vo_service.tools.calibration.snapshot import BoardView, Snapshot


@dataclass(frozen=True)
class BoardPreviewFrame:
    """One snapshot with the corners found in it, the views taken so far, and what to do next."""

    snapshot: Snapshot
    corners: BoardCorners
    views: tuple[BoardView, ...]
    advice: str


class BoardPreview(Protocol):
    """One place where the preview is shown."""

    def show(self, item: BoardPreviewFrame) -> None:
        """Show it, soon; never blocks."""
        ...
