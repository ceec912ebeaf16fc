import logging

import pytest

from drivers.freenect.libfreenect_log import LibfreenectLog

INFO, WARNING, ERROR, SPEW = 4, 2, 1, 6


def image_done(log: LibfreenectLog, packets: int, expected: int = 242) -> None:
    log.add_line(
        SPEW, f"Got depth frame of size 422400/422400, {packets}/{expected} packets arrived,\n"
    )


def test_an_image_is_torn_if_fewer_packets_arrived_than_it_has() -> None:
    log = LibfreenectLog()
    told = []
    for packets in (242, 241, 242):
        image_done(log, packets)
        told.append(log.depth.add_delivered(1.0))
    assert told == [True, False, True]
    assert (log.depth.images, log.depth.incomplete) == (3, 1)


def test_a_loss_across_two_images_tears_both() -> None:
    log = LibfreenectLog()
    log.add_line(INFO, "[Stream 70] Lost 4 packets\n")
    image_done(log, 240)
    first = log.depth.add_delivered(1.0)
    image_done(log, 240)
    second = log.depth.add_delivered(1.0)
    assert (first, second, log.depth.lost_packets) == (False, False, 4)


def test_a_packet_that_is_too_short_tears_its_image() -> None:
    log = LibfreenectLog()
    log.add_line(WARNING, "[Stream 80] Expected 1908 data bytes, but got 900\n")
    log.add_line(SPEW, "Got video frame of size 307200/307200, 162/162 packets arrived, TS 0001\n")
    assert not log.color.add_delivered(1.0)
    assert log.color.add_delivered(1.0)


def test_an_image_that_is_given_up_counts_though_it_never_comes() -> None:
    log = LibfreenectLog()
    log.add_line(INFO, "[Stream 80] Lost 90 packets\n")
    log.add_line(INFO, "[Stream 80] Lost too many packets, resyncing...\n")
    log.add_line(SPEW, "[Stream 80] Not synced yet...\n")
    assert (log.color.images, log.color.incomplete, log.color.lost_packets) == (1, 1, 90)
    assert log.color.last_activity_s > 0
    assert log.depth.last_activity_s == 0


def test_a_stream_that_only_tells_its_packet_size_is_not_heard_yet() -> None:
    log = LibfreenectLog()
    log.add_line(WARNING, "[Stream 70] Negotiated packet size 1760\n")
    assert log.depth.last_activity_s == 0


def test_the_last_complaint_is_kept_and_chatter_is_not() -> None:
    log = LibfreenectLog()
    assert log.last_line == "libfreenect gives no reason"
    log.add_line(ERROR, "Failed to claim camera interface: LIBUSB_ERROR_BUSY\n")
    log.add_line(SPEW, "Write Reg 0x0006 <= 0x02\n")
    assert log.last_line == "Failed to claim camera interface: LIBUSB_ERROR_BUSY"
    assert log.contains("Failed to claim")


def test_what_libfreenect_says_reaches_the_log_but_for_the_line_of_each_image(
    caplog: pytest.LogCaptureFixture,
) -> None:
    log = LibfreenectLog()
    with caplog.at_level(logging.DEBUG, "libfreenect"):
        log.add_line(4, "[Stream 70] Lost 5 packets\n")
        log.add_line(6, "Got depth frame of size 422400/422400, 242/242 packets arrived, TS 1\n")
        log.add_line(1, "Failed to claim camera interface: -6\n")
    said = ["[Stream 70] Lost 5 packets", "Failed to claim camera interface: -6"]
    assert caplog.messages == said
