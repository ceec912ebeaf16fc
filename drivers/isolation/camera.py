"""Any camera, in a process of its own: a native library that hangs or crashes is started again."""

import time
from dataclasses import replace

from drivers.camera import (
    CameraCounters,
    Clock,
    Condition,
    Pace,
    RgbdCamera,
    RgbdFrame,
)
from drivers.errors import CameraError, CameraLostError
from drivers.isolation.limits import TimeLimits
from drivers.isolation.messages import Recipe, Task
from drivers.isolation.order import make_order
from drivers.isolation.ring import RingEndedError, RingReader
from drivers.isolation.supervisor import Supervisor
from drivers.isolation.wishes import Light, Tilt, Wish
from drivers.sensor_settings import Led
from drivers.trajectory import StampedPoses


class IsolatedCamera(RgbdCamera):
    """The camera that `recipe` makes, in a process of its own; frames come through shared memory.

    A live camera (`clock` monotonic) is opened, and opened again, for as long as this one is open:
    `open` returns at once, `read` has no frame while the camera is away, and `condition` says why.
    `seq` and stamps rise over all of that, and over `close` and `open` here.

    A recording is opened by `open`, starts to run with the first `read` and is never begun anew by
    itself: if its process dies, `read` raises CameraLostError.

    In lockstep a late reader makes the camera wait; in realtime it gets the newest frame.
    """

    def __init__(
        self,
        name: str,
        clock: Clock,
        recipe: Recipe,
        pace: Pace,
        limits: TimeLimits = TimeLimits(),  # noqa: B008 (frozen)
    ) -> None:
        """`recipe` is called in the other process: a class or function of a module, or a partial.

        What is wrong for good (InputError, a library that is not installed) is raised by `open`
        of a recording, and by `read` of a live camera.
        """
        self.name, self.clock = name, clock
        self._is_live = clock is Clock.MONOTONIC
        self._ring = RingReader(pace)
        self._supervisor = Supervisor(Task(recipe, pace, self._is_live, limits), self._ring)
        self._order = make_order(clock, pace)
        self._delivered = self._skipped = 0

    def open(self) -> None:
        """Start the process; see the class."""
        self.close()
        self._delivered = self._skipped = 0
        try:
            self._ring.open()
            self._supervisor.start()
            if not self._is_live:
                self._supervisor.wait_until_open()
        except BaseException:
            self.close()
            raise

    def read(self, timeout_s: float) -> RgbdFrame:
        """See `RgbdCamera`. Raises also what is wrong for good."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            frame = self._order(self._take(max(0.0, deadline_s - time.monotonic())))
            if frame is not None:
                self._delivered += 1
                return frame
            self._skipped += 1

    def close(self) -> None:
        """End the process; what was found out and counted can still be asked for."""
        try:
            self._supervisor.stop()
        finally:
            self._ring.close()

    @property
    def counters(self) -> CameraCounters:
        """Totals since `open`, however often the camera was opened; up to 0.3 s behind."""
        mine = CameraCounters(dropped=self._ring.dropped, skipped=self._skipped)
        return replace(self._supervisor.counters + mine, delivered=self._delivered)

    @property
    def condition(self) -> Condition:
        """How the camera is, or what became of its process."""
        return self._supervisor.condition

    @property
    def intrinsics_source(self) -> str:
        """What the camera says; "" until it has been open."""
        return self._supervisor.facts.intrinsics_source

    @property
    def frame_count(self) -> int | None:
        """What the camera says; None until it has been open."""
        return self._supervisor.facts.frame_count

    @property
    def has_base(self) -> bool:
        """What the camera says; True until it has been open."""
        return self._supervisor.facts.has_base

    def set_tilt_deg(self, tilt_deg: float) -> None:
        """See `RgbdCamera`. If the motor is not there, the log says so, a little later."""
        if not self.has_base:
            super().set_tilt_deg(tilt_deg)
        self._ask(Tilt(tilt_deg))

    def set_led(self, led: Led) -> None:
        """See `RgbdCamera`, and `set_tilt_deg`."""
        if not self.has_base:
            super().set_led(led)
        self._ask(Light(led))

    @property
    def ground_truth(self) -> StampedPoses | None:
        """What the camera says; None until it has been open."""
        return self._supervisor.facts.ground_truth

    def _ask(self, wish: Wish) -> None:
        """Raises CameraError if the camera is not open to hear it now."""
        if not self._supervisor.ask(wish):
            raise CameraError(
                f"{self.name}: not open now ({self.condition}); it is done as soon as it is open"
            )

    def _take(self, timeout_s: float) -> RgbdFrame:
        try:
            return self._ring.take(timeout_s)
        except RingEndedError:
            raise self._supervisor.ending or CameraLostError(
                f"{self.name}: not open; open it again"
            ) from None
