"""The `[sensor]` table: settings of a real sensor, for every backend."""

from dataclasses import dataclass
from enum import StrEnum

from drivers.core.config import config_field


class Led(StrEnum):
    """A state of the Kinect's LED."""

    OFF = "off"
    GREEN = "green"
    RED = "red"
    YELLOW = "yellow"
    BLINK_GREEN = "blink-green"
    BLINK_RED_YELLOW = "blink-red-yellow"


@dataclass(frozen=True)
class SensorConfig:
    """Settings of a real sensor, applied whenever it is opened."""

    auto_exposure: bool = config_field(True, "false keeps the exposure that it has")
    auto_white_balance: bool = config_field(True, "false keeps the white balance that it has")
    mirror: bool = config_field(
        False, "left and right swapped, for a camera that looks into a mirror"
    )
    led: Led = config_field(Led.GREEN, "the light while it is open")
    tilt_deg: float | None = config_field(
        None,
        "tilt of the head against the horizon; unset = left as it is",
        minimum=-31.0,
        maximum=31.0,
    )
