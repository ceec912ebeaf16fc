"""The client: connects to a running kinect-vo, reads its poses, sends it commands."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any

import zenoh

from drivers.geometry import Array
from vo_service.client.arguments import (
    arguments_payload,
    check_command_name,
    check_max_age,
    check_timeout,
    reset_arguments,
)
from vo_service.client.asking import ask
from vo_service.client.connecting import Connecting
from vo_service.client.errors import NoAnswer
from vo_service.client.hearing import Hearing, Status
from vo_service.client.judging import SILENCE_S, usable, why_none
from vo_service.client.map_odom import MapOdom, read_map_odom
from vo_service.client.pose import Pose, PoseReader, ReaderOfEachThread, make_pose, read_sample
from vo_service.client.reading import Message, check_fields, read_json, read_status
from vo_service.settings import DEFAULT_ENDPOINT, ZenohConfig, check_prefix

# The service gives its loop five seconds for a command.
ANSWER_S = 6.0
# How long to wait for the service's token before it is asked all the same.
TOKEN_S = 1.0


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
        self._hearing = Hearing()
        self._connecting = Connecting(
            ZenohConfig(prefix, listen=(), connect=(connect,), config_file=file),
            lambda session: self._hearing.subscribe(session, prefix),
        )
        self._own = ReaderOfEachThread()

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
        self._hearing.close()
        self._connecting.close()

    # Poses

    def poses(self, timeout_s: float | None = None) -> Iterator[Pose]:
        """The newest pose, again and again as new ones come; lost ones too, see `Pose.state`.

        A reader that takes its time gets the newest next; `Pose.missed` counts the others. Waits as
        long as it takes or, with `timeout_s`, raises NoPose when none comes for so long.
        """
        check_timeout(timeout_s)
        return self._poses(self._hearing.pose.count, timeout_s)

    def _poses(self, count: int, timeout_s: float | None) -> Iterator[Pose]:
        reader, hearing = PoseReader(), self._hearing
        while newer := hearing.wait_for_newer(hearing.pose, count, timeout_s):
            count, heard = newer
            yield reader.read(heard)
        if not hearing.is_closed:
            raise why_none(hearing, self._where)

    def newest(self, max_age_s: float = 0.2) -> Pose:
        """The newest pose, at once.

        Raises NoPose, with the reason, unless it came within `max_age_s` and is not lost;
        InputError for an age that is negative or NaN. `is_continuous` and `missed` count from the
        pose that this thread got before.
        """
        check_max_age(max_age_s)
        return self._own.reader.read(usable(self._hearing, max_age_s, self._where))

    def latest(self, timeout_s: float = ANSWER_S) -> Pose:
        """The last pose that the service has published, asked for; it may be old.

        Raises CommandRefused if there is none yet, NoAnswer if nobody answers.
        """
        sample = ask(self._sessions(timeout_s), f"{self._prefix}/latest", timeout_s)
        return make_pose(read_sample(sample, run=0), is_continuous=False, missed=0)

    def map_odom(self, timeout_s: float = ANSWER_S) -> MapOdom:
        """How `odom` lies in the map now. What was heard lately is had at once; else it is asked.

        Raises CommandRefused if there is no map, NoAnswer if nobody answers.
        """
        heard = self._hearing.map_odom
        if heard.item is not None and heard.age_s < SILENCE_S:
            return heard.item
        return read_map_odom(ask(self._sessions(timeout_s), f"{self._prefix}/map_odom", timeout_s))

    # The service

    @property
    def is_alive(self) -> bool:
        """Whether the service is there."""
        return self._hearing.is_alive

    def wait_for_publisher(self, timeout_s: float | None = None) -> bool:
        """Wait until the service is there; False if it does not come in time."""
        check_timeout(timeout_s)
        return self._hearing.wait_until_alive(timeout_s)

    def status(self, timeout_s: float = ANSWER_S) -> Status:
        """The newest status; its fields are in `docs/messages.md`.

        Raises NoAnswer if none was heard lately and nobody answers.
        """
        heard = self._hearing.status
        if heard.item is not None and heard.age_s < SILENCE_S:
            return heard.item
        sample = ask(self._sessions(timeout_s), f"{self._prefix}/status", timeout_s)
        return read_status(sample.payload)

    def statuses(self) -> Iterator[Status]:
        """The newest status, again and again: twice a second, and on a change.

        That is one of state, reason or warnings.
        """
        count = 0
        while newer := self._hearing.wait_for_newer(self._hearing.status, count, None):
            count, status = newer
            yield status

    def schemas(self, timeout_s: float = ANSWER_S) -> Mapping[str, Any]:
        """JSON Schemas of the service's messages, by name. Raises NoAnswer."""
        schemas: Mapping[str, Any] = self._field("schema", {}, "schemas", dict, timeout_s)
        return schemas

    # Commands. Each raises CommandRefused with what the service said, NoAnswer if nobody answers,
    # InputError for arguments that cannot be sent.

    def reset(self, T_odom_base: Array | None = None) -> int:
        """Begin a new epoch with the base at this 4x4 pose, or level at the origin; its number.

        Raises InputError unless it is a rigid transform of finite numbers.
        """
        pose = {} if T_odom_base is None else reset_arguments(T_odom_base)
        return int(self._field("command/reset", pose, "epoch", int))

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
        return str(self._field("command/start-recording", {"name": name}, "folder", str))

    def stop_recording(self) -> str:
        """End the recording; the folder's path."""
        return str(self._field("command/stop-recording", {}, "folder", str))

    def save_incident(self) -> str:
        """Write out what the flight recorder holds; the folder's path."""
        return str(self._field("command/save-incident", {}, "folder", str))

    def save_map(self, name: str) -> str:
        """Have a map made; its file, which is there once `saved_map` in the status names it."""
        return str(self._field("command/save-map", {"name": name}, "file", str))

    def load_map(self, name: str) -> str:
        """Have a map's places known again; its file, loaded once `loaded_map` names it."""
        return str(self._field("command/load-map", {"name": name}, "file", str))

    def command(
        self,
        name: str,
        arguments: Mapping[str, object] = MappingProxyType({}),
        timeout_s: float = ANSWER_S,
    ) -> Mapping[str, Any]:
        """Any command by its name; what it answered. Raises InputError for what is no name."""
        check_command_name(name)
        answer = self._ask(f"command/{name}", timeout_s, arguments)
        return {key: value for key, value in answer.items() if key != "schema"}

    def _ask(self, name: str, timeout_s: float, arguments: Mapping[str, object]) -> Message:
        key = f"{self._prefix}/{name}"
        payload = arguments_payload(key, arguments)
        return read_json(ask(self._sessions(timeout_s), key, timeout_s, payload).payload)

    def _field(
        self,
        name: str,
        arguments: Mapping[str, object],
        field: str,
        kind: type,
        timeout_s: float = ANSWER_S,
    ) -> Any:
        answer = self._ask(name, timeout_s, arguments)
        check_fields(f"the answer to {name}", answer, {field: kind})
        return answer[field]

    def _sessions(self, timeout_s: float) -> list[zenoh.Session]:
        """The session to ask on, or none; waits for the service if it is not there."""
        check_timeout(timeout_s)
        if self._hearing.is_closed:
            raise NoAnswer(f"{self._prefix}: this client is closed; open another")
        is_open = bool(self._connecting.sessions)
        self.wait_for_publisher(min(TOKEN_S, timeout_s) if is_open else timeout_s)
        return self._connecting.sessions
