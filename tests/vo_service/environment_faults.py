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

from tests.resource_leaks import find_child_running
from tests.simulators.zenoh_router import RouterProcess
from tests.vo_service.sensor_faults import FaultTiming
from tests.vo_service.service_runner import ServiceRunner
from tests.waiting import wait_until

RECORDER = "vo_service.outputs.recorder.worker:run_recorder"
MAPPER = "vo_service.mapper_process:run"
NO_LIMIT = resource.RLIM_INFINITY


@dataclass(frozen=True)
class ServiceEnvironment:
    """A service that streams, and what it depends on."""

    runner: ServiceRunner
    router: RouterProcess


Action = Callable[[ServiceEnvironment], None]


@dataclass(frozen=True)
class EnvironmentFault:
    """One fault; `words` are in a warning of the status while it lasts."""

    name: str
    begin: Action
    status_text: str
    end: Action


def run_fault(fault: EnvironmentFault, environment: ServiceEnvironment) -> FaultTiming:
    """Let it begin, wait until it is said, let it end, wait until no more is said of it."""
    service = environment.runner.service
    begin_s = time.monotonic()
    fault.begin(environment)
    service.wait_for_status(
        lambda status: any(fault.status_text in each for each in status["warnings"])
    )
    told_s = time.monotonic()
    fault.end(environment)
    service.wait_for_status(
        lambda status: not any(fault.status_text in each for each in status["warnings"])
    )
    return FaultTiming(told_s - begin_s, time.monotonic() - told_s)


def do_nothing(around: ServiceEnvironment) -> None:
    """Nothing needs to be done."""


def make_reload_action(text: Callable[[ServiceRunner], str]) -> Action:
    """Write the configuration and ask the service to read it."""

    def act(around: ServiceEnvironment) -> None:
        around.runner.config.write_text(text(around.runner))
        around.runner.service.process.send_signal(signal.SIGHUP)

    return act


def kill_recorder(around: ServiceEnvironment) -> None:
    """As the kernel does when memory is short."""
    os.kill(recorder_pid(around), signal.SIGKILL)


def kill_mapper(around: ServiceEnvironment) -> None:
    """As the kernel does when memory is short."""
    os.kill(find_child_running(around.runner.service.process.pid, MAPPER), signal.SIGKILL)


def fill_disk(around: ServiceEnvironment) -> None:
    """While it records: from now on no file of the recorder can grow."""
    folder = start_recording(around)
    wait_until(lambda: any((folder / "rgb").glob("*")), "a recorded image")
    resource.prlimit(recorder_pid(around), resource.RLIMIT_FSIZE, (0, NO_LIMIT))


def free_disk(around: ServiceEnvironment) -> None:
    """Files can grow again; the next recording shows it."""
    resource.prlimit(recorder_pid(around), resource.RLIMIT_FSIZE, (NO_LIMIT, NO_LIMIT))
    start_recording(around)
    around.runner.send_command("stop-recording")


def start_recording(around: ServiceEnvironment) -> Path:
    """Into a new folder, as soon as the recorder is there."""
    recordings = around.runner.state_folder / "recordings"
    name = f"room-{len(list(recordings.glob('*')))}"
    wait_until(lambda: around.runner.is_accepted("start-recording", name=name), "the recorder")
    return recordings / name


def recorder_pid(around: ServiceEnvironment) -> int:
    """Process number of the flight recorder."""
    return find_child_running(around.runner.service.process.pid, RECORDER)


ENVIRONMENT_FAULTS = (
    EnvironmentFault(
        "router gone",
        lambda around: around.router.kill(),
        "zenoh: no connection to",
        lambda around: around.router.start(),
    ),
    EnvironmentFault(
        "configuration broken on reload",
        make_reload_action(lambda stage: f"{stage.good_config}\nspeed = "),
        "the configuration is not the one in the file",
        make_reload_action(lambda stage: stage.good_config),
    ),
    EnvironmentFault(
        "recorder killed",
        kill_recorder,
        "recorder: its process ended and is started again",
        do_nothing,
    ),
    EnvironmentFault(
        "map's process killed",
        kill_mapper,
        "map: the mapper process died and is restarted with an empty map",
        do_nothing,
    ),
    EnvironmentFault(
        "disk full while recording",
        fill_disk,
        "recorder: ",
        free_disk,
    ),
)
