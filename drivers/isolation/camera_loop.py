"""What the driver's process does with its camera: open it, pass frames on, open it again."""

import threading
import time
from collections.abc import Callable
from dataclasses import replace

from drivers.camera import (
    CameraCounters,
    CameraState,
    Condition,
    EndOfStream,
    NoFrameYet,
    RgbdCamera,
)
from drivers.errors import CameraError, CameraLostError, CameraNotFoundError
from drivers.isolation.limits import BackOff, Phase
from drivers.isolation.messages import Ended, Facts, Job, Report, Word
from drivers.isolation.ring import RingWriter

TICK_S = 0.25


class CameraLoop:
    """Runs until it is stopped, a recording ends, or an error comes that waiting will not mend.

    A camera that fails again and again would say "opening, absent, opening, absent": what was said
    last stays until something better is known.
    """

    def __init__(
        self,
        camera: RgbdCamera,
        ring: RingWriter,
        job: Job,
        tell: Callable[[Word], object],
        stop: threading.Event,
    ) -> None:
        self._camera, self._ring, self._tell, self._stop = camera, ring, tell, stop
        self._is_live, self._limits = job.task.is_live, job.task.limits
        self._back_off = BackOff(job.task.limits)
        self._before, self._is_open = CameraCounters(), False
        self._phase, self._condition = Phase.LAUNCHING, job.condition
        self._told_s = 0.0

    def run(self) -> None:
        """Raises what the camera raised, unless it is opened again for it."""
        while not self._stop.is_set():
            try:
                self._open()
                self._stream()
            except EndOfStream:
                self._tell(Ended())
                return
            except CameraError as error:
                if not self._is_live:
                    raise
                self._enter(Phase.CLOSING, Condition(self._state_after(error), str(error)))
            finally:
                self._close()
            self._wait()

    def _open(self) -> None:
        self._enter(Phase.OPENING, self._condition)
        self._camera.open()
        self._is_open = True
        is_flaky = self._condition.state is CameraState.LOST
        starting = self._condition if is_flaky else Condition(CameraState.STARTING)
        self._enter(Phase.STARTING, starting)
        self._tell_facts()

    def _close(self) -> None:
        self._enter(Phase.CLOSING, self._condition)
        self._camera.close()
        self._before = self._counters()
        self._is_open = False

    def _stream(self) -> None:
        """Pass frames on until stopped."""
        waiting_since_s = time.monotonic()
        while not self._stop.is_set():
            self._beat()
            if not self._ring.acquire(TICK_S):
                waiting_since_s = time.monotonic()
                continue
            try:
                frame = self._camera.read(TICK_S)
            except NoFrameYet:
                self._check_start(waiting_since_s)
            else:
                self._ring.put(frame)
                self._note_frame()

    def _check_start(self, since_s: float) -> None:
        """Raise CameraLostError if a live camera does not begin to send."""
        is_late = time.monotonic() - since_s > self._limits.first_frame_s
        if is_late and self._is_live and self._phase is Phase.STARTING:
            limit_s = self._limits.first_frame_s
            raise CameraLostError(
                self._camera.condition.reason
                or f"{self._camera.name}: open, but sent no frame within {limit_s:g} s; "
                "it is opened again"
            )

    def _note_frame(self) -> None:
        if self._phase is Phase.STARTING:
            self._back_off.reset()
            self._enter(Phase.STREAMING, Condition(CameraState.STREAMING))
            self._tell_facts()

    def _wait(self) -> None:
        """Until the next attempt."""
        if not self._stop.is_set():
            self._enter(Phase.WAITING, self._condition)
            self._camera.wait_to_retry(self._back_off.next_s())

    def _state_after(self, error: CameraError) -> CameraState:
        if isinstance(error, CameraNotFoundError):
            return CameraState.ABSENT
        return CameraState.OPENING if self._phase is Phase.OPENING else CameraState.LOST

    def _enter(self, phase: Phase, condition: Condition) -> None:
        self._phase, self._condition = phase, condition
        self._report()

    def _beat(self) -> None:
        """A sign of life, not too often."""
        if time.monotonic() - self._told_s >= TICK_S:
            self._report()

    def _report(self) -> None:
        self._told_s = time.monotonic()
        self._tell(Report(self._phase, self._told_condition(), self._counters()))

    def _told_condition(self) -> Condition:
        """What the camera has to say of its stream goes out as well: that most frames are torn."""
        if self._phase is Phase.STREAMING:
            return replace(self._condition, reason=self._camera.condition.reason)
        return self._condition

    def _counters(self) -> CameraCounters:
        """Totals; the camera's own count from 0 again whenever it is opened."""
        return self._before + self._camera.counters if self._is_open else self._before

    def _tell_facts(self) -> None:
        camera = self._camera
        facts = Facts(
            intrinsics_source=camera.intrinsics_source,
            frame_count=camera.frame_count,
            has_base=camera.has_base,
            ground_truth=camera.ground_truth,
        )
        self._tell(facts)
