"""Frame of the preview of a live calibration."""

from dataclasses import dataclass
from typing import Protocol

from vo_service.tools.calibration.board import BoardCorners
from vo_service.tools.calibration.snapshot import BoardView, Snapshot


@dataclass(frozen=True)
class BoardPreviewFrame:
    """Snapshot with its corners, the accepted views so far, and the next instruction."""

    snapshot: Snapshot
    corners: BoardCorners
    views: tuple[BoardView, ...]
    advice: str


class BoardPreview(Protocol):
    """One place where the preview is shown."""

    def show(self, item: BoardPreviewFrame) -> None:
        """Show it, soon; never blocks."""
        ...
