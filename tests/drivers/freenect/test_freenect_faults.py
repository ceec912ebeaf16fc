import time
from collections.abc import Callable
from itertools import pairwise

import pytest

from drivers.camera import CameraState, FrameTimeout, RgbdFrame
from drivers.core import CameraError, CameraLostError, CameraNotFoundError
from drivers.freenect.bindings import load_library
from drivers.freenect.camera import FreenectCamera
from tests.drivers.freenect.conftest import MakeCamera
from tests.simulators.fixtures import FRAME_COUNT
from tests.simulators.kinect_simulator import KinectSimulator, KinectStream
from tests.waiting import wait_until


def pixels(frame: RgbdFrame) -> tuple[bytes, bytes]:
    return frame.color_bgr.tobytes(), frame.depth_raw.tobytes()


def state_of(camera: FreenectCamera) -> CameraState:
    return camera.status.state


def whole_film(camera: FreenectCamera) -> set[tuple[bytes, bytes]]:
    """Every frame of the sequence as it looks when nothing is lost."""
    whole: set[tuple[bytes, bytes]] = set()
    while len(whole) < FRAME_COUNT:
        whole.add(pixels(camera.read(3.0)))
    return whole


def read_until_lost(camera: FreenectCamera) -> CameraLostError:
    """What the camera says when it is lost; fails if it never says so."""
    deadline_s = time.monotonic() + 100
    while time.monotonic() < deadline_s:
        try:
            camera.read(0.2)
        except FrameTimeout:
            pass
        except CameraLostError as error:
            return error
    pytest.fail("the loss was never noticed")


def reopen(camera: FreenectCamera) -> None:
    """Open it as soon as that can be done."""

    def opens() -> bool:
        try:
            camera.open()
        except CameraError:
            return False
        return True

    wait_until(opens)


@pytest.mark.parametrize(
    ("stream", "every"), [(KinectStream.DEPTH, 601), (KinectStream.COLOR, 407)]
)
def test_an_image_with_lost_packets_is_never_delivered(
    stream: KinectStream, every: int, kinect: KinectSimulator, make_camera: MakeCamera
) -> None:
    with make_camera() as camera:
        whole = whole_film(camera)
        kinect.lose_packets(stream, every)
        frames = [camera.read(3.0) for _ in range(20)]
        counters = camera.counters
    assert all(pixels(frame) in whole for frame in frames)
    assert counters.skipped >= 3
    assert sum(frame.lost_packets for frame in frames) >= 3
    assert 0 < counters.lost_packets <= sum(kinect.packets_lost)
    assert all(a.seq < b.seq and a.stamp_s < b.stamp_s for a, b in pairwise(frames))


@pytest.mark.parametrize("packets", [1, 4, 7, 300])
def test_after_a_burst_of_lost_packets_complete_images_arrive(
    packets: int, kinect: KinectSimulator, make_camera: MakeCamera
) -> None:
    with make_camera() as camera:
        whole = whole_film(camera)
        for stream in KinectStream:
            kinect.lose_burst(stream, packets)
        frames = [camera.read(3.0) for _ in range(8)]
        assert camera.counters.skipped >= 1
    assert all(pixels(frame) in whole for frame in frames)


def test_when_most_images_are_incomplete_the_status_has_a_remedy(
    kinect: KinectSimulator, make_camera: MakeCamera
) -> None:
    with make_camera() as camera:
        camera.read(3.0)
        kinect.lose_packets(KinectStream.DEPTH, every=50)
        kinect.lose_packets(KinectStream.COLOR, every=50)
        wait_until(lambda: camera.status.reason != "")
        condition = camera.status
        kinect.lose_packets(KinectStream.DEPTH, every=0)
        kinect.lose_packets(KinectStream.COLOR, every=0)
        wait_until(lambda: camera.status.reason == "")
    assert condition.state is CameraState.STREAMING
    assert "losing USB packets" in condition.reason
    assert "a USB 2 controller of its own" in condition.reason


def test_an_unplugged_kinect_is_lost_and_streams_after_replugging(
    kinect: KinectSimulator, make_camera: MakeCamera
) -> None:
    camera = make_camera()
    camera.open()
    before = camera.read(3.0)
    kinect.unplug()
    assert "the Kinect is gone" in str(read_until_lost(camera))
    assert state_of(camera) is CameraState.LOST
    camera.close()
    with pytest.raises(CameraNotFoundError, match="no Kinect on the USB; plug it in"):
        camera.open()
    assert state_of(camera) is CameraState.ABSENT
    kinect.plug()
    camera.open()
    after = camera.read(3.0)
    assert after.stamp_s > before.stamp_s
    assert state_of(camera) is CameraState.STREAMING


@pytest.mark.parametrize("stream", list(KinectStream))
def test_a_stream_that_stops_is_reported(
    stream: KinectStream, kinect: KinectSimulator, make_camera: MakeCamera
) -> None:
    with make_camera() as camera:
        camera.read(3.0)
        kinect.stall(True, stream)
        error = read_until_lost(camera)
        kinect.stall(False)
        reopen(camera)
        camera.read(3.0)
    assert f"sent no {stream.name.lower()} image for 1 s" in str(error)


def test_a_stream_that_never_starts_is_reported(
    kinect: KinectSimulator, make_camera: MakeCamera
) -> None:
    kinect.stall(True, KinectStream.COLOR)
    with make_camera() as camera:
        assert camera.status.state is CameraState.STARTING
        error = read_until_lost(camera)
    assert "no color image within 2 s of its start" in str(error)
    assert "12 V" in str(error)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (KinectSimulator.set_busy, "held by another program or the kernel"),
        (KinectSimulator.deny_access, "sudo kinect-vo udev install"),
        (KinectSimulator.remove_bandwidth, "no USB bandwidth for the Kinect"),
    ],
)
def test_a_reason_that_prevents_opening_is_reported_until_it_is_gone(
    fault: Callable[[KinectSimulator, bool], None],
    words: str,
    kinect: KinectSimulator,
    make_camera: MakeCamera,
) -> None:
    fault(kinect, True)
    camera = make_camera()
    with pytest.raises(CameraError, match=words):
        camera.open()
    assert camera.status.state is CameraState.OPENING
    assert words in camera.status.reason
    fault(kinect, False)
    with camera:
        camera.read(3.0)


def test_the_kernel_driver_is_detached(kinect: KinectSimulator, make_camera: MakeCamera) -> None:
    kinect.attach_kernel_driver(True)
    with make_camera() as camera:
        camera.read(3.0)


def test_nothing_is_left_open_after_many_failures(
    kinect: KinectSimulator, make_camera: MakeCamera
) -> None:
    camera = make_camera()
    for fault in (kinect.remove_bandwidth, kinect.set_busy, kinect.deny_access) * 4:
        fault(True)
        with pytest.raises(CameraError):
            camera.open()
        fault(False)
    assert (kinect.open_handles, kinect.abandoned_transfers) == (0, 0)


def test_a_missing_library_is_reported_with_its_package() -> None:
    with pytest.raises(Exception, match=r"libfreenect.so.9.* apt install libfreenect0.5"):
        load_library("libfreenect.so.9")
