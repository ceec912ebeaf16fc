"""The ring: what a reader gets is whole or nothing, and the newest is always there."""

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.process.record_ring import RecordRingReader, RecordRingWriter
from tests.full_disk import limit_file_size
from tests.waiting import wait_until

MOST = 4096


@contextmanager
def ring(
    seconds: float = 1.0, most_bytes: int = MOST
) -> Iterator[tuple[RecordRingWriter, RecordRingReader]]:
    """Both ends."""
    writer = RecordRingWriter("trial", seconds, most_bytes)
    reader = RecordRingReader(writer.memory)
    try:
        yield writer, reader
    finally:
        reader.close()
        writer.close()


def put(writer: RecordRingWriter, number: int, length: int, time_s: float, bound: int = 0) -> None:
    """A record whose every byte says which one it is."""
    note = str(number).encode()
    bound = max(bound, length + len(note))
    room = writer.reserve(bound, time_s)
    room[:length] = number % 251
    writer.commit(length, note, bound, time_s)


def held(reader: RecordRingReader, last: int = 1000) -> list[int]:
    """Numbers of those of the last records that are there; fails if one is not whole."""
    numbers = []
    end = reader.record_count
    for number in range(max(reader.oldest_number, end - last), end):
        record = reader.read_record(number)
        if record is not None:
            assert record.metadata == str(number).encode()
            assert reader.read_metadata(number) in (
                record.metadata,
                None,
            )  # None: it has just been overwritten
            assert set(record.payload) <= {number % 251}
            numbers.append(number)
    return numbers


@given(st.lists(st.integers(0, 900), min_size=1, max_size=60))
def test_the_newest_records_are_contiguous(lengths: list[int]) -> None:
    with ring() as (writer, reader):
        for number, length in enumerate(lengths):
            put(writer, number, length, 0.0)
            numbers = held(reader)
            assert numbers == list(range(numbers[0], number + 1))


def test_the_ring_holds_the_configured_time_in_constant_memory() -> None:
    with ring(seconds=1.0, most_bytes=1 << 26) as (writer, reader):
        for number in range(300):
            put(writer, number, 100_000, number / 30)
        assert 30 <= len(held(reader)) <= 40
        assert not writer.is_limited_by_bytes
        assert writer.used_bytes < 45 * 100_000


def test_a_memory_limit_shortens_the_record_and_is_reported() -> None:
    with ring(seconds=10.0) as (writer, reader):
        for number in range(100):
            put(writer, number, 500, number / 30)
        assert 5 <= len(held(reader)) <= 8
        assert writer.is_limited_by_bytes
        assert writer.used_bytes == MOST


def test_memory_is_allocated_only_as_the_ring_is_filled() -> None:
    with ring(seconds=10.0, most_bytes=1 << 26) as (writer, _):
        assert writer.used_bytes == 0
        put(writer, 0, 1000, 0.0)
        assert writer.used_bytes == 1 << 20


def test_a_record_larger_than_the_ring_is_refused_without_damage() -> None:
    with ring() as (writer, reader):
        put(writer, 0, 100, 0.0)
        with pytest.raises(OSError, match="memory"):
            writer.reserve(MOST + 1, 0.0)
        put(writer, 1, 100, 0.0)
        assert 1 in held(reader)


def test_records_from_before_a_clock_step_make_room_for_newer_ones() -> None:
    with ring(seconds=1.0, most_bytes=1 << 22) as (writer, reader):
        for number in range(40):
            put(writer, number, 1000, 5000.0 + number / 30)
        for number in range(40, 80):
            put(writer, number, 1000, number / 30)
        assert set(range(52, 80)) <= set(held(reader))


def test_unavailable_memory_is_an_error_at_once() -> None:
    with limit_file_size(1000), pytest.raises(OSError, match="File too large"):
        RecordRingWriter("trial", 1.0, MOST)


@pytest.mark.slow
def test_a_reader_beside_a_fast_writer_never_reads_a_partial_record() -> None:
    random = np.random.default_rng(1)
    stop = threading.Event()
    with ring(seconds=100.0, most_bytes=200_000) as (writer, reader):

        def write() -> None:
            for number in count():
                put(writer, number, int(random.integers(0, 40_000)), number / 30, 40_010)
                if stop.is_set():
                    return

        thread = threading.Thread(target=write)
        thread.start()
        try:
            wait_until(lambda: reader.record_count > 0)
            seen = sum(len(held(reader, last=3)) for _ in range(500))
        finally:
            stop.set()
            thread.join()
    assert seen > 0


WATCH_THE_COUNTERS = """
import sys
from drivers.core.process.record_ring import RecordRingMemory, RecordRingReader

reader = RecordRingReader(RecordRingMemory(*map(int, sys.argv[1:])))
print(min(reader.record_count for _ in range(2_000_000)))
"""


@pytest.mark.subprocess
def test_another_process_never_sees_the_counters_cleared() -> None:
    with ring() as (writer, _):
        put(writer, 0, 100, 0.0)
        watcher = subprocess.Popen(
            [
                sys.executable,
                "-c",
                WATCH_THE_COUNTERS,
                str(writer.memory.fd),
                str(writer.memory.entries),
            ],
            pass_fds=[writer.memory.fd],
            stdout=subprocess.PIPE,
        )
        while watcher.poll() is None:
            writer.reserve(100, 0.0)
        assert watcher.communicate()[0] == b"1\n"
