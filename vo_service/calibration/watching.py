"""What a preview of a live calibration shows."""

from dataclasses import dataclass

from vo_service.calibration.board import Corners
from vo_service.calibration.snapshot import Snapshot, View


@dataclass(frozen=True)
class Sight:
    """One snapshot with the corners found in it, the views taken so far, and what to do next."""

    snapshot: Snapshot
    corners: Corners
    views: tuple[View, ...]
    advice: str
