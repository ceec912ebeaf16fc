"""Who else hears what a method says in a run: nobody, or what knows places again.

Listeners change nothing of what the method says, nor of its times: they hear each frame after both
were taken down.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Protocol

import numpy as np

from drivers.camera import RgbdFrame
from vo_service.pose_covariance import diagonal
from vo_service.pose_tracker import PoseTracker, StampedFrame
from vo_service.runs.run import LoopsRun
from vo_service.runs.versions import digest_of
from vo_service.settings import MapSettings
from vo_service.types import Estimate

# What loops come from, beside the libraries.
SOURCES = (
    "vo_service/mapping/graph",
    "vo_service/mapping/loops",
    "vo_service/mapping/places",
    "vo_service/mapping/spacing.py",
    "vo_service/pose_covariance.py",
    "vo_service/pose_tracker.py",
    "vo_service/runs/listening.py",
)
# Of a motion, where the method says nothing of how sure it is of that: about what a Kinect's depth
# gives from one frame to the next.
SIGMA_M, SIGMA_RAD = 0.003, 0.002


class Listener(Protocol):
    """Hears a run."""

    def hear(self, frame: RgbdFrame, estimate: Estimate) -> None:
        """Take what the method says of the next frame."""
        ...

    @property
    def result(self) -> LoopsRun | None:
        """What has come of it by now; None of nothing."""
        ...


class ListenerRecipe(Protocol):
    """Makes a listener. Goes to another process, so it can be pickled."""

    @property
    def settings(self) -> Mapping[str, object]:
        """What a run is told apart by, for JSON; empty where nothing is added to it."""
        ...

    @property
    def tables(self) -> Mapping[str, Mapping[str, object]]:
        """The tables of a configuration that count, with what was chosen there."""
        ...

    def prepare(self, tell: Callable[[str], None]) -> None:
        """Compile what is to be compiled, and tell what is being done."""
        ...

    def make(self) -> Listener:
        """A listener, new."""
        ...


class Nobody:
    """Nobody listens: recipe and listener."""

    result = None

    @property
    def settings(self) -> Mapping[str, object]:
        """Nothing."""
        return {}

    @property
    def tables(self) -> Mapping[str, Mapping[str, object]]:
        """None."""
        return {}

    def prepare(self, tell: Callable[[str], None]) -> None:
        """Nothing to prepare."""

    def make(self) -> Listener:
        """Itself: it has no state."""
        return self

    def hear(self, frame: RgbdFrame, estimate: Estimate) -> None:
        """Not."""


NOBODY = Nobody()


@dataclass(frozen=True)
class LoopsRecipe:
    """Places that are known again, with the settings of a configuration."""

    map: MapSettings

    @property
    def settings(self) -> Mapping[str, object]:
        """How much may be remembered, and the code that does it."""
        return {
            "loops": {
                "places_mb": self.map.places_mb,
                "source": digest_of(SOURCES),
                "scipy": version("scipy"),
            }
        }

    @property
    def tables(self) -> Mapping[str, Mapping[str, object]]:
        """Of `[map]`, the memory."""
        return {"map": {"places_mb": self.map.places_mb}}

    def prepare(self, tell: Callable[[str], None]) -> None:
        """Compile or load the kernels."""
        from vo_service.mapping.loops.warm_up import warm_up_loops  # slow to load

        warm_up_loops(tell)

    def make(self) -> Listener:
        """Knows no place yet."""
        return _LoopsListener(self.map)


class _LoopsListener:
    """Makes places of the frames, closes loops, and counts what that takes."""

    def __init__(self, settings: MapSettings) -> None:
        from vo_service.mapping.loops.opening import open_inline_loops

        self._tracker = PoseTracker()
        self._loops = open_inline_loops(settings)
        self._cpu_ms: list[float] = []

    def hear(self, frame: RgbdFrame, estimate: Estimate) -> None:
        """As `Listener`."""
        begin_cpu_s = time.process_time()
        stamped = StampedFrame(frame, frame.stamp_s)
        self._loops.pose(self._tracker.update(stamped, _with_covariance(estimate), {}, 0.0))
        self._cpu_ms.append(1e3 * (time.process_time() - begin_cpu_s))

    @property
    def result(self) -> LoopsRun:
        """As `Listener`."""
        self._loops.close()
        closer = self._loops.closer
        mean_ms = float(np.mean(self._cpu_ms)) if self._cpu_ms else 0.0
        return LoopsRun(self._loops.trajectory, len(closer.places), closer.loops, mean_ms)


def _with_covariance(estimate: Estimate) -> Estimate:
    """Some methods do not say how sure they are of a motion."""
    if estimate.covariance.any():
        return estimate
    return replace(estimate, covariance=diagonal(SIGMA_M, SIGMA_RAD))
