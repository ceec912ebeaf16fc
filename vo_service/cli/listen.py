"""``kinect-vo listen``: print the poses that a running kinect-vo publishes."""

import json
import math
import sys
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any

import zenoh

from drivers.ros_messages.decoding import decode_odometry, decode_transform
from drivers.ros_messages.navigation import OdometryMessage, TransformMessage
from vo_service.cli.options import DEFAULT_PREFIX, ClientConfigFile, ClientPrefix, Connect
from vo_service.cli.request import CommandRequest, flag, number_parser, option
from vo_service.client.connection import BackgroundConnection
from vo_service.config_tables import DEFAULT_ENDPOINT, ZenohConfig, check_prefix
from vo_service.outputs.zenoh.addresses import check_endpoint
from vo_service.signals import EXIT_CODE_SIGINT, InterruptedBySignal, raise_on_signals

EPILOG = """\
examples:
  kinect-vo listen                          poses of the kinect-vo on this computer
  kinect-vo listen --count 10 --json        ten poses, one JSON object a line
  kinect-vo listen --prefix robot1 --connect tcp/192.168.1.20:7450
  kinect-vo listen --prefix robot1 --config-file reader-tls.json5

A line is: stamp x y z qx qy qz qw state. Changes of the status and of the map->odom transform go to
stderr. The command waits for a publisher that has not started or has stopped. Ctrl-C ends it.
"""

# Time for the first message of a running publisher.
_STARTUP_WAIT_S = 1.0


def print_notice(text: str) -> None:
    """Print a notice to stderr; poses go to stdout."""
    print(f"listen: {text}", file=sys.stderr, flush=True)


class TextPosePrinter:
    """Prints poses as lines of a trajectory file; changes of status and map go to stderr."""

    def __init__(self) -> None:
        self._last_map: tuple[bool, int] = (True, 0)

    def print_pose(self, message: OdometryMessage, attachment: dict[str, Any]) -> None:
        """Print stamp, position, quaternion, state."""
        position = " ".join(f"{v:.4f}" for v in message.position_m)
        quaternion = " ".join(f"{v:.5f}" for v in message.quaternion_xyzw)
        state = attachment.get("state", "-")
        print(f"{message.stamp_s:.6f} {position} {quaternion} {state}", flush=True)

    def print_status(self, content: dict[str, Any]) -> None:
        """Print state and reason to stderr."""
        reason = f": {content['reason']}" if content["reason"] else ""
        print_notice(f"status {content['state']}{reason}")

    def print_map_odom(self, message: TransformMessage, attachment: dict[str, Any]) -> None:
        """Print to stderr after a loop closure or a change of localization, not per keyframe."""
        the_map = (bool(attachment["is_localized"]), int(attachment["loop_closures"]))
        if the_map == self._last_map:
            return
        self._last_map = is_localized, loop_closures = the_map
        if not is_localized:
            print_notice(
                f"map: {attachment['map_keyframes']} keyframes; its transform to odom is unknown"
            )
            return
        position = " ".join(f"{v:.4f}" for v in message.position_m)
        quaternion = " ".join(f"{v:.5f}" for v in message.quaternion_xyzw)
        print_notice(
            f"map: {attachment['map_keyframes']} keyframes, {loop_closures} loop closures; "
            f"odom at {position} {quaternion}"
        )


class JsonPosePrinter:
    """Prints one JSON object per line; `kind` is pose, status or map_odom."""

    def print_pose(self, message: OdometryMessage, attachment: dict[str, Any]) -> None:
        """Print the pose with the fields of the attachment."""
        names = ["seq", "state", "epoch", "reason"]
        keys = [name for name in names if name in attachment]
        self._print_pose("pose", message, attachment, keys)

    def print_status(self, content: dict[str, Any]) -> None:
        """Print the whole status."""
        self._print(kind="status", **content)

    def print_map_odom(self, message: TransformMessage, attachment: dict[str, Any]) -> None:
        """Print the transform with the fields of the attachment."""
        keys = ["seq", "epoch", "is_localized", "map_keyframes", "loop_closures"]
        self._print_pose("map_odom", message, attachment, keys)

    def _print_pose(
        self,
        kind: str,
        message: TransformMessage,
        attachment: dict[str, Any],
        keys: list[str],
    ) -> None:
        self._print(
            kind=kind,
            stamp_s=message.stamp_s,
            frame_id=message.frame_id,
            child_frame_id=message.child_frame_id,
            position_m=message.position_m.tolist(),
            quaternion_xyzw=message.quaternion_xyzw.tolist(),
            **{key: attachment[key] for key in keys},
        )

    def _print(self, **content: Any) -> None:
        print(json.dumps(content), flush=True)


PosePrinter = TextPosePrinter | JsonPosePrinter


_parse_count = number_parser(
    int, lambda value: value >= 1, "is not a number of poses: give 1 or more"
)


@dataclass(frozen=True, kw_only=True)
class ListenRequest(CommandRequest):
    """The service to listen to, and what to print."""

    connect: Connect = DEFAULT_ENDPOINT
    prefix: ClientPrefix = DEFAULT_PREFIX
    config_file: ClientConfigFile = None
    count: float = option("stop after N poses", math.inf, "N", _parse_count)
    json: bool = flag("one JSON object a line, changes of status and map too")


def run(request: ListenRequest) -> int:
    """Print until `--count` poses are received, or Ctrl-C.

    Raises:
        BrokenPipeError: The reader has closed the pipe.
    """
    prefix = check_prefix(request.prefix)
    printer: PosePrinter = JsonPosePrinter() if request.json else TextPosePrinter()
    where = request.config_file or request.connect
    listener = _PosePrintingSubscriber(f"{prefix} at {where}", printer, request.count)
    check_endpoint(request.connect)
    plan = ZenohConfig(listen=(), connect=(request.connect,), config_file=request.config_file)
    try:
        # A script that starts it with `&` has SIGINT ignored unless it is handled.
        with (
            raise_on_signals(),
            closing(BackgroundConnection(plan, partial(listener.subscribe, prefix))),
        ):
            listener.run()
    except InterruptedBySignal as interruption:
        return 0 if interruption.exit_code == EXIT_CODE_SIGINT else interruption.exit_code
    return 0


class _PosePrintingSubscriber:
    """Receives samples on Zenoh's threads and prints them on the caller's thread."""

    def __init__(self, publisher: str, printer: PosePrinter, count: float) -> None:
        self._publisher = publisher
        self._printer = printer
        self._remaining = count
        self._last_status: tuple[str, str] = ("", "")
        self._samples: SimpleQueue[zenoh.Sample] = SimpleQueue()
        self._last_map_odom: tuple[bytes, dict[str, Any]] = (b"", {})
        self._handlers = {
            "alive": self._on_liveliness,
            "status": self._on_status,
            "map_odom": self._on_map_odom,
            "odom": self._on_odom,
        }

    def subscribe(self, prefix: str, session: zenoh.Session) -> None:
        """Subscribe to the keys with a prefix; samples are queued on threads of Zenoh."""
        for key in ("status", "map_odom", "odom"):
            session.declare_subscriber(f"{prefix}/{key}", self._samples.put)
        session.liveliness().declare_subscriber(f"{prefix}/alive", self._samples.put, history=True)

    def run(self) -> None:
        """Print until enough poses are received."""
        try:
            self._handle(self._samples.get(timeout=_STARTUP_WAIT_S))
        except Empty:
            print_notice(f"waiting for {self._publisher} (Ctrl-C ends)")
        while self._remaining > 0:
            self._handle(self._samples.get())

    def _handle(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        try:
            self._handlers[key.rsplit("/", 1)[-1]](sample)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            print_notice(f"{key}: ignored a message that cannot be read: {error}")

    def _on_liveliness(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            print_notice(f"listening to {self._publisher}")
        else:
            print_notice(f"{self._publisher} disconnected; waiting for it (Ctrl-C ends)")

    def _on_status(self, sample: zenoh.Sample) -> None:
        content = json.loads(sample.payload.to_bytes())
        status = (str(content["state"]), str(content["reason"]))
        if status != self._last_status:
            self._last_status = status
            self._printer.print_status(content)

    def _on_map_odom(self, sample: zenoh.Sample) -> None:
        """Print the transform if it has changed; it is published again twice a second."""
        message = decode_transform(sample.payload.to_bytes())
        attachment = _decode_attachment(sample)
        map_odom = (message.T_frame_child.tobytes(), attachment | {"seq": 0})
        if map_odom != self._last_map_odom:
            self._last_map_odom = map_odom
            self._printer.print_map_odom(message, attachment)

    def _on_odom(self, sample: zenoh.Sample) -> None:
        self._printer.print_pose(
            decode_odometry(sample.payload.to_bytes()), _decode_attachment(sample)
        )
        self._remaining -= 1


def _decode_attachment(sample: zenoh.Sample) -> dict[str, Any]:
    """Decode the attachment's JSON; {} without an attachment."""
    content: dict[str, Any] = json.loads(sample.attachment.to_bytes()) if sample.attachment else {}
    return content
