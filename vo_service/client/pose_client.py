"""Client of one service: its poses, its status, and commands to it."""

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import zenoh

from drivers.core import InputError
from drivers.ros_messages.decoding import decode_occupancy_grid
from drivers.ros_messages.navigation import (
    ODOMETRY_SCHEMA,
    TWIST_SCHEMA,
    OccupancyGridMessage,
    encode_twist,
)
from vo_service.client.connection import (
    CommandRefused,
    ServiceUnavailable,
    check_timeout,
    encode_arguments,
    query,
)
from vo_service.client.pose import (
    MapOdom,
    Pose,
    PoseReader,
    ThreadLocalReader,
    make_pose,
    parse_map_odom,
    parse_pose_sample,
)
from vo_service.client.subscription import (
    MAX_SILENCE_S,
    ServiceClient,
    StatusMessage,
    parse_status,
    pose_unavailable_error,
    require_fresh,
)
from vo_service.config_tables import DEFAULT_ENDPOINT
from vo_service.types.commands import Reply, TypedCommand
from vo_service.types.messages import JsonObject, decode_message, parse_json_message
from vo_service.wheel_odometry.planar_pose import PlanarPose, PlanarTwist
from vo_service.wheel_odometry.wheel_reading import (
    TwistVariances,
    WheelReading,
    encode_wheel_reading,
)

# The service gives its loop five seconds for a command.
REPLY_TIMEOUT_S = 6.0
# Of the wheels' poses: any frame, and the robot's base.
WHEEL_FRAME_IDS = ("wheel_odom", "base_link")
ODOMETRY_CDR = zenoh.Encoding.APPLICATION_CDR.with_schema(ODOMETRY_SCHEMA)
TWIST_CDR = zenoh.Encoding.APPLICATION_CDR.with_schema(TWIST_SCHEMA)
# Wait this long for the service's liveliness token; then send the query anyway.
LIVELINESS_TIMEOUT_S = 1.0


@dataclass(frozen=True)
class _SchemaReply:
    schemas: dict[str, Any]


class PoseClient(ServiceClient):
    """Client of one service. If the service is not there, the client waits and reconnects.

    Thread-safe; each thread that calls `newest` is a separate reader. Timeouts are in seconds; a
    negative or infinite one raises InputError. After `close`, every query raises
    ServiceUnavailable. A reply that cannot be parsed raises ValueError.
    """

    def __init__(
        self,
        prefix: str = "kinect",
        connect: str = DEFAULT_ENDPOINT,
        config_file: Path | str | None = None,
    ) -> None:
        """Connect to a service; see `ServiceClient`."""
        super().__init__(prefix, connect, config_file)
        self._thread_local = ThreadLocalReader()

    # Poses

    def poses(self, timeout_s: float | None = None) -> Iterator[Pose]:
        """Iterate over poses as they arrive, lost ones too; see `Pose.state`.

        A slow reader skips to the newest pose; `Pose.missed` counts the skipped ones.

        Args:
            timeout_s: Longest wait for the next pose; None waits without limit.

        Raises:
            PoseUnavailable: No pose arrived in time.
        """
        check_timeout(timeout_s)
        return self._poses(self._state.pose.count, timeout_s)

    def _poses(self, count: int, timeout_s: float | None) -> Iterator[Pose]:
        reader, state = PoseReader(), self._state
        while newer := state.wait_for_newer(state.pose, count, timeout_s):
            count, received = newer
            yield reader.read(received)
        if not state.is_closed:
            raise pose_unavailable_error(state, self._where)

    def newest(self, max_age_s: float = 0.2) -> Pose:
        """Return the newest pose without waiting.

        `is_continuous` and `missed` compare it with this thread's previous pose.

        Raises:
            PoseUnavailable: No pose arrived within `max_age_s`, or tracking is lost.
            InputError: `max_age_s` is negative or NaN.
        """
        if not max_age_s >= 0:  # infinity accepts any age
            raise InputError(f"max_age_s = {max_age_s:g}: give seconds, zero or more")
        return self._thread_local.reader.read(require_fresh(self._state, max_age_s, self._where))

    def query_latest(self, timeout_s: float = REPLY_TIMEOUT_S) -> Pose:
        """Query the last pose that the service has published; it may be old.

        Raises:
            CommandRefused: There is no pose yet.
            ServiceUnavailable: No service replied.
        """
        sample = query(self._sessions(timeout_s), f"{self._prefix}/latest", timeout_s)
        return make_pose(parse_pose_sample(sample, run=0), is_continuous=False, missed=0)

    def map_odom(self, timeout_s: float = REPLY_TIMEOUT_S) -> MapOdom:
        """Return the map->odom transform: a recent message if there is one, else a query.

        Raises:
            CommandRefused: There is no map.
            ServiceUnavailable: No service replied.
        """
        self._check_open()
        latest = self._state.map_odom
        if latest.item is not None and latest.age_s < MAX_SILENCE_S:
            return latest.item
        return parse_map_odom(
            query(self._sessions(timeout_s), f"{self._prefix}/map_odom", timeout_s)
        )

    def grid(self, timeout_s: float = REPLY_TIMEOUT_S) -> OccupancyGridMessage:
        """Return the occupancy grid of the map, at any time.

        Raises:
            CommandRefused: There is no grid yet.
            ServiceUnavailable: No service replied.
        """
        sample = query(self._sessions(timeout_s), f"{self._prefix}/map", timeout_s)
        return decode_occupancy_grid(sample.payload.to_bytes())

    # The service

    @property
    def is_alive(self) -> bool:
        """Whether the service is running and reachable."""
        return self._state.is_alive

    def wait_for_publisher(self, timeout_s: float | None = None) -> bool:
        """Wait until the service is reachable; False on timeout."""
        check_timeout(timeout_s)
        return self._state.wait_until_alive(timeout_s)

    def status(self, timeout_s: float = REPLY_TIMEOUT_S) -> StatusMessage:
        """Return the newest status; `docs/reference/messages.md` lists its fields.

        Raises:
            ServiceUnavailable: No status arrived recently and no service replied.
        """
        self._check_open()
        latest = self._state.status
        count = latest.count
        if latest.item is not None and latest.age_s < MAX_SILENCE_S:
            return latest.item
        key = f"{self._prefix}/status"
        try:
            return parse_status(query(self._sessions(timeout_s), key, timeout_s).payload)
        except CommandRefused as error:  # the service starts: it has none yet, but will send it
            newer = self._state.wait_for_newer(latest, count, timeout_s)
            if newer is None:
                raise ServiceUnavailable(f"{key}: {error}") from error
            return newer[1]

    def statuses(self) -> Iterator[StatusMessage]:
        """Iterate over statuses: two a second, and one when state, reason or warnings change."""
        count = 0
        while newer := self._state.wait_for_newer(self._state.status, count, None):
            count, status = newer
            yield status

    def schemas(self, timeout_s: float = REPLY_TIMEOUT_S) -> Mapping[str, Any]:
        """Return the JSON Schemas of the service's messages, by name.

        Raises:
            ServiceUnavailable: No service replied.
        """
        reply = decode_message(
            _SchemaReply, self._query("schema", timeout_s), "the reply to schema"
        )
        return reply.schemas

    # Commands

    def send(self, command: TypedCommand[Reply], timeout_s: float = REPLY_TIMEOUT_S) -> Reply:
        """Send a command of `vo_service.types` and return its reply.

        Example: ``client.send(TiltCommand(10.0))``.

        Args:
            timeout_s: Longest wait for the reply, seconds.

        Raises:
            CommandRefused: The service refused the command; the text is its message.
            ServiceUnavailable: No service replied.
            InputError: An argument cannot be sent.
        """
        name = command.command_name
        given = {key: value for key, value in vars(command).items() if value is not None}
        reply = self._query(f"command/{name}", timeout_s, given)
        return decode_message(command.reply_type(), reply, f"the reply to command/{name}")

    def command(
        self,
        name: str,
        arguments: Mapping[str, object] = MappingProxyType({}),
        timeout_s: float = REPLY_TIMEOUT_S,
    ) -> Mapping[str, Any]:
        """Send any command by its name and return the fields of its reply.

        Args:
            name: Last part of the key, such as "save-map".
            arguments: Arguments by name, as JSON.
            timeout_s: Longest wait for the reply, s.

        Raises:
            InputError: The name or an argument is invalid.
        """
        if not re.fullmatch(r"[A-Za-z0-9_-]+", name):  # one part of a Zenoh key
            raise InputError(f"{name!r} is not a command name; see kinect-vo command --help")
        reply = self._query(f"command/{name}", timeout_s, arguments)
        return {key: value for key, value in reply.items() if key != "schema"}

    # The robot's base

    def send_wheel_odometry(
        self,
        stamp_s: float,
        x_m: float,
        y_m: float,
        yaw_rad: float,
        twist: tuple[float, float, float] = (0.0, 0.0, 0.0),
        twist_variances: TwistVariances = (None, None, None),
    ) -> None:
        """Send a pose of the base by its wheels, for a service with `[wheel_odometry]`.

        Does not block; while the service is not reachable, the pose is lost.

        Args:
            stamp_s: Time of the pose, Unix seconds.
            x_m: Position in any frame that does not move, x forward at the start.
            y_m: The same to the left.
            yaw_rad: Angle, counterclockwise.
            twist: Velocity forward and to the left, m/s, and of the yaw, rad/s; all 0: not known.
            twist_variances: Their variances; None: not known.

        Raises:
            InputError: A number is not finite, or the stamp is no Unix time.
            ServiceUnavailable: The client is closed.
        """
        self._check_open()
        _check_finite("the odometry of the wheels", (stamp_s, x_m, y_m, yaw_rad, *twist))
        reading = WheelReading(
            stamp_s,
            WHEEL_FRAME_IDS,
            PlanarPose(x_m, y_m, yaw_rad),
            PlanarTwist(*twist),
            twist_variances,
        )
        try:
            payload = encode_wheel_reading(reading)
        except ValueError as error:
            raise InputError(f"the odometry of the wheels cannot be sent: {error}") from error
        self._put("wheel_odom", payload, ODOMETRY_CDR)

    def send_velocity(self, forward_m_s: float, yaw_rad_s: float) -> None:
        """Drive the simulated base of a service whose virtual Kinect has the motion `driven`.

        Send it at least four times a second: the base stops half a second after the last one. Does
        not block; while the service is not reachable, the velocity is lost.

        Args:
            forward_m_s: Velocity forward, at most 1 m/s.
            yaw_rad_s: Velocity to the left, at most 2 rad/s.

        Raises:
            InputError: A number is not finite.
            ServiceUnavailable: The client is closed.
        """
        self._check_open()
        _check_finite("the velocity", (forward_m_s, yaw_rad_s))
        payload = encode_twist(np.array([forward_m_s, 0.0, 0.0, 0.0, 0.0, yaw_rad_s]))
        self._put("cmd_vel", payload, TWIST_CDR)

    def _put(self, name: str, payload: bytes, encoding: zenoh.Encoding) -> None:
        for session in self._connection.sessions:
            session.put(f"{self._prefix}/{name}", payload, encoding=encoding, express=True)

    def _query(
        self,
        name: str,
        timeout_s: float,
        arguments: Mapping[str, object] = MappingProxyType({}),
    ) -> JsonObject:
        key = f"{self._prefix}/{name}"
        payload = encode_arguments(key, arguments)
        sample = query(self._sessions(timeout_s), key, timeout_s, payload)
        return parse_json_message(sample.payload.to_bytes())

    def _sessions(self, timeout_s: float) -> list[zenoh.Session]:
        """Return the session to query on, if any; waits for the service if it is not there."""
        check_timeout(timeout_s)
        self._check_open()
        is_open = bool(self._connection.sessions)
        self.wait_for_publisher(min(LIVELINESS_TIMEOUT_S, timeout_s) if is_open else timeout_s)
        return self._connection.sessions

    def _check_open(self) -> None:
        if self._state.is_closed:
            raise ServiceUnavailable(f"{self._prefix}: this client is closed; open another")


def _check_finite(what: str, values: Iterable[object]) -> None:
    """Raise InputError unless all values are finite numbers."""
    for value in values:
        if not (isinstance(value, Real) and math.isfinite(value)):
            raise InputError(f"{what} cannot be sent: {value!r} is not a finite number")
