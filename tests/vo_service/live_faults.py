"""What can go wrong around a service that goes on: how it comes, what is said, how it goes.

The tests let each of them happen; the benchmark measures how long the service needs.
"""

import os
import resource
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.belongings import child_running
from tests.stand_ins.zenoh_router import RouterProcess
from tests.vo_service.live_stage import LiveStage
from tests.vo_service.service_faults import Passed
from tests.waiting import wait_until

RECORDER = "vo_service.recorder.child"
MAPPER = "vo_service.mapping.live.child"
NO_LIMIT = resource.RLIM_INFINITY


@dataclass(frozen=True)
class Around:
    """A service that streams, and what it depends on."""

    stage: LiveStage
    router: RouterProcess


Action = Callable[[Around], None]


@dataclass(frozen=True)
class LiveFault:
    """One fault; `words` are in a warning of the status while it lasts."""

    name: str
    begin: Action
    words: str
    end: Action


def pass_through(fault: LiveFault, around: Around) -> Passed:
    """Let it begin, wait until it is said, let it end, wait until no more is said of it."""
    service = around.stage.service
    begin_s = time.monotonic()
    fault.begin(around)
    service.until(lambda status: any(fault.words in each for each in status["warnings"]))
    told_s = time.monotonic()
    fault.end(around)
    service.until(lambda status: not any(fault.words in each for each in status["warnings"]))
    return Passed(told_s - begin_s, time.monotonic() - told_s)


def by_itself(around: Around) -> None:
    """Nothing needs to be done."""


def reload_with(text: Callable[[LiveStage], str]) -> Action:
    """Write the configuration and ask the service to read it."""

    def act(around: Around) -> None:
        around.stage.config.write_text(text(around.stage))
        around.stage.service.process.send_signal(signal.SIGHUP)

    return act


def kill_recorder(around: Around) -> None:
    """As the kernel does when memory is short."""
    os.kill(recorder_of(around), signal.SIGKILL)


def kill_mapper(around: Around) -> None:
    """As the kernel does when memory is short."""
    os.kill(child_running(around.stage.service.process.pid, MAPPER), signal.SIGKILL)


def fill_disk(around: Around) -> None:
    """While it records: from now on no file of the recorder can grow."""
    folder = start_recording(around)
    wait_until(lambda: any((folder / "rgb").glob("*")), "a recorded image")
    resource.prlimit(recorder_of(around), resource.RLIMIT_FSIZE, (0, NO_LIMIT))


def free_disk(around: Around) -> None:
    """Files can grow again; the next recording shows it."""
    resource.prlimit(recorder_of(around), resource.RLIMIT_FSIZE, (NO_LIMIT, NO_LIMIT))
    start_recording(around)
    around.stage.ask("stop-recording")


def start_recording(around: Around) -> Path:
    """Into a new folder, as soon as the recorder is there."""
    recordings = around.stage.state_folder / "recordings"
    name = f"room-{len(list(recordings.glob('*')))}"
    wait_until(lambda: around.stage.is_obeyed("start-recording", name=name), "the recorder")
    return recordings / name


def recorder_of(around: Around) -> int:
    """Process number of the flight recorder."""
    return child_running(around.stage.service.process.pid, RECORDER)


LIVE_FAULTS = (
    LiveFault(
        "router gone",
        lambda around: around.router.kill(),
        "zenoh: no connection to",
        lambda around: around.router.start(),
    ),
    LiveFault(
        "configuration broken on reload",
        reload_with(lambda stage: f"{stage.good_config}\nspeed = "),
        "the configuration is not the one in the file",
        reload_with(lambda stage: stage.good_config),
    ),
    LiveFault(
        "recorder killed",
        kill_recorder,
        "recorder: its process ended and is started again",
        by_itself,
    ),
    LiveFault(
        "map's process killed",
        kill_mapper,
        "map: its process ended and is started again; the map begins anew",
        by_itself,
    ),
    LiveFault(
        "disk full while recording",
        fill_disk,
        "recorder: ",
        free_disk,
    ),
)
