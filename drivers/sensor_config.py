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

    auto_exposure: bool = config_field(True, "false keeps the current exposure")
    auto_white_balance: bool = config_field(True, "false keeps the current white balance")
    mirror: bool = config_field(False, "swap left and right, for a camera that looks into a mirror")
    led: Led = config_field(Led.GREEN, "LED while the sensor is open")
    tilt_deg: float | None = config_field(
        None,
        "tilt of the head against the horizon; unset = unchanged",
        minimum=-31.0,
        maximum=31.0,
    )
