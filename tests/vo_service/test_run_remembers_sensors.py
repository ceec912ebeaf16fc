"""A service on a shaken Kinect learns its timing, and the next one starts with it."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.calibration import KINECT_TIMING_PRIOR
from drivers.core.geometry import rigid_transform, so3_exp
from tests.simulators.kinect_simulator import (
    KinectSimulator,
    simulator_environment,
)
from tests.simulators.usb_frames import UsbFrames, write_usb_frames
from tests.vo_service.corner_sequence import CAMERA, make_corner_kinect
from tests.vo_service.odometry.synthetic_views import render_corner
from tests.vo_service.service_process import (
    ONLY_POSES_CONFIG,
    ServiceProcess,
    running_service,
)
from vo_service.sensor_memory import (
    read_remembered_sensor,
    sensor_folder,
)

pytestmark = [
    pytest.mark.subprocess,
    pytest.mark.zenoh,
    pytest.mark.usefixtures("real_libfreenect", "simulated_libusb"),
]

# Half a swing; played there and back it takes a second.
FILM_FRAMES = 16


def write_film(folder: Path, count: int) -> UsbFrames:
    """A corner seen by a hand that shakes the Kinect, up to 0.5 rad/s."""
    frames = []
    for seq in range(count):
        swing = np.cos(np.pi * seq / (FILM_FRAMES - 1))
        T = rigid_transform(so3_exp(swing * np.array([0.05, 0.06, 0.03])), [0.03 * swing, 0, 0])
        view = render_corner(T, seq, CAMERA)
        frames.append((view.color_bgr, np.rint(view.depth_m * 1000.0).astype(np.uint16)))
    return write_usb_frames(folder, frames)


@pytest.fixture(scope="module")
def shaken(tmp_path_factory: pytest.TempPathFactory) -> UsbFrames:
    """A sequence of which the timing can be learned."""
    return write_film(tmp_path_factory.mktemp("shaken"), FILM_FRAMES)


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> UsbFrames:
    """A sequence of which nothing can be learned."""
    return write_film(tmp_path_factory.mktemp("still"), 1)


@contextmanager
def service_on(folder: Path, *kinects: KinectSimulator) -> Iterator[ServiceProcess]:
    """A service that is stopped in order at the end."""
    for kinect in kinects:
        kinect.waits_for_reader = True
    environment = simulator_environment(*kinects)
    with running_service(folder, environment, more_config=ONLY_POSES_CONFIG) as service:
        yield service
        assert service.stop() == 0


def wait_for_timing(service: ServiceProcess, source: str) -> Mapping[str, Any]:
    """The part `camera` of the first status whose timing has this source."""
    service.wait_for_status(lambda status: status["camera"]["sensor_timing_source"] == source)
    camera: Mapping[str, Any] = service.status["camera"]
    return camera


def test_what_was_learned_is_used_by_the_next_service(
    shaken: UsbFrames, still: UsbFrames, tmp_path: Path
) -> None:
    with (
        make_corner_kinect(tmp_path, shaken) as kinect,
        service_on(tmp_path / "service", kinect) as service,
    ):
        wait_for_timing(service, "learned")
    learned = read_remembered_sensor(sensor_folder(tmp_path / "service/state"), kinect.serial)
    assert learned is not None
    assert learned.readout_sigma_s < KINECT_TIMING_PRIOR.readout_sigma_s
    with (
        make_corner_kinect(tmp_path, still) as kinect,
        service_on(tmp_path / "service", kinect) as service,
    ):
        camera = wait_for_timing(service, "memory")
    assert camera["readout_ms"] == pytest.approx(1e3 * learned.readout_s, abs=0.01)
    assert camera["depth_offset_ms"] == pytest.approx(1e3 * learned.depth_offset_s, abs=0.01)
