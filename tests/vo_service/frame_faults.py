"""A table of what can be wrong with frames while the camera is well, and a sequence with all of it.

The frames come as fast as they are taken, and none is left out: what a subscriber receives depends
on no clock.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from drivers.camera import CameraCounters, Clock, EndOfStream, RgbdCamera, RgbdFrame
from drivers.faulty_camera import Fault, FaultKind, FaultyCamera
from tests.vo_service.corner_sequence import corner_pose
from tests.vo_service.odometry.synthetic_views import render_corner

# Good frames before each fault, and after it.
GOOD_FRAMES = 15
VIEW_COUNT = 12
JUMP_BACK_S, JUMP_AHEAD_S = -5.0, 3600.0


@dataclass(frozen=True)
class FrameFault:
    """One fault, and what a subscriber is told of it.

    count      frames that suffer
    seconds    by which their stamps are off
    state      of the poses of these frames; "" where there are none
    words      in the reason of these poses
    left_out   frames for which there is no pose, these and later ones
    new_epoch  whether the stamps begin anew
    """

    name: str
    kind: FaultKind
    count: int
    state: str
    status_text: str = ""
    seconds: float = 0.0
    dropped_frames: int = 0
    new_epoch: bool = False


FRAME_FAULTS = (
    FrameFault("black", FaultKind.BLACK, 8, "degraded", "degenerate view"),
    FrameFault("darkness", FaultKind.DARK, 8, "degraded", "degenerate view"),
    FrameFault("noise", FaultKind.NOISE, 8, "lost", "the brightness does not fit"),
    FrameFault("frozen", FaultKind.FROZEN, 8, "tracking"),
    FrameFault("torn", FaultKind.TORN, 8, "tracking"),
    FrameFault("same stamp again", FaultKind.STAMP_REPEAT, 8, "", dropped_frames=8),
    FrameFault(
        "back in time for a moment", FaultKind.STAMP_JUMP, 8, "", "", JUMP_BACK_S, dropped_frames=8
    ),
    FrameFault(
        "back in time for good", FaultKind.STAMP_JUMP, 20, "tracking", "", JUMP_BACK_S,
        dropped_frames=14, new_epoch=True,
    ),
    FrameFault(
        "an hour ahead for a moment", FaultKind.STAMP_JUMP, 8, "tracking", "", JUMP_AHEAD_S,
        dropped_frames=14, new_epoch=True,
    ),
)  # fmt: skip


def frame_span(fault: FrameFault) -> range:
    """The sequence's frames that belong to a fault: good ones, those that suffer, good ones."""
    first = 0
    for each in FRAME_FAULTS:
        length = GOOD_FRAMES + each.count + GOOD_FRAMES
        if each is fault:
            return range(first, first + length)
        first += length
    raise ValueError(f"{fault.name} is not in the table")


def faulty_frames(fault: FrameFault) -> range:
    """Those of the span that suffer."""
    first = frame_span(fault).start + GOOD_FRAMES
    return range(first, first + fault.count)


def faulty_corner(faults: Sequence[FrameFault] = FRAME_FAULTS) -> FaultyCamera:
    """Past a corner and back, round and round, through faults of the table; then it ends."""
    struck = tuple(
        Fault(each.kind, faulty_frames(each).start, each.count, each.seconds) for each in faults
    )
    count = max((frame_span(each).stop for each in faults), default=2 * GOOD_FRAMES)
    return FaultyCamera(CornerCamera(count), struck, seed=1)


class CornerCamera(RgbdCamera):
    """Past a corner and back, round and round, for `count` frames."""

    name = "sequence"
    clock = Clock.RECORDED

    def __init__(self, count: int) -> None:
        self._views = [render_corner(corner_pose(seq), seq) for seq in range(VIEW_COUNT)]
        self._count, self._next = count, 0

    def open(self) -> None:
        """Begin."""
        self._next = 0

    def read(self, timeout_s: float) -> RgbdFrame:
        """The next frame."""
        if self._next >= self._count:
            raise EndOfStream
        seq, self._next = self._next, self._next + 1
        return replace(self._views[view_index(seq)], seq=seq, stamp_s=1000.0 + seq / 30.0)

    def close(self) -> None:
        """Nothing to release."""

    @property
    def counters(self) -> CameraCounters:
        """All of them are delivered."""
        return CameraCounters(delivered=self._next)


def view_index(seq: int) -> int:
    """Which view the sequence shows as frame `seq`: there and back."""
    place = seq % (2 * VIEW_COUNT - 2)
    return min(place, 2 * VIEW_COUNT - 2 - place)
