"""Settings of ROS's middleware, which have to be made before rclpy is imported.

Fast DDS puts messages into a segment of shared memory. Its default of 0.5 MB holds half of a color
image, and best-effort readers then lose most images. ROS's default discovery, SUBNET, would show
images of private rooms to the whole network.
"""

import tempfile
from collections.abc import MutableMapping
from pathlib import Path
from typing import IO

SEGMENT_BYTES = 16 << 20
PROFILE_VARIABLES = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")
# Fast DDS reads this file of the working directory without being told.
_LOCAL_PROFILE = Path("DEFAULT_FASTDDS_PROFILES.xml")
_DISCOVERY_VARIABLES = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY")
# Major versions of rclpy.
_FIRST_WITH_DISCOVERY_RANGE = 4  # iron
_FIRST_WITH_FASTDDS_VARIABLE = 9  # kilted

_PROFILE = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com">
  <profiles>
    <transport_descriptors>
      <transport_descriptor>
        <transport_id>shared_memory</transport_id>
        <type>SHM</type>
        <segment_size>{segment_bytes}</segment_size>
      </transport_descriptor>
      <transport_descriptor>
        <transport_id>udp</transport_id>
        <type>UDPv4</type>
        {interfaces}
      </transport_descriptor>
    </transport_descriptors>
    <participant profile_name="kinect_vo" is_default_profile="true">
      <rtps>
        <userTransports>
          <transport_id>shared_memory</transport_id>
          <transport_id>udp</transport_id>
        </userTransports>
        <useBuiltinTransports>false</useBuiltinTransports>
      </rtps>
    </participant>
  </profiles>
</dds>
"""
_LOOPBACK = "<interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>"


def prepare_middleware(environment: MutableMapping[str, str], rclpy_version: str) -> list[IO[str]]:
    """Limit discovery to this computer and give Fast DDS more shared memory, unless the user chose.

    Args:
        environment: Environment of the process; changed.
        rclpy_version: Version of rclpy, such as "7.1.6".

    Returns:
        The profile, which Fast DDS reads when the node starts; it is removed when it is closed,
        and left behind by a process that is killed before.
    """
    major = int(rclpy_version.partition(".")[0])
    if not any(name in environment for name in _DISCOVERY_VARIABLES):
        if major < _FIRST_WITH_DISCOVERY_RANGE:
            environment["ROS_LOCALHOST_ONLY"] = "1"
        else:
            environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    if any(name in environment for name in PROFILE_VARIABLES) or _LOCAL_PROFILE.exists():
        return []
    profile = tempfile.NamedTemporaryFile("w", prefix="kinect_vo-", suffix=".xml")  # noqa: SIM115
    interfaces = _LOOPBACK if is_local(environment) else ""
    profile.write(_PROFILE.format(segment_bytes=SEGMENT_BYTES, interfaces=interfaces))
    profile.flush()
    fastdds, fastrtps = PROFILE_VARIABLES
    environment[fastrtps if major < _FIRST_WITH_FASTDDS_VARIABLE else fastdds] = profile.name
    return [profile]


def is_local(environment: MutableMapping[str, str]) -> bool:
    """Whether only nodes of this computer are discovered."""
    return (
        environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "LOCALHOST"
        or environment.get("ROS_LOCALHOST_ONLY") == "1"
    )
