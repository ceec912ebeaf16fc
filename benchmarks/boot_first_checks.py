"""Checks of the installed service on a booted computer: one function each.

A check returns a short description of its measurement and raises AssertionError if it fails.
"""

import time
from collections.abc import Callable

from benchmarks.boot_computer import RECOVERY_TIMEOUT_S, RENDER_TIMEOUT_S, UNIT, BootedComputer
from benchmarks.boot_container import wait_for

WATCHDOG_S = 10.0
START_TIMEOUT_S = 600.0
MIN_POSES_PER_S = 15.0


def check_cpu_quota(computer: BootedComputer) -> str:
    """Processor quotas work here; the other checks depend on them."""
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
    """The install command works from the checkout, without compiled kernels, at 30 % CPU."""
    computer.write_config()
    drop_in = computer.tree / "etc/systemd/system/kinect-vo.service.d/quota.conf"
    drop_in.parent.mkdir(parents=True, exist_ok=True)
    drop_in.write_text("[Service]\nCPUQuota=30%\n")
    begin_s = time.monotonic()
    output = computer.container.run(
        computer.command,
        "service",
        "install",
        "--enable",
        limit_s=START_TIMEOUT_S + 120,
        check=True,
    )
    taken_s = time.monotonic() - begin_s
    assert "kinect.toml: kept unchanged" in output
    assert computer.unit_property("ActiveState") == "active"
    assert computer.unit_property("NRestarts") == "0", "it was started more than once"
    compiled = [e["MESSAGE"] for e in computer.journal_entries() if "are ready" in e["MESSAGE"]]
    return f"ready after {taken_s:.0f} s, copying included; {compiled[-1]}"


def check_watchdog_without_camera(computer: BootedComputer) -> str:
    """The watchdog does not restart a service without a camera (the room is being rendered)."""
    time.sleep(2 * WATCHDOG_S)
    assert computer.listener.status["state"] == "no_camera", computer.listener.status["state"]
    assert computer.unit_property("NRestarts") == "0"
    return computer.unit_property("StatusText")


def check_poses_published(computer: BootedComputer) -> str:
    """Poses are published; without a quota, so that the room is rendered sooner."""
    computer.set_cpu_quota("")
    taken_s = computer.listener.wait_for_poses(100, RENDER_TIMEOUT_S)
    assert computer.unit_property("NRestarts") == "0"
    return f"100 poses after {taken_s:.0f} s; {computer.unit_property('StatusText')}"


def check_poses_on_slow_board(computer: BootedComputer) -> str:
    """At 60 % CPU the pose rate is high enough."""
    computer.set_cpu_quota("60%")
    time.sleep(10.0)
    rate = computer.listener.measure_pose_rate(20.0)
    assert rate >= MIN_POSES_PER_S, f"{rate:.1f} poses a second"
    return f"{rate:.1f} poses a second"


def check_watchdog_while_paused(computer: BootedComputer) -> str:
    """The watchdog does not restart a paused service."""
    computer.listener.send_command("pause")
    time.sleep(1.0)
    rate = computer.listener.measure_pose_rate(2 * WATCHDOG_S)
    status_text = computer.unit_property("StatusText")
    computer.listener.send_command("resume")
    computer.listener.wait_for_poses(30, RECOVERY_TIMEOUT_S)
    assert rate == 0.0, f"{rate} poses a second while paused"
    assert computer.unit_property("NRestarts") == "0"
    return status_text


def check_reload_of_invalid_config(computer: BootedComputer) -> str:
    """`systemctl reload` reports an invalid configuration until it is fixed."""
    main = computer.unit_property("MainPID")
    computer.write_config(level="loud")
    computer.container.run("systemctl", "reload", UNIT, check=True)
    wait_for(
        lambda: "loud" in computer.unit_property("StatusText"), 20.0, "the configuration error"
    )
    status_text = computer.unit_property("StatusText")
    computer.write_config()
    computer.container.run("systemctl", "reload", UNIT, check=True)
    wait_for(
        lambda: "loud" not in computer.unit_property("StatusText"), 20.0, "the end of the error"
    )
    assert computer.unit_property("MainPID") == main
    computer.listener.wait_for_poses(30, RECOVERY_TIMEOUT_S)
    return status_text


def check_journal_levels(computer: BootedComputer) -> str:
    """The lines in the journal have their levels: information, warning, error."""
    ours = [e for e in computer.journal_entries() if e.get("SYSLOG_IDENTIFIER") == "kinect-vo"]
    levels = {entry["PRIORITY"] for entry in ours}
    assert {"3", "4"} <= levels, f"only the levels {sorted(levels)}"
    assert not [e for e in ours if e["MESSAGE"].startswith("<") or "Traceback" in e["MESSAGE"]]
    return f"{len(ours)} lines of levels {', '.join(sorted(levels))}"


def check_restart_after_hang(computer: BootedComputer) -> str:
    """The watchdog restarts the service after SIGSTOP of the main process."""
    return _recovery_after_signal(computer, "STOP", "watchdog")


def check_restart_after_crash(computer: BootedComputer) -> str:
    """The service restarts after SIGSEGV, and the recorder writes an incident."""
    before = _incidents(computer)
    outcome = _recovery_after_signal(computer, "SEGV", "core-dump|signal")
    wait_for(lambda: len(_incidents(computer)) > len(before), 30.0, "an incident")
    return f"{outcome}; incident {sorted(set(_incidents(computer)) - set(before))[-1]}"


def check_stop_time(computer: BootedComputer) -> str:
    """`systemctl stop` takes less than 5 s."""
    begin_s = time.monotonic()
    computer.container.run("systemctl", "stop", UNIT, check=True)
    taken_s = time.monotonic() - begin_s
    assert taken_s < 5.0, f"it took {taken_s:.1f} s"
    assert computer.unit_property("Result") == "success", computer.unit_property("Result")
    return f"{taken_s:.1f} s"


def check_no_restart_on_config_error(computer: BootedComputer) -> str:
    """After exit code 2, a configuration error, systemd does not restart the service."""
    computer.write_config(level="loud")
    computer.container.run("systemctl", "start", UNIT)
    time.sleep(8.0)
    state, status = computer.unit_property("ActiveState"), computer.unit_property("ExecMainStatus")
    messages = [e["MESSAGE"] for e in computer.journal_entries() if "loud" in e["MESSAGE"]]
    computer.write_config()
    assert (state, status) == ("failed", "2"), f"{state}, exit code {status}"
    return f"{state}, exit code {status}: {messages[-1]}"


def _recovery_after_signal(computer: BootedComputer, signal: str, results: str) -> str:
    """Send the main process a signal, and wait for poses of the restarted service."""
    run = computer.container
    restarts, main = int(computer.unit_property("NRestarts")), computer.unit_property("MainPID")
    run.shell(f"kill -{signal} {main}")
    begin_s = time.monotonic()
    wait_for(lambda: int(computer.unit_property("NRestarts")) > restarts, 60.0, "a restart")
    computer.listener.wait_for_poses(30, RECOVERY_TIMEOUT_S)
    taken_s = time.monotonic() - begin_s
    messages = [
        e["MESSAGE"] for e in computer.journal_entries() if "Failed with result" in e["MESSAGE"]
    ]
    assert any(f"'{result}'" in messages[-1] for result in results.split("|")), messages[-1]
    return f"poses again after {taken_s:.0f} s; {messages[-1]}"


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
