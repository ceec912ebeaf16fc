"""What must hold of the installed service on a computer that boots: one function a check.

Each returns what it saw, in a few words, and raises AssertionError where that is not enough.
"""

import time
from collections.abc import Callable

from benchmarks.boot_computer import RECOVERY_TIMEOUT_S, RENDER_TIMEOUT_S, UNIT, BootedComputer
from benchmarks.boot_container import wait_for

WATCHDOG_S = 10.0
START_TIMEOUT_S = 600.0
MIN_POSES_PER_S = 15.0


def check_cpu_quota(computer: BootedComputer) -> str:
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


def check_install(computer: BootedComputer) -> str:
    """The real command, from the checkout, with no kernel compiled and 30 % of a processor."""
    computer.write_config()
    drop_in = computer.tree / "etc/systemd/system/kinect-vo.service.d/quota.conf"
    drop_in.parent.mkdir(parents=True, exist_ok=True)
    drop_in.write_text("[Service]\nCPUQuota=30%\n")
    begin_s = time.monotonic()
    said = computer.container.run(
        computer.command,
        "service",
        "install",
        "--enable",
        limit_s=START_TIMEOUT_S + 120,
        check=True,
    )
    taken_s = time.monotonic() - begin_s
    assert "kinect.toml: kept unchanged" in said
    assert computer.unit_property("ActiveState") == "active"
    assert computer.unit_property("NRestarts") == "0", "it was started more than once"
    compiled = [e["MESSAGE"] for e in computer.journal_entries() if "are ready" in e["MESSAGE"]]
    return f"ready after {taken_s:.0f} s, copying included; {compiled[-1]}"


def check_watchdog_without_camera(computer: BootedComputer) -> str:
    """While the room is rendered there is no camera, for longer than the watchdog waits."""
    time.sleep(2 * WATCHDOG_S)
    assert computer.listener.status["state"] == "no_camera", computer.listener.status["state"]
    assert computer.unit_property("NRestarts") == "0"
    return computer.unit_property("StatusText")


def check_poses_published(computer: BootedComputer) -> str:
    """Without the limit, so that the room is rendered sooner."""
    computer.set_cpu_quota("")
    taken_s = computer.listener.wait_for_poses(100, RENDER_TIMEOUT_S)
    assert computer.unit_property("NRestarts") == "0"
    return f"100 poses after {taken_s:.0f} s; {computer.unit_property('StatusText')}"


def check_poses_on_slow_board(computer: BootedComputer) -> str:
    """60 % of a processor."""
    computer.set_cpu_quota("60%")
    time.sleep(10.0)
    rate = computer.listener.measure_pose_rate(20.0)
    assert rate >= MIN_POSES_PER_S, f"{rate:.1f} poses a second"
    return f"{rate:.1f} poses a second"


def check_watchdog_while_paused(computer: BootedComputer) -> str:
    """Paused for longer than the watchdog waits."""
    computer.listener.send_command("pause")
    time.sleep(1.0)
    rate = computer.listener.measure_pose_rate(2 * WATCHDOG_S)
    shown = computer.unit_property("StatusText")
    computer.listener.send_command("resume")
    computer.listener.wait_for_poses(30, RECOVERY_TIMEOUT_S)
    assert rate == 0.0, f"{rate} poses a second while paused"
    assert computer.unit_property("NRestarts") == "0"
    return shown


def check_reload_of_invalid_config(computer: BootedComputer) -> str:
    """`systemctl reload` with a mistake in the file, then with it mended."""
    main = computer.unit_property("MainPID")
    computer.write_config(level="loud")
    computer.container.run("systemctl", "reload", UNIT, check=True)
    wait_for(lambda: "loud" in computer.unit_property("StatusText"), 20.0, "a word of the mistake")
    shown = computer.unit_property("StatusText")
    computer.write_config()
    computer.container.run("systemctl", "reload", UNIT, check=True)
    wait_for(lambda: "loud" not in computer.unit_property("StatusText"), 20.0, "the end of it")
    assert computer.unit_property("MainPID") == main
    computer.listener.wait_for_poses(30, RECOVERY_TIMEOUT_S)
    return shown


def check_journal_levels(computer: BootedComputer) -> str:
    """Of our own lines: information, warnings and errors as such."""
    ours = [e for e in computer.journal_entries() if e.get("SYSLOG_IDENTIFIER") == "kinect-vo"]
    levels = {entry["PRIORITY"] for entry in ours}
    assert {"3", "4"} <= levels, f"only the levels {sorted(levels)}"
    assert not [e for e in ours if e["MESSAGE"].startswith("<") or "Traceback" in e["MESSAGE"]]
    return f"{len(ours)} lines of levels {', '.join(sorted(levels))}"


def check_restart_after_hang(computer: BootedComputer) -> str:
    """SIGSTOP of the main process; the watchdog sees to it."""
    return _recovery_after_signal(computer, "STOP", "watchdog")


def check_restart_after_crash(computer: BootedComputer) -> str:
    """SIGSEGV of the main process; what the recorder held is written down."""
    before = _incidents(computer)
    seen = _recovery_after_signal(computer, "SEGV", "core-dump|signal")
    wait_for(lambda: len(_incidents(computer)) > len(before), 30.0, "an incident")
    return f"{seen}; incident {sorted(set(_incidents(computer)) - set(before))[-1]}"


def check_stop_time(computer: BootedComputer) -> str:
    """`systemctl stop`."""
    begin_s = time.monotonic()
    computer.container.run("systemctl", "stop", UNIT, check=True)
    taken_s = time.monotonic() - begin_s
    assert taken_s < 5.0, f"it took {taken_s:.1f} s"
    assert computer.unit_property("Result") == "success", computer.unit_property("Result")
    return f"{taken_s:.1f} s"


def check_no_restart_on_config_error(computer: BootedComputer) -> str:
    """Exit code 2 is the end, until somebody mends the file."""
    computer.write_config(level="loud")
    computer.container.run("systemctl", "start", UNIT)
    time.sleep(8.0)
    state, status = computer.unit_property("ActiveState"), computer.unit_property("ExecMainStatus")
    told = [e["MESSAGE"] for e in computer.journal_entries() if "loud" in e["MESSAGE"]]
    computer.write_config()
    assert (state, status) == ("failed", "2"), f"{state}, exit code {status}"
    return f"{state}, exit code {status}: {told[-1]}"


def _recovery_after_signal(computer: BootedComputer, signal: str, results: str) -> str:
    """Send the main process a signal, and wait until a new one publishes poses."""
    run = computer.container
    restarts, main = int(computer.unit_property("NRestarts")), computer.unit_property("MainPID")
    run.shell(f"kill -{signal} {main}")
    begin_s = time.monotonic()
    wait_for(lambda: int(computer.unit_property("NRestarts")) > restarts, 60.0, "a restart")
    computer.listener.wait_for_poses(30, RECOVERY_TIMEOUT_S)
    taken_s = time.monotonic() - begin_s
    said = [
        e["MESSAGE"] for e in computer.journal_entries() if "Failed with result" in e["MESSAGE"]
    ]
    assert any(f"'{result}'" in said[-1] for result in results.split("|")), said[-1]
    return f"poses again after {taken_s:.0f} s; {said[-1]}"


def _incidents(computer: BootedComputer) -> list[str]:
    folder = computer.tree / "var/lib/private/kinect-vo/incidents"
    return sorted(path.name for path in folder.glob("*")) if folder.exists() else []


FIRST_BOOT: tuple[Callable[[BootedComputer], str], ...] = (
    check_cpu_quota,
    check_install,
    check_watchdog_without_camera,
    check_poses_published,
    check_poses_on_slow_board,
    check_watchdog_while_paused,
    check_reload_of_invalid_config,
    check_journal_levels,
    check_restart_after_hang,
    check_restart_after_crash,
    check_stop_time,
    check_no_restart_on_config_error,
)
