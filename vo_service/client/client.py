"""The client: connects to a running kinect-vo, reads its poses, sends it commands."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any

import zenoh

from drivers.core.geometry import Array
from vo_service.client.arguments import (
    check_command_name,
    check_max_age,
    check_timeout,
    encode_arguments,
    reset_arguments,
)
from vo_service.client.connection import BackgroundConnection
from vo_service.client.errors import ServiceUnavailable
from vo_service.client.freshness import MAX_SILENCE_S, pose_unavailable_error, require_fresh
from vo_service.client.map_odom import MapOdom, parse_map_odom
from vo_service.client.message_parsing import JsonObject, check_fields, parse_json, parse_status
from vo_service.client.pose import Pose, PoseReader, ThreadLocalReader, make_pose, parse_pose_sample
from vo_service.client.query import query
from vo_service.client.subscription import ServiceState, StatusMessage
from vo_service.config_tables import DEFAULT_ENDPOINT, ZenohConfig, check_prefix

# The service gives its loop five seconds for a command.
REPLY_TIMEOUT_S = 6.0
# How long to wait for the service's token before it is asked all the same.
LIVELINESS_TIMEOUT_S = 1.0


class PoseClient:
    """Reads one service. Stays connected: a service that is not there yet or goes is waited for.

    Any number of threads may use it; each that calls `newest` is a reader of its own. Every
    time-out is in seconds; one that is negative or not finite raises InputError. After `close`
    every question raises NoAnswer. An answer that cannot be read raises ValueError.
    """

    def __init__(
        self,
        prefix: str = "kinect",
        connect: str = DEFAULT_ENDPOINT,
        config_file: Path | str | None = None,
    ) -> None:
        """Connect to `connect`, or wherever a Zenoh configuration (JSON5, for TLS) says.

        Raises InputError if one of the three is wrong.
        """
        self._prefix = check_prefix(prefix)
        file = None if config_file is None else Path(config_file)
        self._where = f"as {prefix} " + (
            f"at {connect}" if file is None else f"where {file} says, or it refuses us"
        )
        self._state = ServiceState()
        self._connection = BackgroundConnection(
            ZenohConfig(prefix, listen=(), connect=(connect,), config_file=file),
            lambda session: self._state.subscribe(session, prefix),
        )
        self._thread_local = ThreadLocalReader()

    def __enter__(self) -> "PoseClient":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Disconnect; `poses` and `statuses` end. Safe to call twice."""
        self._state.close()
        self._connection.close()

    # Poses

    def poses(self, timeout_s: float | None = None) -> Iterator[Pose]:
        """The newest pose, again and again as new ones come; lost ones too, see `Pose.state`.

        A reader that takes its time gets the newest next; `Pose.missed` counts the others. Waits as
        long as it takes or, with `timeout_s`, raises NoPose when none comes for so long.
        """
        check_timeout(timeout_s)
        return self._poses(self._state.pose.count, timeout_s)

    def _poses(self, count: int, timeout_s: float | None) -> Iterator[Pose]:
        reader, hearing = PoseReader(), self._state
        while newer := hearing.wait_for_newer(hearing.pose, count, timeout_s):
            count, heard = newer
            yield reader.read(heard)
        if not hearing.is_closed:
            raise pose_unavailable_error(hearing, self._where)

    def newest(self, max_age_s: float = 0.2) -> Pose:
        """The newest pose, at once.

        Raises NoPose, with the reason, unless it came within `max_age_s` and is not lost;
        InputError for an age that is negative or NaN. `is_continuous` and `missed` count from the
        pose that this thread got before.
        """
        check_max_age(max_age_s)
        return self._thread_local.reader.read(require_fresh(self._state, max_age_s, self._where))

    def query_latest(self, timeout_s: float = REPLY_TIMEOUT_S) -> Pose:
        """The last pose that the service has published, asked for; it may be old.

        Raises CommandRefused if there is none yet, NoAnswer if nobody answers.
        """
        sample = query(self._sessions(timeout_s), f"{self._prefix}/latest", timeout_s)
        return make_pose(parse_pose_sample(sample, run=0), is_continuous=False, missed=0)

    def map_odom(self, timeout_s: float = REPLY_TIMEOUT_S) -> MapOdom:
        """How `odom` lies in the map now. What was heard lately is had at once; else it is asked.

        Raises CommandRefused if there is no map, NoAnswer if nobody answers.
        """
        heard = self._state.map_odom
        if heard.item is not None and heard.age_s < MAX_SILENCE_S:
            return heard.item
        return parse_map_odom(
            query(self._sessions(timeout_s), f"{self._prefix}/map_odom", timeout_s)
        )

    # The service

    @property
    def is_alive(self) -> bool:
        """Whether the service is there."""
        return self._state.is_alive

    def wait_for_publisher(self, timeout_s: float | None = None) -> bool:
        """Wait until the service is there; False if it does not come in time."""
        check_timeout(timeout_s)
        return self._state.wait_until_alive(timeout_s)

    def status(self, timeout_s: float = REPLY_TIMEOUT_S) -> StatusMessage:
        """The newest status; its fields are in `docs/messages.md`.

        Raises NoAnswer if none was heard lately and nobody answers.
        """
        heard = self._state.status
        if heard.item is not None and heard.age_s < MAX_SILENCE_S:
            return heard.item
        sample = query(self._sessions(timeout_s), f"{self._prefix}/status", timeout_s)
        return parse_status(sample.payload)

    def statuses(self) -> Iterator[StatusMessage]:
        """The newest status, again and again: twice a second, and on a change.

        That is one of state, reason or warnings.
        """
        count = 0
        while newer := self._state.wait_for_newer(self._state.status, count, None):
            count, status = newer
            yield status

    def schemas(self, timeout_s: float = REPLY_TIMEOUT_S) -> Mapping[str, Any]:
        """JSON Schemas of the service's messages, by name. Raises NoAnswer."""
        schemas: Mapping[str, Any] = self._query_field("schema", {}, "schemas", dict, timeout_s)
        return schemas

    # Commands. Each raises CommandRefused with what the service said, NoAnswer if nobody answers,
    # InputError for arguments that cannot be sent.

    def reset(self, T_odom_base: Array | None = None) -> int:
        """Begin a new epoch with the base at this 4x4 pose, or level at the origin; its number.

        Raises InputError unless it is a rigid transform of finite numbers.
        """
        pose = {} if T_odom_base is None else reset_arguments(T_odom_base)
        return int(self._query_field("command/reset", pose, "epoch", int))

    def pause(self) -> None:
        """Publish no poses until `resume`."""
        self.command("pause")

    def resume(self) -> None:
        """Go on after `pause`."""
        self.command("resume")

    def tilt(self, tilt_deg: float) -> None:
        """Tilt the sensor's head against the horizon."""
        self.command("tilt", {"tilt_deg": tilt_deg})

    def led(self, led: str) -> None:
        """Switch the sensor's light: off, green, red, yellow, blink-green, blink-red-yellow."""
        self.command("led", {"led": led})

    def start_recording(self, name: str) -> str:
        """Record frames into a folder of this name; its path on the service's computer."""
        return str(self._query_field("command/start-recording", {"name": name}, "folder", str))

    def stop_recording(self) -> str:
        """End the recording; the folder's path."""
        return str(self._query_field("command/stop-recording", {}, "folder", str))

    def save_incident(self) -> str:
        """Write out what the flight recorder holds; the folder's path."""
        return str(self._query_field("command/save-incident", {}, "folder", str))

    def save_map(self, name: str) -> str:
        """Have a map made; its file, which is there once `saved_map` in the status names it."""
        return str(self._query_field("command/save-map", {"name": name}, "file", str))

    def load_map(self, name: str) -> str:
        """Have a map's places known again; its file, loaded once `loaded_map` names it."""
        return str(self._query_field("command/load-map", {"name": name}, "file", str))

    def command(
        self,
        name: str,
        arguments: Mapping[str, object] = MappingProxyType({}),
        timeout_s: float = REPLY_TIMEOUT_S,
    ) -> Mapping[str, Any]:
        """Any command by its name; what it answered. Raises InputError for what is no name."""
        check_command_name(name)
        answer = self._query(f"command/{name}", timeout_s, arguments)
        return {key: value for key, value in answer.items() if key != "schema"}

    def _query(self, name: str, timeout_s: float, arguments: Mapping[str, object]) -> JsonObject:
        key = f"{self._prefix}/{name}"
        payload = encode_arguments(key, arguments)
        return parse_json(query(self._sessions(timeout_s), key, timeout_s, payload).payload)

    def _query_field(
        self,
        name: str,
        arguments: Mapping[str, object],
        field: str,
        kind: type,
        timeout_s: float = REPLY_TIMEOUT_S,
    ) -> Any:
        answer = self._query(name, timeout_s, arguments)
        check_fields(f"the answer to {name}", answer, {field: kind})
        return answer[field]

    def _sessions(self, timeout_s: float) -> list[zenoh.Session]:
        """The session to ask on, or none; waits for the service if it is not there."""
        check_timeout(timeout_s)
        if self._state.is_closed:
            raise ServiceUnavailable(f"{self._prefix}: this client is closed; open another")
        is_open = bool(self._connection.sessions)
        self.wait_for_publisher(min(LIVELINESS_TIMEOUT_S, timeout_s) if is_open else timeout_s)
        return self._connection.sessions
