"""The client: connects to a running kinect-vo, reads its poses, sends it commands."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any

import zenoh

from drivers.geometry import Array, quaternion_from_rotation
from vo_service.client.asking import ask, ask_json
from vo_service.client.connecting import Connecting
from vo_service.client.hearing import Hearing, Status
from vo_service.client.judging import SILENCE_S, usable, why_none
from vo_service.client.pose import Pose, PoseReader, make_pose, read_sample
from vo_service.outputs.zenoh_session import DEFAULT_ENDPOINT, ZenohConfig, check_prefix

# The service gives its loop five seconds for a command.
ANSWER_S = 6.0
# How long to wait for the service's token before it is asked all the same.
TOKEN_S = 1.0


class PoseClient:
    """Reads one service. Stays connected: a service that is not there yet or goes is waited for.

    Any number of threads may use it.
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
        self._reader = PoseReader()

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

        Raises NoPose, with the reason, unless it came within `max_age_s` and is not lost.
        """
        return self._reader.read(usable(self._hearing, max_age_s, self._where))

    def latest(self, timeout_s: float = ANSWER_S) -> Pose:
        """The last pose that the service has published, asked for; it may be old.

        Raises CommandRefused if there is none yet, NoAnswer if nobody answers.
        """
        sample = ask(self._sessions(timeout_s), f"{self._prefix}/latest", timeout_s)
        return make_pose(read_sample(sample, run=0), is_continuous=False, missed=0)

    # The service

    @property
    def is_alive(self) -> bool:
        """Whether the service is there."""
        return self._hearing.is_alive

    def wait_for_publisher(self, timeout_s: float | None = None) -> bool:
        """Wait until the service is there; False if it does not come in time."""
        return self._hearing.wait_until_alive(timeout_s)

    def status(self, timeout_s: float = ANSWER_S) -> Status:
        """The newest status; its fields are in `docs/messages.md`.

        Raises NoAnswer if none was heard lately and nobody answers.
        """
        heard = self._hearing.status
        if heard.item is not None and heard.age_s < SILENCE_S:
            return heard.item
        return self._ask("status", timeout_s, {})

    def statuses(self) -> Iterator[Status]:
        """The newest status, again and again: twice a second, and when the state changes."""
        count = 0
        while newer := self._hearing.wait_for_newer(self._hearing.status, count, None):
            count, status = newer
            yield status

    def schemas(self, timeout_s: float = ANSWER_S) -> Mapping[str, Any]:
        """JSON Schemas of the service's messages, by name. Raises NoAnswer."""
        schemas: Mapping[str, Any] = self._ask("schema", timeout_s, {})["schemas"]
        return schemas

    # Commands. Each raises CommandRefused with what the service said, NoAnswer if nobody answers.

    def reset(self, T_odom_base: Array | None = None) -> int:
        """Begin a new epoch with the base at this 4x4 pose, or level at the origin; its number."""
        if T_odom_base is None:
            return int(self.command("reset")["epoch"])
        pose = {
            "position_m": T_odom_base[:3, 3].tolist(),
            "quaternion_xyzw": quaternion_from_rotation(T_odom_base[:3, :3]).tolist(),
        }
        return int(self.command("reset", pose)["epoch"])

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
        return str(self.command("start-recording", {"name": name})["folder"])

    def stop_recording(self) -> str:
        """End the recording; the folder's path."""
        return str(self.command("stop-recording")["folder"])

    def save_incident(self) -> str:
        """Write out what the flight recorder holds; the folder's path."""
        return str(self.command("save-incident")["folder"])

    def command(
        self,
        name: str,
        arguments: Mapping[str, object] = MappingProxyType({}),
        timeout_s: float = ANSWER_S,
    ) -> Mapping[str, Any]:
        """Any command by its name; what it answered."""
        answer = self._ask(f"command/{name}", timeout_s, arguments)
        return {key: value for key, value in answer.items() if key != "schema"}

    def _ask(self, name: str, timeout_s: float, arguments: Mapping[str, object]) -> Status:
        key = f"{self._prefix}/{name}"
        return ask_json(self._sessions(timeout_s), key, timeout_s, arguments)

    def _sessions(self, timeout_s: float) -> list[zenoh.Session]:
        """The session to ask on, or none; waits for the service if it is not there."""
        is_open = bool(self._connecting.sessions)
        self.wait_for_publisher(min(TOKEN_S, timeout_s) if is_open else timeout_s)
        return self._connecting.sessions
