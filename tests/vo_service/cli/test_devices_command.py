"""`kinect-vo devices`: what is plugged in, and what to give to --camera."""

import json
from collections.abc import Callable

import pytest

from drivers.kinect_usb.usb_ids import SensorModel
from drivers.openni2.device import DetectedDevice
from tests.simulators.kinect_simulator import KinectModel as Played
from tests.simulators.kinect_simulator import KinectSimulator, simulator_environment
from tests.vo_service.cli.cli_runner import KinectVo
from tests.vo_service.tools.doctor.doctor_fakes import make_sensor
from vo_service.tools.doctor.device_list import OpenNI2Listing, list_available_devices
from vo_service.tools.doctor.usb_probe import OpenError

SERIAL = "A00123456789012A"
CARMINE = DetectedDevice("1d27/0609@1/5", "PrimeSense", "PS1080", (0x1D27, 0x0609))


@pytest.fixture
def plug_in(
    simulate_kinect: Callable[..., KinectSimulator], monkeypatch: pytest.MonkeyPatch
) -> Callable[..., list[KinectSimulator]]:
    """Plug in Kinects, one for each model, that the children of this process see."""

    def plug(*models: Played) -> list[KinectSimulator]:
        kinects = [simulate_kinect(model=model, serial=f"{SERIAL[:-1]}{model}") for model in models]
        for name, value in simulator_environment(*kinects).items():
            monkeypatch.setenv(name, value)
        return kinects

    return plug


@pytest.mark.subprocess
def test_each_kinect_is_listed_with_its_camera_argument(
    plug_in: Callable[..., list[KinectSimulator]], kinect_vo: KinectVo
) -> None:
    kinects = plug_in(Played.K1414, Played.K1473)
    outcome = kinect_vo("devices")
    assert outcome.code == 0
    assert outcome.out.splitlines() == [
        f"--camera freenect:{kinects[0].serial}  Kinect 1414, bus 1 port 1.2",
        f"--camera freenect:{kinects[1].serial}  Kinect 1473, bus 2 port 1.2",
    ]


@pytest.mark.subprocess
def test_the_json_has_the_same_with_stable_keys(
    plug_in: Callable[..., list[KinectSimulator]], kinect_vo: KinectVo
) -> None:
    (kinect,) = plug_in(Played.K1414)
    kinect.deny_access()
    outcome = kinect_vo("devices", "--json")
    assert json.loads(outcome.out) == {
        "schema": 1,
        "devices": [
            {
                "camera": "freenect",
                "name": "Kinect 1414",
                "where": "bus 1 port 1.2",
                "serial": "",
                "error": "this user may not open it",
            }
        ],
        "plugins": [],
    }


@pytest.mark.subprocess
def test_without_a_sensor_there_is_advice(
    plug_in: Callable[..., list[KinectSimulator]], kinect_vo: KinectVo
) -> None:
    (kinect,) = plug_in(Played.K1414)
    kinect.unplug()
    outcome = kinect_vo("devices")
    assert (outcome.code, outcome.error_lines) == (0, "")
    assert "plug one in" in outcome.out
    assert "--camera synthetic" in outcome.out


def test_an_unsupported_sensor_is_listed_without_a_camera_argument() -> None:
    (found,) = list_available_devices([make_sensor(SensorModel.AZURE)], OpenNI2Listing())
    assert (found.camera, found.name, found.error) == ("", "Azure Kinect", "not supported")


def test_a_primesense_sensor_has_its_openni2_name() -> None:
    (found,) = list_available_devices(
        [make_sensor(SensorModel.CARMINE)], OpenNI2Listing((CARMINE,))
    )
    assert (found.camera, found.error) == ("openni2:1d27/0609@1/5", "")


@pytest.mark.parametrize("error_text", ["", "libOpenNI2.so.0 cannot be loaded"])
def test_a_primesense_sensor_unknown_to_openni2_is_listed(error_text: str) -> None:
    (found,) = list_available_devices(
        [make_sensor(SensorModel.CARMINE)], OpenNI2Listing((), error_text)
    )
    assert found.camera == "openni2"
    assert found.error == (error_text or "libOpenNI2 does not see it")


def test_a_kinect_in_use_is_listed_as_in_use() -> None:
    (found,) = list_available_devices(
        [make_sensor(serial="A1", open_error=OpenError.BUSY)], OpenNI2Listing()
    )
    assert (found.camera, found.error) == ("freenect:A1", "another program has it")
