"""`[sensor]`: how a real sensor is set up, whichever library drives it."""

from dataclasses import dataclass
from enum import StrEnum

from drivers.strict_toml import setting


class Led(StrEnum):
    """The Kinect's light."""

    OFF = "off"
    GREEN = "green"
    RED = "red"
    YELLOW = "yellow"
    BLINK_GREEN = "blink-green"
    BLINK_RED_YELLOW = "blink-red-yellow"


@dataclass(frozen=True)
class SensorSettings:
    """Applied whenever the sensor is opened, so also after it was unplugged."""

    auto_exposure: bool = setting(True, "false keeps the exposure that it has")
    auto_white_balance: bool = setting(True, "false keeps the white balance that it has")
    mirror: bool = setting(False, "left and right swapped, for a camera that looks into a mirror")
    led: Led = setting(Led.GREEN, "the light while it is open")
    tilt_deg: float | None = setting(
        None, "tilt of the head against the horizon; unset = left as it is", low=-31.0, high=31.0
    )
