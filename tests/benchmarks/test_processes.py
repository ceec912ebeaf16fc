"""Load and memory of processes, and the messages that a subscriber receives."""

import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from benchmarks.processes import LoadMeter, memory_mb
from benchmarks.subscriber import Arrivals
from tests.waiting import wait_until

pytestmark = pytest.mark.subprocess


def test_the_load_is_that_of_a_process_and_its_descendants() -> None:
    shell = ["sh", "-c", f"{sys.executable} -c 'while True: pass'; true"]
    with subprocess.Popen(shell, start_new_session=True) as process:
        meter = LoadMeter(process.pid)
        wait_until(lambda: sum(meter.read().cpu_s.values()) > 0.2)
        load = meter.read()
        os.killpg(process.pid, signal.SIGKILL)
    assert load.cpu_s[process.pid] < 0.1
    assert load.percent() == pytest.approx(100.0 * sum(load.cpu_s.values()) / load.seconds)
    assert load.percent_without(process.pid) > 0.9 * load.percent()
    assert load.per_frame_ms(100) == pytest.approx(10.0 * sum(load.cpu_s.values()))


def test_memory_is_in_megabytes() -> None:
    assert 10.0 < memory_mb(os.getpid(), "RssAnon") < memory_mb(os.getpid(), "VmRSS") < 1e5
    assert 10.0 < memory_mb(os.getpid(), "Pss") < 1e5


def test_lost_messages_and_latencies_are_those_between_two_stamps() -> None:
    seq = np.array([4.0, 5.0, 7.0, 8.0])
    arrivals = Arrivals(seq + 0.01, seq, seq, cpu_s=0.0).between(5.0, 8.0)
    assert (len(arrivals), arrivals.lost) == (2, 1)
    assert arrivals.latency_ms == pytest.approx([10.0, 10.0])
    assert arrivals.between(9.0).lost == 0
