"""What must hold of the installed service on a computer that boots: one function a check.

Each returns what it saw, in a few words, and raises AssertionError where that is not enough.
"""

import time
from collections.abc import Callable

from benchmarks.boot_computer import BACK_LIMIT_S, RENDER_LIMIT_S, UNIT, Computer
from benchmarks.boot_container import wait_for

WATCHDOG_S = 10.0
START_LIMIT_S = 600.0
LEAST_POSES_PER_S = 15.0


def quota_holds(computer: Computer) -> str:
    """A limit of the processor works here, or what is measured under one is worth nothing."""
    run = computer.container.run
    burn = ["sh", "-c", "while :; do :; done"]
    run("systemd-run", "--unit=burn", "-p", "CPUQuota=30%", *burn, check=True)
    time.sleep(4.0)
    process = run("systemctl", "show", "burn", "-p", "MainPID", "--value").strip()
    ticks = int(computer.container.shell(f"cut -d' ' -f14 /proc/{process}/stat"))
    run("systemctl", "stop", "burn")
    assert ticks < 4.0 * 100 * 0.45, f"a process limited to 30 % took {ticks / 4:.0f} %"
    return f"30 % gave {ticks / 4:.0f} %"


def one_command_installs_and_starts_it(computer: Computer) -> str:
    """The real command, from the checkout, with no kernel compiled and 30 % of a processor."""
    computer.write_config()
    drop_in = computer.tree / "etc/systemd/system/kinect-vo.service.d/quota.conf"
    drop_in.parent.mkdir(parents=True, exist_ok=True)
    drop_in.write_text("[Service]\nCPUQuota=30%\n")
    begin_s = time.monotonic()
    said = computer.container.run(
        computer.command, "service", "install", "--enable", limit_s=START_LIMIT_S + 120, check=True
    )
    taken_s = time.monotonic() - begin_s
    assert "kinect.toml: kept as it is" in said
    assert computer.property("ActiveState") == "active"
    assert computer.property("NRestarts") == "0", "it was started more than once"
    compiled = [e["MESSAGE"] for e in computer.entries() if "are ready" in e["MESSAGE"]]
    return f"ready after {taken_s:.0f} s, copying included; {compiled[-1]}"


def no_camera_feeds_the_watchdog(computer: Computer) -> str:
    """While the room is rendered there is no camera, for longer than the watchdog waits."""
    time.sleep(2 * WATCHDOG_S)
    assert computer.listener.status["state"] == "no_camera", computer.listener.status["state"]
    assert computer.property("NRestarts") == "0"
    return computer.property("StatusText")


def poses_are_heard_outside(computer: Computer) -> str:
    """Without the limit, so that the room is rendered sooner."""
    computer.quota("")
    taken_s = computer.listener.wait_for_poses(100, RENDER_LIMIT_S)
    assert computer.property("NRestarts") == "0"
    return f"100 poses after {taken_s:.0f} s; {computer.property('StatusText')}"


def a_small_board_gets_its_poses(computer: Computer) -> str:
    """60 % of a processor."""
    computer.quota("60%")
    time.sleep(10.0)
    rate = computer.listener.poses_per_s(20.0)
    assert rate >= LEAST_POSES_PER_S, f"{rate:.1f} poses a second"
    return f"{rate:.1f} poses a second"


def a_pause_feeds_the_watchdog(computer: Computer) -> str:
    """Paused for longer than the watchdog waits."""
    computer.listener.command("pause")
    time.sleep(1.0)
    rate = computer.listener.poses_per_s(2 * WATCHDOG_S)
    shown = computer.property("StatusText")
    computer.listener.command("resume")
    computer.listener.wait_for_poses(30, BACK_LIMIT_S)
    assert rate == 0.0, f"{rate} poses a second while paused"
    assert computer.property("NRestarts") == "0"
    return shown


def a_broken_configuration_changes_nothing(computer: Computer) -> str:
    """`systemctl reload` with a mistake in the file, then with it mended."""
    main = computer.property("MainPID")
    computer.write_config(level="loud")
    computer.container.run("systemctl", "reload", UNIT, check=True)
    wait_for(lambda: "loud" in computer.property("StatusText"), 20.0, "a word of the mistake")
    shown = computer.property("StatusText")
    computer.write_config()
    computer.container.run("systemctl", "reload", UNIT, check=True)
    wait_for(lambda: "loud" not in computer.property("StatusText"), 20.0, "the end of it")
    assert computer.property("MainPID") == main
    computer.listener.wait_for_poses(30, BACK_LIMIT_S)
    return shown


def the_journal_has_levels(computer: Computer) -> str:
    """Of our own lines: information, warnings and errors as such."""
    ours = [e for e in computer.entries() if e.get("SYSLOG_IDENTIFIER") == "kinect-vo"]
    levels = {entry["PRIORITY"] for entry in ours}
    assert {"3", "4"} <= levels, f"only the levels {sorted(levels)}"
    assert not [e for e in ours if e["MESSAGE"].startswith("<") or "Traceback" in e["MESSAGE"]]
    return f"{len(ours)} lines of levels {', '.join(sorted(levels))}"


def a_hung_process_is_started_again(computer: Computer) -> str:
    """SIGSTOP of the main process; the watchdog sees to it."""
    return _back_after(computer, "STOP", "watchdog")


def a_crash_is_started_again(computer: Computer) -> str:
    """SIGSEGV of the main process; what the recorder held is written down."""
    before = _incidents(computer)
    seen = _back_after(computer, "SEGV", "core-dump|signal")
    wait_for(lambda: len(_incidents(computer)) > len(before), 30.0, "an incident")
    return f"{seen}; incident {sorted(set(_incidents(computer)) - set(before))[-1]}"


def it_stops_in_time(computer: Computer) -> str:
    """`systemctl stop`."""
    begin_s = time.monotonic()
    computer.container.run("systemctl", "stop", UNIT, check=True)
    taken_s = time.monotonic() - begin_s
    assert taken_s < 5.0, f"it took {taken_s:.1f} s"
    assert computer.property("Result") == "success", computer.property("Result")
    return f"{taken_s:.1f} s"


def a_wrong_configuration_is_not_tried_again(computer: Computer) -> str:
    """Exit code 2 is the end, until somebody mends the file."""
    computer.write_config(level="loud")
    computer.container.run("systemctl", "start", UNIT)
    time.sleep(8.0)
    state, status = computer.property("ActiveState"), computer.property("ExecMainStatus")
    told = [e["MESSAGE"] for e in computer.entries() if "loud" in e["MESSAGE"]]
    computer.write_config()
    assert (state, status) == ("failed", "2"), f"{state}, exit code {status}"
    return f"{state}, exit code {status}: {told[-1]}"


def _back_after(computer: Computer, signal: str, results: str) -> str:
    """Send the main process a signal, and wait until a new one publishes poses."""
    run = computer.container
    restarts, main = int(computer.property("NRestarts")), computer.property("MainPID")
    run.shell(f"kill -{signal} {main}")
    begin_s = time.monotonic()
    wait_for(lambda: int(computer.property("NRestarts")) > restarts, 60.0, "a restart")
    computer.listener.wait_for_poses(30, BACK_LIMIT_S)
    taken_s = time.monotonic() - begin_s
    said = [e["MESSAGE"] for e in computer.entries() if "Failed with result" in e["MESSAGE"]]
    assert any(f"'{result}'" in said[-1] for result in results.split("|")), said[-1]
    return f"poses again after {taken_s:.0f} s; {said[-1]}"


def _incidents(computer: Computer) -> list[str]:
    folder = computer.tree / "var/lib/private/kinect-vo/incidents"
    return sorted(path.name for path in folder.glob("*")) if folder.exists() else []


FIRST_BOOT: tuple[Callable[[Computer], str], ...] = (
    quota_holds,
    one_command_installs_and_starts_it,
    no_camera_feeds_the_watchdog,
    poses_are_heard_outside,
    a_small_board_gets_its_poses,
    a_pause_feeds_the_watchdog,
    a_broken_configuration_changes_nothing,
    the_journal_has_levels,
    a_hung_process_is_started_again,
    a_crash_is_started_again,
    it_stops_in_time,
    a_wrong_configuration_is_not_tried_again,
)
