import logging

import pytest

from drivers.freenect.log import LibfreenectLog

INFO, WARNING, ERROR, SPEW = 4, 2, 1, 6


def image_done(log: LibfreenectLog, packets: int, expected: int = 242) -> None:
    log.add_line(
        SPEW, f"Got depth frame of size 422400/422400, {packets}/{expected} packets arrived,\n"
    )


def test_an_image_with_missing_packets_is_incomplete() -> None:
    log = LibfreenectLog()
    told = []
    for packets in (242, 241, 242):
        image_done(log, packets)
        told.append(log.depth.add_delivered(1.0))
    assert told == [True, False, True]
    assert (log.depth.images, log.depth.incomplete) == (3, 1)


def test_a_loss_across_two_images_makes_both_incomplete() -> None:
    log = LibfreenectLog()
    log.add_line(INFO, "[Stream 70] Lost 4 packets\n")
    image_done(log, 240)
    first = log.depth.add_delivered(1.0)
    image_done(log, 240)
    second = log.depth.add_delivered(1.0)
    assert (first, second, log.depth.lost_packets) == (False, False, 4)


def test_a_short_packet_makes_its_image_incomplete() -> None:
    log = LibfreenectLog()
    log.add_line(WARNING, "[Stream 80] Expected 1908 data bytes, but got 900\n")
    log.add_line(SPEW, "Got video frame of size 307200/307200, 162/162 packets arrived, TS 0001\n")
    assert not log.color.add_delivered(1.0)
    assert log.color.add_delivered(1.0)


def test_a_discarded_image_counts_as_incomplete() -> None:
    log = LibfreenectLog()
    log.add_line(INFO, "[Stream 80] Lost 90 packets\n")
    log.add_line(INFO, "[Stream 80] Lost too many packets, resyncing...\n")
    log.add_line(SPEW, "[Stream 80] Not synced yet...\n")
    assert (log.color.images, log.color.incomplete, log.color.lost_packets) == (1, 1, 90)
    assert log.color.last_activity_s > 0
    assert log.depth.last_activity_s == 0


def test_a_stream_that_only_reports_its_packet_size_has_not_started() -> None:
    log = LibfreenectLog()
    log.add_line(WARNING, "[Stream 70] Negotiated packet size 1760\n")
    assert log.depth.last_activity_s == 0


def test_the_last_error_line_is_kept_and_debug_lines_are_not() -> None:
    log = LibfreenectLog()
    assert log.last_line == "libfreenect gives no reason"
    log.add_line(ERROR, "Failed to claim camera interface: LIBUSB_ERROR_BUSY\n")
    log.add_line(SPEW, "Write Reg 0x0006 <= 0x02\n")
    assert log.last_line == "Failed to claim camera interface: LIBUSB_ERROR_BUSY"
    assert log.contains("Failed to claim")


def test_libfreenect_lines_are_logged_except_those_of_each_image(
    caplog: pytest.LogCaptureFixture,
) -> None:
    log = LibfreenectLog()
    with caplog.at_level(logging.DEBUG, "libfreenect"):
        log.add_line(4, "[Stream 70] Lost 5 packets\n")
        log.add_line(6, "Got depth frame of size 422400/422400, 242/242 packets arrived, TS 1\n")
        log.add_line(1, "Failed to claim camera interface: -6\n")
    said = ["[Stream 70] Lost 5 packets", "Failed to claim camera interface: -6"]
    assert caplog.messages == said
